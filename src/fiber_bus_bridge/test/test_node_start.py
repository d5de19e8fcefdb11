# SPDX-License-Identifier: Apache-2.0
"""Plans that wait for orders or a start: which one a start means, and how they end."""

import numpy as np
import pytest
from rest_of_graph import COUNTS, PLANE, turning
from test_node_memory import unfolding

from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import topics

pytestmark = pytest.mark.timeout(600)


def test_newer_orders_replace_those_that_wait(rest):
    rest.ask(20, PLANE.ids, PLANE.centers + 3.0)
    rest.ready(20)
    rest.ready(21, turning(ticks=10))
    result, reason, _ = rest.end(20)
    assert np.all(result == Outcome.HELD) and np.all(reason == Reason.STOPPED)
    # which plan is meant is not known any more
    answer = rest.call(topics.START)
    assert not answer.success and "have taken the place of plan 0.000000020" in answer.message
    assert np.array_equal(rest.counts(), COUNTS)
    rest.name_plan("0.000000020")
    answer = rest.call(topics.START)
    assert not answer.success and "the orders of plan 0.000000021 wait" in answer.message
    rest.name_plan("0.000000021")
    assert rest.call(topics.START).success
    rest.end(21)
    rest.until(lambda: np.array_equal(rest.counts(), turning(ticks=10).end))


def test_a_plan_is_not_started_while_newer_targets_are_planned_from_its_start(rest):
    rest.ready(20)
    rest.ask_ends(21, turning(ticks=10))
    for name in ("", "0.000000020"):
        rest.name_plan(name)
        answer = rest.call(topics.START)
        assert not answer.success
        assert "targets of plan 0.000000021 have come since" in answer.message
    rest.order(21, turning(ticks=10))
    rest.end(20)
    rest.name_plan("0.000000021")
    assert rest.call(topics.START).success
    rest.end(21)
    rest.until(lambda: np.array_equal(rest.counts(), turning(ticks=10).end))


@pytest.mark.parametrize("ready", [False, True])
def test_a_plan_whose_bridge_ends_before_its_start_is_told_by_the_next(night, ready):
    night.ask_ends(9, unfolding(300))
    if ready:
        night.ready(9, unfolding(300))
    night.restart()
    result, reason, _ = night.end(9)
    assert np.all(result == Outcome.HELD) and np.all(reason == Reason.NOT_PLANNED)
    night.ready(20)
    assert night.call(topics.START).success
    result, _, _ = night.end(20)
    assert np.all(result == Outcome.REACHED)
    night.restart()
    night.until(lambda: night.received[topics.LAYOUT.name])
    assert not night.received[topics.OUTCOME.name]

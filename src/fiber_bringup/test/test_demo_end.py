# SPDX-License-Identifier: Apache-2.0
"""The exit code of the demo, from the outcomes of the robots."""

import numpy as np
import pytest

from fiber_bringup.demo import _as_simulated, _stuck
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.presets import preset


def outcome_of(*reasons):
    reason = np.array(reasons, dtype=int)
    bad = np.isin(reason, (Reason.NOT_MOVED, Reason.STALLED))
    told = np.select([reason == Reason.OK, bad], [Outcome.REACHED, Outcome.FAILED], Outcome.HELD)
    return PlanOutcome(0, np.arange(len(reason)) + 7, told, reason, np.zeros(len(reason)))


@pytest.mark.parametrize(
    ("reasons", "stuck", "good"),
    [
        ((Reason.OK, Reason.NOT_MOVED), [8], True),
        ((Reason.OK, Reason.NOT_MOVED), [7], False),
        ((Reason.OK, Reason.NOT_MOVED), [], False),
        ((Reason.NOT_MOVED,) * 100, [8], False),
        ((Reason.OK, Reason.STALLED), [8], False),
        ((Reason.OK, Reason.NOT_MOVED, Reason.STALLED), [8], False),
        ((Reason.OK, Reason.GOAL_BLOCKED), [], True),
        ((), [], False),
    ],
)
def test_only_joints_that_the_simulated_drives_let_stick_are_no_error(reasons, stuck, good):
    assert _as_simulated(outcome_of(*reasons), stuck) == good


def test_a_hundredth_of_the_simulated_robots_has_such_a_joint():
    plane = preset("desi", 500)
    stuck = _stuck(plane, 3)
    assert len(stuck) == 5 and np.isin(stuck, plane.ids).all()
    assert not np.array_equal(stuck, _stuck(plane, 4))

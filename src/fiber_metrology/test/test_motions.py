# SPDX-License-Identifier: Apache-2.0
"""Which motion came last, by messages that overtake each other."""

import threading
from itertools import permutations

import numpy as np
import pytest

from fiber_metrology.errors import MetrologyError
from fiber_metrology.node.motions import Motions
from fiber_msgs_py import Attempt, PlanStamp

BEFORE, AFTER = np.zeros((3, 2)), np.ones((3, 2))
HOME_NS, OPENED = 50, "session_a"


class Heard:
    """Motions, and the begins that they told of."""

    def __init__(self):
        self.begun = []
        self.motions = Motions(lambda angles, straight: self.begun.append((angles[0, 0], straight)))
        self.motions.open(OPENED)
        self.motions.hear_states(10, BEFORE, moving=False)


def test_a_motion_without_targets_begins_where_the_robots_rested_before_it():
    heard = Heard()
    for ns in range(51, 251):  # more than are kept
        heard.motions.hear_states(ns, BEFORE + 0.1, moving=True)
    heard.motions.hear_states(251, AFTER, moving=False)
    heard.motions.hear_outcome(PlanStamp(HOME_NS))
    heard.motions.hear_states(252, AFTER, moving=False)
    assert heard.begun == [(0.0, False)]
    rest = heard.motions.at_rest()
    assert rest.plan == PlanStamp(HOME_NS) and np.array_equal(rest.counters, AFTER)


@pytest.mark.parametrize("order", list(permutations(("accepted", "ended", "moving"))))
def test_a_correction_is_one_in_whichever_order_its_messages_come(order):
    heard = Heard()
    plan = PlanStamp(20)
    calls = {
        "accepted": lambda: heard.motions.hear_accepted(Attempt(plan, plan, 1, 10, 10), True),
        "ended": lambda: heard.motions.hear_outcome(plan),
        "moving": lambda: heard.motions.hear_states(30, AFTER / 2, moving=True),
    }
    for name in order:
        calls[name]()
    heard.motions.hear_states(40, AFTER, moving=False)
    assert heard.begun[-1] == (0.0, True) and {angle for angle, _ in heard.begun} == {0.0}


def test_rest_begins_after_the_outcome_of_the_motion():
    heard = Heard()
    assert heard.motions.at_rest().since_ns == 10
    heard.motions.hear_states(60, AFTER / 2, moving=True)
    heard.motions.hear_states(70, AFTER, moving=False)
    heard.motions.hear_outcome(PlanStamp(HOME_NS))
    heard.motions.hear_states(80, AFTER, moving=False)
    heard.motions.hear_states(90, AFTER, moving=False)
    rest = heard.motions.at_rest()
    assert rest.since_ns == 80 and rest.lasts_until(heard.motions.at_rest())


def test_a_bridge_that_begins_anew_while_an_image_waits_is_an_error_with_a_reason():
    heard = Heard()
    heard.motions.hear_states(60, AFTER / 2, moving=True)
    threading.Timer(0.2, heard.motions.open, ["session_b"]).start()
    with pytest.raises(MetrologyError, match="begun anew"):
        heard.motions.at_rest()
    with pytest.raises(MetrologyError, match="no plane is known"):
        heard.motions.at_rest()


def test_a_plan_that_waits_is_no_rest():
    heard = Heard()
    heard.motions.hear_accepted(Attempt(PlanStamp(20), PlanStamp(20), 1, 10, 10), False)
    with pytest.raises(MetrologyError, match="plan 0.000000020 has not ended"):
        heard.motions.at_rest()


def heard_late(*states):
    """Motions of a node that hears no targets, but states before and after and the outcome."""
    begun = []
    motions = Motions(lambda angles, straight: begun.append((angles[0, 0], straight)))
    motions.open(OPENED)
    for ns, angles in states:
        motions.hear_states(ns, angles, moving=False)
    motions.hear_outcome(PlanStamp(20))
    motions.hear_states(90, AFTER, moving=False)
    return begun, motions


def test_a_node_that_is_started_between_targets_and_motion_knows_where_the_motion_began():
    begun, motions = heard_late((30, BEFORE), (80, AFTER))
    assert begun == [(0.0, False)] and motions.at_rest().begin_heard


@pytest.mark.parametrize("states", [(), ((80, AFTER),)], ids=["nothing", "states of after it"])
def test_a_node_that_is_started_after_the_motion_tells_that_it_does_not_know(states):
    _, motions = heard_late(*states)
    assert not motions.at_rest().begin_heard
    motions.hear_accepted(Attempt(PlanStamp(100), PlanStamp(100), 1, 90, 90), False)
    motions.hear_outcome(PlanStamp(100))
    motions.hear_states(110, BEFORE, moving=False)
    assert motions.at_rest().begin_heard  # of the next motion it does

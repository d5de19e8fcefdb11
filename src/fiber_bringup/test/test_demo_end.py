# SPDX-License-Identifier: Apache-2.0
"""The exit code of the demo, from the outcomes of the robots."""

import numpy as np
import pytest

from fiber_bringup.demo import _as_simulated
from fiber_core.outcomes import Outcome, PlanOutcome, Reason


def outcome_of(*reasons):
    reason = np.array(reasons)
    bad = np.isin(reason, (Reason.NOT_MOVED, Reason.STALLED))
    told = np.select([reason == Reason.OK, bad], [Outcome.REACHED, Outcome.FAILED], Outcome.HELD)
    return PlanOutcome(0, np.arange(len(reason)) + 7, told, reason, np.zeros(len(reason)))


@pytest.mark.parametrize(
    ("reasons", "camera", "good"),
    [
        ((Reason.OK, Reason.NOT_MOVED), True, True),
        ((Reason.OK, Reason.NOT_MOVED), False, False),
        ((Reason.OK, Reason.STALLED), True, False),
        ((Reason.OK, Reason.NOT_MOVED, Reason.STALLED), True, False),
        ((Reason.OK, Reason.GOAL_BLOCKED), False, True),
    ],
)
def test_joints_that_the_simulated_drives_let_stick_are_no_error(reasons, camera, good):
    assert _as_simulated(outcome_of(*reasons), camera) == good

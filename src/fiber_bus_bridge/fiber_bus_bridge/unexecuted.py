# SPDX-License-Identifier: Apache-2.0
"""The result of a plan that was ended before any of its orders was accepted."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.plan_result import PlanResult
from fiber_core import kinematics
from fiber_core.array_types import Angles
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason

__all__ = ["unexecuted"]


def unexecuted(
    plane: FocalPlane, angles: Angles, goals: ArrayLike | None, reason: Reason
) -> PlanResult:
    """Return the result in which every robot is held where it is.

    Args:
        plane: the focal plane, with the fibre that each target is for.
        angles: joint angles now [rad], shape (n, 2).
        goals: target of each fibre [mm], shape (n, 2), nan = no target; None if the targets could
            not be read, and then the reason is that of every robot.
        reason: Reason of the robots with a target.
    """
    held = np.full(plane.n, Outcome.HELD, dtype=np.int64)
    if goals is None:
        return PlanResult(held, np.full(plane.n, int(reason)), np.full(plane.n, np.nan))
    goals = np.asarray(goals, dtype=float)
    error_mm = kinematics.on_target(plane, angles, goals).error_mm
    asked = np.all(np.isfinite(goals), axis=1)
    return PlanResult(held, np.where(asked, reason, Reason.NO_TARGET), error_mm)

"""The planning stage: check the targets, plan the accepted ones, give each robot a reason.

`plan_targets` is the stage as the pipeline without ROS runs it. The planner node runs its two
halves, `fiber_core.assignment.assign` and `plan_assignment`, and logs refused targets in between.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Mask
from fiber_core.assignment import Assignment, assign
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason, first_reason, holds
from fiber_core.problem import Problem
from fiber_planner.errors import PlannerError
from fiber_planner.interface import PlannedMotion, Planner, ProgressCallback

__all__ = ["PlanStageResult", "plan_assignment", "plan_targets"]


@dataclass(frozen=True, eq=False)
class PlanStageResult:
    """The result of the planning stage.

    Args:
        assignment: the targets that were accepted, and the reasons of the refused ones.
        problem: the plane, the present joint angles and the accepted targets.
        planned: the motion that the planner made.
        reason: Reason of each robot, shape (n,): OK (it arrives at its target), NO_TARGET,
            why its target was refused, or why the planner holds it.
    """

    assignment: Assignment
    problem: Problem
    planned: PlannedMotion
    reason: Codes

    @property
    def arriving(self) -> Mask:
        """Robots that arrive at their targets, shape (n,)."""
        return self.reason == Reason.OK

    @property
    def held(self) -> Mask:
        """Robots that have a target and will not arrive there, shape (n,)."""
        return holds(self.reason)


def plan_targets(
    plane: FocalPlane,
    start: ArrayLike,
    ids: ArrayLike,
    xy_mm: ArrayLike,
    planner: Planner,
    progress: ProgressCallback | None = None,
) -> PlanStageResult:
    """Assign targets to robots and plan the motion to those that are accepted.

    Args:
        plane: the focal plane.
        start: joint angles as the encoders read them [rad], shape (n, 2).
        ids: ids of the robots that have a target, shape (k,).
        xy_mm: their targets [mm], shape (k, 2).
        planner: the planner.
        progress: called with the fraction of the planning that is done and a short text.

    Raises:
        TargetsError: an id is unknown or given twice, or a value is not finite; nothing
            was planned.
        PlannerError: the planner's parameters do not suit the plane, or its motion does not
            have one row for each robot.
    """
    return plan_assignment(start, assign(plane, start, ids, xy_mm), planner, progress)


def plan_assignment(
    start: ArrayLike,
    assignment: Assignment,
    planner: Planner,
    progress: ProgressCallback | None = None,
) -> PlanStageResult:
    """Plan the motion to the accepted targets of an assignment; the second half of plan_targets.

    Args:
        start: joint angles as the encoders read them [rad], shape (n, 2).
        assignment: the checked targets, from fiber_core.assignment.assign.
        planner: the planner.
        progress: called with the fraction of the planning that is done and a short text.

    Raises:
        PlannerError: as for plan_targets.
    """
    plane = assignment.plane
    problem = Problem(plane, np.asarray(start, dtype=np.float64), assignment.targets)
    planned = planner.plan(problem, progress)
    if planned.motion.n != plane.n:
        raise PlannerError(
            f"planner {planner.name!r} returned a motion of {planned.motion.n} robots "
            f"for a plane of {plane.n}"
        )
    reason = first_reason(assignment.reason, planned.reason)
    return PlanStageResult(assignment, problem, planned, reason)

# SPDX-License-Identifier: Apache-2.0
"""The planning stage: check the targets, plan the accepted ones, give each robot a reason.

`plan_targets` is the stage as the pipeline without ROS runs it. The planner node runs its two
halves, `fiber_core.assignment.assign` and `plan_assignment`, and logs refused targets in between.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Codes, Mask
from fiber_core.assignment import Assignment, assign
from fiber_core.focal_plane import FIXED_JOINT_RAD, FocalPlane
from fiber_core.motors import alone_s, longest_move_s
from fiber_core.outcomes import Reason, first_reason, holds
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_planner.errors import PlannerError
from fiber_planner.interface import PlannedMotion, Planner, ProgressCallback, spacing_of

__all__ = ["PlanStageResult", "plan_assignment", "plan_targets"]


@dataclass(frozen=True, eq=False)
class PlanStageResult:
    """The result of the planning stage.

    Args:
        assignment: the targets that were accepted, and the reasons of the refused ones.
        problem: the plane, the present joint angles and the accepted targets.
        planned: the motion that the planner made.
        reason: Reason of each robot, shape (n,): OK (it arrives at its target), NO_TARGET,
            why its target was refused, or why the planner holds it; TOO_MANY_SEGMENTS if the
            robot is too slow for an order.
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
    spacing_mm = spacing_of(planner, plane)
    assignment = assign(plane, start, ids, xy_mm, spacing_mm=spacing_mm)
    return plan_assignment(start, assignment, planner, progress)


def plan_assignment(
    start: ArrayLike,
    assignment: Assignment,
    planner: Planner,
    progress: ProgressCallback | None = None,
) -> PlanStageResult:
    """Plan the motion to the accepted targets of an assignment; the second half of plan_targets.

    A robot that is too slow for the longest order of the wire stays where it is, as a disabled
    one: planned with the others it would make their motion too long for an order. A fixed joint
    stays at its present angle. A joint turns no faster than its motor can get in one ramp.

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
    softer = _softer(problem)
    slow = _too_slow(softer)
    planned = planner.plan(_to_plan(softer, slow), progress)
    if planned.motion.n != plane.n:
        raise PlannerError(
            f"planner {planner.name!r} returned a motion of {planned.motion.n} robots "
            f"for a plane of {plane.n}"
        )
    late = np.where(slow & problem.asked, Reason.TOO_MANY_SEGMENTS, planned.reason)
    reason = first_reason(assignment.reason, late)
    return PlanStageResult(assignment, problem, planned, reason)


def _softer(problem: Problem) -> Problem:
    # the problem with joints that turn no faster than they get in one ramp
    plane = problem.plane
    fastest = plane.drive.largest_step_rad_s
    if (plane.speeds <= fastest * (1.0 + 1e-9)).all():
        return problem
    return replace(problem, plane=replace(plane, speeds=np.minimum(plane.speeds, fastest)))


def _to_plan(problem: Problem, slow: Mask) -> Problem:
    # the problem with the slow robots disabled, and the fixed joints where they are
    plane = problem.plane.with_fixed_joints_at(problem.start)
    if not slow.any():
        return problem if plane is problem.plane else replace(problem, plane=plane)
    targets = np.where(slow[:, None], np.nan, problem.targets)
    return Problem(plane.with_enabled(plane.enabled & ~slow), problem.start, targets)


def _too_slow(problem: Problem) -> Mask:
    # Robots with a joint slower than one velocity unit, and those that need, alone, more than
    # half of the longest order: the other half is for detours. Shape (n,).
    plane = problem.plane
    units = WireUnits.for_plane(plane)
    fixed = np.diff(plane.limits, axis=2)[:, :, 0] <= FIXED_JOINT_RAD
    slow = np.any((plane.speeds < units.velocity_rad_s) & ~fixed, axis=1)
    longest_s = 0.5 * units.longest_order_s
    for row in np.flatnonzero(~slow & problem.asked & (longest_move_s(plane) > longest_s)):
        alone = plane.permuted([row])
        angles, valid = kinematics.inverse(alone, problem.targets[[row]])
        time_s = alone_s(alone, problem.start[[row]], angles)[0][valid[0]]
        slow[row] = time_s.min(initial=np.inf) > longest_s
    return slow & plane.enabled

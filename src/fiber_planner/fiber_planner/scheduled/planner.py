# SPDX-License-Identifier: Apache-2.0
"""The planner `scheduled`, for listed speeds: it chooses when a joint moves, not how fast."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fiber_core import kinematics
from fiber_core.array_types import Angles, Codes, Floats, Mask
from fiber_core.bounds import Range
from fiber_core.clearance import Safety, neighbour_pairs
from fiber_core.drive import motors_allowed
from fiber_core.metrics import power_bound_s
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_planner.approach import inside_approaches
from fiber_planner.direct.reachability import reachable
from fiber_planner.goal_selection import choose_goals
from fiber_planner.interface import PlannedMotion, ProgressCallback
from fiber_planner.safe_parameters import SafeParameters
from fiber_planner.scheduled.conflicts import Conflicts
from fiber_planner.scheduled.moves import motors_of_plane
from fiber_planner.scheduled.orders import sampled
from fiber_planner.scheduled.search import Search

__all__ = ["ScheduledParameters", "ScheduledPlanner", "timed"]

_LONG_S = 30.0  # a longer motion needs more than this gap, for the errors of clocks
_SPARE_RAD = np.deg2rad(0.05)  # an approach is a few ticks of creep longer than it must be
_ALLOWANCE_MM = 0.02  # for the rounding of goals to whole ticks


@dataclass(frozen=True)
class ScheduledParameters(SafeParameters):
    """Margin and timing errors, and the effort that the search may spend.

    Args:
        slack: by how much the first makespan that is tried exceeds its bound, as a share of it.
        stretch: longest makespan tried, in units of the bound.
        rounds: rounds of the local search at each makespan.
        candidates: motions that a robot in conflict tries in a round.
        seed: seed of the random numbers.

    Raises:
        PlannerError: a value is out of range.
    """

    RANGES: ClassVar = {
        **SafeParameters.RANGES,
        "slack": Range(0.0, 10.0),
        "stretch": Range(1.0, 100.0),
        "rounds": Range(1, 10_000, whole=True),
        "candidates": Range(1, 1000, whole=True),
        "seed": Range(0, 2**63 - 1, whole=True),
    }

    slack: float = 0.08
    stretch: float = 2.0
    rounds: int = 16
    candidates: int = 8
    seed: int = 0


class ScheduledPlanner:
    """Moves at listed speeds, placed in a timetable; local search where robots would collide.

    Phi goes to an angle on the way, theta turns, phi goes to its goal, and each joint ends with
    its approach; legs that are not needed are left out. The first timetable keeps these phases for
    all robots. Robots that would still collide try other angles on the way and other times, as far
    as motors of their supply are free. If conflicts are left the timetable gets longer. Robots that
    cannot be freed stay at their starts.

    Args:
        parameters: clearance to keep, effort to spend.
    """

    name = "scheduled"

    def __init__(self, parameters: ScheduledParameters | None = None):
        self.parameters = parameters or ScheduledParameters()

    def plan(self, problem: Problem, progress: ProgressCallback | None = None) -> PlannedMotion:
        """Plan the motion of every robot, see Planner.plan."""
        problem, outside = _from_inside(problem)
        narrower = inside_approaches(problem, _SPARE_RAD)
        pairs = neighbour_pairs(problem.plane)
        can = reachable(problem, pairs, self.parameters.margin_mm)
        goal, reason = _goals(narrower, self.parameters.safety)
        reason[problem.asked & problem.plane.enabled & ~can] = Reason.GOAL_BLOCKED
        reason[outside] = Reason.START_OUTSIDE_LIMITS
        angles, valid = kinematics.inverse(narrower.plane, narrower.targets)
        others = np.where(valid[..., None], angles, goal[:, None])
        planned = timed(problem, goal, others, reason, self.parameters, progress, far=True)
        # robots that would have an end, if their approach could come to it
        none = (planned.reason == Reason.GOAL_BLOCKED) & ~valid.any(axis=1)
        return replace(planned, reason=np.where(none, Reason.OUTSIDE_JOINT_RANGE, planned.reason))


def timed(
    problem: Problem,
    goal: Angles,
    others: Floats,
    reason: Codes,
    parameters: ScheduledParameters,
    progress: ProgressCallback | None = None,
    far: bool = False,
) -> PlannedMotion:
    """Find times and angles on the way for moves to given goals.

    Args:
        problem: the plane and the present joint angles.
        goal: joint angles at the end [rad], shape (n, 2).
        others: configurations that a robot may take instead [rad], shape (n, k, 2).
        reason: Reason of each robot, shape (n,); those with another one than OK rest.
        parameters: clearance to keep, effort to spend.
        progress: called with the fraction that is done and a short text.
        far: whether arms fold on the way, and robots that cannot get to their goals go elsewhere
            to be in no one's way.

    Returns:
        The motion. Robots that cannot be freed rest or make way, for GOAL_BLOCKED where others that
        rest leave them no way, else for NOT_CONVERGED; or they rest for OUTSIDE_JOINT_RANGE where
        an approach would lead beyond the range of a joint.
    """
    units, reason = WireUnits.for_plane(problem.plane), reason.copy()
    start = units.encoder_counts(problem.plane, problem.start)
    moving, lost = reason == Reason.OK, far & (reason == Reason.GOAL_BLOCKED)
    plane = problem.plane.with_enabled(moving | lost)
    turn = np.where(moving[:, None], units.to_counts(goal) - start, 0)
    turns = np.where(moving[:, None, None], units.to_counts(others) - start[:, None], 0)
    bound_s = power_bound_s(replace(problem, plane=problem.plane.with_enabled(moving)))
    ticks = int(np.ceil((1.0 + parameters.slack) * bound_s / units.tick_s))
    lasts_s = max(bound_s * parameters.stretch, ticks * units.tick_s)
    search = Search(
        Conflicts.of_plane(plane, units, start, parameters.safety, lasts_s),
        motors_of_plane(plane, units),
        np.unique(plane.supply, return_inverse=True)[1],
        motors_allowed(plane.supply, plane.drive.motors_on),
        turn,
        turns,
        max(ticks, 1),
        np.random.default_rng(parameters.seed),
        far,
        lost,
    )
    search.run(parameters, int(lasts_s / units.tick_s), progress)
    time_s, angles = sampled(units, start, search.legs, search.starts)
    reason[search.given_up & moving] = Reason.NOT_CONVERGED
    reason[search.blocked & moving] = Reason.GOAL_BLOCKED
    reason[~search.legs.possible & moving] = Reason.OUTSIDE_JOINT_RANGE
    goal = np.where((moving | lost)[:, None], units.to_angles(start + search.legs.turn), goal)
    return PlannedMotion(SampledMotion(time_s, angles), goal, reason)


def _from_inside(problem: Problem) -> tuple[Problem, Mask]:
    # the problem without robots that stand outside their limits, and those that have a target
    low, high = np.moveaxis(problem.plane.limits, -1, 0)
    inside = ((problem.start >= low) & (problem.start <= high)).all(axis=1)
    plane = problem.plane.with_enabled(problem.plane.enabled & inside)
    return replace(problem, plane=plane), problem.asked & ~inside


def _goals(problem: Problem, safety: Safety) -> tuple[Angles, Codes]:
    # goals as far apart as fast robots must be, unless more robots would lose their targets
    most_mm = safety.at_full_speed_mm(problem.plane, _LONG_S)
    goal, reason = choose_goals(problem, most_mm + _ALLOWANCE_MM)
    other, why = choose_goals(problem, safety.margin_mm + _ALLOWANCE_MM)
    if (why == Reason.GOAL_BLOCKED).sum() < (reason == Reason.GOAL_BLOCKED).sum():
        goal, reason = other, why
    return goal, np.array(reason)

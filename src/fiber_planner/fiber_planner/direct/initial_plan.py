# SPDX-License-Identifier: Apache-2.0
"""The initial plan: the goal of every robot, straight motions, the gaps to keep."""

from functools import partial
from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.array_types import Angles, Bools, Codes, Floats, Gaps, Ints, Mask, Pairs
from fiber_core.clearance import gaps, levers_of, point_speeds
from fiber_core.focal_plane import FocalPlane
from fiber_core.motors import motors_of
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.threads import share_out
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.parting import robots_that_wait
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.reachability import reachable
from fiber_planner.direct.scene import Scene, allowances_mm
from fiber_planner.direct.time_grid import TimeGrid
from fiber_planner.goal_program import (
    GoalProgram,
    goal_program,
    least_makespan_s,
    most_goals,
    robots_with_goals,
)
from fiber_planner.goal_selection import choose_goals

__all__ = ["Ends", "choose_ends", "straight_plan"]

_EPS_MM = 1e-6
_NEARER_MM = 2e-4  # that a pair may come nearer than it starts; the certificate grants a micrometre
_LEAST_ROBOTS = 2000  # of a thread: fewer are done sooner than it begins
_UNTANGLING = 0.25  # share of the time alone in which a tangled pair has to part
_LEAST_TURN_RAD = 0.1  # sets the makespan if no robot has to move: time to make way


class Ends(NamedTuple):
    """Where robots should end, and the reasons of those that cannot.

    Args:
        reason: Reason of each robot as far as it is known, shape (n,).
        choice: index of the option that each robot ends in, -1 if it may end anywhere,
            shape (n,).
        angles: joint angles of that option; the start of a robot that may end anywhere [rad],
            shape (n, 2).
        alone_s: time that the slowest robot needs alone to a clear end [s]; some time to make way
            if no robot has to move.
        waits: robots that start too close to one that has to leave, shape (b,).
    """

    reason: Codes
    choice: Ints
    angles: Angles
    alone_s: float
    waits: Bools


def choose_ends(problem: Problem, scene: Scene, parameters: DirectParameters) -> Ends:
    """Choose for every robot with a reachable target an option that is clear of all others.

    Args:
        problem: the plane, the present joint angles and the targets.
        scene: the same robots as the search sees them.
        parameters: clearance to keep.
    """
    rows = np.arange(problem.plane.n)
    reason = _reasons(problem, scene, parameters.margin_mm)
    waits = robots_that_wait(scene, parameters.margin_mm)
    reason[waits[rows] & (reason == Reason.OK)] = Reason.TANGLED
    seeking = reason == Reason.OK
    time = _times_s(problem, scene)
    alone_s = _alone_s(scene, time[seeking, 0])
    margins_mm = _end_margins_mm(problem, scene, parameters, alone_s)
    choice, some_blocked = _clear_options(problem, scene, margins_mm)
    if some_blocked or (time[rows, choice] > alone_s)[seeking].any():
        # Ends that no choice of elbows parts would be conflicts of every plan, and elbows that are
        # reached late make it longer.
        elbow, program = _soonest_ends(problem, seeking, margins_mm)
        reason[seeking & (elbow < 0)] = Reason.GOAL_BLOCKED
        partner = seeking & (elbow < 0) & _has_partner(program.tangled, elbow >= 0)
        reason[partner], seeking, ends = Reason.TANGLED, elbow >= 0, program.angles
        choice = _option_at(scene, ends[rows, elbow])
        alone_s = _alone_s(scene, time[rows, choice][seeking])
    choice[~seeking] = -1
    angles = np.where(seeking[:, None], scene.options[rows, choice], problem.start)
    return Ends(reason, choice, angles, alone_s, waits)


def _has_partner(pairs: Pairs, which: Mask) -> Mask:
    # robots of which the other one of a pair is among some, (n,)
    found = np.zeros(len(which), dtype=bool)
    for side in range(2):
        found[pairs[which[pairs[:, 1 - side]], side]] = True
    return found


def _soonest_ends(
    problem: Problem, seeking: Mask, margins_mm: list[float]
) -> tuple[Ints, GoalProgram]:
    # An elbow of as many robots as possible, -1 for the others, (n,), with the least time of the
    # slowest, and the program that it solves. The widest margin is taken with which as
    # many robots have clear ends as with the narrowest.
    programs = [goal_program(problem, seeking, mm, margins_mm[-1]) for mm in margins_mm]
    chosen = [most_goals(program)[0] for program in programs]
    robots = [robots_with_goals(elbow) for elbow in chosen]
    widest = next(k for k, count in enumerate(robots) if count >= robots[-1])
    program = programs[widest]
    least_s, _ = least_makespan_s(program, robots[widest])
    soonest = most_goals(program, least_s, soonest=True)[0]
    if robots_with_goals(soonest) < robots[widest]:  # that search was given up
        soonest = chosen[widest]
    return soonest, program


def _times_s(problem: Problem, scene: Scene) -> Floats:
    # the time that each robot needs alone to each of its options, (n, s)
    change = scene.options - problem.start[:, None]
    time = (np.abs(change) / scene.speed[:, None]).max(axis=2)
    if not scene.coupling.shape[1]:
        return time
    of_motors = np.abs(motors_of(problem.plane, change)) / scene.motor_speed[:, None]
    return np.maximum(time, of_motors.max(axis=2))


def _alone_s(scene: Scene, time_s: Floats) -> float:
    # of robots that need some times alone
    longest_s = float(time_s.max(initial=0.0))
    return longest_s or float((_LEAST_TURN_RAD / scene.speed).max(initial=0.0))


def straight_plan(
    problem: Problem, scene: Scene, parameters: DirectParameters, ends: Ends, grid: TimeGrid
) -> tuple[PlanState, Bools]:
    """Return the plan in which every robot goes straight to its end, all in the same time.

    Args:
        problem: the plane, the present joint angles and the targets.
        scene: the same robots as the search sees them.
        parameters: clearance to keep.
        ends: where robots should end.
        grid: the instants of the plan.

    Returns:
        The plan, collision costs not computed yet, and the tangled pairs, shape (p,).
    """
    plane, n = problem.plane, problem.plane.n
    # numpy asks the system for huge pages, numba does not
    q = np.empty((len(scene.movable), 2, grid.intervals + 1))
    share_out(partial(_fill_straight, problem.start, ends.angles, q), len(q), _LEAST_ROBOTS)

    # The gap that safety requires at the speeds of this plan. A robot that moves faster later
    # may need more, which the certificate finds; to require that of all pairs would make the
    # ends of many infeasible.
    speeds = np.minimum(np.abs(ends.angles - problem.start) / grid.makespan_s, plane.speeds)
    least = _least_mm(scene, parameters, plane, speeds, grid.makespan_s)
    at_start = gaps(plane, scene.pairs, problem.start) - _EPS_MM
    at_end = gaps(plane, scene.pairs, ends.angles) - _EPS_MM
    tangled = at_start < least
    wanted = np.minimum(least + allowances_mm(scene, parameters), at_end)
    wanted = np.where(tangled, wanted, np.minimum(wanted, at_start))
    required = np.maximum(wanted, least)
    required[~scene.movable[scene.pairs].any(axis=1)] = -np.inf  # neither robot can make way
    release = max(1, round(_UNTANGLING * ends.alone_s / grid.step_s))
    plan = PlanState(
        q=q,
        choice=ends.choice.astype(np.int64),
        required=required,
        required_early=np.minimum(required, at_start - _NEARER_MM),
        release=np.where(tangled, min(release, grid.intervals), 0),
        weight=np.ones(len(required)),
        cost=np.zeros(len(required)),
        folded=np.zeros((n, 2), dtype=np.int64),
        changed=np.ones(len(q), dtype=bool),
        shortcut_due=np.zeros(len(q), dtype=bool),  # straight lines have no breakpoints
    )
    return plan, tangled


@nb.njit(cache=True, nogil=True)
def _fill_straight(start, end, q, first, last):
    # angles of some bodies on the way from start to end, (b, 2, k + 1); zeros for obstacles
    intervals = q.shape[2] - 1
    for i in range(first, last):
        for joint in range(2):
            s = start[i, joint] if i < len(start) else 0.0
            g = end[i, joint] if i < len(start) else 0.0
            for k in range(intervals):
                q[i, joint, k] = s + (g - s) * (k / intervals)
            q[i, joint, intervals] = g


def _reasons(problem: Problem, scene: Scene, margin_mm: float) -> Codes:
    plane, asked = problem.plane, problem.asked
    reason = np.full(plane.n, int(Reason.OK))
    reason[~asked] = Reason.NO_TARGET
    reason[asked & ~plane.enabled] = Reason.DISABLED
    blocked = asked & plane.enabled & ~reachable(problem, scene.pairs, margin_mm)
    reason[blocked] = Reason.GOAL_BLOCKED
    return reason


def _end_margins_mm(
    problem: Problem, scene: Scene, parameters: DirectParameters, alone_s: float
) -> list[float]:
    # Gaps to ask for at the ends: with the allowance at full speed, with the allowance, the margin.
    least = parameters.margin_mm + parameters.allowance_mm
    plane = problem.plane
    most = _least_mm(scene, parameters, plane, plane.speeds, 2.0 * alone_s).max(initial=0.0)
    return [max(least, most + parameters.allowance_mm), least, parameters.margin_mm]


def _clear_options(problem: Problem, scene: Scene, margins_mm: list[float]) -> tuple[Ints, bool]:
    # The option of each robot that is nearest to the goal of choose_goals, and whether a robot has
    # no clear goal. The wider margin is preferred, unless more robots would lose their targets.
    goal, reason = choose_goals(problem, margins_mm[0])
    blocked = np.count_nonzero(reason == Reason.GOAL_BLOCKED)
    if blocked:
        other, reason = choose_goals(problem, margins_mm[1])
        if np.count_nonzero(reason == Reason.GOAL_BLOCKED) < blocked:
            goal = other
    return _option_at(scene, goal), bool((reason == Reason.GOAL_BLOCKED).any())


def _option_at(scene: Scene, goal: Angles) -> Ints:
    # the option of each robot that is nearest to a goal, (n,)
    away = np.abs(scene.options - goal[:, None]).max(axis=2)
    away[np.arange(scene.options.shape[1]) >= scene.option_count[:, None]] = np.inf
    return away.argmin(axis=1)


def _least_mm(
    scene: Scene,
    parameters: DirectParameters,
    plane: FocalPlane,
    speed_rad_s: Floats,
    makespan_s: float,
) -> Gaps:
    # the gap that Safety requires of each pair at some joint speeds, if no pair is tangled
    speeds = point_speeds(levers_of(plane), speed_rad_s * scene.movable[: plane.n, None])
    pairs, sector = scene.pairs, plane.sector
    return parameters.safety.required_at(speeds, makespan_s, pairs, sector=sector)

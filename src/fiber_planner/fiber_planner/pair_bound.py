# SPDX-License-Identifier: Apache-2.0
"""The pair bound: the best that any motion can do, as neighbours exclude each other's ends."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fiber_core import kinematics
from fiber_core.clearance import neighbour_pairs
from fiber_core.metrics import bounds_of
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_planner.approach import inside_approaches
from fiber_planner.direct.reachability import reachable
from fiber_planner.goal_program import goal_program, least_makespan_s, most_goals, robots_with_goals
from fiber_planner.goal_selection import choose_goals, travel_s

__all__ = ["PairBound", "pair_bound"]

_FINEST_RAD = math.radians(0.125)  # of the cells on which ways past static bodies are sought


class PairBound(NamedTuple):
    """Bounds of every certified motion that ends on its targets, up to the rounding to quanta.

    Args:
        robots: at most as many robots can reach their targets in one motion.
        time_s: a motion in which as many do lasts at least as long, up to the rounding of its end
            to quanta and ticks [s].
        proven: whether the search for these figures was complete. It is not where a target leaves
            the choice of its fibre: of several, only the one that is there first is considered.
    """

    robots: int
    time_s: float
    proven: bool


def pair_bound(problem: Problem, margin_mm: float = 0.05) -> PairBound:
    """Return how many robots can reach their targets in one motion, and in what time at least.

    At the end of a certified motion every robot on its target has one of two elbows, and every pair
    keeps the margin, less what the rounding to quanta can cost. So the elbows are a solution of the
    integer program of `goal_program`, which leaves out all that robots without targets need, and
    of the way all but static bodies, and that of two robots which start too close only one moves. A
    robot at an elbow has turned its joints from their start by the difference at
    least, at its highest speed: if the motion lasts T, no elbow is used that needs more than T. The
    least T with which the program still places its largest number of robots is the bound.
    It is never less than the time of the slowest of those robots alone (`lower_bound_s`). Where
    motors make an approach, ends at which it would leave the range of its joint are none.

    Args:
        problem: the plane, the present joint angles and the targets.
        margin_mm: gap between outlines that the certificate requires at every instant [mm].
    """
    # on its way an arm may go where no approach can end
    can = reachable(problem, neighbour_pairs(problem.plane), margin_mm, _FINEST_RAD)
    limits, problem = problem.plane.limits, inside_approaches(problem)
    plane = problem.plane
    _, valid, fibre, _ = kinematics.solutions(plane, problem.targets)
    lowest = np.where(valid, fibre, np.iinfo(fibre.dtype).max).min(axis=1)
    one_fibre = not bool((valid & (fibre != lowest[:, None])).any())
    can &= valid.any(axis=1)
    if not can.any():
        return PairBound(0, 0.0, True)
    rounding_mm = 2.0 * WireUnits.for_plane(plane).quantum_rad * float(plane.reach_mm.max())
    program = goal_program(problem, can, max(0.0, margin_mm - rounding_mm))
    left = replace(problem, targets=np.where(can[:, None], problem.targets, np.nan))
    goal, reason = choose_goals(left, margin_mm)
    alone_s = bounds_of(left, limits).alone_s
    clear = not len(program.tangled) and bool((reason[can] == Reason.OK).all())
    if clear and travel_s(left, goal)[can].max() <= alone_s:
        return PairBound(int(can.sum()), alone_s, one_fibre)  # nothing is in the way
    chosen, proven = most_goals(program)
    robots = robots_with_goals(chosen)
    time_s, least = least_makespan_s(program, robots)
    return PairBound(robots, time_s, proven and least and one_fibre)

# SPDX-License-Identifier: Apache-2.0
"""Goals by integer programming: as many as can be clear of each other, and the soonest of those."""

from typing import NamedTuple

import numpy as np

from fiber_core import kinematics
from fiber_core.array_types import Bools, Floats, Gaps, Ints, Mask, Pairs
from fiber_core.clearance import bodies_of, gaps, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_planner.goal_selection import ends_that_clash, fastest_ends, travel_s

__all__ = ["GoalProgram", "goal_program", "least_makespan_s", "most_goals", "robots_with_goals"]

_MEASURED_MM = 1e-3  # a pair that starts too close must keep its gap, less this, at the end
_SAME_S = 1e-9
_TOLERANCE_MM = 0.1  # a robot as near to its target need not move
_NODES = 20_000  # of branch and bound; a limit of time would not be repeatable
_HASTE = 0.25  # share of a robot that the times of all robots together count for


class GoalProgram(NamedTuple):
    """The elbows with which each robot can be on its target, and those that exclude each other.

    Args:
        angles: the fastest configuration of each elbow, faster one first [rad], shape (n, 2, 2).
        time_s: the time that a robot needs to it alone [s], shape (n, 2).
        possible: whether there is one, clear of all static bodies, shape (n, 2).
        pairs: rows of robots that exclude each other with some elbows, shape (p, 2).
        clash: whether they do with elbows i and j, shape (p, 2, 2).
        tangled: the pairs that start too close, of which only one may move, shape (t, 2).
    """

    angles: Floats
    time_s: Floats
    possible: Bools
    pairs: Pairs
    clash: Bools
    tangled: Pairs


def goal_program(
    problem: Problem, seeking: Mask, margin_mm: float, least_mm: float | None = None
) -> GoalProgram:
    """Collect the elbows with which robots can be on their targets at the end of any motion.

    Robots that seek no target may stand anywhere. At the end of every certified motion a pair keeps
    the margin; a pair that starts closer may keep the gap with which it starts, and only one of its
    robots may move (`Safety`), so that both arrive only if one is on its target already. Turns of
    one elbow are the same place, so only the fastest one counts.

    Args:
        problem: the plane, the present joint angles and the targets.
        seeking: robots with a target that they could reach alone, shape (n,).
        margin_mm: gap that outlines must keep at the end [mm].
        least_mm: gap below which a pair starts too close; by default that margin [mm].
    """
    plane = problem.plane
    angles, count = fastest_ends(problem)
    count[~seeking] = 0
    possible = np.arange(2) < count[:, None]
    fixed = np.append(~plane.enabled, np.ones(plane.fixtures, dtype=bool))
    seeks = np.append(count > 0, np.zeros(plane.fixtures, dtype=bool))
    pairs = neighbour_pairs(plane, margin_mm).astype(np.int64, order="C")
    pairs = pairs[seeks[pairs].any(axis=1) & (seeks | fixed)[pairs].all(axis=1)]
    clash, at_start = _clash_of(plane, problem, pairs, angles, count, margin_mm)
    close = at_start < (margin_mm if least_mm is None else least_mm)
    away_mm = kinematics.on_target(plane, problem.start, problem.targets).error_mm
    moves = seeks & np.append(away_mm > _TOLERANCE_MM, np.zeros(plane.fixtures, dtype=bool))
    tangled = close & moves[pairs].all(axis=1)
    clash[tangled, :2, :2] = True
    for side in range(2):  # an elbow at which a static body is in the way is none
        beside = fixed[pairs[:, 1 - side]]
        hit = clash[beside, :2, 2] if side == 0 else clash[beside, 2, :2]
        np.logical_and.at(possible, pairs[beside, side], ~hit)
    used = seeks[pairs].all(axis=1) & clash[:, :2, :2].any(axis=(1, 2))
    ends = angles[:, :2]
    time_s = np.where(possible, travel_s(problem, ends), np.inf)
    return GoalProgram(ends, time_s, possible, pairs[used], clash[used, :2, :2], pairs[tangled])


def _clash_of(
    plane: FocalPlane, problem: Problem, pairs: Pairs, angles: Floats, count: Ints, margin_mm: float
) -> tuple[Bools, Gaps]:
    # as from ends_that_clash, and the gaps at the start
    bodies = bodies_of(plane)
    clash = ends_that_clash(bodies, pairs, angles, count, margin_mm)
    at_start = gaps(plane, pairs, problem.start)
    for e in np.flatnonzero(at_start < margin_mm):
        kept = at_start[e] - _MEASURED_MM
        clash[e : e + 1] = ends_that_clash(bodies, pairs[e : e + 1], angles, count, kept)
    return clash, at_start


def most_goals(
    program: GoalProgram, within_s: float = np.inf, soonest: bool = False
) -> tuple[Ints, bool]:
    """Return elbows that are clear of each other for as many robots as possible.

    A binary for every robot and elbow; at most one elbow of a robot, and of two elbows that
    exclude each other at most one. Solved by the branch and bound of HiGHS (Huangfu and Hall,
    Math. Prog. Comp. 10, 2018).

    Args:
        program: the elbows.
        within_s: no elbow is used to which its robot needs longer alone [s].
        soonest: of the choices that have as many, take the one with the least sum of times.

    Returns:
        The elbow of each robot, -1 for none, shape (n,); and whether no choice has more.
    """
    from scipy.optimize import (  # seldom needed, and takes long to load
        Bounds,
        LinearConstraint,
        milp,
    )
    from scipy.sparse import coo_array

    chosen = np.full(len(program.possible), -1)
    usable = program.possible & (program.time_s <= within_s + _SAME_S)
    robot, elbow = np.nonzero(usable)
    if not len(robot):
        return chosen, True
    number = np.full(usable.shape, -1)
    number[robot, elbow] = np.arange(len(robot))
    e, i, j = np.nonzero(program.clash)
    a, b = program.pairs[e].T
    both = np.stack([number[a, i], number[b, j]], axis=1)
    rows = np.concatenate([number[usable.all(axis=1)], both[(both >= 0).all(axis=1)]])
    share = program.time_s[robot, elbow] / max(float(program.time_s[robot, elbow].max()), _SAME_S)
    worth = 1.0 - (_HASTE / len(usable) if soonest else 0.0) * share
    constraints = coo_array(
        (np.ones(rows.size), (np.repeat(np.arange(len(rows)), 2), rows.ravel())),
        shape=(len(rows), len(robot)),
    )
    found = milp(
        -worth,
        integrality=np.ones(len(robot)),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(constraints.tocsr(), -np.inf, 1.0) if len(rows) else None,
        options={"node_limit": _NODES, "mip_rel_gap": 0.0},
    )
    if found.x is None:
        return chosen, False
    taken = found.x > 0.5
    chosen[robot[taken]] = elbow[taken]
    return chosen, found.status == 0


def robots_with_goals(chosen: Ints) -> int:
    """Return the number of robots that have an elbow."""
    return int(np.count_nonzero(chosen >= 0))


def least_makespan_s(program: GoalProgram, robots: int) -> tuple[float, bool]:
    """Return the least time in which as many robots can be on their targets [s], and if proven.

    Args:
        program: the elbows.
        robots: their number, of most_goals without a limit of time.
    """
    times = np.unique(program.time_s[program.possible])
    low, high, all_proven = 0, len(times) - 1, True
    while low < high:  # the first time that suffices is in low..high
        middle = (low + high) // 2
        chosen, proven = most_goals(program, float(times[middle]))
        if robots_with_goals(chosen) >= robots:
            high = middle
        else:  # a search that was given up may have missed as many
            low, all_proven = middle + 1, all_proven and proven
    return (float(times[high]) if len(times) else 0.0), all_proven

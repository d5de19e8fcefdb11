# SPDX-License-Identifier: Apache-2.0
"""Goal selection: the elbow and turn of each robot, such that no two robots overlap at the end."""

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Angles, Bools, Codes, Floats, Ints, Pairs
from fiber_core.clearance import (
    Bodies,
    Neighbours,
    bodies_of,
    neighbour_pairs,
    neighbours_of,
    pair_gap_below,
)
from fiber_core.metrics import lower_bound_s
from fiber_core.motors import alone_s
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.threads import share_out

__all__ = ["choose_goals", "ends_that_clash", "fastest_ends", "lower_bound_s", "travel_s"]

_STAYS = 2  # pose of a robot that ends where it starts; 0 and 1 are its elbows, faster first
_LEAST_PAIRS = 1000  # of a thread: fewer are done sooner than it begins
_OPEN = -1  # pose of a robot that has none yet


def travel_s(problem: Problem, goal: ArrayLike) -> Floats:
    """Return the time that each robot needs from its start at full speed, if it is alone [s].

    Args:
        problem: the plane and the present joint angles.
        goal: configurations [rad], shape (n, ..., 2), one or several for each robot.

    Returns:
        The time of the slowest joint or coupled motor, shape (n, ...).
    """
    return alone_s(problem.plane, problem.start, goal)


def choose_goals(problem: Problem, margin_mm: float = 0.1) -> tuple[Angles, Codes]:
    """Choose for each robot the fastest configuration on its target that is clear of all others.

    A robot has at most two poses on its target, one for each elbow; turns differ only in
    time. To choose one of two poses so that no pair overlaps is 2-satisfiability, solved
    exactly by limited backtracking (Even, Itai, Shamir, SIAM J. Comput. 5, 1976): give some
    robot its faster pose and its neighbours all poses that follow from it; if that leads to
    a contradiction, give it the slower pose. If both do, the robot has no goal and stays at
    its start. At the end robots change to their faster pose if it is clear. Robots are
    visited by place, so the choice does not depend on the order of the rows.

    Args:
        problem: the plane, the present joint angles and the targets.
        margin_mm: gap that outlines must keep at the end [mm].

    Returns:
        Goal of each robot [rad], shape (n, 2), the start of a robot that has none; and the
        Reason of each, shape (n,): OK, NO_TARGET, DISABLED (it has a target and cannot
        move) or GOAL_BLOCKED (no configuration inside the joint limits is clear).
    """
    plane = problem.plane
    options, count = fastest_ends(problem)
    pairs = neighbour_pairs(plane, margin_mm).astype(np.int64, order="C")
    free = np.concatenate([count > 0, np.zeros(plane.fixtures, dtype=bool)])
    pairs = pairs[free[pairs].any(axis=1)]
    clash = ends_that_clash(bodies_of(plane), pairs, options, count, margin_mm)
    pairs, clash = pairs[clash.any(axis=(1, 2))], clash[clash.any(axis=(1, 2))]
    order = np.lexsort((plane.centers[:, 1], plane.centers[:, 0]))
    near = neighbours_of(len(free), pairs)
    pose = _choose(near.offsets, near.body, _clashes_by_robot(near, clash), count, order)

    reason = np.full(plane.n, int(Reason.OK))
    reason[pose == _STAYS] = Reason.GOAL_BLOCKED
    reason[problem.asked & ~plane.enabled] = Reason.DISABLED
    reason[~problem.asked] = Reason.NO_TARGET
    return options[np.arange(plane.n), pose], reason


def fastest_ends(problem: Problem) -> tuple[Floats, Ints]:
    """Return the fastest configuration of each elbow, faster one first, then the start.

    Where a target leaves the choice of its fibre, of all fibres the one that is there first.

    Args:
        problem: the plane, the present joint angles and the targets.

    Returns:
        Joint angles [rad], shape (n, 3, 2); and the number of elbows that have one, shape (n,).
    """
    plane = problem.plane
    angles, valid, _, is_left = kinematics.solutions(plane, problem.targets)
    valid &= plane.enabled[:, None]
    time = np.where(valid, travel_s(problem, angles), np.inf)
    rows = np.arange(plane.n)
    picks, times = [], []
    for side in (is_left, ~is_left):
        of_side = np.where(side, time, np.inf)
        picks.append(angles[rows, of_side.argmin(axis=1)])
        times.append(of_side.min(axis=1))
    faster = np.argsort(times, axis=0, kind="stable")
    elbows = np.stack(picks)[faster, rows]
    options = np.concatenate([np.moveaxis(elbows, 0, 1), problem.start[:, None]], axis=1)
    return options, np.isfinite(times).sum(axis=0)


def _clashes_by_robot(near: Neighbours, clash: Bools) -> Bools:
    # clash[e, own pose, neighbour's pose] of each robot with each of its neighbours
    clash = clash[near.pair]
    is_second = near.side == 1
    clash[is_second] = clash[is_second].transpose(0, 2, 1)
    return clash


def ends_that_clash(
    bodies: Bodies, pairs: Pairs, options: Floats, count: Ints, margin_mm: float
) -> Bools:
    """Return for each pair the combinations of ends that come nearer than the margin, (p, 3, 3).

    Args:
        bodies: outlines, from bodies_of.
        pairs: rows of robots and fixtures, shape (p, 2).
        options, count: from fastest_ends.
        margin_mm: gap to keep [mm].
    """
    clash = np.zeros((len(pairs), 3, 3), dtype=np.bool_)

    def find(first: int, last: int) -> None:
        some = slice(first, last)
        _find_clashes(bodies, pairs[some], options, count, margin_mm, clash[some])

    share_out(find, len(pairs), _LEAST_PAIRS)
    return clash


@nb.njit(cache=True, nogil=True)
def _find_clashes(bodies, pairs, options, count, margin_mm, clash):
    n = len(options)
    for e in range(len(pairs)):
        a, b = pairs[e]
        for i in range(3):
            if i != _STAYS and i >= count[a]:
                continue
            for j in range(3):
                if b < n and j != _STAYS and j >= count[b]:
                    continue
                if (i == _STAYS and (b >= n or j == _STAYS)) or (b >= n and j != _STAYS):
                    continue  # neither robot moves
                theta, phi = (options[b, j, 0], options[b, j, 1]) if b < n else (0.0, 0.0)
                gap = pair_gap_below(
                    bodies, a, b, options[a, i, 0], options[a, i, 1], theta, phi, margin_mm
                )
                clash[e, i, j] = gap < margin_mm


@nb.njit(cache=True)
def _propagate(i, chosen, offsets, neighbours, clash, count, pose, trail):
    # Set the pose of robot i and all poses that follow from it. Returns the number of robots
    # set, listed in `trail`, and a robot that has no pose left, -1 if all have one. That is never
    # a robot that stays: it cannot be held a second time.
    pose[i] = chosen
    trail[0] = i
    size, at = 1, 0
    while at < size:
        a = trail[at]
        at += 1
        for e in range(offsets[a], offsets[a + 1]):
            b = neighbours[e]
            if pose[b] != _OPEN:
                if clash[e, pose[a], pose[b]]:
                    return size, a if pose[b] == _STAYS else b
                continue
            left, possible = 0, _OPEN
            for j in range(count[b]):
                if not clash[e, pose[a], j]:
                    left, possible = left + 1, j
            if left == 0:
                return size, b
            if left < count[b]:
                pose[b] = possible
                trail[size] = b
                size += 1
    return size, -1


@nb.njit(cache=True)
def _solve(offsets, neighbours, clash, count, pose, trail, order):
    # One pass of the algorithm; returns a robot that must stay, -1 if all have a pose.
    for i in range(len(pose)):
        if pose[i] == _STAYS:
            _, stuck = _propagate(i, _STAYS, offsets, neighbours, clash, count, pose, trail)
            if stuck >= 0:
                return stuck
    for only_one in (True, False):
        for i in order:
            if pose[i] != _OPEN or (count[i] == 1) != only_one:
                continue
            for chosen in range(count[i]):
                size, stuck = _propagate(i, chosen, offsets, neighbours, clash, count, pose, trail)
                if stuck < 0:
                    break
                for k in range(size):
                    pose[trail[k]] = _OPEN
            if pose[i] == _OPEN:
                return i
    return -1


@nb.njit(cache=True)
def _choose(offsets, neighbours, clash, count, order):
    # the pose of each robot, (n,); robots without a possible pose stay at their starts
    n, rows = len(count), len(offsets) - 1
    stays = np.ones(rows, dtype=np.bool_)
    for i in range(n):
        stays[i] = count[i] == 0
    pose, trail = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int64)
    stuck = 0
    while stuck >= 0:
        for i in range(rows):
            pose[i] = _STAYS if stays[i] else _OPEN
        stuck = _solve(offsets, neighbours, clash, count, pose, trail, order)
        if stuck >= 0:
            stays[stuck] = True
    changed = True
    while changed:  # terminates: times only fall
        changed = False
        for i in order:
            if pose[i] != 1:
                continue
            clear = True
            for e in range(offsets[i], offsets[i + 1]):
                clear &= not clash[e, 0, pose[neighbours[e]]]
            if clear:
                pose[i], changed = 0, True
    return pose[:n]

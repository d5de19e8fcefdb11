"""Which elbow and turn each robot should end in, so that nobody overlaps at the end."""

import numba as nb
import numpy as np

from fiber_core import kinematics
from fiber_core.clearance import bodies_of, neighbour_pairs, pair_gap_below
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem

__all__ = ["choose_goals", "lower_bound_s", "travel_s"]

_STAYS = 2  # pose of a robot that ends where it starts; 0 and 1 are its elbows, faster first
_OPEN = -1


def travel_s(problem: Problem, goal) -> np.ndarray:
    """Return how long each robot needs from its start at full speed, if it is alone [s].

    Args:
        problem: the plane and where its robots are.
        goal: configurations [rad], shape (n, ..., 2), one or several for each robot.

    Returns:
        The time of the slower joint, shape (n, ...).
    """
    several = (slice(None),) + (None,) * (np.ndim(goal) - 2)
    turn = np.abs(np.asarray(goal, dtype=float) - problem.start[several])
    return (turn / problem.plane.speeds[several]).max(axis=-1)


def choose_goals(problem: Problem, margin_mm: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Choose for each robot the fastest configuration on its target that is clear of all others.

    A robot has at most two poses on its target, one for each elbow; turns only differ in
    time. To choose among two so that no pair overlaps is 2-satisfiability, solved exactly
    by limited backtracking (Even, Itai, Shamir, SIAM J. Comput. 5, 1976): take the faster
    pose of some robot and all that follows from it for its neighbours; where that leads to
    a contradiction, take the other. Where both do, the robot is given up and stays at its
    start. At the end robots change to their faster pose wherever that is clear. The order
    follows the robots' places, so the choice does not depend on their numbers.

    Args:
        problem: the plane, where its robots are, where their fibres should go.
        margin_mm: gap that outlines must keep at the end [mm].

    Returns:
        Goal of each robot [rad], shape (n, 2), its start where it has none; and the
        Reason of each, shape (n,): OK, NO_TARGET, DISABLED (asked, but it cannot
        move) or GOAL_BLOCKED (no configuration inside the joint limits is clear).
    """
    plane = problem.plane
    options, count = _options(problem)
    pairs = neighbour_pairs(plane, margin_mm).astype(np.int64, order="C")
    free = np.concatenate([count > 0, np.zeros(len(plane.obstacles), dtype=bool)])
    pairs = pairs[free[pairs].any(axis=1)]
    clash = _clashes(bodies_of(plane), pairs, options, count, margin_mm)
    pairs, clash = pairs[clash.any(axis=(1, 2))], clash[clash.any(axis=(1, 2))]
    order = np.lexsort((plane.centers[:, 1], plane.centers[:, 0]))
    pose = _choose(*_adjacency(pairs, clash, len(free)), count, order)

    reason = np.full(plane.n, int(Reason.OK))
    reason[pose == _STAYS] = Reason.GOAL_BLOCKED
    reason[problem.asked & ~plane.enabled] = Reason.DISABLED
    reason[~problem.asked] = Reason.NO_TARGET
    return options[np.arange(plane.n), pose], reason


def _options(problem):
    # Fastest configuration of either elbow, faster one first, then the start: (n, 3, 2),
    # and how many of the first two exist, (n,).
    plane = problem.plane
    angles, valid = kinematics.inverse(plane, problem.targets)
    valid &= plane.enabled[:, None]
    time = np.where(valid, travel_s(problem, angles), np.inf)
    rows = np.arange(plane.n)
    picks, times = [], []
    for side in (np.sin(angles[..., 1]) >= 0, np.sin(angles[..., 1]) < 0):
        of_side = np.where(side, time, np.inf)
        picks.append(angles[rows, of_side.argmin(axis=1)])
        times.append(of_side.min(axis=1))
    faster = np.argsort(times, axis=0, kind="stable")
    elbows = np.stack(picks)[faster, rows]
    options = np.concatenate([np.moveaxis(elbows, 0, 1), problem.start[:, None]], axis=1)
    return options, np.isfinite(times).sum(axis=0)


def _adjacency(pairs, clash, rows):
    # clashing pairs seen from each row: offsets, neighbours, clash[e, own pose, other's pose]
    a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
    both = np.concatenate([clash, clash.transpose(0, 2, 1)])
    by_row = np.argsort(a, kind="stable")
    return np.searchsorted(a[by_row], np.arange(rows + 1)), b[by_row], both[by_row]


@nb.njit(cache=True)
def _clashes(bodies, pairs, options, count, margin):
    # which poses of which pair come nearer than the margin, (p, 3, 3)
    n = len(options)
    clash = np.zeros((len(pairs), 3, 3), dtype=np.bool_)
    for e in range(len(pairs)):
        a, b = pairs[e]
        for i in range(3):
            if i != _STAYS and i >= count[a]:
                continue
            for j in range(3):
                if b < n and j != _STAYS and j >= count[b]:
                    continue
                if (i == _STAYS and (b >= n or j == _STAYS)) or (b >= n and j != _STAYS):
                    continue  # two that stay where they are
                theta, phi = options[b, j] if b < n else options[a, i]
                gap = pair_gap_below(
                    bodies, a, b, options[a, i, 0], options[a, i, 1], theta, phi, margin
                )
                clash[e, i, j] = gap < margin
    return clash


@nb.njit(cache=True)
def _follow(i, chosen, offsets, neighbours, clash, count, pose, trail):
    # Set the pose of i and all that follows from it. Returns how many were set, they
    # stand on the trail, and who was left without a pose, -1 if nobody was: never one that
    # stays, or who is given up would be given up again without end.
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
def _settle(offsets, neighbours, clash, count, pose, trail, order):
    # One pass of the algorithm; returns the robot to give up, -1 if all have a pose.
    for i in range(len(pose)):
        if pose[i] == _STAYS:
            _, lost = _follow(i, _STAYS, offsets, neighbours, clash, count, pose, trail)
            if lost >= 0:
                return lost
    for only_one in (True, False):
        for i in order:
            if pose[i] != _OPEN or (count[i] == 1) != only_one:
                continue
            for chosen in range(count[i]):
                size, lost = _follow(i, chosen, offsets, neighbours, clash, count, pose, trail)
                if lost < 0:
                    break
                for k in range(size):
                    pose[trail[k]] = _OPEN
            if pose[i] == _OPEN:
                return i
    return -1


@nb.njit(cache=True)
def _choose(offsets, neighbours, clash, count, order):
    n, rows = len(count), len(offsets) - 1
    stays = np.ones(rows, dtype=np.bool_)
    for i in range(n):
        stays[i] = count[i] == 0
    pose, trail = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int64)
    lost = 0
    while lost >= 0:
        for i in range(rows):
            pose[i] = _STAYS if stays[i] else _OPEN
        lost = _settle(offsets, neighbours, clash, count, pose, trail, order)
        if lost >= 0:
            stays[lost] = True
    changed = True
    while changed:  # ends: times only fall
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

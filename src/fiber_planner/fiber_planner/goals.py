"""Which elbow and turn each robot should end in, so that nobody overlaps at the end."""

import numba as nb
import numpy as np

from fiber_core import kinematics
from fiber_core.clearance import bodies_of, neighbour_pairs, pair_gap_below
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.report import lower_bound_s

__all__ = ["choose_goals", "lower_bound_s", "travel_s"]

_SWEEPS = 100


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

    Local search: robots in conflict take, one after the other, the option with the
    least weighted conflict, then the fastest; the weight of a pair grows as long as
    its conflict lasts. Where no choice clears a conflict a robot is given up: it stays
    at its start. The order of the search follows the robots' places, not their rows.

    Args:
        problem: the plane, where its robots are, where their fibres should go.
        margin_mm: gap that outlines must keep at the end [mm].

    Returns:
        Goal of each robot [rad], shape (n, 2), its start where it has none; and the
        Reason of each, shape (n,): OK, NO_TARGET, DISABLED (asked, but it cannot
        move) or GOAL_BLOCKED (no configuration inside the joint limits is clear).
    """
    plane = problem.plane
    angles, valid = kinematics.inverse(plane, problem.targets)
    valid &= plane.enabled[:, None]
    time = np.where(valid, travel_s(problem, angles), np.inf)
    fastest_first = np.argsort(time, axis=1, kind="stable")
    options = np.take_along_axis(angles, fastest_first[:, :, None], axis=1)
    count = valid.sum(axis=1)
    # The last column is the start: the only option of whoever is not asked.
    options = np.concatenate([options, problem.start[:, None]], axis=1)

    asked = count > 0
    pairs = neighbour_pairs(plane, margin_mm)
    free = np.concatenate([asked, np.zeros(len(plane.obstacles), dtype=bool)])
    pairs = pairs[free[pairs].any(axis=1)]
    offsets, neighbours, edges = _adjacency(pairs, len(free))
    order = np.lexsort((plane.centers[:, 1], plane.centers[:, 0]))
    choice = _search(
        bodies_of(plane), options, count, offsets, neighbours, edges, len(pairs), order, margin_mm
    )

    reason = np.full(plane.n, int(Reason.OK))
    reason[choice < 0] = Reason.GOAL_BLOCKED
    reason[problem.asked & ~plane.enabled] = Reason.DISABLED
    reason[~problem.asked] = Reason.NO_TARGET
    return options[np.arange(plane.n), choice], reason


def _adjacency(pairs, rows):
    # pairs (p, 2) as lists of neighbours: offsets, neighbour rows, number of the pair
    a, b = np.concatenate([pairs, pairs[:, ::-1]]).T.astype(np.int64)
    edges = np.tile(np.arange(len(pairs)), 2)
    by_row = np.argsort(a, kind="stable")
    return np.searchsorted(a[by_row], np.arange(rows + 1)), b[by_row], edges[by_row]


@nb.njit(cache=True)
def _pose(options, choice, i, n):
    # obstacles ignore their angles
    if i >= n:
        return 0.0, 0.0
    return options[i, choice[i], 0], options[i, choice[i], 1]


@nb.njit(cache=True)
def _conflict(i, option, bodies, options, choice, offsets, neighbours, edges, weight, margin):
    # sum of the weights of the pairs that robot i's option does not clear
    n = len(options)
    theta, phi = options[i, option]
    total = 0
    for e in range(offsets[i], offsets[i + 1]):
        j = neighbours[e]
        theta_j, phi_j = _pose(options, choice, j, n)
        if pair_gap_below(bodies, i, j, theta, phi, theta_j, phi_j, margin) < margin:
            total += weight[edges[e]]
    return total


@nb.njit(cache=True)
def _search(bodies, options, count, offsets, neighbours, edges, pairs, order, margin):
    # Returns the option each robot takes; -1, the start, for those not asked or given up.
    n = len(options)
    ones = np.ones(pairs, dtype=np.int64)
    weight = ones.copy()
    count = count.copy()
    choice = np.where(count > 0, 0, -1)
    doubtful = np.ones(n, dtype=np.bool_)
    while True:
        _sweep(
            bodies, options, count, choice, doubtful,
            offsets, neighbours, edges, weight, order, margin,
        )  # fmt: skip
        # Give up the robot with most conflicts, the last of them in the order.
        worst, most = -1, 0
        for i in order:
            if count[i] and doubtful[i]:
                here = _conflict(
                    i, choice[i], bodies, options, choice, offsets, neighbours, edges, ones, margin
                )
                if here and here >= most:
                    worst, most = i, here
        if worst < 0:
            break
        count[worst], choice[worst] = 0, -1
        for e in range(offsets[worst], offsets[worst + 1]):
            if neighbours[e] < n:
                doubtful[neighbours[e]] = True
    _hasten(bodies, options, choice, offsets, neighbours, edges, ones, order, margin)
    return choice


@nb.njit(cache=True)
def _sweep(
    bodies, options, count, choice, doubtful, offsets, neighbours, edges, weight, order, margin
):
    # Sweep over the robots in conflict until there are none or patience ends. Whoever
    # is not doubtful is known to be clear.
    n = len(options)
    for _ in range(_SWEEPS):
        clear = True
        for i in order:
            if not doubtful[i] or count[i] == 0:
                continue
            before = choice[i]
            least = _conflict(
                i, before, bodies, options, choice, offsets, neighbours, edges, weight, margin
            )
            if least == 0:
                doubtful[i] = False
                continue
            clear = False
            for option in range(count[i]):
                here = _conflict(
                    i, option, bodies, options, choice, offsets, neighbours, edges, weight, margin
                )
                if here < least or (here == least and option < choice[i]):
                    least, choice[i] = here, option
            doubtful[i] = least > 0
            theta, phi = options[i, choice[i]]
            for e in range(offsets[i], offsets[i + 1]):
                j = neighbours[e]
                theta_j, phi_j = _pose(options, choice, j, n)
                if pair_gap_below(bodies, i, j, theta, phi, theta_j, phi_j, margin) < margin:
                    weight[edges[e]] += 1
                if j < n and choice[i] != before:
                    doubtful[j] = True
        if clear:
            break


@nb.njit(cache=True)
def _hasten(bodies, options, choice, offsets, neighbours, edges, ones, order, margin):
    # Let robots take a faster option where that is now clear, until nobody can. Times
    # only fall, so this ends.
    changed = True
    while changed:
        changed = False
        for i in order:
            for option in range(choice[i]):
                here = _conflict(
                    i, option, bodies, options, choice, offsets, neighbours, edges, ones, margin
                )
                if here == 0:
                    choice[i] = option
                    changed = True
                    break

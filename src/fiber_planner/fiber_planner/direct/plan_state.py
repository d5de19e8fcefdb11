"""A plan in the making, and what one robot's profile means to its neighbours."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_planner.direct.collision_cost import penetration
from fiber_planner.direct.profile_sampling import copy_profile

__all__ = [
    "Draft",
    "adopt",
    "alter",
    "count_conflicts",
    "measure",
    "measure_some",
    "most_neighbours",
    "weigh",
    "worst_first",
]


class Draft(NamedTuple):
    """A plan in the making; all arrays are written by the search.

    Args:
        q: joint angles on the common grid [rad], shape (b, 2, k + 1), obstacles included.
        choice: the option each robot ends in, -1 where it may end anywhere, shape (n,).
        required: gap each pair must keep [mm], shape (p,).
        early: gap it must keep at first [mm], less where it starts too close, shape (p,).
        release: grid time from which on it must keep all of it, shape (p,).
        weight: what the search makes of each pair's conflict, shape (p,).
        depth: penetration of each pair [mm x intervals], shape (p,).
        legs: grid times between which an arm is folded, 0, 0 where it is not planned so,
            shape (n, 2).
        changed: whether a robot's profile changed since it was last certified, shape (b,).
        around: whether its profile or a neighbour's changed since it was last tried to be
            made simpler, shape (b,).
    """

    q: np.ndarray
    choice: np.ndarray
    required: np.ndarray
    early: np.ndarray
    release: np.ndarray
    weight: np.ndarray
    depth: np.ndarray
    legs: np.ndarray
    changed: np.ndarray
    around: np.ndarray


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _depth(crowd, draft, p, qa, qb, limit):
    a, b = crowd.pairs[p]
    return penetration(
        crowd.bodies, crowd.lever, a, b, qa, qb,
        draft.required[p], draft.early[p], draft.release[p], limit,
    )  # fmt: skip


def measure(crowd, draft):
    """Measure the penetration of every pair anew; return how many pairs are in conflict."""
    measure_some(crowd, draft, np.arange(len(crowd.pairs)))
    return count_conflicts(draft)


@nb.njit(cache=True, error_model="numpy")
def measure_some(crowd, draft, pairs):
    """Measure the penetration of some pairs anew: rows of crowd.pairs, shape (k,)."""
    for p in pairs:
        a, b = crowd.pairs[p]
        draft.depth[p] = _depth(crowd, draft, p, draft.q[a], draft.q[b], np.inf)


@nb.njit(cache=True)
def alter(crowd, draft, i):
    """Note that the profile of a robot is another one now."""
    draft.changed[i] = draft.around[i] = True
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        draft.around[crowd.neighbours[e]] = True


@nb.njit(cache=True)
def count_conflicts(draft):
    """Return how many pairs are in conflict as far as measured."""
    count = 0
    for p in range(len(draft.depth)):
        if draft.depth[p] > 0.0:
            count += 1
    return count


@nb.njit(cache=True)
def most_neighbours(crowd):
    """Return the most neighbours a body has: room for the depths of weigh."""
    most = 0
    for i in range(len(crowd.offsets) - 1):
        most = max(most, crowd.offsets[i + 1] - crowd.offsets[i])
    return most


@nb.njit(cache=True, error_model="numpy")
def worst_first(crowd, draft, i, order):
    """Write the neighbours of a robot as weigh counts them, most weighted conflict first."""
    begin, count = crowd.offsets[i], crowd.offsets[i + 1] - crowd.offsets[i]
    for e in range(count):
        p = crowd.pair[begin + e]
        at = e
        while at > 0:
            q = crowd.pair[begin + order[at - 1]]
            if draft.weight[q] * draft.depth[q] >= draft.weight[p] * draft.depth[p]:
                break
            order[at] = order[at - 1]
            at -= 1
        order[at] = e


@nb.njit(cache=True, error_model="numpy")
def weigh(crowd, draft, i, profile, best, order, depths):
    """Return the weighted penetration of a robot with another profile.

    Args:
        crowd: the robots.
        draft: the plan of all others.
        i: row of the robot.
        profile: its joint angles on the grid [rad], shape (2, k + 1).
        best: value beyond which the exact result is of no interest.
        order: order in which the neighbours are looked at, from worst_first.
        depths: penetration with each neighbour, written as far as looked at.
    """
    total = 0.0
    begin = crowd.offsets[i]
    for at in range(crowd.offsets[i + 1] - begin):
        e = begin + order[at]
        p = crowd.pair[e]
        limit = (best - total) / draft.weight[p]
        a, b = crowd.pairs[p]  # always in this order: no digit depends on who is asking
        qa = profile if a == i else draft.q[a]
        qb = profile if b == i else draft.q[b]
        depth = _depth(crowd, draft, p, qa, qb, limit)
        depths[e - begin] = depth
        total += draft.weight[p] * depth
        if total > best:
            return total
    return total


@nb.njit(cache=True, error_model="numpy")
def adopt(crowd, draft, i, profile, depths):
    """Give a robot a profile whose penetrations weigh has written."""
    copy_profile(profile, draft.q[i])
    alter(crowd, draft, i)
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        draft.depth[crowd.pair[e]] = depths[e - crowd.offsets[i]]

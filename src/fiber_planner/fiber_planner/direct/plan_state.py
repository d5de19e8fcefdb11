# SPDX-License-Identifier: Apache-2.0
"""The plan that the local search improves, and the cost of one robot's profile in it."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Floats, Ints
from fiber_core.threads import share_out
from fiber_planner.direct.collision_cost import collision_cost, least_cost_at
from fiber_planner.direct.profile_sampling import copy_profile
from fiber_planner.direct.scene import Scene

__all__ = [
    "PlanState",
    "commit",
    "count_conflicts",
    "is_free",
    "mark_changed",
    "measure_all",
    "measure_pairs",
    "rank_neighbours",
    "weighted_cost",
]

_NEVER = -1  # no conflict with a neighbour is known
_LEAST_PAIRS = 400  # of a thread: fewer are done sooner than it begins


class PlanState(NamedTuple):
    """A plan during the search; the search writes all arrays in place.

    Args:
        q: joint angles on the common time grid [rad], shape (b, 2, k + 1), obstacles included.
        choice: index of the option that each robot ends in, -1 if it may end anywhere,
            shape (n,).
        required: gap that each pair must keep [mm], shape (p,).
        required_early: gap that it must keep before `release` [mm], less than `required` for a
            pair that starts too close, shape (p,).
        release: grid time from which a pair must keep `required`, shape (p,).
        weight: weight of each pair's collision cost in the search, shape (p,).
        cost: collision cost of each pair [mm x intervals], shape (p,).
        folded: first and last grid time at which an arm is folded, (0, 0) for a profile that
            is not planned with a folded part, shape (n, 2).
        changed: robots whose profile changed since it was last certified, shape (b,).
        shortcut_due: robots whose profile, or that of a neighbour, changed since shortcuts were
            last tried, shape (b,).
    """

    q: Floats
    choice: Ints
    required: Floats
    required_early: Floats
    release: Ints
    weight: Floats
    cost: Floats
    folded: Ints
    changed: Bools
    shortcut_due: Bools

    def saved(self) -> list[np.ndarray]:
        """Return copies of all arrays, for `take_back`."""
        return [np.copy(column) for column in self]

    def take_back(self, saved: list[np.ndarray]) -> None:
        """Write saved arrays over the present ones."""
        for column, old in zip(self, saved):
            column[...] = old


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _pair_cost(scene, plan, p, qa, qb, limit):
    # the collision cost of a pair, and when the two are nearest
    a, b = scene.pairs[p]
    return collision_cost(
        scene.bodies, scene.lever, a, b, qa, qb,
        plan.required[p], plan.required_early[p], plan.release[p], limit,
    )  # fmt: skip


def measure_all(scene: Scene, plan: PlanState) -> int:
    """Compute the collision cost of every pair; return the number of pairs in conflict."""
    measure_pairs(scene, plan, np.arange(len(scene.pairs)))
    return count_conflicts(plan)


def measure_pairs(scene: Scene, plan: PlanState, pairs: Ints) -> None:
    """Compute the collision cost of some pairs, given as rows of scene.pairs, shape (k,)."""

    def measure(first: int, last: int) -> None:
        _measure_pairs(scene, plan, pairs[first:last])

    share_out(measure, len(pairs), _LEAST_PAIRS)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _measure_pairs(scene, plan, pairs):
    for p in pairs:
        a, b = scene.pairs[p]
        plan.cost[p], _ = _pair_cost(scene, plan, p, plan.q[a], plan.q[b], np.inf)


@nb.njit(cache=True)
def mark_changed(scene: Scene, plan: PlanState, i: int) -> None:
    """Mark the profile of robot i as changed: certificate and shortcuts are due again."""
    plan.changed[i] = plan.shortcut_due[i] = True
    for e in range(scene.near.offsets[i], scene.near.offsets[i + 1]):
        plan.shortcut_due[scene.near.body[e]] = True


@nb.njit(cache=True)
def count_conflicts(plan: PlanState) -> int:
    """Return the number of pairs in conflict by the costs last computed."""
    count = 0
    for p in range(len(plan.cost)):
        if plan.cost[p] > 0.0:
            count += 1
    return count


@nb.njit(cache=True, error_model="numpy", nogil=True)
def rank_neighbours(scene: Scene, plan: PlanState, i: int, order: Ints) -> None:
    """Sort the neighbours of robot i by weighted collision cost, highest first.

    No grid time is known yet at which one of them was in conflict.

    Args:
        scene: the robots and their surroundings.
        plan: the plan, with its costs.
        i: row of the robot.
        order: indices of the neighbours, counted from scene.near.offsets[i], and for each
            neighbour, in the second row, when it was in conflict last; written, shape (2, m).
    """
    begin, count = scene.near.offsets[i], scene.near.offsets[i + 1] - scene.near.offsets[i]
    for e in range(count):
        p = scene.near.pair[begin + e]
        at = e
        while at > 0:
            q = scene.near.pair[begin + order[0, at - 1]]
            if plan.weight[q] * plan.cost[q] >= plan.weight[p] * plan.cost[p]:
                break
            order[0, at] = order[0, at - 1]
            at -= 1
        order[0, at], order[1, e] = e, _NEVER


@nb.njit(cache=True, error_model="numpy", nogil=True)
def weighted_cost(
    scene: Scene, plan: PlanState, i: int, profile: Floats, best: float, order: Ints, costs: Floats
) -> float:
    """Return the weighted collision cost that robot i would have with another profile.

    Similar profiles are in conflict at about the same time: where a neighbour was in conflict last,
    its gap alone often shows that a profile costs too much.

    Args:
        scene: the robots and their surroundings.
        plan: the plan of all other robots.
        i: row of the robot.
        profile: its joint angles on the grid [rad], shape (2, k + 1).
        best: value above which the exact result does not matter.
        order: order in which the neighbours are evaluated, from rank_neighbours; written.
        costs: collision cost with each neighbour, written for those that were evaluated.
    """
    total = 0.0
    begin = scene.near.offsets[i]
    if _least_cost(scene, plan, i, profile, best, order) > best:
        return np.inf
    for at in range(scene.near.offsets[i + 1] - begin):
        e = int(begin + order[0, at])
        p = int(scene.near.pair[e])
        limit = (best - total) / plan.weight[p]
        a, b = scene.pairs[p]  # always in this order: the result is the same for both robots
        qa = profile if a == i else plan.q[a]
        qb = profile if b == i else plan.q[b]
        cost, when = _pair_cost(scene, plan, p, qa, qb, limit)
        costs[e - begin] = cost
        if when != _NEVER:
            order[1, e - begin] = when
        total += plan.weight[p] * cost
        if total > best:
            return total
    return total


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _least_cost(scene, plan, i, profile, best, order):
    # the weighted cost of a profile by its gaps at the times of the last conflicts, as far as it
    # does not exceed `best`
    total, begin = 0.0, scene.near.offsets[i]
    for at in range(scene.near.offsets[i + 1] - begin):
        e = order[0, at]
        if order[1, e] == _NEVER:
            continue
        p = int(scene.near.pair[begin + e])
        a, b = scene.pairs[p]
        qa = profile if a == i else plan.q[a]
        qb = profile if b == i else plan.q[b]
        total += plan.weight[p] * least_cost_at(
            scene.bodies, a, b, qa, qb,
            plan.required[p], plan.required_early[p], plan.release[p], order[1, e],
        )  # fmt: skip
        if total > best:
            break
    return total


@nb.njit(cache=True, error_model="numpy", nogil=True)
def is_free(
    scene: Scene, plan: PlanState, i: int, profile: Floats, order: Ints, costs: Floats
) -> bool:
    """Return whether robot i would have no conflict with another profile.

    A neighbour that is in the way is evaluated first the next time: it is in the way of similar
    profiles too.

    Args:
        scene: the robots and their surroundings.
        plan: the plan of all other robots.
        i: row of the robot.
        profile: its joint angles on the grid [rad], shape (2, k + 1).
        order: order in which the neighbours are evaluated, as in rank_neighbours; written.
        costs: zeros, written where the profile is free.
    """
    begin = scene.near.offsets[i]
    if _least_cost(scene, plan, i, profile, 0.0, order) > 0.0:
        return False
    for at in range(scene.near.offsets[i + 1] - begin):
        e = int(begin + order[0, at])
        p = int(scene.near.pair[e])
        a, b = scene.pairs[p]
        qa = profile if a == i else plan.q[a]
        qb = profile if b == i else plan.q[b]
        costs[e - begin] = 0.0
        cost, when = _pair_cost(scene, plan, p, qa, qb, 0.0)
        if cost > 0.0:
            for k in range(at, 0, -1):
                order[0, k] = order[0, k - 1]
            order[0, 0], order[1, e - begin] = e - begin, when
            return False
    return True


@nb.njit(cache=True, error_model="numpy", nogil=True)
def commit(scene: Scene, plan: PlanState, i: int, profile: Floats, costs: Floats) -> None:
    """Give robot i a new profile.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; profile and costs of robot i are written.
        i: row of the robot.
        profile: its joint angles on the grid [rad], shape (2, k + 1).
        costs: collision cost with each neighbour, as weighted_cost wrote them.
    """
    copy_profile(profile, plan.q[i])
    mark_changed(scene, plan, i)
    for e in range(scene.near.offsets[i], scene.near.offsets[i + 1]):
        plan.cost[scene.near.pair[e]] = costs[e - scene.near.offsets[i]]

# SPDX-License-Identifier: Apache-2.0
"""Local search: robots in conflict try other profiles until no pair is in conflict."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Floats, Ints, Rows
from fiber_core.clearance import most_neighbours
from fiber_planner.direct.coupled import motors_follow, sample_by_motors, sample_legs
from fiber_planner.direct.moves import (
    INFEASIBLE,
    nearer_fold,
    resample_half,
    sample_folded,
    sample_lines,
    sample_profile,
)
from fiber_planner.direct.perturbation import perturb_profile
from fiber_planner.direct.plan_state import (
    PlanState,
    commit,
    mark_changed,
    rank_neighbours,
    weighted_cost,
)
from fiber_planner.direct.profile_sampling import (
    copy_profile,
    fill_two_ramps,
    least_intervals,
)
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.splitmix64 import next_uniform, seeded_rng

__all__ = ["fold_arms", "raise_weights", "restore", "straighten", "sweep"]

_GROWTH = 1.3  # of the weight of a pair, for every sweep that its conflict lasts
_KEEP_HALF = 0.3  # share of the moves with odd numbers that change half of a profile
# In this share of visits a robot ignores its costliest conflict, which the other robot of the
# pair may resolve, and takes the best move for all its other pairs: two robots that pass
# through each other are not always freed by moves of one robot at a time.
_KICK = 0.1
_NEAR = 0.3  # share of the moves that change the present profile a little, where arms fold
_LINES = 8  # moves of a visit that take one segment a joint, where arms do not fold
_BY_MOTORS = 0.7  # share of the moves of coupled joints that are made for them
_FOLDING_OF_COUPLED = 0.3  # least share of their moves that fold the arm: time is short
_IGNORED = 1e-9  # weight of the conflict that is ignored


class _Buffers(NamedTuple):
    # Arrays of a sweep: the move under evaluation, and the best one so far.
    profile: Floats  # (2, k + 1)
    best_profile: Floats
    costs: Floats  # with each neighbour
    best_costs: Floats
    order: Ints  # of the neighbours, as weighted_cost evaluates them, (2, m)
    folded: Ints  # (2,)
    best_folded: Ints


@nb.njit(cache=True, error_model="numpy", nogil=True)
def sweep(
    scene: Scene,
    plan: PlanState,
    step_s: float,
    folding: float,
    number: int,
    rows: Rows,
    draws: int,
) -> int:
    """Visit some robots, and let those in conflict try other profiles.

    Guided local search (Voudouris and Tsang, EJOR 113, 1999): a robot takes the first
    move that frees it from all conflicts, else the move of least weighted collision cost if
    that is an improvement.

    Args:
        scene: the robots and their surroundings.
        plan: the plan, with its collision costs.
        step_s: length of a grid interval [s].
        folding: share of the moves that fold the arm on its way.
        number: number of the sweep; each has other random numbers.
        rows: the robots to visit, in this order, shape (k,).
        draws: moves per robot.

    Returns:
        Number of moves evaluated.
    """
    buffers = _buffers(scene, plan)
    evaluated = 0
    for row in rows:
        i = int(row)
        if not scene.movable[i]:
            continue
        best = _present_cost(scene, plan, i)
        if best == 0.0:
            continue
        rank_neighbours(scene, plan, i, buffers.order)
        rng = seeded_rng(scene.key[i], 2 * number + 1)
        ignored, weight = -1, 0.0
        if next_uniform(rng) < _KICK:
            ignored = _costliest_pair(scene, plan, i)
            weight, plan.weight[ignored] = plan.weight[ignored], _IGNORED
            best = np.inf
        moves, choice = _best_move(scene, plan, i, step_s, folding, draws, best, rng, buffers)
        evaluated += moves
        if ignored >= 0:
            plan.weight[ignored] = weight
        if choice != INFEASIBLE:
            commit(scene, plan, i, buffers.best_profile, buffers.best_costs)
            plan.choice[i] = choice
            plan.folded[i, 0], plan.folded[i, 1] = buffers.best_folded
    return evaluated


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _buffers(scene, plan):
    profile = np.empty((2, plan.q.shape[2]))
    costs = np.empty(most_neighbours(scene.near))
    order = np.empty((2, len(costs)), dtype=np.int64)
    folded, best_folded = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    return _Buffers(
        profile, np.empty_like(profile), costs, np.empty_like(costs), order, folded, best_folded
    )


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _present_cost(scene, plan, i):
    # the weighted collision cost of robot i
    total = 0.0
    for e in range(scene.near.offsets[i], scene.near.offsets[i + 1]):
        total += plan.weight[scene.near.pair[e]] * plan.cost[scene.near.pair[e]]
    return total


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _costliest_pair(scene, plan, i):
    # the pair of robot i with the highest weighted collision cost
    costliest, most = -1, -1.0
    for e in range(scene.near.offsets[i], scene.near.offsets[i + 1]):
        p = scene.near.pair[e]
        if plan.weight[p] * plan.cost[p] > most:
            costliest, most = p, plan.weight[p] * plan.cost[p]
    return costliest


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _best_move(scene, plan, i, step_s, folding, draws, best, rng, buffers):
    # Sample moves of robot i until one is free of conflict; keep the best one in the buffers.
    # Returns the number of moves evaluated and the option that the best one ends at,
    # INFEASIBLE if none costs less than `best`.
    evaluated, best_choice = 0, INFEASIBLE
    profile, folded = buffers.profile, buffers.folded
    coupled = scene.coupling.shape[1] > 0
    lines = _LINES if folding == 0.0 and not coupled else 0
    if coupled:
        folding = max(folding, _FOLDING_OF_COUPLED)
    for draw in range(draws):
        folded[0] = folded[1] = 0
        if draw < lines and plan.choice[i] >= 0:
            choice = sample_lines(scene, plan, i, step_s, rng, profile)
        elif coupled and next_uniform(rng) < _BY_MOTORS:
            if next_uniform(rng) < 0.5:
                choice = sample_legs(scene, plan, i, draw, draws, step_s, rng, profile)
            else:
                choice = sample_by_motors(scene, plan, i, draw, draws, step_s, rng, profile)
            if choice == INFEASIBLE:
                continue
        elif folding > 0.0 and not coupled and next_uniform(rng) < _NEAR:
            choice = plan.choice[i]
            perturb_profile(scene, plan, i, step_s, rng, profile)
        elif next_uniform(rng) < folding:
            choice = sample_folded(scene, plan, i, step_s, rng, profile, folded)
            if choice == INFEASIBLE:
                continue
        elif draw % 2 and next_uniform(rng) < _KEEP_HALF:
            choice = plan.choice[i]
            resample_half(scene, plan, i, step_s, rng, profile)
        else:
            choice = sample_profile(scene, plan, i, draw, draws, step_s, folding, rng, profile)
        if not motors_follow(scene, i, profile, step_s):
            continue
        evaluated += 1
        total = weighted_cost(scene, plan, i, profile, best, buffers.order, buffers.costs)
        if total < best:
            best, best_choice = total, choice
            buffers.best_folded[0], buffers.best_folded[1] = folded
            copy_profile(profile, buffers.best_profile)
            for e in range(len(buffers.costs)):
                buffers.best_costs[e] = buffers.costs[e]
            if total == 0.0:
                break
    return evaluated, best_choice


@nb.njit(cache=True)
def raise_weights(plan: PlanState) -> None:
    """Raise the weight of every pair that is still in conflict; called after each sweep."""
    for p in range(len(plan.cost)):
        if plan.cost[p] > 0.0:
            plan.weight[p] *= _GROWTH


@nb.njit(cache=True, nogil=True)
def fold_arms(scene: Scene, plan: PlanState, which: Bools, step_s: float) -> None:
    """Give robots profiles that fold the arm at full speed first and unfold it at the end.

    Robots that do not move, may end anywhere, or have no time to fold keep their profiles. Robots
    whose coupled motors cannot follow go straight.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; its collision costs have to be computed again.
        which: robots to fold, shape (b,).
        step_s: length of a grid interval [s].
    """
    last = plan.q.shape[2] - 1
    for i in range(len(scene.start)):
        if not which[i]:
            continue
        plan.folded[i, 0] = plan.folded[i, 1] = 0
        s, g = plan.q[i, 1, 0], plan.q[i, 1, last]
        v1, v2 = nearer_fold(scene.folded_phi[i], s), nearer_fold(scene.folded_phi[i], g)
        if plan.choice[i] < 0 or (s == g and plan.q[i, 0, 0] == plan.q[i, 0, last]):
            continue
        fold = max(2, least_intervals(v1 - s, scene.speed[i, 1] * step_s))
        unfold = max(2, least_intervals(g - v2, scene.speed[i, 1] * step_s))
        between = least_intervals(v2 - v1, scene.speed[i, 1] * step_s)
        if fold + unfold + max(1, between) > last:
            continue
        mark_changed(scene, plan, i)
        t1, t2 = fold, last - unfold
        plan.folded[i, 0], plan.folded[i, 1] = t1, t2
        fill_two_ramps(plan.q[i, 1, : t2 + 1], s, v1, v2, 0, t1, t1, t2)
        fill_two_ramps(plan.q[i, 1, t2:], v2, g, g, 0, unfold, unfold, unfold)
        s, g = plan.q[i, 0, 0], plan.q[i, 0, last]
        turn = least_intervals(g - s, scene.speed[i, 0] * step_s)
        begin = min(t1, max(0, (last - turn) // 2))
        end = max(begin + max(1, turn), t2)
        fill_two_ramps(plan.q[i, 0], s, g, g, begin, end, last, last)
        if not motors_follow(scene, i, plan.q[i], step_s):
            _straighten_one(plan, i)


@nb.njit(cache=True, nogil=True)
def straighten(scene: Scene, plan: PlanState, which: Bools) -> None:
    """Give robots straight profiles over the whole time, from their starts to their ends.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; its collision costs have to be computed again.
        which: robots to change, shape (b,); those that may end anywhere stay as they are.
    """
    for i in range(len(scene.start)):
        if which[i] and plan.choice[i] >= 0:
            mark_changed(scene, plan, i)
            _straighten_one(plan, i)


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _straighten_one(plan, i):
    last = plan.q.shape[2] - 1
    plan.folded[i, 0] = plan.folded[i, 1] = 0
    for joint in range(2):
        s, g = plan.q[i, joint, 0], plan.q[i, joint, last]
        fill_two_ramps(plan.q[i, joint], s, g, g, 0, last, last, last)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def restore(
    scene: Scene,
    plan: PlanState,
    step_s: float,
    folding: float,
    rows: Ints,
    number: int,
    draws: int,
) -> int:
    """Give robots that lost their targets a profile to the target, if a free one is found.

    Args:
        scene: the robots and their surroundings.
        plan: a plan without conflict.
        step_s: length of a grid interval [s].
        folding: share of the moves that fold the arm on its way.
        rows: robots to try, shape (k,).
        number: number of a sweep that was not made yet.
        draws: moves per robot.

    Returns:
        Number of robots that have their targets again.
    """
    profile = np.empty((2, plan.q.shape[2]))
    costs = np.empty(most_neighbours(scene.near))
    order = np.empty((2, len(costs)), dtype=np.int64)
    count = 0
    for row in rows:
        i = int(row)
        choice = plan.choice[i]
        if choice >= 0 or scene.option_count[i] == 0:
            continue
        plan.choice[i] = 0
        rank_neighbours(scene, plan, i, order)
        rng = seeded_rng(scene.key[i], 2 * number + 1)
        for draw in range(draws):
            ends_at = sample_profile(scene, plan, i, draw, draws, step_s, folding, rng, profile)
            if not motors_follow(scene, i, profile, step_s):
                continue
            if weighted_cost(scene, plan, i, profile, 0.0, order, costs) == 0.0:
                commit(scene, plan, i, profile, costs)
                plan.folded[i, 0] = plan.folded[i, 1] = 0
                choice = ends_at
                count += 1
                break
        plan.choice[i] = choice
    return count

"""Repair of a plan by local search: robots in conflict try other profiles until none is left."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_planner.direct.candidates import (
    NO_FIT,
    draw_any,
    draw_folded,
    draw_half,
    nearer_fold,
)
from fiber_planner.direct.draws import (
    copy_profile,
    least_intervals,
    next_uniform,
    seeded,
    trapezoid,
)
from fiber_planner.direct.penetration import penetration

__all__ = ["Draft", "fold_first", "measure", "repair", "restore", "straighten"]

_GROWTH = 1.3  # of the weight of a pair, for every sweep its conflict lasts
_KEEP_HALF = 0.3  # share of the odd draws that change half a profile
# In this share of visits a robot leaves its heaviest conflict to the other one of the pair
# and takes the best candidate for all others: two robots that pass through each other are
# not always freed by moving one at a time.
_KICK = 0.1
_IGNORED = 1e-9  # weight of the conflict left to the other


class Draft(NamedTuple):
    """A plan in the making; all arrays are written by the search.

    Args:
        q: joint angles on the common grid [rad], shape (b, 2, k + 1), obstacles included.
        choice: the option each robot ends in, -1 where it may end anywhere, shape (n,).
        required: gap each pair must keep [mm], shape (p,).
        weight: what the search makes of each pair's conflict, shape (p,).
        depth: penetration of each pair [mm x intervals], shape (p,).
        legs: grid times between which an arm is folded, 0, 0 where it is not planned so,
            shape (n, 2).
    """

    q: np.ndarray
    choice: np.ndarray
    required: np.ndarray
    weight: np.ndarray
    depth: np.ndarray
    legs: np.ndarray


@nb.njit(cache=True, error_model="numpy")
def measure(crowd, draft):
    """Measure the penetration of every pair anew; return how many pairs are in conflict."""
    conflicts = 0
    for p in range(len(crowd.pairs)):
        a, b = crowd.pairs[p]
        draft.depth[p] = penetration(
            crowd.bodies, crowd.lever, a, b, draft.q[a], draft.q[b], draft.required[p], np.inf
        )
        if draft.depth[p] > 0.0:
            conflicts += 1
    return conflicts


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _most_neighbours(crowd):
    most = 0
    for i in range(len(crowd.offsets) - 1):
        most = max(most, crowd.offsets[i + 1] - crowd.offsets[i])
    return most


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _conflicts(draft):
    count = 0
    for p in range(len(draft.depth)):
        if draft.depth[p] > 0.0:
            count += 1
    return count


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _weigh(crowd, draft, i, profile, best, depths):
    # weighted penetration of robot i with a profile; beyond `best` any value above it
    total = 0.0
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        p = crowd.pair[e]
        limit = (best - total) / draft.weight[p]
        a, b = crowd.pairs[p]  # always in this order: no digit depends on who is asking
        qa = profile if a == i else draft.q[a]
        qb = profile if b == i else draft.q[b]
        depth = penetration(crowd.bodies, crowd.lever, a, b, qa, qb, draft.required[p], limit)
        depths[e - crowd.offsets[i]] = depth
        total += draft.weight[p] * depth
        if total > best:
            return total
    return total


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _adopt(crowd, draft, i, profile, depths):
    copy_profile(profile, draft.q[i])
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        draft.depth[crowd.pair[e]] = depths[e - crowd.offsets[i]]


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _heaviest(crowd, draft, i):
    # the pair of robot i with most weighted conflict
    heaviest, most = -1, -1.0
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        p = crowd.pair[e]
        if draft.weight[p] * draft.depth[p] > most:
            heaviest, most = p, draft.weight[p] * draft.depth[p]
    return heaviest


@nb.njit(cache=True, error_model="numpy")
def repair(crowd, draft, step_s, folding, first, sweeps, draws, effort):
    """Sweep over the robots in conflict until none is left or the effort is spent.

    Guided local search (Voudouris and Tsang, EJOR 113, 1999): a robot takes the first
    candidate that clears it of all its neighbours, else the one of least weighted
    penetration; after each sweep the weight of every pair still in conflict grows.
    Sweeps go forth and back over the rows.

    Args:
        crowd: the robots.
        draft: the plan, with its penetrations measured.
        step_s: length of a grid interval [s].
        folding: share of the candidates that fold the arm on their way.
        first: number of the first sweep; other numbers give other draws.
        sweeps: most sweeps.
        draws: candidates per robot and sweep.
        effort: most candidates in all.

    Returns:
        Number of pairs still in conflict, sweeps done, candidates weighed.
    """
    n = len(crowd.start)
    profile = np.empty((2, draft.q.shape[2]))
    best_profile = np.empty_like(profile)
    depths = np.empty(_most_neighbours(crowd))
    best_depths = np.empty_like(depths)
    spent = 0
    legs = np.zeros(2, dtype=np.int64)
    best_legs = np.zeros(2, dtype=np.int64)
    for sweep in range(sweeps):
        conflicts = _conflicts(draft)
        if conflicts == 0 or spent >= effort:
            return conflicts, sweep, spent
        for visit in range(n):
            i = visit if (first + sweep) % 2 == 0 else n - 1 - visit
            if not crowd.movable[i]:
                continue
            best = 0.0
            for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
                best += draft.weight[crowd.pair[e]] * draft.depth[crowd.pair[e]]
            if best == 0.0:
                continue
            found = False
            best_choice = draft.choice[i]
            state = seeded(crowd.key[i], 2 * (first + sweep) + 1)
            heaviest, weight = -1, 0.0
            if next_uniform(state) < _KICK:
                heaviest = _heaviest(crowd, draft, i)
                weight, draft.weight[heaviest] = draft.weight[heaviest], _IGNORED
                best = np.inf
            for number in range(draws):
                legs[0] = legs[1] = 0
                if next_uniform(state) < folding:
                    choice = draw_folded(crowd, draft, i, step_s, state, profile, legs)
                    if choice == NO_FIT:
                        continue
                elif number % 2 and next_uniform(state) < _KEEP_HALF:
                    choice = draft.choice[i]
                    draw_half(crowd, draft, i, step_s, state, profile)
                else:
                    choice = draw_any(
                        crowd, draft, i, number, draws, step_s, folding, state, profile
                    )
                spent += 1
                total = _weigh(crowd, draft, i, profile, best, depths)
                if total < best:
                    found, best, best_choice = True, total, choice
                    best_legs[0], best_legs[1] = legs[0], legs[1]
                    copy_profile(profile, best_profile)
                    for e in range(len(depths)):
                        best_depths[e] = depths[e]
                    if total == 0.0:
                        break
            if heaviest >= 0:
                draft.weight[heaviest] = weight
            if found:
                _adopt(crowd, draft, i, best_profile, best_depths)
                draft.choice[i] = best_choice
                draft.legs[i, 0], draft.legs[i, 1] = best_legs[0], best_legs[1]
        for p in range(len(crowd.pairs)):
            if draft.depth[p] > 0.0:
                draft.weight[p] *= _GROWTH
    return _conflicts(draft), sweeps, spent


@nb.njit(cache=True)
def fold_first(crowd, draft, step_s):
    """Let every robot on its way fold its arm as fast as it can and unfold it at the end.

    Args:
        crowd: the robots.
        draft: the plan; its penetrations have to be measured again.
        step_s: length of a grid interval [s].
    """
    last = draft.q.shape[2] - 1
    for i in range(len(crowd.start)):
        draft.legs[i, 0] = draft.legs[i, 1] = 0
        s, g = draft.q[i, 1, 0], draft.q[i, 1, last]
        v1, v2 = nearer_fold(crowd.fold[i], s), nearer_fold(crowd.fold[i], g)
        if draft.choice[i] < 0 or (s == g and draft.q[i, 0, 0] == draft.q[i, 0, last]):
            continue
        there = max(2, least_intervals(v1 - s, crowd.speed[i, 1] * step_s))
        back = max(2, least_intervals(g - v2, crowd.speed[i, 1] * step_s))
        between = least_intervals(v2 - v1, crowd.speed[i, 1] * step_s)
        if there + back + max(1, between) > last:
            continue
        draft.legs[i, 0], draft.legs[i, 1] = there, last - back
        trapezoid(draft.q[i, 1, : last - back + 1], s, v1, v2, 0, there, there, last - back)
        trapezoid(draft.q[i, 1, last - back :], v2, g, g, 0, back, back, back)
        s, g = draft.q[i, 0, 0], draft.q[i, 0, last]
        turn = least_intervals(g - s, crowd.speed[i, 0] * step_s)
        begin = min(there, max(0, (last - turn) // 2))
        end = max(begin + max(1, turn), last - back)
        trapezoid(draft.q[i, 0], s, g, g, begin, end, last, last)


@nb.njit(cache=True, error_model="numpy")
def straighten(crowd, draft, step_s):
    """Let robots that make a detour go straight where that is clear now; return how many do."""
    n = len(crowd.start)
    last = draft.q.shape[2] - 1
    profile = np.empty((2, last + 1))
    depths = np.empty(_most_neighbours(crowd))
    count = 0
    for i in range(n):
        if not crowd.movable[i]:
            continue
        straight = True
        for joint in range(2):
            s, g = draft.q[i, joint, 0], draft.q[i, joint, last]
            if draft.choice[i] < 0:
                g = s
            trapezoid(profile[joint], s, g, g, 0, last, last, last)
            for k in range(last + 1):
                straight = straight and abs(draft.q[i, joint, k] - profile[joint, k]) < 1e-9
        if not straight and _weigh(crowd, draft, i, profile, 0.0, depths) == 0.0:
            _adopt(crowd, draft, i, profile, depths)
            draft.legs[i, 0] = draft.legs[i, 1] = 0
            count += 1
    return count


@nb.njit(cache=True, error_model="numpy")
def restore(crowd, draft, step_s, folding, wish, first, draws):
    """Let robots that were given up go to their targets after all where that meets nobody.

    Args:
        crowd: the robots.
        draft: a plan without conflict.
        step_s: length of a grid interval [s].
        folding: share of the candidates that fold the arm on their way.
        wish: robots to try, shape (n,).
        first: number of a sweep not made yet.
        draws: candidates per robot.

    Returns:
        Number of robots restored.
    """
    profile = np.empty((2, draft.q.shape[2]))
    depths = np.empty(_most_neighbours(crowd))
    count = 0
    for i in range(len(wish)):
        before = draft.choice[i]
        if not wish[i] or before >= 0 or crowd.options[i] == 0:
            continue
        draft.choice[i] = 0
        state = seeded(crowd.key[i], 2 * first + 1)
        for number in range(draws):
            choice = draw_any(crowd, draft, i, number, draws, step_s, folding, state, profile)
            if _weigh(crowd, draft, i, profile, 0.0, depths) == 0.0:
                _adopt(crowd, draft, i, profile, depths)
                draft.legs[i, 0] = draft.legs[i, 1] = 0
                before = choice
                count += 1
                break
        draft.choice[i] = before
    return count

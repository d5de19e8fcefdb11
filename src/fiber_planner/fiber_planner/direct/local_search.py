"""Repair of a plan by local search: robots in conflict try other profiles until none is left."""

import numba as nb
import numpy as np

from fiber_planner.direct.moves import (
    NO_FIT,
    draw_any,
    draw_folded,
    draw_half,
    nearer_fold,
)
from fiber_planner.direct.plan_state import adopt, alter, most_neighbours, weigh, worst_first
from fiber_planner.direct.profile_sampling import (
    copy_profile,
    least_intervals,
    next_uniform,
    seeded,
    trapezoid,
)

__all__ = ["add_weight", "fold_first", "go_straight", "restore", "sweep"]

_GROWTH = 1.3  # of the weight of a pair, for every sweep its conflict lasts
_KEEP_HALF = 0.3  # share of the odd draws that change half a profile
# In this share of visits a robot leaves its heaviest conflict to the other one of the pair
# and takes the best candidate for all others: two robots that pass through each other are
# not always freed by moving one at a time.
_KICK = 0.1
_IGNORED = 1e-9  # weight of the conflict left to the other


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _heaviest(crowd, draft, i):
    # the pair of robot i with most weighted conflict
    heaviest, most = -1, -1.0
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        p = crowd.pair[e]
        if draft.weight[p] * draft.depth[p] > most:
            heaviest, most = p, draft.weight[p] * draft.depth[p]
    return heaviest


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _in_conflict(crowd, draft):
    # the robots of all pairs in conflict
    busy = np.zeros(len(crowd.movable), dtype=np.bool_)
    for p in range(len(draft.depth)):
        if draft.depth[p] > 0.0:
            busy[crowd.pairs[p, 0]] = busy[crowd.pairs[p, 1]] = True
    return busy


@nb.njit(cache=True, error_model="numpy")
def sweep(crowd, draft, step_s, folding, number, first, last, draws):
    """Visit the robots in conflict, part of a sweep, and let each try other profiles.

    Guided local search (Voudouris and Tsang, EJOR 113, 1999): a robot takes the first
    candidate that clears it of all its neighbours, else the one of least weighted
    penetration. Sweeps go forth and back over the rows.

    Args:
        crowd: the robots.
        draft: the plan, with its penetrations measured.
        step_s: length of a grid interval [s].
        folding: share of the candidates that fold the arm on their way.
        number: of the sweep; other numbers give other draws.
        first, last: which visits of the sweep, 0 <= first <= last <= n.
        draws: candidates per robot.

    Returns:
        Number of candidates weighed.
    """
    n = len(crowd.start)
    profile = np.empty((2, draft.q.shape[2]))
    best_profile = np.empty_like(profile)
    depths = np.empty(most_neighbours(crowd))
    best_depths = np.empty_like(depths)
    order = np.empty(len(depths), dtype=np.int64)
    legs = np.zeros(2, dtype=np.int64)
    best_legs = np.zeros(2, dtype=np.int64)
    busy = _in_conflict(crowd, draft)
    spent = 0
    for visit in range(first, last):
        i = visit if number % 2 == 0 else n - 1 - visit
        if not (busy[i] and crowd.movable[i]):
            continue
        best = 0.0
        for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
            best += draft.weight[crowd.pair[e]] * draft.depth[crowd.pair[e]]
        if best == 0.0:
            continue
        worst_first(crowd, draft, i, order)
        found = False
        best_choice = draft.choice[i]
        state = seeded(crowd.key[i], 2 * number + 1)
        heaviest, weight = -1, 0.0
        if next_uniform(state) < _KICK:
            heaviest = _heaviest(crowd, draft, i)
            weight, draft.weight[heaviest] = draft.weight[heaviest], _IGNORED
            best = np.inf
        for draw in range(draws):
            legs[0] = legs[1] = 0
            if next_uniform(state) < folding:
                choice = draw_folded(crowd, draft, i, step_s, state, profile, legs)
                if choice == NO_FIT:
                    continue
            elif draw % 2 and next_uniform(state) < _KEEP_HALF:
                choice = draft.choice[i]
                draw_half(crowd, draft, i, step_s, state, profile)
            else:
                choice = draw_any(crowd, draft, i, draw, draws, step_s, folding, state, profile)
            spent += 1
            total = weigh(crowd, draft, i, profile, best, order, depths)
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
            adopt(crowd, draft, i, best_profile, best_depths)
            for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
                if best_depths[e - crowd.offsets[i]] > 0.0:
                    busy[crowd.neighbours[e]] = True
            draft.choice[i] = best_choice
            draft.legs[i, 0], draft.legs[i, 1] = best_legs[0], best_legs[1]
    return spent


@nb.njit(cache=True)
def add_weight(draft):
    """Let the weight of every pair still in conflict grow, after a sweep."""
    for p in range(len(draft.depth)):
        if draft.depth[p] > 0.0:
            draft.weight[p] *= _GROWTH


@nb.njit(cache=True)
def fold_first(crowd, draft, which, step_s):
    """Let robots on their way fold their arms as fast as they can and unfold them at the end.

    Args:
        crowd: the robots.
        draft: the plan; its penetrations have to be measured again.
        which: robots to fold, shape (b,).
        step_s: length of a grid interval [s].
    """
    last = draft.q.shape[2] - 1
    for i in range(len(crowd.start)):
        if not which[i]:
            continue
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
        alter(crowd, draft, i)
        draft.legs[i, 0], draft.legs[i, 1] = there, last - back
        trapezoid(draft.q[i, 1, : last - back + 1], s, v1, v2, 0, there, there, last - back)
        trapezoid(draft.q[i, 1, last - back :], v2, g, g, 0, back, back, back)
        s, g = draft.q[i, 0, 0], draft.q[i, 0, last]
        turn = least_intervals(g - s, crowd.speed[i, 0] * step_s)
        begin = min(there, max(0, (last - turn) // 2))
        end = max(begin + max(1, turn), last - back)
        trapezoid(draft.q[i, 0], s, g, g, begin, end, last, last)


@nb.njit(cache=True)
def go_straight(crowd, draft, which):
    """Let robots turn both motors over the whole time to where they end, shape of which (b,)."""
    last = draft.q.shape[2] - 1
    for i in range(len(crowd.start)):
        if which[i] and draft.choice[i] >= 0:
            alter(crowd, draft, i)
            draft.legs[i, 0] = draft.legs[i, 1] = 0
            for joint in range(2):
                s, g = draft.q[i, joint, 0], draft.q[i, joint, last]
                trapezoid(draft.q[i, joint], s, g, g, 0, last, last, last)


@nb.njit(cache=True, error_model="numpy")
def restore(crowd, draft, step_s, folding, rows, number, draws):
    """Let robots that were given up go to their targets after all where that meets nobody.

    Args:
        crowd: the robots.
        draft: a plan without conflict.
        step_s: length of a grid interval [s].
        folding: share of the candidates that fold the arm on their way.
        rows: robots to try, shape (k,).
        number: of a sweep not made yet.
        draws: candidates per robot.

    Returns:
        Number of robots restored.
    """
    profile = np.empty((2, draft.q.shape[2]))
    depths = np.empty(most_neighbours(crowd))
    order = np.empty(len(depths), dtype=np.int64)
    count = 0
    for i in rows:
        before = draft.choice[i]
        if before >= 0 or crowd.options[i] == 0:
            continue
        draft.choice[i] = 0
        worst_first(crowd, draft, i, order)
        state = seeded(crowd.key[i], 2 * number + 1)
        for draw in range(draws):
            choice = draw_any(crowd, draft, i, draw, draws, step_s, folding, state, profile)
            if weigh(crowd, draft, i, profile, 0.0, order, depths) == 0.0:
                adopt(crowd, draft, i, profile, depths)
                draft.legs[i, 0] = draft.legs[i, 1] = 0
                before = choice
                count += 1
                break
        draft.choice[i] = before
    return count

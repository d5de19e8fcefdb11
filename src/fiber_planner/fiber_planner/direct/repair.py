"""Repair of a plan by local search: robots in conflict try other profiles until none is left."""

import math
from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_planner.direct.draws import (
    fold_profile,
    least_intervals,
    next_uniform,
    seeded,
    trapezoid,
    via_profile,
    window,
)
from fiber_planner.direct.penetration import penetration

__all__ = ["Draft", "fold_first", "measure", "repair", "restore", "straighten"]

_GROWTH = 1.3  # of the weight of a pair, for every sweep its conflict lasts
_OTHER_OPTION = 0.3  # share of draws that end in another configuration on the target


class Draft(NamedTuple):
    """A plan in the making; all arrays are written by the search.

    Args:
        q: joint angles on the common grid [rad], shape (b, 2, k + 1), obstacles included.
        choice: the option each robot ends in, -1 where it may end anywhere, shape (n,).
        required: gap each pair must keep [mm], shape (p,).
        weight: what the search makes of each pair's conflict, shape (p,).
        depth: penetration of each pair [mm x intervals], shape (p,).
    """

    q: np.ndarray
    choice: np.ndarray
    required: np.ndarray
    weight: np.ndarray
    depth: np.ndarray


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


@nb.njit(cache=True, error_model="numpy")
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


@nb.njit(cache=True, error_model="numpy")
def _adopt(crowd, draft, i, profile, depths):
    draft.q[i] = profile
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        draft.depth[crowd.pair[e]] = depths[e - crowd.offsets[i]]


@nb.njit(cache=True, error_model="numpy")
def _draw(crowd, draft, i, number, many, step_s, folding, state, profile):
    # Write a candidate profile of robot i; return the option it ends in. Simple ones come
    # first: windows, then third angles close to the straight line, then anywhere.
    last = profile.shape[1] - 1
    choice = draft.choice[i]
    theta, phi = crowd.start[i]
    if choice >= 0:
        if crowd.options[i] > 1 and next_uniform(state) < _OTHER_OPTION:
            choice = int(next_uniform(state) * crowd.options[i])
        theta, phi = crowd.option[i, choice]
        for joint in range(2):
            goal = crowd.option[i, choice, joint]
            turn = goal - crowd.start[i, joint]
            if least_intervals(turn, crowd.speed[i, joint] * step_s) > last:
                choice = draft.choice[i]
        theta, phi = crowd.option[i, choice]
    elif number > 0:
        ease = (number / many) ** 2
        for joint in range(2):
            span = min(crowd.speed[i, joint] * step_s * last, math.pi * ease)
            end = crowd.start[i, joint] + span * (2.0 * next_uniform(state) - 1.0)
            end = min(max(end, crowd.low[i, joint]), crowd.high[i, joint])
            if joint == 0:
                theta = end
            else:
                phi = end
    folds = next_uniform(state) < folding
    kind = next_uniform(state)
    progress = number / many
    for joint in range(2):
        s = crowd.start[i, joint]
        g = theta if joint == 0 else phi
        per_interval = crowd.speed[i, joint] * step_s
        spread = math.pi * (0.15 + progress) * (0.2 + 0.8 * next_uniform(state))
        straight = progress < 0.3 or (kind < 0.3 and joint == 0) or (0.3 < kind < 0.5 and joint == 1)
        if folds and joint == 1:
            fold_profile(profile[joint], s, crowd.fold[i], g, per_interval, state)
        elif straight:
            window(profile[joint], s, g, per_interval, state)
        else:
            dwell = progress > 0.5 and next_uniform(state) < 0.5
            via_profile(
                profile[joint], s, g, crowd.low[i, joint], crowd.high[i, joint],
                per_interval, spread, dwell, state,
            )  # fmt: skip
    return choice


@nb.njit(cache=True, error_model="numpy")
def _redraw_leg(crowd, draft, i, step_s, folding, state, profile):
    # Write a candidate that keeps one half of robot i's profile, or only its ends; then it
    # passes the middle of the time folded (as far as it gets) and turned anyhow.
    last = profile.shape[1] - 1
    middle = last // 2
    profile[:] = draft.q[i]
    which = next_uniform(state)
    first, second = which < 0.4 or which >= 0.8, which >= 0.4
    turn = next_uniform(state) ** 2
    for joint in range(2):
        s, g = profile[joint, 0], profile[joint, last]
        per_interval = crowd.speed[i, joint] * step_s
        m = profile[joint, middle]
        if first and second:
            far, back = per_interval * middle, per_interval * (last - middle)
            low = max(crowd.low[i, joint], max(s - far, g - back))
            high = min(crowd.high[i, joint], min(s + far, g + back))
            if joint == 0:
                wanted = m + math.pi * turn * (2.0 * next_uniform(state) - 1.0)
            else:
                wanted = crowd.fold[i]
                if next_uniform(state) >= folding:
                    wanted += (0.5 * (s + g) - wanted) * next_uniform(state)
            if low <= high:
                m = min(max(wanted, low), high)
        spread = math.pi * next_uniform(state)
        for leg in range(2):
            if leg == 0:
                wanted_leg, row, begin, end = first, profile[joint, : middle + 1], s, m
            else:
                wanted_leg, row, begin, end = second, profile[joint, middle:], m, g
            if not wanted_leg:
                continue
            if next_uniform(state) < 0.55:
                window(row, begin, end, per_interval, state)
            else:
                via_profile(
                    row, begin, end, crowd.low[i, joint], crowd.high[i, joint],
                    per_interval, spread, next_uniform(state) < 0.5, state,
                )  # fmt: skip


@nb.njit(cache=True, error_model="numpy")
def repair(crowd, draft, step_s, folding, first, sweeps, draws, effort):
    """Sweep over the robots in conflict until none is left or the effort is spent.

    Guided local search (Voudouris and Tsang, EJOR 113, 1999): a robot takes the first
    candidate that clears it of all its neighbours, else the one of least weighted
    penetration; after each sweep the weight of every pair still in conflict grows.
    Robots go in an order that depends on their places and the sweep only.

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
    most = np.diff(crowd.offsets).max()
    depths = np.empty(most)
    best_depths = np.empty(most)
    touched = np.zeros(n, dtype=np.bool_)
    spent = 0
    keep_half = 0.3 if folding == 0.0 else 1.0
    for sweep in range(sweeps):
        touched[:] = False
        conflicts = 0
        for p in range(len(crowd.pairs)):
            if draft.depth[p] > 0.0:
                conflicts += 1
                for side in range(2):
                    if crowd.movable[crowd.pairs[p, side]]:
                        touched[crowd.pairs[p, side]] = True
        if conflicts == 0 or spent >= effort:
            return conflicts, sweep, spent
        robots = np.flatnonzero(touched)
        order = np.empty(len(robots), dtype=np.uint64)
        for m in range(len(robots)):
            order[m] = seeded(crowd.key[robots[m]], 2 * (first + sweep))[0]
        for m in np.argsort(order):
            i = robots[m]
            best = 0.0
            for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
                best += draft.weight[crowd.pair[e]] * draft.depth[crowd.pair[e]]
            if best == 0.0:
                continue
            found = False
            best_choice = draft.choice[i]
            state = seeded(crowd.key[i], 2 * (first + sweep) + 1)
            for number in range(draws):
                if number % 2 and next_uniform(state) < keep_half:
                    choice = draft.choice[i]
                    _redraw_leg(crowd, draft, i, step_s, folding, state, profile)
                else:
                    choice = _draw(crowd, draft, i, number, draws, step_s, folding, state, profile)
                spent += 1
                total = _weigh(crowd, draft, i, profile, best, depths)
                if total < best:
                    found, best, best_choice = True, total, choice
                    best_profile[:] = profile
                    best_depths[:] = depths
                    if total == 0.0:
                        break
            if found:
                _adopt(crowd, draft, i, best_profile, best_depths)
                draft.choice[i] = best_choice
        for p in range(len(crowd.pairs)):
            if draft.depth[p] > 0.0:
                draft.weight[p] *= _GROWTH
    conflicts = 0
    for p in range(len(crowd.pairs)):
        if draft.depth[p] > 0.0:
            conflicts += 1
    return conflicts, sweeps, spent


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
        s, g, v = draft.q[i, 1, 0], draft.q[i, 1, last], crowd.fold[i]
        if draft.choice[i] < 0 or (s == g and draft.q[i, 0, 0] == draft.q[i, 0, last]):
            continue
        there = least_intervals(v - s, crowd.speed[i, 1] * step_s)
        back = least_intervals(g - v, crowd.speed[i, 1] * step_s)
        if there + back <= last:
            trapezoid(draft.q[i, 1], s, v, g, 0, there, last - back, last)
            s, g = draft.q[i, 0, 0], draft.q[i, 0, last]
            turn = least_intervals(g - s, crowd.speed[i, 0] * step_s)
            least = min(there, last - turn)
            most = min(last, max(least + turn, last - back))
            trapezoid(draft.q[i, 0], s, g, g, least, most, last, last)


@nb.njit(cache=True, error_model="numpy")
def straighten(crowd, draft, step_s):
    """Let robots that make a detour go straight where that is clear now; return how many do."""
    n = len(crowd.start)
    last = draft.q.shape[2] - 1
    profile = np.empty((2, last + 1))
    depths = np.empty(np.diff(crowd.offsets).max())
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
    depths = np.empty(np.diff(crowd.offsets).max())
    count = 0
    for i in np.flatnonzero(wish):
        before = draft.choice[i]
        if before >= 0 or crowd.options[i] == 0:
            continue
        draft.choice[i] = 0
        state = seeded(crowd.key[i], 2 * first + 1)
        for number in range(draws):
            choice = _draw(crowd, draft, i, number, draws, step_s, folding, state, profile)
            if _weigh(crowd, draft, i, profile, 0.0, depths) == 0.0:
                _adopt(crowd, draft, i, profile, depths)
                before = choice
                count += 1
                break
        draft.choice[i] = before
    return count

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
_KEEP_HALF = 0.3  # share of the odd draws that change half a profile
# In this share of visits a robot leaves its heaviest conflict to the other one of the pair
# and takes the best candidate for all others: two robots that pass through each other are
# not always freed by moving one at a time.
_KICK = 0.1
_IGNORED = 1e-9  # weight of the conflict left to the other
_IN_TURNS = 0.4  # share of folded draws in which one joint waits for the other
_OTHER_OPTION = 0.3  # share of draws that end in another configuration on the target


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


@nb.njit(cache=True)
def _most_neighbours(crowd):
    most = 0
    for i in range(len(crowd.offsets) - 1):
        most = max(most, crowd.offsets[i + 1] - crowd.offsets[i])
    return most


@nb.njit(cache=True)
def _conflicts(draft):
    count = 0
    for p in range(len(draft.depth)):
        if draft.depth[p] > 0.0:
            count += 1
    return count


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


@nb.njit(cache=True)
def _copy(source, target):
    # loops: numba compiles an assignment of slices for seconds
    for joint in range(2):
        for k in range(source.shape[1]):
            target[joint, k] = source[joint, k]


@nb.njit(cache=True, error_model="numpy")
def _adopt(crowd, draft, i, profile, depths):
    _copy(profile, draft.q[i])
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        draft.depth[crowd.pair[e]] = depths[e - crowd.offsets[i]]


@nb.njit(cache=True)
def _heaviest(crowd, draft, i):
    # the pair of robot i with most weighted conflict
    heaviest, most = -1, -1.0
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        p = crowd.pair[e]
        if draft.weight[p] * draft.depth[p] > most:
            heaviest, most = p, draft.weight[p] * draft.depth[p]
    return heaviest


@nb.njit(cache=True)
def _nearer(fold, phi):
    return fold[0] if abs(fold[0] - phi) <= abs(fold[1] - phi) else fold[1]


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
        straight = (
            progress < 0.3 or (kind < 0.3 and joint == 0) or (0.3 < kind < 0.5 and joint == 1)
        )
        if folds and joint == 1:
            fold_profile(profile[joint], s, _nearer(crowd.fold[i], s), g, per_interval, state)
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
    _copy(draft.q[i], profile)
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
                wanted = _nearer(crowd.fold[i], m)
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


@nb.njit(cache=True)
def _least(a, b, step):
    return max(2, least_intervals(a - b, step))


@nb.njit(cache=True)
def _draw_leg(row, s, g, low, high, per_interval, spread, state):
    if next_uniform(state) < 0.6:
        window(row, s, g, per_interval, state)
    else:
        dwell = next_uniform(state) < 0.5
        via_profile(row, s, g, low, high, per_interval, spread, dwell, state)


@nb.njit(cache=True, error_model="numpy")
def _draw_folded(crowd, draft, i, step_s, state, profile, legs):
    # Write a candidate of robot i in three parts: from the start to a folded arm turned
    # anyhow, turning folded, from there to the goal. Often one of the outer parts is kept.
    # Returns the option it ends in, -2 if the parts do not fit together.
    last = profile.shape[1] - 1
    _copy(draft.q[i], profile)
    t1, t2 = draft.legs[i]
    which = next_uniform(state)
    first, second = which < 0.55, which >= 0.45
    if t1 == 0:
        first = second = True
    choice = draft.choice[i]
    turn_step, bend_step = crowd.speed[i, 0] * step_s, crowd.speed[i, 1] * step_s
    theta, phi = profile[0, last], profile[1, last]
    if second and choice >= 0 and crowd.options[i] > 1 and next_uniform(state) < _OTHER_OPTION:
        choice = int(next_uniform(state) * crowd.options[i])
        theta, phi = crowd.option[i, choice]
    v1, v2 = profile[1, t1], profile[1, t2]
    theta1, theta2 = profile[0, t1], profile[0, t2]
    if first:
        v1 = _nearer(crowd.fold[i], crowd.start[i, 1])
        if next_uniform(state) < 0.2:
            v1 = crowd.fold[i, int(2 * next_uniform(state))]
    if second:
        v2 = _nearer(crowd.fold[i], phi)
        if next_uniform(state) < 0.2:
            v2 = v1
    there = max(2, least_intervals(v1 - crowd.start[i, 1], bend_step))
    back = max(2, least_intervals(phi - v2, bend_step))
    if second:
        room = last - back - 1 - (there if first else t1)
        if room < 0:
            return -2
        t2 = last - back - int(next_uniform(state) ** 2 * (room + 1))
    if first:
        room = t2 - 1 - there
        if room < 0:
            return -2
        t1 = there + int(next_uniform(state) ** 2 * (room + 1))
    spread = 2.0 * math.pi * next_uniform(state) ** 2
    if second:
        theta2 = theta + spread * (2.0 * next_uniform(state) - 1.0)
        reach = turn_step * (last - t2)
        theta2 = min(max(theta2, theta - reach), theta + reach)
    if first:
        theta1 = crowd.start[i, 0] + spread * (2.0 * next_uniform(state) - 1.0)
        reach = turn_step * t1
        theta1 = min(max(theta1, crowd.start[i, 0] - reach), crowd.start[i, 0] + reach)
        between = turn_step * (t2 - t1)
        theta1 = min(max(theta1, theta2 - between), theta2 + between)
        theta1 = min(max(theta1, crowd.low[i, 0]), crowd.high[i, 0])
        if abs(theta1 - crowd.start[i, 0]) > reach * (1.0 + 1e-9):
            if not second:
                return -2
            theta1 = crowd.start[i, 0] + math.copysign(reach, theta1 - crowd.start[i, 0])
    if second:
        between = turn_step * (t2 - t1)
        reach = turn_step * (last - t2)
        theta2 = min(max(theta2, theta1 - between), theta1 + between)
        theta2 = min(max(theta2, crowd.low[i, 0]), crowd.high[i, 0])
        if abs(theta2 - theta) > reach * (1.0 + 1e-9):
            return -2
    if abs(theta2 - theta1) > turn_step * (t2 - t1) * (1.0 + 1e-9):
        return -2
    if abs(v2 - v1) > bend_step * (t2 - t1) * (1.0 + 1e-9):
        return -2
    # often a robot waits before it folds, or is unfolded early: both joints together
    wait = early = 0
    if next_uniform(state) < 0.5:
        wait = int(
            next_uniform(state)
            * (t1 - max(there, _least(theta1, crowd.start[i, 0], turn_step)) + 1)
        )
    if next_uniform(state) < 0.5:
        early = int(
            next_uniform(state) * (last - t2 - max(back, _least(theta2, theta, turn_step)) + 1)
        )
    # often one joint turns first and the other when it is done
    out_turn, out_bend = _least(theta1, crowd.start[i, 0], turn_step), there
    in_turn, in_bend = _least(theta2, theta, turn_step), back
    kind = next_uniform(state)
    in_turns = kind < _IN_TURNS
    turn_first = kind < 0.5 * _IN_TURNS
    for joint in range(2):
        low, high = crowd.low[i, joint], crowd.high[i, joint]
        step = turn_step if joint == 0 else bend_step
        m1, m2 = (theta1, theta2) if joint == 0 else (v1, v2)
        wide = math.pi * next_uniform(state)
        if first:
            s = crowd.start[i, joint]
            begin, end = wait, t1
            if in_turns and t1 - wait >= out_turn + out_bend:
                if turn_first == (joint == 0):
                    end = wait + (out_turn if joint == 0 else out_bend)
                else:
                    begin = wait + (out_bend if joint == 0 else out_turn)
            for k in range(t1 + 1):
                profile[joint, k] = s if k <= begin else m1
            _draw_leg(profile[joint, begin : end + 1], s, m1, low, high, step, wide, state)
        if second:
            g = theta if joint == 0 else phi
            begin, end = t2, last - early
            if in_turns and last - early - t2 >= in_turn + in_bend:
                if turn_first == (joint == 1):  # the way out, backwards
                    end = t2 + (in_turn if joint == 0 else in_bend)
                else:
                    begin = t2 + (in_bend if joint == 0 else in_turn)
            for k in range(t2, last + 1):
                profile[joint, k] = m2 if k <= begin else g
            _draw_leg(profile[joint, begin : end + 1], m2, g, low, high, step, wide, state)
        for k in range(t1 + 1, t2):
            profile[joint, k] = m1 + (m2 - m1) * ((k - t1) / (t2 - t1))
    legs[0], legs[1] = t1, t2
    return choice


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
                    choice = _draw_folded(crowd, draft, i, step_s, state, profile, legs)
                    if choice == -2:
                        continue
                elif number % 2 and next_uniform(state) < _KEEP_HALF:
                    choice = draft.choice[i]
                    _redraw_leg(crowd, draft, i, step_s, folding, state, profile)
                else:
                    choice = _draw(crowd, draft, i, number, draws, step_s, folding, state, profile)
                spent += 1
                total = _weigh(crowd, draft, i, profile, best, depths)
                if total < best:
                    found, best, best_choice = True, total, choice
                    best_legs[0], best_legs[1] = legs[0], legs[1]
                    _copy(profile, best_profile)
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
        v1, v2 = _nearer(crowd.fold[i], s), _nearer(crowd.fold[i], g)
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
            choice = _draw(crowd, draft, i, number, draws, step_s, folding, state, profile)
            if _weigh(crowd, draft, i, profile, 0.0, depths) == 0.0:
                _adopt(crowd, draft, i, profile, depths)
                draft.legs[i, 0] = draft.legs[i, 1] = 0
                before = choice
                count += 1
                break
        draft.choice[i] = before
    return count

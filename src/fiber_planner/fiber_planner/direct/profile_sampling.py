"""Seeded draws, and the profiles that are drawn."""

import math

import numba as nb
import numpy as np

__all__ = [
    "fold_profile",
    "least_intervals",
    "next_uniform",
    "seeded",
    "trapezoid",
    "via_profile",
    "window",
]

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _mix(z):
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@nb.njit(cache=True)
def seeded(key, round_):
    """Return the state of a generator for one robot in one round, uint64, shape (1,)."""
    state = np.empty(1, dtype=np.uint64)
    state[0] = _mix(key + (np.uint64(round_) + np.uint64(1)) * _GOLDEN)
    return state


@nb.njit(cache=True)
def next_uniform(state):
    """Return the next number in [0, 1) of splitmix64 (Steele, Lea, Flood, OOPSLA 2014)."""
    state[0] = state[0] + _GOLDEN
    return float(_mix(state[0]) >> _S11) * (1.0 / 9007199254740992.0)


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _whole(state, low, high):
    # uniform in low..high, both included
    return min(high, low + int(next_uniform(state) * (high - low + 1)))


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def least_intervals(turn, per_interval):
    """Return how many whole intervals a joint needs for a turn [rad] at its highest speed."""
    return int(math.ceil(abs(turn) / per_interval - 1e-9))


@nb.njit(cache=True)
def trapezoid(row, s, v, g, a0, a1, b0, b1):
    """Fill a profile: from s to v in grid times a0..a1, rest, from v to g in b0..b1.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        s, v, g: first, middle and last angle [rad].
        a0, a1, b0, b1: grid times, 0 <= a0 <= a1 <= b0 <= b1 <= k.
    """
    for k in range(len(row)):
        if k <= a0:
            row[k] = s
        elif k < a1:
            row[k] = s + (v - s) * ((k - a0) / (a1 - a0))
        elif k <= b0:
            row[k] = v
        elif k < b1:
            row[k] = v + (g - v) * ((k - b0) / (b1 - b0))
        else:
            row[k] = g
    row[0] = s
    row[len(row) - 1] = g


@nb.njit(cache=True)
def window(row, s, g, per_interval, state):
    """Draw a profile that goes straight from s to g within a part of the time."""
    last = len(row) - 1
    least = max(1, least_intervals(g - s, per_interval))
    length = _whole(state, least, last)
    begin = _whole(state, 0, last - length)
    kind = next_uniform(state)
    if kind < 0.25:
        begin = 0
    elif kind < 0.5:
        begin = last - length
    trapezoid(row, s, g, g, begin, begin + length, last, last)


@nb.njit(cache=True)
def via_profile(row, s, g, low, high, per_interval, spread, dwell, state):
    """Draw a profile that goes from s to g by way of a third angle.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        s, g: first and last angle [rad], g within reach of s in k intervals.
        low, high: range of the third angle [rad].
        per_interval: farthest turn in one interval [rad].
        spread: how far from the straight line the third angle may be [rad].
        dwell: whether the joint may rest there.
        state: of the generator.
    """
    last = len(row) - 1
    middle = _whole(state, 1, last - 1)
    share = middle / last
    line = s + (g - s) * share
    v = line + spread * (2.0 * next_uniform(state) - 1.0)
    low = max(low, max(s - per_interval * middle, g - per_interval * (last - middle)))
    high = min(high, min(s + per_interval * middle, g + per_interval * (last - middle)))
    if low > high:
        v = line
    else:
        v = min(max(v, low), high)
    first = least_intervals(v - s, per_interval)
    second = least_intervals(g - v, per_interval)
    if first > middle or second > last - middle:  # a line at full speed, cut by rounding
        trapezoid(row, s, g, g, 0, last, last, last)
        return
    a0, a1, b0, b1 = 0, middle, middle, last
    if dwell:
        a1 = _whole(state, max(1, first), middle)
        b0 = _whole(state, middle, min(last - 1, last - second))
        if next_uniform(state) < 0.5:
            a0 = _whole(state, 0, a1 - max(1, first))
        if next_uniform(state) < 0.5:
            b1 = _whole(state, b0 + max(1, second), last)
    trapezoid(row, s, v, g, a0, a1, b0, b1)


@nb.njit(cache=True)
def fold_profile(row, s, fold, g, per_interval, state):
    """Draw a profile that goes from s to a folded arm, rests there, and ends in g.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        s, g: first and last angle [rad], g within reach of s in k intervals.
        fold: the angle of the folded arm [rad].
        per_interval: farthest turn in one interval [rad].
        state: of the generator.
    """
    last = len(row) - 1
    if next_uniform(state) < 0.5:  # not all the way
        fold += (0.5 * (s + g) - fold) * next_uniform(state)
    v = fold
    for _ in range(6):
        first = max(1, least_intervals(v - s, per_interval))
        second = max(1, least_intervals(g - v, per_interval))
        if first + second <= last:
            break
        v = 0.5 * (v + 0.5 * (s + g))
    if first + second > last:
        window(row, s, g, per_interval, state)
        return
    room = last - first - second
    a0 = _whole(state, 0, room // 2) if next_uniform(state) < 0.5 else 0
    a1 = a0 + first
    if next_uniform(state) < 0.5:
        a1 += _whole(state, 0, room // 2 - a0)
    left = last - second - a1
    b1 = last - (_whole(state, 0, left) if next_uniform(state) < 0.5 else 0)
    b0 = b1 - second
    if next_uniform(state) < 0.5:
        b0 -= _whole(state, 0, b0 - a1)
    trapezoid(row, s, v, g, a0, a1, b0, b1)


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def copy_profile(source, target):
    """Copy the profiles of both joints; both shape (2, k + 1)."""
    for joint in range(2):  # loops: numba takes seconds to compile an assignment of slices
        for k in range(source.shape[1]):
            target[joint, k] = source[joint, k]

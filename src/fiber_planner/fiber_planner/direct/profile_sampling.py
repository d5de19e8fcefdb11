# SPDX-License-Identifier: Apache-2.0
"""Random profiles of one joint on the time grid."""

import math

import numba as nb

from fiber_core.array_types import Floats
from fiber_planner.direct.splitmix64 import RngState, next_uniform

__all__ = [
    "copy_profile",
    "fill_two_ramps",
    "least_intervals",
    "sample_fold",
    "sample_line",
    "sample_via",
    "sample_window",
]


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _random_int(rng, low, high):
    # uniform in low..high, both included
    return min(high, low + int(next_uniform(rng) * (high - low + 1)))


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def least_intervals(angle: float, per_interval: float) -> int:
    """Return the number of whole intervals that a joint needs for an angle at full speed.

    Args:
        angle: change of the joint angle, of either sign [rad].
        per_interval: largest change in one interval [rad].
    """
    return int(math.ceil(abs(angle) / per_interval - 1e-9))


@nb.njit(cache=True)
def fill_two_ramps(
    row: Floats, s: float, v: float, g: float, a0: int, a1: int, b0: int, b1: int
) -> None:
    """Write a profile that goes from s to v in grid times a0..a1, rests, and from v to g in b0..b1.

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
def sample_line(
    row: Floats, s: float, g: float, per_interval: float, whole: bool, rng: RngState
) -> None:
    """Sample a profile that goes straight from s to g from the start on, at some speed.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        s, g: first and last angle [rad], g within reach of s in k intervals.
        per_interval: largest change in one interval [rad].
        whole: whether it takes all of the time.
        rng: of the random numbers.
    """
    last = len(row) - 1
    least = max(1, least_intervals(g - s, per_interval))
    length = last if whole else _random_int(rng, min(least, last), last)
    fill_two_ramps(row, s, g, g, 0, length, last, last)


@nb.njit(cache=True)
def sample_window(row: Floats, s: float, g: float, per_interval: float, rng: RngState) -> None:
    """Sample a profile that goes straight from s to g within a random part of the time.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        s, g: first and last angle [rad], g within reach of s in k intervals.
        per_interval: largest change in one interval [rad].
        rng: of the random numbers.
    """
    last = len(row) - 1
    least = max(1, least_intervals(g - s, per_interval))
    length = _random_int(rng, least, last)
    begin = _random_int(rng, 0, last - length)
    kind = next_uniform(rng)
    if kind < 0.25:
        begin = 0
    elif kind < 0.5:
        begin = last - length
    fill_two_ramps(row, s, g, g, begin, begin + length, last, last)


@nb.njit(cache=True)
def sample_via(
    row: Floats,
    s: float,
    g: float,
    low: float,
    high: float,
    per_interval: float,
    spread: float,
    dwell: bool,
    rng: RngState,
) -> None:
    """Sample a profile that goes from s to g by way of a third angle.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        s, g: first and last angle [rad], g within reach of s in k intervals.
        low, high: range of the third angle [rad].
        per_interval: largest change in one interval [rad].
        spread: largest distance of the third angle from the straight line [rad].
        dwell: whether the joint may rest at the third angle.
        rng: of the random numbers.
    """
    last = len(row) - 1
    middle = _random_int(rng, 1, last - 1)
    share = middle / last
    line = s + (g - s) * share
    v = line + spread * (2.0 * next_uniform(rng) - 1.0)
    low = max(low, max(s - per_interval * middle, g - per_interval * (last - middle)))
    high = min(high, min(s + per_interval * middle, g + per_interval * (last - middle)))
    if low > high:
        v = line
    else:
        v = min(max(v, low), high)
    first = least_intervals(v - s, per_interval)
    second = least_intervals(g - v, per_interval)
    if first > middle or second > last - middle:  # a line at full speed, cut by rounding
        fill_two_ramps(row, s, g, g, 0, last, last, last)
        return
    a0, a1, b0, b1 = 0, middle, middle, last
    if dwell:
        a1 = _random_int(rng, max(1, first), middle)
        b0 = _random_int(rng, middle, min(last - 1, last - second))
        if next_uniform(rng) < 0.5:
            a0 = _random_int(rng, 0, a1 - max(1, first))
        if next_uniform(rng) < 0.5:
            b1 = _random_int(rng, b0 + max(1, second), last)
    fill_two_ramps(row, s, v, g, a0, a1, b0, b1)


@nb.njit(cache=True)
def sample_fold(
    row: Floats, s: float, fold: float, g: float, per_interval: float, rng: RngState
) -> None:
    """Sample a profile of phi that goes from s to a folded arm, rests there, and ends at g.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        s, g: first and last angle [rad], g within reach of s in k intervals.
        fold: the angle of the folded arm [rad].
        per_interval: largest change in one interval [rad].
        rng: of the random numbers.
    """
    last = len(row) - 1
    if next_uniform(rng) < 0.5:  # folded partly
        fold += (0.5 * (s + g) - fold) * next_uniform(rng)
    v = fold
    first = second = 0
    for _ in range(6):
        first = max(1, least_intervals(v - s, per_interval))
        second = max(1, least_intervals(g - v, per_interval))
        if first + second <= last:
            break
        v = 0.5 * (v + 0.5 * (s + g))
    if first + second > last:
        sample_window(row, s, g, per_interval, rng)
        return
    spare = last - first - second
    a0 = _random_int(rng, 0, spare // 2) if next_uniform(rng) < 0.5 else 0
    a1 = a0 + first
    if next_uniform(rng) < 0.5:
        a1 += _random_int(rng, 0, spare // 2 - a0)
    left = last - second - a1
    b1 = last - (_random_int(rng, 0, left) if next_uniform(rng) < 0.5 else 0)
    b0 = b1 - second
    if next_uniform(rng) < 0.5:
        b0 -= _random_int(rng, 0, b0 - a1)
    fill_two_ramps(row, s, v, g, a0, a1, b0, b1)


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def copy_profile(source: Floats, target: Floats) -> None:
    """Copy the profiles of both joints; both arrays have shape (2, k + 1)."""
    for joint in range(2):  # loops: numba takes seconds to compile an assignment of slices
        for k in range(source.shape[1]):
            target[joint, k] = source[joint, k]

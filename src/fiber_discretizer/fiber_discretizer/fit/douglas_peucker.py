# SPDX-License-Identifier: Apache-2.0
"""Recursive bisection: a straight line from end to end, cut where it leaves its corridor most.

The discretization of Makarem et al. (SPIE 2014, arXiv 1410.1181), in the manner of Douglas and
Peucker (Cartographica 10, 1973), which cuts where the line is farthest from the profile.
"""

import numpy as np
from numba import njit

from fiber_core.array_types import Floats, Ints, Offsets

__all__ = ["bisection_knots"]


@njit(cache=True)
def bisection_knots(
    time_s: Floats, profiles: Floats, low: Floats, high: Floats, last: Ints
) -> tuple[Offsets, Ints]:
    """Return the samples at which each profile is cut, ends included.

    A line is cut at the sample where it leaves the corridor by most, and both parts are
    treated in the same way.

    Args:
        time_s: sample times [s], shape (t,).
        profiles: joint angles [rad], shape (p, t).
        low, high: bounds of the corridors [rad], shape (p, t).
        last: sample at which each profile ends, shape (p,).

    Returns:
        Offsets, shape (p + 1,), and samples of the knots, shape (k,).
    """
    p, t = profiles.shape
    offsets = np.zeros(p + 1, np.int64)
    flat = np.empty(4 * p + t, np.int64)
    used = 0
    rights = np.empty(t, np.int64)  # right ends of the parts that remain, nearest on top
    for i in range(p):
        if used + t > len(flat):
            grown = np.empty(2 * len(flat) + t, np.int64)
            for k in range(used):  # a slice assignment compiles for seconds
                grown[k] = flat[k]
            flat = grown
        flat[used] = 0
        used += 1
        rights[0] = last[i]
        left, depth = 0, 1 if last[i] > 0 else 0
        while depth > 0:
            right = rights[depth - 1]
            cut = _worst_sample(time_s, profiles[i], low[i], high[i], left, right)
            if cut >= 0:
                rights[depth] = cut
                depth += 1
            else:
                flat[used] = right
                used += 1
                left = right
                depth -= 1
        offsets[i + 1] = used
    return offsets, flat[:used].copy()


@njit(cache=True)
def _worst_sample(time_s, profile, low, high, left, right):
    # the sample between left and right where their chord leaves the corridor by most, or -1
    slope = (profile[right] - profile[left]) / (time_s[right] - time_s[left])
    worst, at = 0.0, -1
    for k in range(left + 1, right):
        chord = profile[left] + slope * (time_s[k] - time_s[left])
        excess = max(low[k] - chord, chord - high[k])
        if excess > worst:
            worst, at = excess, k
    return at

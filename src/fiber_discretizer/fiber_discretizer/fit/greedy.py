# SPDX-License-Identifier: Apache-2.0
"""Greedy fit: straight lines from sample to sample, each as long as its corridor allows."""

import numpy as np
from numba import njit

from fiber_core.array_types import Floats, Ints, Offsets

__all__ = ["greedy_knots"]


@njit(cache=True)
def greedy_knots(
    time_s: Floats, profiles: Floats, low: Floats, high: Floats, last: Ints
) -> tuple[Offsets, Ints]:
    """Return the samples at which the lines along each profile meet, ends included.

    From a knot on the profile the next is the farthest sample that a straight line inside the
    corridor reaches. The slopes that pass all bounds up to there are an interval that only
    shrinks.

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
    flat = np.empty(p * t, np.int64)
    used = 0
    for i in range(p):
        knot = 0
        flat[used] = 0
        used += 1
        while knot < last[i]:
            flattest, steepest, farthest = -np.inf, np.inf, knot + 1
            for k in range(knot + 1, last[i] + 1):
                dt, angle = time_s[k] - time_s[knot], profiles[i, knot]
                slope = (profiles[i, k] - angle) / dt
                if flattest <= slope <= steepest:
                    farthest = k
                flattest = max(flattest, (low[i, k] - angle) / dt)
                steepest = min(steepest, (high[i, k] - angle) / dt)
                if flattest > steepest:
                    break
            knot = farthest
            flat[used] = knot
            used += 1
        offsets[i + 1] = used
    return offsets, flat[:used].copy()

"""Straight lines from sample to sample, each as long as it goes: the common shortcut."""

import numpy as np
from numba import njit

__all__ = ["greedy_knots"]


@njit(cache=True)
def greedy_knots(time_s, profiles, low, high, last):
    """Return offsets and samples of the knots of each profile.

    From a knot on the profile the next is the farthest sample that a straight line inside the
    tube meets. The slopes that pass all walls up to there are an interval that only shrinks.
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
            flattest, steepest, best = -np.inf, np.inf, knot + 1
            for k in range(knot + 1, last[i] + 1):
                dt, here = time_s[k] - time_s[knot], profiles[i, knot]
                slope = (profiles[i, k] - here) / dt
                if flattest <= slope <= steepest:
                    best = k
                flattest = max(flattest, (low[i, k] - here) / dt)
                steepest = min(steepest, (high[i, k] - here) / dt)
                if flattest > steepest:
                    break
            knot = best
            flat[used] = knot
            used += 1
        offsets[i + 1] = used
    return offsets, flat[:used].copy()

"""The bisection of the paper: a straight line from end to end, cut where it strays most."""

import numpy as np
from numba import njit

__all__ = ["bisection_knots"]


@njit(cache=True)
def bisection_knots(time_s, profiles, low, high, last):
    """Return offsets and samples of the knots of each profile.

    Makarem et al. 2014 (SPIE, arXiv 1410.1181): a line is cut at the sample where it leaves
    its margin by most, and both parts are treated the same.
    """
    p, t = profiles.shape
    offsets = np.zeros(p + 1, np.int64)
    flat = np.empty(4 * p + t, np.int64)
    used = 0
    rights = np.empty(t, np.int64)  # right ends of the parts still to do, nearest on top
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
    # the sample between left and right where their chord leaves the tube by most, or -1
    slope = (profile[right] - profile[left]) / (time_s[right] - time_s[left])
    worst, at = 0.0, -1
    for k in range(left + 1, right):
        chord = profile[left] + slope * (time_s[k] - time_s[left])
        excess = max(low[k] - chord, chord - high[k])
        if excess > worst:
            worst, at = excess, k
    return at

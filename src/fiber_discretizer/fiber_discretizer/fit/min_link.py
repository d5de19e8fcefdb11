# SPDX-License-Identifier: Apache-2.0
"""The path with the fewest straight lines inside a corridor, both ends fixed, in linear time.

A minimum-link path in a corridor that only goes forward in time (Suri, Computer Vision,
Graphics and Image Processing 35, 1986; Imai and Iri, Journal of Information Processing 9,
1986). The part of the corridor that one line from the start can reach ends at a *window*: the
extreme line touches one bound at b and, later, hits the other bound at c. Every path has to cross
the window between b and c, and the extreme line reaches every point of the window. So the next
line is any line that crosses the window, and the first path to reach the end has the fewest
lines. To find the lines that cross a window and the gates after it, only points have to be
stabbed: of lower bound and upper bound, in the order of time, as in O'Rourke (Communications of
the ACM 24, 1981), with the steepest and the flattest line and the two hulls that they lean on.
No sample is evaluated more than twice.

Lines are no steeper than the speed limit: a bound on the slopes of all lines. It changes
nothing above, as long as some path no faster than the limit is inside the corridor.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from fiber_core.array_types import Floats, Ints, Offsets

__all__ = ["min_link_paths", "relaxed_paths"]

_STEEPEST = 1e6  # steepest slope of a line [rad/s]; a steeper one would lose digits
_TINY_RAD = 1e-12  # a bound is hit when a line is this far beyond it
_NARROWINGS = 5  # halvings of the share of the corridor that a path may use


@njit(cache=True, error_model="numpy")
def min_link_paths(
    time_s: Floats, profiles: Floats, low: Floats, high: Floats, last: Ints, fastest: Floats
) -> tuple[Offsets, Floats, Floats]:
    """Return the minimum-link path of each profile.

    Args:
        time_s: sample times [s], shape (t,).
        profiles: joint angles [rad], shape (p, t).
        low, high: bounds of the corridors [rad], shape (p, t).
        last: sample at which each path ends, shape (p,).
        fastest: highest speed of each path [rad/s], shape (p,).

    Returns:
        Offsets, shape (p + 1,), times [s] and angles [rad] of the knots, shape (k,). Where a
        corridor cannot be passed at its speed, the path has no knots.
    """
    return _paths(time_s, profiles, low, high, last, fastest, 0)


@njit(cache=True, error_model="numpy")
def relaxed_paths(
    time_s: Floats, profiles: Floats, low: Floats, high: Floats, last: Ints, fastest: Floats
) -> tuple[Offsets, Floats, Floats]:
    """Return minimum-link paths that use a small share of their corridors, as min_link_paths.

    The share is the smallest, within 1/32, that needs no more lines, of the way from the
    profile, or from the point of the corridor nearest to it, to the bounds.
    """
    return _paths(time_s, profiles, low, high, last, fastest, _NARROWINGS)


@njit(cache=True, error_model="numpy")
def _paths(time_s, profiles, low, high, last, fastest, narrowings):
    p, t = profiles.shape
    offsets = np.zeros(p + 1, np.int64)
    size = 4 * p + t + 1
    knot_time, knot_angle = np.empty(size), np.empty(size)
    work = np.empty((9, t + 3))
    lower, upper, center, best = np.empty(t), np.empty(t), np.empty(t), np.empty((2, t + 1))
    used = 0
    for i in range(p):
        if used + t + 1 > size:
            size = 2 * size + t
            grown_time, grown_angle = np.empty(size), np.empty(size)
            for k in range(used):  # a slice assignment compiles for seconds
                grown_time[k], grown_angle[k] = knot_time[k], knot_angle[k]
            knot_time, knot_angle = grown_time, grown_angle
        end = last[i]
        for k in range(end + 1):
            center[k] = min(max(profiles[i, k], low[i, k]), high[i, k])
            lower[k], upper[k] = low[i, k], high[i, k]
        center[0], center[end] = profiles[i, 0], profiles[i, end]
        lower[0] = upper[0] = center[0]
        lower[end] = upper[end] = center[end]
        count = _path(time_s, lower, upper, end, fastest[i], t, work, best)
        if count > 2:
            least, most = 0.0, 1.0
            for _ in range(narrowings):
                share = 0.5 * (least + most)
                _narrow(low[i], high[i], center, share, end, lower, upper)
                fits = _path(time_s, lower, upper, end, fastest[i], count - 1, work, best)
                if fits == count:
                    most = share
                else:
                    least = share
            if narrowings > 0:
                _narrow(low[i], high[i], center, most, end, lower, upper)
                _path(time_s, lower, upper, end, fastest[i], count - 1, work, best)
        for k in range(count):
            knot_time[used + k], knot_angle[used + k] = best[0, k], best[1, k]
        used += count
        offsets[i + 1] = used
    return offsets, knot_time[:used].copy(), knot_angle[:used].copy()


@njit(cache=True, error_model="numpy")
def _narrow(low, high, center, share, end, lower, upper):
    # put the bounds at a share of the way from the center to the corridor's own
    for k in range(1, end):
        lower[k] = center[k] + share * (low[k] - center[k])
        upper[k] = center[k] + share * (high[k] - center[k])


class _Extremes(NamedTuple):
    # The extreme lines of both sides. The upper bound is treated upside down, so that both
    # bounds are below: side 0 is the lower, side 1 the upper bound. The extreme line of a side
    # leans on that bound at its right and on the other one at its left.
    x: Floats  # where each line leans on its bound: time,
    y: Floats  # and angle
    slope: Floats
    after: Ints  # the first sample after that point
    hull_x: Floats  # convex hull of each bound so far
    hull_y: Floats
    head: Ints  # first point of each hull that still counts
    size: Ints  # points of each hull


@njit(cache=True, error_model="numpy")
def _path(time_s, lower, upper, end, fastest, most, work, knots):
    # Fills in the knots of a path of at most `most` lines; returns the number of knots, 0 if
    # there is no such path.
    bounds = (lower, upper)
    steepest = min(fastest, _STEEPEST)
    windows = work[4:9]  # of each stage: a point of the line (time, angle), slope, b, c
    lines = _Extremes(
        np.empty(2), np.empty(2), np.empty(2), np.ones(2, np.int64),
        work[0:2], work[2:4], np.zeros(2, np.int64), np.ones(2, np.int64),
    )  # fmt: skip
    for side in range(2):
        lines.x[side] = lines.hull_x[side, 0] = time_s[0]
        lines.y[side] = lines.hull_y[side, 0] = (1 - 2 * side) * bounds[side][0]
        lines.slope[side] = -steepest
    knots[0, 0], knots[1, 0] = time_s[0], lower[0]
    links, k = 1, 1
    beyond, leaning = 1, 0  # first sample beyond the window; the bound that counts before it
    while k <= end:
        x = time_s[k]
        blocked = -1
        if k >= beyond:
            if lines.y[0] + lines.slope[0] * (x - lines.x[0]) > upper[k] + _TINY_RAD:
                blocked = 0
            elif lines.y[1] + lines.slope[1] * (x - lines.x[1]) > -lower[k] + _TINY_RAD:
                blocked = 1
        if blocked >= 0:
            if links >= min(most, end) or lines.slope[blocked] <= -steepest:
                return 0
            other_bound = bounds[1 - blocked]
            _open_window(lines, time_s, other_bound, k, blocked, steepest, windows[:, links - 1])
            links += 1
            # The next line is above b and its bound up to c, below c, and then between both.
            beyond, leaning, k = k, blocked, lines.after[blocked]
            lines.after[1 - blocked] = beyond
            continue
        for side in range(2):
            if k >= beyond or side == leaning:
                _lean(lines, side, k, x, (1 - 2 * side) * bounds[side][k], steepest)
        k += 1
    if end == 0:
        return 1
    slope = 0.5 * (lines.slope[0] - lines.slope[1])  # in the middle of those that meet the end
    return _knots_of(windows, links, time_s[end], lower[end], slope, knots)


@njit(cache=True, error_model="numpy")
def _open_window(lines, time_s, other_bound, k, side, steepest, window):
    # The extreme line of a side hits the other bound before sample k: record its window, and
    # begin both extreme lines anew at b and c.
    other, sign = 1 - side, 1 - 2 * side
    b, b_y, slope = lines.x[side], lines.y[side], lines.slope[side]
    before, x = time_s[k - 1], time_s[k]
    inside = max(sign * other_bound[k - 1] - (b_y + slope * (before - b)), 0.0)
    outside = b_y + slope * (x - b) - sign * other_bound[k]
    c = max(before + inside / (inside + outside) * (x - before), b)
    c_y = b_y + slope * (c - b)
    window[0], window[1] = b, sign * b_y
    window[2], window[3] = sign * slope, b
    window[4] = c
    lines.slope[side] = -steepest
    lines.x[other], lines.y[other], lines.slope[other] = c, -c_y, -slope
    lines.hull_x[side, 0], lines.hull_y[side, 0] = b, b_y
    lines.hull_x[other, 0], lines.hull_y[other, 0] = c, -c_y
    lines.head[0] = lines.head[1] = 0
    lines.size[0] = lines.size[1] = 1


@njit(cache=True, error_model="numpy")
def _lean(lines, side, k, x, y, steepest):
    # Let the extreme line of a side pass above the point (x, y) of its bound, sample k, and add
    # the point to the hull of the bound.
    other = 1 - side
    hull_x, hull_y = lines.hull_x, lines.hull_y
    if lines.y[side] + lines.slope[side] * (x - lines.x[side]) < y:
        # turn the line: through this point and leaning on the hull of the other side
        slope, i = -np.inf, lines.head[other]
        while i < lines.size[other] and hull_x[other, i] < x:
            s = (y + hull_y[other, i]) / (x - hull_x[other, i])
            if s < slope:
                break  # slopes to the hull rise up to the tangent and fall behind it
            slope = s
            lines.head[other] = i
            i += 1
        lines.x[side], lines.y[side], lines.slope[side] = x, y, max(slope, -steepest)
        lines.after[side] = k + 1
    n = lines.size[side]
    while n - lines.head[side] >= 2:
        ax, ay = hull_x[side, n - 2], hull_y[side, n - 2]
        bx, by = hull_x[side, n - 1], hull_y[side, n - 1]
        if (by - ay) * (x - bx) > (y - by) * (bx - ax):
            break
        n -= 1
    hull_x[side, n], hull_y[side, n] = x, y
    lines.size[side] = n + 1


@njit(cache=True, error_model="numpy")
def _knots_of(windows, links, x, y, slope, knots):
    # Where the last line, through (x, y), meets the window before it, and so back to the
    # start. Returns the number of knots. Rounding can make two knots of a point that both
    # bounds touch; the second is left out.
    knots[0, links], knots[1, links] = x, y
    for i in range(links - 2, -1, -1):
        at, value, other_slope = windows[0, i], windows[1, i], windows[2, i]
        meet = windows[4, i]
        if abs(slope - other_slope) > 1e-12 * (1.0 + abs(slope)):
            meet = (value - other_slope * at - y + slope * x) / (slope - other_slope)
        x = min(max(meet, windows[3, i]), windows[4, i])
        y = value + other_slope * (x - at)
        slope = other_slope
        knots[0, i + 1], knots[1, i + 1] = x, y
    kept = 1
    for i in range(1, links + 1):
        if knots[0, i] > knots[0, kept - 1]:
            knots[0, kept], knots[1, kept] = knots[0, i], knots[1, i]
            kept += 1
    knots[1, kept - 1] = knots[1, links]
    return kept

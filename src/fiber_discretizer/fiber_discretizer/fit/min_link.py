"""The path with the fewest straight lines inside a tube, both ends fixed, in linear time.

A minimum-link path in a corridor that only goes forward in time (Suri, Computer Vision,
Graphics and Image Processing 35, 1986; Imai and Iri, Journal of Information Processing 9,
1986). All that one line from the start can see ends at a *window*: the extreme line, that
touches one wall at b and, later, hits the other wall at c. Everything beyond must cross the
window between b and c, and every point of it is reached by the extreme line itself. So the
next line is any that crosses the window, the first path to see the end has the fewest lines,
and only points have to be stabbed: of lower wall and upper wall, in the order of time, as in
O'Rourke (Communications of the ACM 24, 1981), with the steepest and the flattest line and the
two hulls they lean on. No sample is looked at more than twice.

Lines are no steeper than the speed limit: a bound on the slopes of all of them. It changes
nothing above, as long as some path no faster than the limit is inside the tube.
"""

import numpy as np
from numba import njit

__all__ = ["min_link_paths", "relaxed_paths"]

_STEEPEST = 1e6  # [rad/s] of a line; steeper ones would lose digits
_TINY_RAD = 1e-12  # walls are hit when a line is this far beyond them
_NARROWINGS = 5  # halvings of the share of the tube that a path may use


@njit(cache=True, error_model="numpy")
def min_link_paths(time_s, profiles, low, high, last, fastest):
    """Return the minimum-link path of each profile: offsets, knot times, knot angles.

    A profile whose tube cannot be passed at its speed has a path of no knots.
    """
    return _paths(time_s, profiles, low, high, last, fastest, 0)


@njit(cache=True, error_model="numpy")
def relaxed_paths(time_s, profiles, low, high, last, fastest):
    """Return minimum-link paths that use a small share of their tubes, as min_link_paths.

    The share is the smallest, within 1/32, in which no line more is needed, of the way from
    the profile, or the point of the tube nearest to it, to the walls.
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
        count = _one_path(time_s, lower, upper, end, fastest[i], t, work, best)
        if count > 2:
            least, most = 0.0, 1.0
            for _ in range(narrowings):
                share = 0.5 * (least + most)
                for k in range(1, end):
                    lower[k] = center[k] + share * (low[i, k] - center[k])
                    upper[k] = center[k] + share * (high[i, k] - center[k])
                fits = _one_path(time_s, lower, upper, end, fastest[i], count - 1, work, best)
                if fits == count:
                    most = share
                else:
                    least = share
            if narrowings > 0:
                for k in range(1, end):
                    lower[k] = center[k] + most * (low[i, k] - center[k])
                    upper[k] = center[k] + most * (high[i, k] - center[k])
                _one_path(time_s, lower, upper, end, fastest[i], count - 1, work, best)
        for k in range(count):
            knot_time[used + k], knot_angle[used + k] = best[0, k], best[1, k]
        used += count
        offsets[i + 1] = used
    return offsets, knot_time[:used].copy(), knot_angle[:used].copy()


@njit(cache=True, error_model="numpy")
def _one_path(time_s, lower, upper, end, fastest, most, work, knots):
    # Fills in the knots of a path of at most `most` lines; returns how many knots, 0 if
    # there is no such path. Everything on the upper wall is treated upside down, so that
    # both walls are below: side 0 is the lower, side 1 the upper wall. The extreme line of
    # a side leans on that wall at its right and on the other one at its left.
    walls = (lower, upper)
    steepest = min(fastest, _STEEPEST)
    hull_x, hull_y = work[0:2], work[2:4]
    windows = work[4:9]  # of each stage: a point of the line (time, angle), slope, b, c
    head, size = np.zeros(2, np.int64), np.ones(2, np.int64)
    line_x, line_y, line_slope = np.empty(2), np.empty(2), np.empty(2)
    after = np.ones(2, np.int64)  # the first sample after the point each line leans on
    for side in range(2):
        line_x[side] = hull_x[side, 0] = time_s[0]
        line_y[side] = hull_y[side, 0] = (1 - 2 * side) * walls[side][0]
        line_slope[side] = -steepest
    knots[0, 0], knots[1, 0] = time_s[0], lower[0]
    links, k = 1, 1
    beyond, leaning = 1, 0  # first sample beyond the window; the wall that counts before it
    while k <= end:
        x = time_s[k]
        blocked = -1
        if k >= beyond:
            if line_y[0] + line_slope[0] * (x - line_x[0]) > upper[k] + _TINY_RAD:
                blocked = 0
            elif line_y[1] + line_slope[1] * (x - line_x[1]) > -lower[k] + _TINY_RAD:
                blocked = 1
        if blocked >= 0:
            if links >= min(most, end) or line_slope[blocked] <= -steepest:
                return 0
            side, other = blocked, 1 - blocked
            sign = 1 - 2 * side
            b, b_y, slope = line_x[side], line_y[side], line_slope[side]
            room = max(sign * walls[other][k - 1] - (b_y + slope * (time_s[k - 1] - b)), 0.0)
            lack = b_y + slope * (x - b) - sign * walls[other][k]
            c = max(time_s[k - 1] + room / (room + lack) * (x - time_s[k - 1]), b)
            c_y = b_y + slope * (c - b)
            windows[0, links - 1], windows[1, links - 1] = b, sign * b_y
            windows[2, links - 1], windows[3, links - 1] = sign * slope, b
            windows[4, links - 1] = c
            links += 1
            # The next line is above b and its wall up to c, below c, and then between both.
            beyond, leaning, k = k, side, after[side]
            line_slope[side] = -steepest
            line_x[other], line_y[other], line_slope[other] = c, -c_y, -slope
            hull_x[side, 0], hull_y[side, 0] = b, b_y
            hull_x[other, 0], hull_y[other, 0] = c, -c_y
            head[0] = head[1] = 0
            size[0] = size[1] = 1
            after[other] = beyond
            continue
        for side in range(2):
            if k < beyond and side != leaning:
                continue
            other = 1 - side
            y = (1 - 2 * side) * walls[side][k]
            if line_y[side] + line_slope[side] * (x - line_x[side]) < y:
                # turn the line: through this point and leaning on the hull of the other side
                slope, i = -np.inf, head[other]
                while i < size[other] and hull_x[other, i] < x:
                    s = (y + hull_y[other, i]) / (x - hull_x[other, i])
                    if s < slope:
                        break  # slopes to the hull rise up to the tangent and fall behind it
                    slope = s
                    head[other] = i
                    i += 1
                line_x[side], line_y[side], line_slope[side] = x, y, max(slope, -steepest)
                after[side] = k + 1
            n = size[side]
            while n - head[side] >= 2:
                ax, ay = hull_x[side, n - 2], hull_y[side, n - 2]
                bx, by = hull_x[side, n - 1], hull_y[side, n - 1]
                if (by - ay) * (x - bx) > (y - by) * (bx - ax):
                    break
                n -= 1
            hull_x[side, n], hull_y[side, n] = x, y
            size[side] = n + 1
        k += 1
    if end == 0:
        return 1
    slope = 0.5 * (line_slope[0] - line_slope[1])  # in the middle of those that meet the end
    return _knots_of(windows, links, time_s[end], lower[end], slope, knots)


@njit(cache=True, error_model="numpy")
def _knots_of(windows, links, x, y, slope, knots):
    # Where the last line, through (x, y), meets the window before it, and so back to the
    # start. Returns the number of knots; those at one instant, which rounding can make of a
    # point both walls touch, are left out.
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

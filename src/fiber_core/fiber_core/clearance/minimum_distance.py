# SPDX-License-Identifier: Apache-2.0
"""The smallest gap of a pair over a whole motion, bracketed from below and from above."""

import heapq
from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.array_types import Angles, Floats, Gaps, Mask, Offsets, Pairs, Rows, Times
from fiber_core.clearance.collision_bodies import Bodies
from fiber_core.clearance.distance import table_gap
from fiber_core.motion import CurveArrays
from fiber_core.threads import share_out

__all__ = ["FINEST_MM", "Minima", "minimum_gaps"]

FINEST_MM = 1e-6  # no gap is resolved further than this
_LEAST_PAIRS = 200  # of a thread: fewer are done sooner than it begins
_ROUNDING_MM = 1e-9  # far above the rounding of a gap, far below anything that matters


class Minima(NamedTuple):
    """Bounds of the smallest gap of each pair: lower <= smallest gap <= best.

    Args:
        lower: proven lower bound [mm], shape (p,).
        best: smallest gap found [mm], shape (p,).
        time_s: instant at which it was found [s], shape (p,).
    """

    lower: Gaps
    best: Gaps
    time_s: Times

    @classmethod
    def unknown(cls, p: int) -> "Minima":
        """Return the bounds of p pairs about which nothing is known."""
        return cls(np.full(p, -np.inf), np.full(p, np.inf), np.zeros(p))


@nb.njit(cache=True, error_model="numpy")
def _speed(
    arm1: float,
    phi_reach: float,
    theta_reach: float,
    w_theta: float,
    w_phi: float,
    u_theta: float,
    u_phi: float,
) -> float:
    # No vertex of a body moves faster [mm/s] while its joint speeds change evenly from w to u. The
    # phi link is bounded in two ways: elbow plus turning about it, or theta about the centre
    # plus phi about the elbow. Both are convex in the speeds, so they are largest at an end.
    about_elbow = max(
        abs(w_theta) * arm1 + abs(w_theta + w_phi) * phi_reach,
        abs(u_theta) * arm1 + abs(u_theta + u_phi) * phi_reach,
    )
    about_center = max(
        abs(w_theta) * (arm1 + phi_reach) + abs(w_phi) * phi_reach,
        abs(u_theta) * (arm1 + phi_reach) + abs(u_phi) * phi_reach,
    )
    return max(min(about_elbow, about_center), max(abs(w_theta), abs(u_theta)) * theta_reach)


@nb.njit(cache=True, error_model="numpy")
def _pair_speed(
    arm1: Floats,
    phi_reach: Floats,
    theta_reach: Floats,
    a: int,
    b: int,
    w: Floats,
    c: Floats,
    begin: float,
    end: float,
) -> float:
    # No gap of bodies a and b changes faster between two times after a piece began [mm/s]; w are
    # its joint speeds then, c its accelerations.
    return _speed(
        arm1[a], phi_reach[a], theta_reach[a],
        w[0] + c[0] * begin, w[1] + c[1] * begin, w[0] + c[0] * end, w[1] + c[1] * end,
    ) + _speed(
        arm1[b], phi_reach[b], theta_reach[b],
        w[2] + c[2] * begin, w[3] + c[3] * begin, w[2] + c[2] * end, w[3] + c[3] * end,
    )  # fmt: skip


@nb.njit(cache=True, error_model="numpy")
def _lower_bound(g0: float, g1: float, way: float) -> float:
    # Piyavskii (1972), Shubert (1972): no gap between two instants is below this when
    # the gap can change by at most `way` in between. g0 and g1 may be lower bounds.
    return max(0.5 * (g0 + g1 - way), max(g0, g1) - way)


@nb.njit(cache=True, error_model="numpy")
def _gap_after(
    table: Floats,
    a: int,
    b: int,
    q: Floats,
    w: Floats,
    c: Floats,
    passed: float,
    cutoff: float,
) -> float:
    # the gap of bodies a and b some time after a piece began, exact below the cutoff [mm]
    half = 0.5 * passed * passed
    return table_gap(
        table, a, b,
        q[0] + (w[0] * passed + c[0] * half), q[1] + (w[1] * passed + c[1] * half),
        q[2] + (w[2] * passed + c[2] * half), q[3] + (w[3] * passed + c[3] * half),
        cutoff,
    )  # fmt: skip


@nb.njit(cache=True, error_model="numpy")
def _value(acceleration: Floats, segment: int) -> float:
    return acceleration[segment] if len(acceleration) else 0.0


@nb.njit(cache=True, error_model="numpy")
def _most_segments(offsets: Offsets) -> int:
    # number of segments of the joint that has most of them
    most = 0
    for profile in range(len(offsets) - 1):
        most = max(most, offsets[profile + 1] - offsets[profile])
    return most


@nb.njit(cache=True, error_model="numpy")
def _cut(
    start: Angles,
    offsets: Offsets,
    duration: Floats,
    velocity: Floats,
    acceleration: Floats,
    resting: Mask,
    a: int,
    b: int,
    t: Times,
    q: Floats,
    w: Floats,
    c: Floats,
    now: Floats,
) -> int:
    # Cut the motion of bodies a and b into pieces on which all four joint accelerations are
    # constant: begin t[k], angles q[k] and speeds w[k] there, accelerations c[k]. Returns their
    # number; one row more holds the end. An obstacle has no joints: its row is beyond those of the
    # robots. The rows of `now` are, for the present segment of each joint, when it begins, when
    # it ends, and the angle at its begin.
    robots = len(start)
    cursor, last = np.zeros(4, dtype=np.int64), np.zeros(4, dtype=np.int64)
    begins, ends, angle = now[0], now[1], now[2]
    q[0] = 0.0
    for j in range(4):
        body, joint = (a, j) if j < 2 else (b, j - 2)
        if body < robots:
            q[0, j] = start[body, joint]
            if not resting[body]:
                cursor[j] = offsets[2 * body + joint]
                last[j] = offsets[2 * body + joint + 1]
            if cursor[j] < last[j]:
                begins[j], ends[j], angle[j] = 0.0, duration[cursor[j]], q[0, j]
    t[0] = 0.0
    k = 0
    while (cursor < last).any():
        t[k + 1] = np.inf
        for j in range(4):
            w[k, j] = c[k, j] = 0.0
            if cursor[j] < last[j]:
                c[k, j] = _value(acceleration, cursor[j])
                w[k, j] = velocity[cursor[j]] + c[k, j] * (t[k] - begins[j])
                t[k + 1] = min(t[k + 1], ends[j])
        for j in range(4):
            q[k + 1, j] = q[k, j]
            if cursor[j] < last[j]:
                v, bend = velocity[cursor[j]], 0.5 * c[k, j]
                passed, lasts = t[k + 1] - begins[j], duration[cursor[j]]
                q[k + 1, j] = angle[j] + v * passed + bend * passed * passed
                if ends[j] <= t[k + 1]:
                    angle[j] = angle[j] + v * lasts + bend * lasts * lasts
                    begins[j] = ends[j]
                    cursor[j] += 1
                    if cursor[j] < last[j]:
                        ends[j] += duration[cursor[j]]
        k += 1
    return k


def minimum_gaps(
    bodies: Bodies,
    motion: CurveArrays,
    resting: Mask,
    pairs: Pairs,
    rows: Rows,
    level: Gaps,
    tolerance: float,
    resolve: bool,
    minima: Minima,
) -> None:
    """Bracket the smallest gap of some pairs, on all cores, until it is proven or resolved.

    For each pair, the time interval with the lowest bound is halved until that bound reaches
    the level (proven), or is within the tolerance of the smallest gap found (resolved).

    Args:
        bodies: outlines, from bodies_of.
        motion: the curve_arrays of a SegmentMotion or a CurveMotion.
        resting: robots that stay at their start instead, shape (n,).
        pairs: rows a, b of bodies, shape (p, 2).
        rows: pairs to work on, shape (r,).
        level: gap of each pair above which no better bound is needed [mm], shape (p,).
        tolerance: resolution of a gap below its level, at least 1e-6 [mm].
        resolve: whether the search goes on after a gap below the level was found.
        minima: filled in at the rows.
    """

    def bracket(first: int, last: int) -> None:
        some = rows[first:last]
        _minimum_gaps(bodies, motion, resting, pairs, some, level, tolerance, resolve, minima)

    share_out(bracket, len(rows), _LEAST_PAIRS)


@nb.njit(cache=True, error_model="numpy", nogil=True)  # the longest loop of all
def _minimum_gaps(
    bodies: Bodies,
    motion: CurveArrays,
    resting: Mask,
    pairs: Pairs,
    rows: Rows,
    level: Gaps,
    tolerance: float,
    resolve: bool,
    minima: Minima,
) -> None:
    # Fields are read once: each reading of a tuple's array costs two atomic operations.
    table, arm1 = bodies.table, bodies.arm1
    phi_reach, theta_reach = bodies.phi_reach, bodies.theta_reach
    start, offsets, duration, velocity, acceleration = motion
    curved = len(acceleration) > 0
    tolerance = max(tolerance, FINEST_MM)
    longest = _most_segments(offsets)
    piece_t = np.empty(4 * longest + 1)
    piece_q, piece_w = np.empty((4 * longest + 1, 4)), np.empty((4 * longest + 1, 4))
    piece_c = np.zeros((4 * longest + 1, 4))
    now = np.empty((3, 4))
    row: int
    a: int
    b: int
    for row in rows:
        a, b = pairs[row]
        pieces = _cut(
            start, offsets, duration, velocity, acceleration, resting, a, b,
            piece_t, piece_q, piece_w, piece_c, now,
        )  # fmt: skip
        q = piece_q[0]
        gap = table_gap(table, a, b, q[0], q[1], q[2], q[3], np.inf)
        best, when, lower = gap, 0.0, gap
        enough = level[row] + _ROUNDING_MM
        queue = [(np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0)]
        for k in range(pieces):
            w = piece_w[k]
            t0, t1, q, before = piece_t[k], piece_t[k + 1], piece_q[k + 1], gap
            speed = _pair_speed(arm1, phi_reach, theta_reach, a, b, w, piece_c[k], 0.0, t1 - t0)
            if speed == 0.0:
                continue
            way = speed * (t1 - t0)
            gap = table_gap(table, a, b, q[0], q[1], q[2], q[3], enough + way)
            if gap < min(best, enough + way):
                best, when = gap, t1
            bound = _lower_bound(before, gap, way)
            if bound >= enough:
                lower = min(lower, bound)
            else:
                heapq.heappush(queue, (bound, t0, before, t1, gap, speed, k))
        while queue[0][0] < min(enough, best - tolerance) and (resolve or best >= enough):
            _, t0, g0, t1, g1, speed, k = heapq.heappop(queue)
            t = 0.5 * (t0 + t1)
            way = speed * (t - t0)
            q, w, c, passed = piece_q[k], piece_w[k], piece_c[k], t - piece_t[k]
            gap = _gap_after(table, a, b, q, w, c, passed, enough + way)
            if gap < min(best, enough + way):
                best, when = gap, t
            for u0, h0, u1, h1 in ((t0, g0, t, gap), (t, gap, t1, g1)):
                if curved:
                    begin, end = u0 - piece_t[k], u1 - piece_t[k]
                    speed = _pair_speed(arm1, phi_reach, theta_reach, a, b, w, c, begin, end)
                    way = speed * (u1 - u0)
                bound = _lower_bound(h0, h1, way)
                if bound >= enough:
                    lower = min(lower, bound)
                else:
                    heapq.heappush(queue, (bound, u0, h0, u1, h1, speed, k))
        minima.lower[row] = min(min(lower, best), queue[0][0]) - _ROUNDING_MM
        minima.best[row] = best
        minima.time_s[row] = when

# SPDX-License-Identifier: Apache-2.0
"""Signed separation of two convex polygons, each in its own turned frame.

The signed separation of two convex sets is the largest value, over all unit
directions u, of min u.b - max u.a. For sets apart it is their distance; for sets
that overlap it is minus the shortest push that parts them. Because it is a maximum
of support functions, moving every point of one set by no more than e changes it by
no more than e. Growing the sets by radii subtracts the radii.

A polygon is passed as the row and the column of a table where its vertices x, y, x, y, ...
begin, and their number: a view of the vertices would cost more than the arithmetic.
"""

import math

import numba as nb
import numpy as np

from fiber_core.array_types import Floats

__all__ = ["gjk_distance"]

_TINY = 1e-10  # [mm] below this the two polygons touch and overlap is measured instead
_ROUNDS = 64  # more than the vertices of any outline: the search ends long before


@nb.njit(cache=True, error_model="numpy")
def gjk_distance(
    table: Floats,
    i: int,
    p: int,
    p_count: int,
    j: int,
    q: int,
    q_count: int,
    x: float,
    y: float,
    c: float,
    s: float,
    cutoff: float,
) -> float:
    """Return the signed separation of two hulls [mm]; above the cutoff a lower bound of it.

    Args:
        table: vertices in the frame of their link, counter-clockwise [mm], shape (b, w).
        i, p: row and column where the vertices of the first hull begin.
        p_count: number of its vertices.
        j, q: row and column where the vertices of the second hull begin.
        q_count: number of its vertices.
        x, y: origin of the second frame, seen in the first [mm].
        c, s: cosine and sine of the angle from the first frame to the second.
        cutoff: value above which any lower bound above the cutoff is enough [mm].
    """
    if p_count <= 2 and q_count <= 2:
        return _segment_distance(table, i, p, p_count, j, q, q_count, x, y, c, s)
    return _polygon_distance(table, i, p, p_count, j, q, q_count, x, y, c, s, cutoff)


@nb.njit(cache=True, error_model="numpy")
def _square_to_segment(
    px: float, py: float, ax: float, ay: float, ux: float, uy: float, u2: float
) -> float:
    # squared distance of a point from the segment a, a + u
    px -= ax
    py -= ay
    along = px * ux + py * uy
    if along >= u2:
        px -= ux
        py -= uy
    elif along > 0.0:
        across = px * uy - py * ux
        return across * across / u2
    return px * px + py * py


@nb.njit(cache=True, error_model="numpy")
def _segment_distance(
    table: Floats,
    i: int,
    p: int,
    p_count: int,
    j: int,
    q: int,
    q_count: int,
    x: float,
    y: float,
    c: float,
    s: float,
) -> float:
    # gjk_distance of two segments; a point is a segment of length zero
    p_last, q_last = p + 2 * p_count - 2, q + 2 * q_count - 2
    ax, ay = table[i, p], table[i, p + 1]
    ux, uy = table[i, p_last] - ax, table[i, p_last + 1] - ay
    qx, qy = table[j, q], table[j, q + 1]
    bx, by = x + c * qx - s * qy, y + s * qx + c * qy
    qx, qy = table[j, q_last] - qx, table[j, q_last + 1] - qy
    vx, vy = c * qx - s * qy, s * qx + c * qy
    u2, v2 = ux * ux + uy * uy, vx * vx + vy * vy
    dx, dy = bx - ax, by - ay
    # distances of the ends of each segment from the line of the other, times its length
    turn = ux * vy - uy * vx
    b0 = ux * dy - uy * dx
    b1 = b0 + turn
    a0 = vy * dx - vx * dy
    a1 = a0 - turn
    if b0 * b1 < 0.0 and a0 * a1 < 0.0:
        # They cross. Pushing along an edge normal has to pass the nearer end.
        beside_u = min(abs(b0), abs(b1)) / math.sqrt(u2)
        beside_v = min(abs(a0), abs(a1)) / math.sqrt(v2)
        return -min(beside_u, beside_v)
    square = _square_to_segment(bx, by, ax, ay, ux, uy, u2)
    square = min(square, _square_to_segment(bx + vx, by + vy, ax, ay, ux, uy, u2))
    square = min(square, _square_to_segment(ax, ay, bx, by, vx, vy, v2))
    square = min(square, _square_to_segment(ax + ux, ay + uy, bx, by, vx, vy, v2))
    return math.sqrt(square)


@nb.njit(cache=True, error_model="numpy")
def _farthest(table: Floats, i: int, p: int, count: int, ux: float, uy: float) -> int:
    # column of the vertex farthest along u
    at = p
    best = table[i, p] * ux + table[i, p + 1] * uy
    for k in range(p + 2, p + 2 * count, 2):
        value = table[i, k] * ux + table[i, k + 1] * uy
        if value > best:
            best = value
            at = k
    return at


@nb.njit(cache=True, error_model="numpy")
def _nearest_on_segment(ax: float, ay: float, bx: float, by: float) -> tuple[float, float, int]:
    # the point of the segment a, b nearest to the origin; 1 if it is a, 2 if b, else 0
    ux, uy = bx - ax, by - ay
    u2 = ux * ux + uy * uy
    along = -(ax * ux + ay * uy)
    if along <= 0.0:
        return ax, ay, 1
    if along >= u2:
        return bx, by, 2
    share = along / u2
    return ax + share * ux, ay + share * uy, 0


@nb.njit(cache=True, error_model="numpy")
def _polygon_distance(
    table: Floats,
    i: int,
    p: int,
    p_count: int,
    j: int,
    q: int,
    q_count: int,
    x: float,
    y: float,
    c: float,
    s: float,
    cutoff: float,
) -> float:
    # Gilbert, Johnson, Keerthi (IEEE J. Robotics and Automation 4, 1988) on the
    # difference q - p: v is its point nearest to the origin as far as known, on the
    # segment a, b (or at the vertex a); w is its vertex farthest against v. Then
    # v.w / |v| is the separation along a direction: a lower bound at any moment.
    vx, vy = x, y
    ax = ay = bx = by = 0.0
    corners = 0
    lower = -np.inf
    for _ in range(_ROUNDS):
        size = math.sqrt(vx * vx + vy * vy)
        if size < _TINY:
            if corners:
                break
            vx, size = 1.0, 1.0
        k = _farthest(table, i, p, p_count, vx, vy)
        m = _farthest(table, j, q, q_count, -(c * vx + s * vy), s * vx - c * vy)
        wx = x + c * table[j, m] - s * table[j, m + 1] - table[i, k]
        wy = y + s * table[j, m] + c * table[j, m + 1] - table[i, k + 1]
        bound = (vx * wx + vy * wy) / size
        lower = max(lower, bound)
        if lower > cutoff:
            return lower
        if corners == 0:
            ax, ay, corners = wx, wy, 1
            vx, vy = wx, wy
            continue
        if size - bound < 1e-12 * (1.0 + size):
            return lower
        if corners == 2:
            ab = ax * by - ay * bx
            bw = bx * wy - by * wx
            wa = wx * ay - wy * ax
            if (ab > 0.0 and bw > 0.0 and wa > 0.0) or (ab < 0.0 and bw < 0.0 and wa < 0.0):
                break  # the triangle a, b, w holds the origin: the polygons overlap
            to_a_x, to_a_y, end_a = _nearest_on_segment(ax, ay, wx, wy)
            to_b_x, to_b_y, end_b = _nearest_on_segment(bx, by, wx, wy)
            if to_a_x * to_a_x + to_a_y * to_a_y <= to_b_x * to_b_x + to_b_y * to_b_y:
                vx, vy, end = to_a_x, to_a_y, end_a
            else:
                vx, vy, end = to_b_x, to_b_y, end_b
                ax, ay = bx, by
        else:
            vx, vy, end = _nearest_on_segment(ax, ay, wx, wy)
        bx, by, corners = wx, wy, 2
        if end:
            corners = 1
            if end == 2:
                ax, ay = bx, by
    else:
        return lower
    # They touch or overlap: the best direction is an edge normal of one of them.
    back_x, back_y = -(c * x + s * y), s * x - c * y
    return max(
        _edge_separation(table, i, p, p_count, j, q, q_count, x, y, c, s),
        _edge_separation(table, j, q, q_count, i, p, p_count, back_x, back_y, c, -s),
    )


@nb.njit(cache=True, error_model="numpy")
def _edge_separation(
    table: Floats,
    i: int,
    p: int,
    p_count: int,
    j: int,
    q: int,
    q_count: int,
    x: float,
    y: float,
    c: float,
    s: float,
) -> float:
    # largest separation along an outward edge normal of the first polygon
    best = -np.inf
    k = p + 2 * p_count - 2
    for after in range(p, p + 2 * p_count, 2):
        ex, ey = table[i, after] - table[i, k], table[i, after + 1] - table[i, k + 1]
        length = math.sqrt(ex * ex + ey * ey)
        if length > 0.0:
            nx, ny = ey / length, -ex / length
            m = _farthest(table, j, q, q_count, -(c * nx + s * ny), s * nx - c * ny)
            wx = x + c * table[j, m] - s * table[j, m + 1] - table[i, k]
            wy = y + s * table[j, m] + c * table[j, m + 1] - table[i, k + 1]
            best = max(best, nx * wx + ny * wy)
        k = after
    return best

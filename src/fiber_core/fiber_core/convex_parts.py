# SPDX-License-Identifier: Apache-2.0
"""Any simple polygon as convex polygons, of which walls are made; hulls."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from fiber_core.array_types import Points
from fiber_core.errors import LayoutError

__all__ = ["convex_hull", "convex_parts"]

_STRAIGHT = 1e-12  # relative area below which three corners lie on a line


def convex_hull(points: ArrayLike) -> Points:
    """Return the convex hull of three or more points, counter-clockwise, shape (k, 2)."""
    corners = np.array(points, dtype=float).reshape(-1, 2)
    return corners[ConvexHull(corners).vertices]


def convex_parts(polygon: ArrayLike) -> list[Points]:
    """Return convex polygons that together cover a simple polygon, and nothing else.

    Triangles are cut off corner by corner (ear clipping), then merged while they stay convex
    (Hertel and Mehlhorn 1983: at most four times as many parts as are needed).

    Args:
        polygon: corners in order, either way round [mm], shape (c, 2), c >= 1; the first may be
            repeated at the end. One or two corners are a point or a line.

    Returns:
        The parts, counter-clockwise [mm], each of shape (k, 2).

    The outline may touch itself at a corner.

    Raises:
        LayoutError: the polygon crosses itself.
    """
    corners = np.array(polygon, dtype=float).reshape(-1, 2)
    differs = (corners != np.roll(corners, -1, axis=0)).any(axis=1)
    corners = corners[differs] if differs.any() else corners[:1]
    if len(corners) < 3:
        return [corners]
    x, y = (corners - corners[0]).T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    corners = corners if area > 0.0 else corners[::-1]
    flat = _STRAIGHT * float(np.ptp(corners, axis=0).max()) ** 2
    triangles = _triangles(corners, flat)
    covered = sum(_turn(corners, a, b, c) for a, b, c in triangles)
    if not triangles or abs(covered - abs(area)) > len(corners) * flat:
        raise LayoutError(f"a polygon crosses itself: {corners.tolist()} mm")
    return [corners[part] for part in _merged(corners, triangles, flat)]


def _triangles(corners: Points, flat: float) -> list[list[int]]:
    left = list(range(len(corners)))
    triangles: list[list[int]] = []
    while len(left) > 2:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            turn = _turn(corners, a, b, c)
            if abs(turn) <= flat:
                del left[k]  # on a line: no triangle
                break
            ends = corners[[a, c]]  # where the outline touches itself it is not inside
            others = [i for i in left if i not in (a, b, c) and (corners[i] != ends).any(1).all()]
            if turn > flat and not any(_inside(corners, i, (a, b, c)) for i in others):
                triangles.append([a, b, c])
                del left[k]
                break
        else:
            raise LayoutError(f"a polygon crosses itself: {corners.tolist()} mm")
    return triangles


def _merged(corners: Points, parts: list[list[int]], flat: float) -> list[list[int]]:
    at = 0
    while at < len(parts):
        joined = None
        for other in range(at + 1, len(parts)):
            joined = _joined(corners, parts[at], parts[other], flat)
            if joined is not None:
                parts[at] = joined
                del parts[other]
                break
        at += joined is None
    return parts


def _joined(corners: Points, first: list[int], second: list[int], flat: float) -> list[int] | None:
    # both parts in one if they share an edge and their union is convex
    for k, a in enumerate(first):
        b = first[(k + 1) % len(first)]
        if b in second and second[(second.index(b) + 1) % len(second)] == a:
            at = second.index(a)
            path = second[at:] + second[:at]  # from a round to b
            whole = first[: k + 1] + path[1:-1] + first[k + 1 :]
            turns = [
                _turn(corners, whole[i - 1], whole[i], whole[(i + 1) % len(whole)])
                for i in range(len(whole))
            ]
            return whole if min(turns) >= -flat else None
    return None


def _turn(corners: Points, a: int, b: int, c: int) -> float:
    # twice the area of a triangle, positive if it turns to the left
    (x, y), (u, v) = corners[b] - corners[a], corners[c] - corners[a]
    return float(x * v - y * u)


def _inside(corners: Points, i: int, triangle: tuple[int, int, int]) -> bool:
    a, b, c = triangle
    return all(_turn(corners, p, q, i) >= 0.0 for p, q in ((a, b), (b, c), (c, a)))

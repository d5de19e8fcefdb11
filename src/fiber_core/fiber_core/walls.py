# SPDX-License-Identifier: Apache-2.0
"""Walls: fixed convex polygons that arms must not touch, as petal edges and cameras."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Bools, Floats, Ints, Points
from fiber_core.errors import LayoutError
from fiber_core.validation import frozen_array

__all__ = ["checked_walls", "distances_to_walls", "is_convex", "padded_walls"]

_MOST_CORNERS = 64
_STRAIGHT_RAD = 1e-9  # a turn to the other side that is rounding


def checked_walls(walls: ArrayLike) -> Floats:
    """Return walls as a read-only array [mm], shape (w, c, 2).

    Args:
        walls: corners of each wall in order, either way round [mm], shape (w, c, 2), c >= 1.

    Raises:
        LayoutError: a corner is out of bounds, or a polygon is not convex; names the wall.
    """
    checked = frozen_array(walls, np.float64, (None, None, 2), "walls", LayoutError)
    if not 1 <= checked.shape[1] <= _MOST_CORNERS:
        raise LayoutError(f"walls have {checked.shape[1]} corners, expected 1 to {_MOST_CORNERS}")
    most = bounds.MAX_COORDINATE_MM
    bad = ~(np.abs(checked) <= most).all(axis=(1, 2))  # nan is outside
    if bad.any():
        at = int(np.argmax(bad))
        raise LayoutError(
            f"wall {at}: corners must be {-most:.6g} to {most:.6g} mm, got {checked[at].tolist()}"
        )
    convex = _are_convex(checked)
    if not convex.all():
        at = int(np.argmin(convex))
        raise LayoutError(
            f"wall {at} is not convex: split it into convex parts, or into its edges as lines of "
            f"two corners; got {checked[at].tolist()} mm"
        )
    return checked


def padded_walls(polygons: list[Points]) -> Floats:
    """Return polygons with different numbers of corners as one array, shape (w, c, 2).

    Args:
        polygons: corners of each [mm], shape (c, 2), c >= 1; the last one is repeated.
    """
    most = max((len(polygon) for polygon in polygons), default=1)
    rows = [np.concatenate([p, np.repeat(p[-1:], most - len(p), axis=0)]) for p in polygons]
    return np.stack(rows) if rows else np.zeros((0, 1, 2))


def distances_to_walls(points: Points, walls: Floats) -> Floats:
    """Return the distance of points from walls [mm], 0 inside, shape (k,).

    Args:
        points: one point for each wall [mm], shape (k, 2).
        walls: the walls [mm], shape (k, c, 2).
    """
    ends = np.roll(walls, -1, axis=1)
    along, to = ends - walls, points[:, None] - walls
    length2 = (along**2).sum(axis=2)
    share = np.clip((to * along).sum(axis=2) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    from_edges = np.hypot(*np.moveaxis(to - share[..., None] * along, -1, 0)).min(axis=1)
    cross = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
    turning = (cross >= 0.0).all(axis=1) | (cross <= 0.0).all(axis=1)
    area = np.abs((walls[..., 0] * ends[..., 1] - walls[..., 1] * ends[..., 0]).sum(axis=1))
    return np.where(turning & (area > 0.0), 0.0, from_edges)


def is_convex(corners: Points) -> bool:
    """Return whether a polygon turns to one side only, and once around; a point or a line does.

    Args:
        corners: in order, either way round [mm], shape (c, 2).
    """
    return bool(_are_convex(np.asarray(corners)[None])[0])


def _are_convex(walls: Floats) -> Bools:
    # is_convex for each wall at once, (w,): a plane has hundreds, and is made anew in many places
    edges = np.roll(walls, -1, axis=1) - walls
    is_edge = np.any(edges != 0.0, axis=2)
    order = np.argsort(~is_edge, axis=1, kind="stable")  # edges without length come last
    edges = np.take_along_axis(edges, order[..., None], axis=1)
    count: Ints = np.count_nonzero(is_edge, axis=1).astype(np.int64)[:, None]
    number = np.arange(int(walls.shape[1]))
    after = np.take_along_axis(edges, ((number + 1) % np.maximum(count, 1))[..., None], axis=1)
    (x, y), (u, v) = np.moveaxis(edges, -1, 0), np.moveaxis(after, -1, 0)
    turns = np.where(number < count, np.arctan2(x * v - y * u, x * u + y * v), 0.0)
    to_one_side = (turns >= -_STRAIGHT_RAD).all(axis=1) | (turns <= _STRAIGHT_RAD).all(axis=1)
    once = np.abs(np.abs(turns.sum(axis=1)) - 2 * np.pi) < 1e-6
    return np.asarray((count[:, 0] <= 2) | (to_one_side & once))

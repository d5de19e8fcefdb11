# SPDX-License-Identifier: Apache-2.0
"""Neighbours: the pairs of robots and obstacles that can come close to each other."""

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numba as nb
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiber_core.array_types import Ints, Offsets, Pairs, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.ragged import Parts
from fiber_core.walls import distances_to_walls

__all__ = ["Neighbours", "most_neighbours", "neighbour_pairs", "neighbours_of"]

_ROUNDING_MM = 1e-6  # above the rounding of distances in a plane

# the pairs of every plane in use, by slack; a plane never changes
_known: WeakKeyDictionary[FocalPlane, dict[float, Pairs]] = WeakKeyDictionary()


class Neighbours(NamedTuple):
    """The neighbours of each robot, ragged by robot; compiled loops take it as it is.

    Args:
        offsets: first neighbour of each robot, shape (n + 1,).
        body: rows of the neighbours, robots and obstacles, shape (m,).
        pair: the pair that robot and neighbour form, shape (m,).
        side: 0 where the robot stands first in this pair, 1 where it stands second, shape (m,).
    """

    offsets: Offsets
    body: Ints
    pair: Ints
    side: Ints

    @property
    def parts(self) -> Parts:
        """The neighbours of each robot, as parts of the flat arrays."""
        return Parts(self.offsets)


def neighbour_pairs(plane: FocalPlane, slack_mm: float = 1.0) -> Pairs:
    """Return every pair with reach discs that come within a slack of each other.

    All other pairs keep a gap above the slack in every configuration.

    Args:
        plane: the focal plane.
        slack_mm: a pair is left out if the gap of its reach discs is larger than this [mm].

    Returns:
        Rows a < b in increasing order, int32, shape (p, 2). Rows from n on are the
        obstacles, then the walls; two fixed bodies are never a pair.
    """
    known = _known.setdefault(plane, {})
    if slack_mm not in known:
        known[slack_mm] = _pairs_within(plane, slack_mm)
        known[slack_mm].setflags(write=False)
    return known[slack_mm]


def _pairs_within(plane: FocalPlane, slack_mm: float) -> Pairs:
    if plane.n == 0:
        return np.zeros((0, 2), dtype=np.int32)
    reach = plane.reach_mm
    robots = cKDTree(plane.centers)
    close = robots.query_pairs(2 * reach.max() + slack_mm, output_type="ndarray")
    close = np.sort(close.reshape(-1, 2), axis=1)
    x, y, radius = plane.obstacles.T
    if len(x):
        near = robots.query_ball_point(np.stack([x, y], axis=1), radius + reach.max() + slack_mm)
        obstacle = plane.n + np.repeat(np.arange(len(x)), [len(found) for found in near])
        with_obstacle = np.stack([np.concatenate(near), obstacle], axis=1).astype(close.dtype)
        close = np.concatenate([close, with_obstacle])
    centers = np.concatenate([plane.centers, plane.obstacles[:, :2]])
    apart = np.hypot(*(centers[close[:, 0]] - centers[close[:, 1]]).T)
    reaches = np.concatenate([reach, radius])
    close = close[apart <= reaches[close[:, 0]] + reaches[close[:, 1]] + slack_mm]
    close = np.concatenate([close, _near_walls(plane, robots, slack_mm)])
    return close[np.lexsort(close.T[::-1])].astype(np.int32)


def _near_walls(plane: FocalPlane, robots: cKDTree, slack_mm: float) -> Pairs:
    # robots with reach discs that come within the slack of a wall
    walls, reach = plane.walls, plane.reach_mm
    if not len(walls):
        return np.zeros((0, 2), dtype=np.int64)
    middles = 0.5 * (walls.min(axis=1) + walls.max(axis=1))
    around = np.hypot(*np.moveaxis(walls - middles[:, None], -1, 0)).max(axis=1)
    near = robots.query_ball_point(middles, around + reach.max() + slack_mm)
    number = np.repeat(np.arange(len(walls)), [len(found) for found in near])
    robot = np.concatenate(near).astype(np.int64)
    # most robots in the circle around a long wall are far from it: the box around it tells
    half = 0.5 * np.ptp(walls, axis=1)
    beside = np.abs(plane.centers[robot] - middles[number]) - half[number]
    in_box = np.hypot(*np.maximum(beside, 0.0).T) <= reach[robot] + slack_mm + _ROUNDING_MM
    robot, number = robot[in_box], number[in_box]
    apart = distances_to_walls(plane.centers[robot], walls[number])
    close = apart <= reach[robot] + slack_mm
    return np.stack([robot, plane.n + len(plane.obstacles) + number], axis=1)[close]


def neighbours_of(
    n: int, pairs: ArrayLike, by_row: bool = False, places: Points | None = None
) -> Neighbours:
    """Return the neighbours of each robot.

    Args:
        n: rows 0..n-1 get a list of neighbours; later rows are only neighbours of others.
        pairs: rows of two neighbours each, shape (p, 2).
        by_row: sort the neighbours of a robot by their rows.
        places: sort the neighbours of a robot by these places, first by x, then by y: so sums
            over the neighbours do not depend on the order of the rows [mm], shape (b, 2). Without
            by_row and places, neighbours have the order of the pairs: first those pairs in which
            the robot stands first.
    """
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    own, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    keys = [other] if by_row else [] if places is None else list(places[other].T[::-1])
    order = np.lexsort([*keys, own])
    order = order[own[order] < n]
    parts = Parts.from_owners(own[order], n)
    side, pair = np.divmod(order, max(len(pairs), 1))
    return Neighbours(parts.offsets, other[order], pair, side)


@nb.njit(cache=True)
def most_neighbours(neighbours: Neighbours) -> int:
    """Return the largest number of neighbours of a robot, 0 without robots."""
    most = 0
    for i in range(len(neighbours.offsets) - 1):
        most = max(most, neighbours.offsets[i + 1] - neighbours.offsets[i])
    return most

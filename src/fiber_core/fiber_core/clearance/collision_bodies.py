# SPDX-License-Identifier: Apache-2.0
"""Outlines of every robot and obstacle as plain arrays that compiled loops can read."""

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numba as nb
import numpy as np

from fiber_core.array_types import Floats, Ints, Points
from fiber_core.focal_plane import FocalPlane

__all__ = ["Bodies", "bodies_of"]

# Columns of Bodies.table: the numbers of a body, then the records of its phi and theta link.
X, Y, ARM1, THETA, PHI = range(5)  # THETA holds the column of the theta record
COUNT, RADIUS, DISC, VERTICES = 0, 1, 2, 5  # columns of a record from its first

# A vertex that makes a turn of less than this (of its sine) is left out: it is farther out than the
# hull by 1e-10 mm at most, and the search for the distance of two hulls goes astray where only
# rounding makes a turn.
_STRAIGHT = 1e-12

# the bodies of every plane in use; a plane never changes
_known: WeakKeyDictionary[FocalPlane, "Bodies"] = WeakKeyDictionary()


class Bodies(NamedTuple):
    """Robots followed by obstacles and walls, one row each: the input of the distance kernels.

    An obstacle is a body without arms whose phi outline is one vertex rounded by the
    radius of the disc; a wall is one whose phi outline is its polygon. Vertices are
    hulls: convex, counter-clockwise, the first ``count`` of a row in use. ``disc`` is a
    circle around them: x, y in the frame of the link and a radius, the rounding not
    included. ``reach`` is the distance of the
    farthest vertex from the origin of the link, the rounding not included.

    Args:
        center: theta axes [mm], shape (b, 2).
        arm1: lengths of the theta arms [mm], shape (b,).
        arm2: lengths of the phi arms [mm], shape (b,).
        phi_vertices: hull of the phi outline [mm], shape (b, k, 2).
        phi_count: number of its vertices, at least 1, shape (b,).
        phi_radius: its rounding [mm], shape (b,).
        phi_disc: circle around its vertices [mm], shape (b, 3).
        phi_reach: farthest vertex from the elbow [mm], shape (b,).
        theta_vertices: hull of the theta outline [mm], shape (b, m, 2).
        theta_count: number of its vertices, 0 where there is no outline, shape (b,).
        theta_radius: its rounding [mm], shape (b,).
        theta_disc: circle around its vertices [mm], shape (b, 3).
        theta_reach: farthest vertex from the centre [mm], shape (b,).
        table: the same numbers, one row for each body, for the kernels: one row is one or
            two cache lines, and many arrays would cost each call more than its arithmetic.
    """

    center: Points
    arm1: Floats
    arm2: Floats
    phi_vertices: Floats
    phi_count: Ints
    phi_radius: Floats
    phi_disc: Floats
    phi_reach: Floats
    theta_vertices: Floats
    theta_count: Ints
    theta_radius: Floats
    theta_disc: Floats
    theta_reach: Floats
    table: Floats


def bodies_of(plane: FocalPlane) -> Bodies:
    """Return the outlines of all robots, then of obstacles and walls as rows n, n + 1, ...

    An outline is grown by as much as the uncertainty of its joints can displace it.

    Args:
        plane: the focal plane.
    """
    if plane not in _known:
        _known[plane] = _build(plane)
    return _known[plane]


def _build(plane: FocalPlane) -> Bodies:
    discs, walls = plane.obstacles, plane.walls
    nothing = np.zeros(plane.fixtures)
    middles = 0.5 * (walls.min(axis=1) + walls.max(axis=1))

    def rows(of_robots: Floats, of_fixtures: Floats) -> Floats:
        return np.concatenate([of_robots, of_fixtures])

    def padded(vertices: Floats, of_walls: Floats) -> Floats:
        most = max(vertices.shape[1], of_walls.shape[1] if len(of_walls) else 0)
        shapes = (vertices, np.zeros((len(discs), 1, 2)), of_walls)
        return np.concatenate([_lengthened(each, most) for each in shapes])

    center = rows(plane.centers, np.concatenate([discs[:, :2], middles]))
    arm1, arm2 = rows(plane.arms[:, 0], nothing), rows(plane.arms[:, 1], nothing)
    phi_hull, phi_count, phi_disc, phi_reach = _hulls(
        padded(plane.phi_vertices, walls - middles[:, None])
    )
    growth = plane.growth_mm
    rounding = np.append(discs[:, 2], np.zeros(len(walls)))
    phi_radius = rows(plane.phi_radius + growth[:, 1], rounding)
    theta_hull, theta_count, theta_disc, theta_reach = _hulls(
        rows(plane.theta_vertices, np.zeros((plane.fixtures, *plane.theta_vertices.shape[1:])))
    )
    theta_count[plane.n :] = 0
    theta_radius = rows(plane.theta_radius + growth[:, 0], nothing)

    def record(count: Ints, radius: Floats, disc: Floats, hull: Floats) -> Floats:
        corners = hull.reshape(len(hull), 2 * hull.shape[1])
        return np.column_stack([count.astype(np.float64), radius, disc, corners])

    phi_record = record(phi_count, phi_radius, phi_disc, phi_hull)
    theta_record = record(theta_count, theta_radius, theta_disc, theta_hull)
    theta_column = np.full(len(center), PHI + phi_record.shape[1])
    bodies = Bodies(
        center, arm1, arm2,
        phi_hull, phi_count, phi_radius, phi_disc, phi_reach,
        theta_hull, theta_count, theta_radius, theta_disc, theta_reach,
        np.column_stack([center, arm1, theta_column, phi_record, theta_record]),
    )  # fmt: skip
    for column in bodies:
        column.setflags(write=False)
    return bodies


def _lengthened(vertices: Floats, most: int) -> Floats:
    # the same outlines with as many vertices as the longest one: the last one is repeated
    return vertices[:, np.minimum(np.arange(most), vertices.shape[1] - 1)]


@nb.njit(cache=True)
def _hulls(vertices: Floats) -> tuple[Floats, Ints, Floats, Floats]:
    # per row: convex hull, its size, a circle around it, its reach from the origin
    rows, most, _ = vertices.shape
    hull = np.zeros((rows, max(most, 1), 2))
    count = np.zeros(rows, dtype=np.int64)
    disc = np.zeros((rows, 3))
    reach = np.zeros(rows)
    for i in range(rows):
        count[i] = _hull(vertices[i], hull[i])
        widest = -1.0
        for j in range(count[i]):
            reach[i] = max(reach[i], np.hypot(hull[i, j, 0], hull[i, j, 1]))
            for k in range(j + 1):
                width = np.hypot(hull[i, j, 0] - hull[i, k, 0], hull[i, j, 1] - hull[i, k, 1])
                if width > widest:
                    widest = width
                    disc[i, 0] = 0.5 * (hull[i, j, 0] + hull[i, k, 0])
                    disc[i, 1] = 0.5 * (hull[i, j, 1] + hull[i, k, 1])
        for j in range(count[i]):
            out = np.hypot(hull[i, j, 0] - disc[i, 0], hull[i, j, 1] - disc[i, 1])
            disc[i, 2] = max(disc[i, 2], out)
    return hull, count, disc, reach


@nb.njit(cache=True)
def _hull(points: Points, out: Points) -> int:
    # Fills in the convex hull of some points by Andrew's monotone chain (Information
    # Processing Letters 9, 1979); returns the number of its vertices.
    most = len(points)
    if most == 0:
        return 0
    order = np.arange(most)
    for i in range(1, most):  # a dozen points: insertion sort by x, then y
        for j in range(i, 0, -1):
            p, q = points[order[j - 1]], points[order[j]]
            if p[0] < q[0] or (p[0] == q[0] and p[1] <= q[1]):
                break
            order[j - 1], order[j] = order[j], order[j - 1]
    chain = np.empty((2 * most + 1, 2))
    size = 0
    for side in range(2):  # lower side from left to right, then upper side back
        base = size
        for step in range(most):
            p = points[order[step if side == 0 else most - 1 - step]]
            while size - base >= 2:
                u, v = chain[size - 2], chain[size - 1]
                right = (v[0] - u[0]) * (p[1] - u[1])
                left = (v[1] - u[1]) * (p[0] - u[0])
                if right - left > _STRAIGHT * (abs(right) + abs(left)):
                    break
                size -= 1
            chain[size, 0], chain[size, 1] = p[0], p[1]
            size += 1
        size -= 1  # the last point of a side is the first of the other
    size = max(size, 1)
    if size == 2 and chain[0, 0] == chain[1, 0] and chain[0, 1] == chain[1, 1]:
        size = 1
    for k in range(size):  # not as a slice: its overlap check alone compiles for seconds
        out[k, 0], out[k, 1] = chain[k, 0], chain[k, 1]
    return size

# SPDX-License-Identifier: Apache-2.0
"""Outlines as the kernels read them: hulls, circles around them, reaches, and the table."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from fiber_core.clearance import bodies_of
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import preset


def _plane(phi, theta=None, discs=((3.0, -4.0, 0.5), (20.0, 7.0, 0.0))) -> FocalPlane:
    """Return robots with these vertices, all rows of different arms and radii, and discs."""
    n = len(phi)
    return FocalPlane(
        ids=np.arange(n),
        centers=np.arange(2.0 * n).reshape(n, 2),
        arms=1.0 + np.arange(2.0 * n).reshape(n, 2) / 10,
        limits=np.tile([-9.0, 9.0], (n, 2, 1)),
        speeds=np.ones((n, 2)),
        phi_vertices=phi,
        phi_radius=0.1 + 0.01 * np.arange(n),
        theta_vertices=np.zeros((n, 0, 2)) if theta is None else theta,
        theta_radius=0.5 + 0.01 * np.arange(n),
        enabled=np.ones(n, dtype=bool),
        obstacles=np.array(discs).reshape(-1, 3),
    )


def _links(bodies):
    """Hulls, numbers of vertices, circles and reaches of the phi links, then of the theta links."""
    return (
        (bodies.phi_vertices, bodies.phi_count, bodies.phi_disc, bodies.phi_reach),
        (bodies.theta_vertices, bodies.theta_count, bodies.theta_disc, bodies.theta_reach),
    )


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


@pytest.mark.parametrize("vertices", [3, 5, 8, 13])
def test_a_hull_has_the_vertices_of_the_convex_hull_counter_clockwise(vertices):
    rng = np.random.default_rng(vertices)
    phi = rng.normal(0.0, 2.0, (12, vertices, 2))
    theta = rng.normal(3.0, 2.0, (12, vertices + 1, 2))
    bodies = bodies_of(_plane(phi, theta))
    for points, (hull, count, _, _) in zip((phi, theta), _links(bodies)):
        for row in range(12):
            corners = points[row, ConvexHull(points[row]).vertices]
            found = hull[row, : count[row]]
            start = np.argmin(np.abs(corners - found[0]).sum(axis=1))
            np.testing.assert_array_equal(found, np.roll(corners, -start, axis=0))


_DEGENERATE = {
    # vertices of an outline, and those of its hull
    "a point": ([[1.0, 2.0]], [[1.0, 2.0]]),
    "the same point twice": ([[1.0, 2.0], [1.0, 2.0]], [[1.0, 2.0]]),
    "the same point often": ([[1.0, 2.0]] * 4, [[1.0, 2.0]]),
    "a line": ([[0.0, 0.0], [4.0, 2.0]], [[0.0, 0.0], [4.0, 2.0]]),
    "points on a line": ([[2.0, 1.0], [4.0, 2.0], [0.0, 0.0], [1.0, 0.5]], [[0, 0], [4, 2]]),
    "points on an upright line": ([[1.0, 3.0], [1.0, 0.0], [1.0, 5.0]], [[1, 0], [1, 5]]),
    "points on a level line": ([[3.0, 1.0], [0.0, 1.0], [5.0, 1.0]], [[0, 1], [5, 1]]),
    "a square with points on its sides and within": (
        [[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 1], [0, 2], [0, 1], [1, 2], [0, 0]],
        [[0, 0], [2, 0], [2, 2], [0, 2]],
    ),
}


@pytest.mark.parametrize("case", _DEGENERATE)
def test_a_hull_has_no_vertex_twice_and_none_on_a_side(case):
    points, corners = (np.array(each, dtype=float) for each in _DEGENERATE[case])
    shift = np.array([[0.0, 0.0], [5.0, -7.0]])
    rows = points + shift[:, None]
    bodies = bodies_of(_plane(rows, rows))
    for hull, count, _, _ in _links(bodies):
        for row in range(2):
            assert hull[row, : count[row]].tolist() == (corners + shift[row]).tolist()


def test_the_order_of_the_vertices_of_an_outline_does_not_matter():
    rng = np.random.default_rng(3)
    phi = rng.integers(-2, 3, (40, 7, 2)).astype(float)  # a coarse grid: many equal x and lines
    bodies = bodies_of(_plane(phi))
    shuffled = bodies_of(_plane(phi[:, ::-1]))
    again = bodies_of(_plane(rng.permutation(phi, axis=1)))
    for other in (shuffled, again):
        np.testing.assert_array_equal(bodies.phi_count, other.phi_count)
        for row in range(40):
            corners = slice(0, bodies.phi_count[row])
            np.testing.assert_array_equal(
                bodies.phi_vertices[row, corners], other.phi_vertices[row, corners]
            )
    for row in range(40):
        hull = bodies.phi_vertices[row, : bodies.phi_count[row]]
        if len(hull) > 2:
            side = np.roll(hull, -1, axis=0) - hull
            assert (_cross(side, np.roll(side, -1, axis=0)) > 0).all()
            out = _cross(side[:, None], phi[row][None] - hull[:, None])
            assert (out >= 0).all()


def test_the_circle_holds_all_vertices_and_is_not_wider_than_it_must_be():
    rng = np.random.default_rng(1)
    phi, theta = rng.normal(1.0, 2.0, (60, 6, 2)), rng.normal(0.0, 2.0, (60, 9, 2))
    bodies = bodies_of(_plane(phi, theta))
    for points, (_, _, disc, reach) in zip((phi, theta), _links(bodies)):
        out = np.hypot(*np.moveaxis(points - disc[:60, None, :2], -1, 0)).max(axis=1)
        np.testing.assert_allclose(disc[:60, 2], out, rtol=1e-12)
        apart = points[:, :, None] - points[:, None]
        width = np.hypot(*np.moveaxis(apart, -1, 0)).max(axis=(1, 2))
        # around the middle of the longest diagonal all is within sqrt(3) / 2 of its length
        assert (out <= np.sqrt(0.75) * width + 1e-12).all()
        assert (np.abs(out - width / 2) < 1e-12).mean() > 0.3
        far = np.hypot(*np.moveaxis(points, -1, 0)).max(axis=1)
        np.testing.assert_allclose(reach[:60], far, rtol=1e-12)


def test_the_circle_around_one_vertex_is_that_vertex():
    point = np.array([[[1.5, -2.0]], [[0.0, 3.0]]])
    bodies = bodies_of(_plane(point, point))
    for _, _, disc, _ in _links(bodies):
        assert disc[:2].tolist() == [[1.5, -2.0, 0.0], [0.0, 3.0, 0.0]]


def test_an_obstacle_is_a_rounded_point_without_arms():
    rng = np.random.default_rng(2)
    plane = _plane(rng.normal(size=(3, 4, 2)), rng.normal(size=(3, 5, 2)))
    bodies = bodies_of(plane)
    assert len(bodies.center) == len(bodies.table) == 5
    np.testing.assert_array_equal(bodies.center, np.r_[plane.centers, plane.obstacles[:, :2]])
    np.testing.assert_array_equal(bodies.arm1, [*plane.arms[:, 0], 0.0, 0.0])
    np.testing.assert_array_equal(bodies.arm2, [*plane.arms[:, 1], 0.0, 0.0])
    np.testing.assert_array_equal(bodies.phi_radius, [*plane.phi_radius, 0.5, 0.0])
    np.testing.assert_array_equal(bodies.theta_radius, [*plane.theta_radius, 0.0, 0.0])
    assert bodies.phi_count[3:].tolist() == [1, 1] and bodies.theta_count[3:].tolist() == [0, 0]
    assert (bodies.theta_count[:3] >= 3).all()
    for hull, _, disc, reach in _links(bodies):
        assert not hull[3:, 0].any() and not disc[3:].any() and not reach[3:].any()


def test_robots_without_a_theta_outline_have_no_theta_vertices():
    bodies = bodies_of(preset("desi", 3))
    assert not bodies.theta_count.any() and (bodies.phi_count == 2).all()
    assert not bodies.theta_reach.any()


def test_bodies_cannot_be_changed():
    for column in bodies_of(preset("desi_outlines", 2)):
        assert not column.flags.writeable


def test_the_bodies_of_changed_planes_are_built_anew():
    plane = preset("desi", 2)
    wider = replace(plane, phi_radius=2 * plane.phi_radius)
    np.testing.assert_array_equal(bodies_of(wider).phi_radius, 2 * bodies_of(plane).phi_radius)

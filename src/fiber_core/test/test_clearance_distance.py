# SPDX-License-Identifier: Apache-2.0
"""Laws of the gap between outlines, and of neighbour pairs."""

import gc
from dataclasses import replace
from weakref import ref

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from fiber_core.clearance import (
    bodies_of,
    gaps,
    neighbour_pairs,
    pair_gap,
    pair_gap_below,
    sampled_gaps,
)
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import preset

seeds = st.integers(0, 2**32 - 1)
laws = settings(max_examples=100, deadline=None)


def _random_plane(rng: np.random.Generator, n: int = 2, discs: int = 0) -> FocalPlane:
    """Return robots of random build, close together: 1 to 7 phi and 0 to 9 theta vertices."""
    return FocalPlane(
        ids=np.arange(n),
        centers=rng.uniform(-8, 8, (n, 2)),
        arms=rng.uniform(0.5, 5.0, (n, 2)),
        limits=np.tile([-9.0, 9.0], (n, 2, 1)),
        speeds=np.ones((n, 2)),
        phi_vertices=rng.normal(0.0, 2.0, (n, rng.integers(1, 8), 2)) + [1.0, 0.0],
        phi_radius=rng.uniform(0.0, 1.5, n) * rng.integers(0, 2),
        theta_vertices=rng.normal(0.0, 2.0, (n, rng.integers(0, 10), 2)),
        theta_radius=rng.uniform(0.0, 1.5, n) * rng.integers(0, 2),
        enabled=np.ones(n, dtype=bool),
        obstacles=np.c_[rng.uniform(-8, 8, (discs, 2)), rng.uniform(0.0, 2.0, discs)],
    )


def _random_angles(rng, n):
    return rng.uniform(-np.pi, np.pi, (n, 2))


def _all_pairs(plane):
    bodies = plane.n + len(plane.obstacles)
    return [(a, b) for a in range(plane.n) for b in range(a + 1, bodies)]


def _turned(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def _links(plane: FocalPlane, row: int, angles) -> list:
    """Return the placed vertices and radius of each link of a body, by the definition."""
    if row >= plane.n:
        x, y, radius = plane.obstacles[row - plane.n]
        return [(np.array([[x, y]]), radius)]
    theta, phi = angles[row]
    center = plane.centers[row]
    elbow = center + plane.arms[row, 0] * np.array([np.cos(theta), np.sin(theta)])
    links = [(elbow + _turned(plane.phi_vertices[row], theta + phi), plane.phi_radius[row])]
    if plane.theta_vertices.shape[1]:
        links.append((center + _turned(plane.theta_vertices[row], theta), plane.theta_radius[row]))
    return links


def _reference_separation(p, q) -> float:
    """Return max over u of min u.q - max u.p, over every direction that can be the best.

    That is a line between a vertex of each, or a normal of a line between two of one.
    """
    both = np.concatenate([p, q])
    lines = (both[:, None] - both[None, :]).reshape(-1, 2)
    lines = lines[np.hypot(*lines.T) > 0]
    lines /= np.hypot(*lines.T)[:, None]
    u = np.concatenate([lines, lines[:, ::-1] * [1.0, -1.0], [[1.0, 0.0]]])
    return ((q @ u.T).min(axis=0) - (p @ u.T).max(axis=0)).max()


def _reference_gap(plane, a, b, angles) -> float:
    return min(
        _reference_separation(p, q) - p_radius - q_radius
        for p, p_radius in _links(plane, a, angles)
        for q, q_radius in _links(plane, b, angles)
    )


def test_gap_is_the_separation_along_the_best_direction():
    apart = overlapping = 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        plane = _random_plane(rng, n=3, discs=1)
        angles = _random_angles(rng, 3)
        pairs = _all_pairs(plane)
        reference = [_reference_gap(plane, a, b, angles) for a, b in pairs]
        np.testing.assert_allclose(gaps(plane, pairs, angles), reference, rtol=0, atol=1e-9)
        apart += np.sum(np.array(reference) > 0)
        overlapping += np.sum(np.array(reference) < 0)
    assert min(apart, overlapping) > 300


def _boundary(points, radius, count=4000):
    """Return points on the rounded outline of a convex polygon given counter-clockwise."""
    ends = np.roll(points, -1, axis=0)
    edge = ends - points
    length = np.hypot(*edge.T)
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length[:, None]
    share = np.linspace(0.0, 1.0, count // len(points))[:, None, None]
    sides = points + radius * normal + share * edge
    turn = np.linspace(0.0, 2 * np.pi, count // len(points))[:, None, None]
    caps = points + radius * np.concatenate([np.cos(turn), np.sin(turn)], axis=2)
    return np.concatenate([sides, caps]).reshape(-1, 2)


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
def test_gap_is_the_distance_of_boundary_points(name):
    plane = preset(name, 2)
    rng = np.random.default_rng(7)
    compared = 0
    while compared < 8:
        angles = _random_angles(rng, 2)
        (gap,) = gaps(plane, [(0, 1)], angles)
        if gap <= 0.05:
            continue
        nearest = np.inf
        for p, p_radius in _links(plane, 0, angles):
            for q, q_radius in _links(plane, 1, angles):
                apart, _ = cKDTree(_boundary(p, p_radius)).query(_boundary(q, q_radius))
                nearest = min(nearest, apart.min())
        assert gap <= nearest + 1e-9
        assert nearest - gap < 1e-3
        compared += 1


@laws
@given(seeds)
def test_gap_is_symmetric(seed):
    rng = np.random.default_rng(seed)
    plane, angles = _random_plane(rng), _random_angles(rng, 2)
    bodies = bodies_of(plane)
    there = pair_gap(bodies, 0, 1, *angles[0], *angles[1])
    back = pair_gap(bodies, 1, 0, *angles[1], *angles[0])
    assert there == pytest.approx(back, abs=1e-9)


@laws
@given(seeds, st.floats(-10, 10), st.floats(-500, 500), st.floats(-500, 500))
def test_gap_does_not_change_when_the_plane_is_turned_and_shifted(seed, turn, x, y):
    rng = np.random.default_rng(seed)
    plane, angles = _random_plane(rng, discs=1), _random_angles(rng, 2)
    elsewhere = replace(
        plane,
        centers=_turned(plane.centers, turn) + [x, y],
        obstacles=np.c_[_turned(plane.obstacles[:, :2], turn) + [x, y], plane.obstacles[:, 2]],
    )
    pairs = _all_pairs(plane)
    moved = gaps(elsewhere, pairs, angles + [turn, 0.0])
    np.testing.assert_allclose(moved, gaps(plane, pairs, angles), rtol=0, atol=1e-9)


@laws
@given(seeds, st.floats(1e-6, 1.0))
def test_gap_changes_no_more_than_the_points_move(seed, size):
    rng = np.random.default_rng(seed)
    plane, before = _random_plane(rng, discs=1), _random_angles(rng, 2)
    after = before + size * rng.normal(size=(2, 2))
    for a, b in _all_pairs(plane):
        moved = sum(
            max(
                np.hypot(*(p - q).T).max()
                for (p, _), (q, _) in zip(_links(plane, row, before), _links(plane, row, after))
            )
            for row in (a, b)
        )
        change = gaps(plane, [(a, b)], after) - gaps(plane, [(a, b)], before)
        assert abs(change[0]) <= moved + 1e-9


@laws
@given(seeds, st.floats(0.0, 3.0))
def test_gap_shrinks_as_much_as_the_outlines_grow(seed, more):
    rng = np.random.default_rng(seed)
    plane, angles = _random_plane(rng), _random_angles(rng, 2)
    grown = replace(
        plane, phi_radius=plane.phi_radius + more, theta_radius=plane.theta_radius + more
    )
    (gap,), (less,) = gaps(plane, [(0, 1)], angles), gaps(grown, [(0, 1)], angles)
    assert less == pytest.approx(gap - 2 * more, abs=1e-9)


@laws
@given(seeds, st.floats(-2.0, 10.0))
def test_gap_below_is_exact_below_the_cutoff_and_a_lower_bound_above(seed, cutoff):
    rng = np.random.default_rng(seed)
    plane, angles = _random_plane(rng), _random_angles(rng, 2)
    bodies = bodies_of(plane)
    gap = pair_gap(bodies, 0, 1, *angles[0], *angles[1])
    below = pair_gap_below(bodies, 0, 1, *angles[0], *angles[1], cutoff)
    if gap < cutoff:
        assert below == pytest.approx(gap, abs=1e-9)
    else:
        assert cutoff - 1e-9 <= below <= gap + 1e-9


def test_crossed_capsules_overlap_by_the_shortest_push_that_parts_them():
    # The second arm lies across the first, its tip 0.5 mm beyond.
    plane = replace(preset("desi", 2), centers=[[0.0, 0.0], [5.0, -5.5]])
    angles = [[0.0, 0.0], [np.pi / 2, 0.0]]
    assert gaps(plane, [(0, 1)], angles)[0] == pytest.approx(-0.5 - 2.0)


@laws
@given(seeds)
@example(2700)  # vertices on a line, but for rounding
def test_only_the_hull_of_the_vertices_counts(seed):
    rng = np.random.default_rng(seed)
    plane, angles = _random_plane(rng), _random_angles(rng, 2)
    inner = rng.dirichlet(np.ones(plane.phi_vertices.shape[1]), (2, 3)) @ plane.phi_vertices
    mixed = np.concatenate([inner, plane.phi_vertices, plane.phi_vertices[:, :1]], axis=1)
    same = replace(plane, phi_vertices=rng.permutation(mixed, axis=1))
    assert gaps(same, [(0, 1)], angles) == pytest.approx(gaps(plane, [(0, 1)], angles), abs=1e-9)


def test_bodies_are_built_once_for_a_plane_and_kept_as_long_as_the_plane():
    plane = preset("desi_outlines", 7)
    kept = ref(bodies_of(plane).table)
    assert bodies_of(plane).table is kept()
    assert bodies_of(preset("desi_outlines", 7)).table is not kept()
    del plane
    gc.collect()
    assert kept() is None


def test_sampled_gaps_are_the_gaps_of_each_instant():
    rng = np.random.default_rng(3)
    plane = _random_plane(rng, n=4, discs=2)
    angles = rng.uniform(-np.pi, np.pi, (4, 2, 5))
    pairs = _all_pairs(plane)
    sampled = sampled_gaps(plane, pairs, angles)
    assert sampled.shape == (len(pairs), 5)
    for k in range(5):
        np.testing.assert_array_equal(sampled[:, k], gaps(plane, pairs, angles[:, :, k]))
    bodies = bodies_of(plane)
    one = pair_gap(bodies, 1, 3, *angles[1, :, 2], *angles[3, :, 2])
    assert one == pytest.approx(sampled[pairs.index((1, 3)), 2], abs=1e-12)


@pytest.mark.parametrize("name, neighbours", [("desi", 6), ("desi_outlines", 6), ("moons", 18)])
def test_interior_robots_have_all_neighbours_within_reach(name, neighbours):
    plane = preset(name, 300)
    counts = np.bincount(neighbour_pairs(plane).ravel(), minlength=plane.n)
    inner = np.hypot(*plane.centers.T) < 0.6 * np.hypot(*plane.centers.T).max()
    assert inner.sum() > 50
    assert (counts[inner] == neighbours).all()


def test_neighbour_pairs_are_all_and_only_those_within_slack():
    rng = np.random.default_rng(11)
    plane = _random_plane(rng, n=40, discs=9)
    plane = replace(plane, centers=7 * plane.centers, obstacles=plane.obstacles * [7, 7, 6])
    middle = np.concatenate([plane.centers, plane.obstacles[:, :2]])
    reach = np.concatenate([plane.reach_mm, plane.obstacles[:, 2]])
    expected = [
        (a, b)
        for a, b in _all_pairs(plane)
        if np.hypot(*(middle[a] - middle[b])) <= reach[a] + reach[b] + 0.7
    ]
    found = neighbour_pairs(plane, 0.7)
    assert found.dtype == np.int32
    assert found.tolist() == [list(pair) for pair in expected]
    assert 40 < len(found) < 600


def test_pairs_left_out_keep_the_slack():
    rng = np.random.default_rng(5)
    plane = _random_plane(rng, n=30, discs=5)
    plane = replace(plane, centers=4 * plane.centers)
    close = set(map(tuple, neighbour_pairs(plane, 2.0).tolist()))
    far = [pair for pair in _all_pairs(plane) if pair not in close]
    assert len(far) > 50
    angles = rng.uniform(-np.pi, np.pi, (30, 2, 200))
    assert sampled_gaps(plane, far, angles).min() > 2.0


def test_planes_without_robots_or_obstacles_have_no_pairs():
    empty = preset("desi", 3).permuted([])
    assert neighbour_pairs(empty).shape == (0, 2)
    assert neighbour_pairs(preset("desi", 1)).shape == (0, 2)
    assert gaps(empty, np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)

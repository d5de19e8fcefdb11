# SPDX-License-Identifier: Apache-2.0
"""Walls: refused where they are not convex, and kept clear of by every stage of a plan."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import (
    LayoutError,
    Reason,
    SegmentMotion,
    assign,
    forward,
    load_problem,
    preset,
    random_field,
    save_problem,
)
from fiber_core.clearance import Safety, certify, gaps, hold_until_safe, neighbour_pairs
from fiber_core.walls import distances_to_walls, padded_walls

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def walls_between(plane, count, rng):
    """Lines, triangles and quadrangles between robots, near enough to be touched."""
    walls = []
    for _ in range(count):
        row = rng.integers(plane.n)
        middle = plane.centers[row] + 0.5 * plane.reach_mm[row] * rng.uniform(1.2, 2.2) * unit(rng)
        turns = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(2, 5)))
        size = 0.25 * plane.reach_mm[row]
        walls.append(middle + size * np.stack([np.cos(turns), np.sin(turns)], axis=1))
    return padded_walls(walls)


def unit(rng):
    turn = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(turn), np.sin(turn)])


def sampled_outline(vertices, samples=12):
    """Points on the edges of a closed polygon, shape (m, 2)."""
    ends = np.roll(vertices, -1, axis=0)
    share = np.linspace(0, 1, samples, endpoint=False)[:, None, None]
    return (vertices + share * (ends - vertices)).reshape(-1, 2)


def is_inside(points, polygon):
    """Even-odd rule, written for this test alone."""
    inside = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0)):
        if y0 == y1:
            continue
        crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
        inside ^= crosses & (points[:, 0] < x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0))
    return inside


def crosses(polygon, other):
    """Whether an edge of one polygon crosses an edge of another."""
    a, b = polygon[:, None], np.roll(polygon, -1, axis=0)[:, None]
    c, d = other[None], np.roll(other, -1, axis=0)[None]

    def side(p, q, r):
        (x, y), (u, v) = np.moveaxis(q - p, -1, 0), np.moveaxis(r - p, -1, 0)
        return x * v - y * u

    return np.any((side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0))


def gap_by_sampling(plane, row, angles, wall):
    """The distance of a robot from a wall, from points on the outlines; -1 where they overlap."""
    theta, phi = angles
    elbow = plane.centers[row] + plane.arms[row, 0] * np.array([np.cos(theta), np.sin(theta)])
    links = [(plane.phi_vertices[row], plane.phi_radius[row], theta + phi, elbow)]
    if plane.theta_vertices.shape[1]:
        links.append(
            (plane.theta_vertices[row], plane.theta_radius[row], theta, plane.centers[row])
        )
    best = np.inf
    for vertices, radius, turn, origin in links:
        c, s = np.cos(turn), np.sin(turn)
        placed = vertices @ np.array([[c, s], [-s, c]]) + origin
        if (
            crosses(placed, wall)
            or is_inside(placed[:1], wall)[0]
            or is_inside(wall[:1], placed)[0]
        ):
            return -1.0
        points, others = sampled_outline(placed), sampled_outline(wall)
        between = np.hypot(*(points[:, None] - others[None]).transpose(2, 0, 1)).min()
        best = min(best, between - radius)
    return best


@pytest.mark.parametrize("name", ["desi_outlines", "desi", "sdss_v"])
def test_gaps_to_walls_agree_with_dense_points_on_the_outlines(name):
    rng = np.random.default_rng(3)
    plane = preset(name, 19)
    plane = replace(plane, walls=walls_between(plane, 25, rng))
    pairs = neighbour_pairs(plane)
    pairs = pairs[pairs[:, 1] >= plane.n]
    assert len(pairs) > 25
    overlaps = 0
    for _ in range(10):
        angles = rng.uniform(*np.moveaxis(plane.limits, -1, 0))
        for (row, body), gap in zip(pairs, gaps(plane, pairs, angles)):
            expected = gap_by_sampling(plane, row, angles[row], plane.walls[body - plane.n])
            overlaps += expected == -1.0
            if expected == -1.0:
                assert gap < 1e-9
            else:  # sampling can only find more than the true distance
                spacing = plane.reach_mm[row] / 6
                assert expected - spacing <= gap <= expected + 1e-9
    assert overlaps > 5


def test_pairs_that_are_left_out_never_come_near():
    rng = np.random.default_rng(4)
    plane = preset("desi_outlines", 37)
    plane = replace(plane, walls=walls_between(plane, 30, rng))
    kept = {tuple(pair) for pair in neighbour_pairs(plane, 1.0)}
    every = np.array([(i, plane.n + k) for i in range(plane.n) for k in range(30)])
    others = np.array([pair for pair in every.tolist() if tuple(pair) not in kept])
    assert len(others) > 500
    for _ in range(30):
        angles = rng.uniform(*np.moveaxis(plane.limits, -1, 0))
        assert gaps(plane, others, angles).min() > 1.0


def test_a_certificate_with_walls_agrees_with_dense_sampling():
    rng = np.random.default_rng(5)
    plane = preset("desi_outlines", 19)
    plane = replace(plane, walls=walls_between(plane, 6, rng))
    field = random_field(plane, rng)
    way = rng.uniform(*np.moveaxis(plane.limits, -1, 0)) - field.problem.start
    motion = SegmentMotion(
        field.problem.start, np.arange(2 * plane.n + 1), np.full(2 * plane.n, 3.0), way.ravel() / 3
    )
    certificate = certify(plane, motion, Safety())
    walls = certificate.pairs[:, 1] >= plane.n
    pairs = certificate.pairs[walls]
    dense = np.min([gaps(plane, pairs, motion(t)) for t in np.linspace(0, 3, 3001)], axis=0)
    assert (dense < 0).any() and (dense > 0.05).any()
    assert np.all(certificate.gap_mm[walls] <= dense + 1e-9)
    assert not np.any(certificate.unsafe[walls] & (dense > certificate.required_mm[walls] + 0.01))
    assert np.all(certificate.unsafe[walls][dense < certificate.required_mm[walls]])
    safe, held, proof = hold_until_safe(plane, motion, Safety())
    assert proof.ok and held.any() and not held.all()
    dense = [gaps(plane, proof.pairs, safe(t)).min() for t in np.linspace(0, 3, 301)]
    assert min(dense) >= Safety().margin_mm


def test_a_thin_wall_is_not_jumped_over():
    plane = replace(preset("desi", 1), walls=[[[4.0, -9.0], [4.0, 9.0]]])
    start = np.array([[np.pi / 2, 0.0]])
    through = SegmentMotion(start, [0, 1, 1], [0.1], [-10.0 * np.pi])  # half a turn in 0.1 s
    certificate = certify(plane, through, Safety())
    assert certificate.unsafe.all() and certificate.unsafe_robots.tolist() == [True]
    aside = SegmentMotion(start, [0, 1, 1], [0.1], [10.0 * np.pi])
    assert not certify(plane, aside, Safety()).unsafe.any()


def test_a_target_behind_a_wall_is_refused_and_the_wall_named():
    plane = preset("desi", 7)
    plane = replace(
        plane, obstacles=[[99.0, 0.0, 1.0]], walls=[SQUARE + 50, SQUARE * 0.4 + [-4.8, -0.2]]
    )
    start = np.tile([0.0, np.pi], (7, 1))
    found = assign(plane, start, [0], [[-4.5, 0.0]])
    assert found.reason[0] == Reason.TARGET_ON_OBSTACLE
    assert found.explain(0).endswith("cannot be reached: wall 1 is in the way")
    assert assign(plane, start, [0], [[4.5, 0.0]]).reason[0] == Reason.OK


def test_random_fields_keep_clear_of_walls():
    rng = np.random.default_rng(6)
    plane = preset("desi_outlines", 61)
    plane = replace(plane, walls=walls_between(plane, 20, rng))
    field = random_field(plane, rng)
    pairs = neighbour_pairs(plane)
    for angles in (field.problem.start, field.goal):
        assert gaps(plane, pairs, angles).min() >= Safety().margin_mm
    reached = np.hypot(*(forward(plane, field.goal)[1] - field.problem.targets).T)
    assert reached.max() < 1e-9


@pytest.mark.parametrize(
    "walls, words",
    [
        ([[[0, 0], [4, 0], [1, 1], [0, 4]]], ["wall 0", "not convex", "split"]),  # a dent
        ([SQUARE.tolist(), SQUARE[[0, 2, 1, 3]].tolist()], ["wall 1", "not convex"]),  # a bow
        ([[[0, 0], [np.nan, 0]]], ["wall 0", "nan"]),
        ([[[0, 0], [1e7, 0]]], ["wall 0", "1e+06"]),
        (np.zeros((1, 0, 2)), ["0 corners"]),
        ([[0.0, 1.0]], ["shape"]),
    ],
)
def test_walls_that_are_no_convex_polygons_are_refused(walls, words):
    with pytest.raises(LayoutError) as refusal:
        replace(preset("desi", 7), walls=walls)
    assert all(word in str(refusal.value) for word in words), str(refusal.value)


def test_points_lines_and_either_way_round_are_walls():
    walls = padded_walls([SQUARE, SQUARE[::-1], SQUARE[:2], SQUARE[:1]])
    plane = replace(preset("desi", 7), walls=walls)
    assert plane.fixtures == 4 and plane.name_of(9) == "wall 2" and plane.name_of(6) == "robot 6"
    point = np.repeat([[0.5, 3.0]], 4, axis=0)
    np.testing.assert_allclose(distances_to_walls(point, walls), [2, 2, 3, np.hypot(0.5, 3)])
    assert distances_to_walls(point[:2] - [0, 2.5], walls[:2]).tolist() == [0, 0]


def test_a_problem_file_holds_walls(tmp_path):
    plane = preset("desi", 7)
    plane = replace(plane, walls=[SQUARE + 50])
    problem = random_field(plane, np.random.default_rng(1)).problem
    save_problem(tmp_path / "problem.npz", problem)
    assert np.array_equal(load_problem(tmp_path / "problem.npz").plane.walls, plane.walls)

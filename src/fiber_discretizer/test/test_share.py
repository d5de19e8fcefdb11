# SPDX-License-Identifier: Apache-2.0
"""Shares of the free space: safe by the rule "safe", contact by the rule "printed"."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core import kinematics
from fiber_core.clearance import gaps, neighbour_pairs, sampled_gaps
from fiber_discretizer import joint_shares, lever_arms_mm, tip_distances_mm
from fiber_discretizer.makarem2014.free_space import FreeSpace, free_space_mm

REQUIRED_MM = 0.1
TRIANGLE = [[0.0, 0.0], [10.4, 0.0], [5.2, 9.0]]


def random_angles(rng, n, samples):
    steps = rng.normal(0.0, 0.08, (n, 2, samples)) * (rng.random((n, 1, samples)) < 0.7)
    return rng.uniform([-3, 0], [3, 3], (n, 2))[:, :, None] + np.cumsum(steps, axis=2)


def shares_of(plane, joint, angles, robots, printed=False):
    pairs = neighbour_pairs(plane)
    if printed:
        free = tip_distances_mm(plane, pairs, angles)
    else:
        free = sampled_gaps(plane, pairs, angles) - REQUIRED_MM
    return joint_shares(plane, joint, pairs, free, angles[:, 1], robots)


@given(seed=st.integers(0, 2**32 - 1), joint=st.sampled_from([0, 1]))
def test_safe_shares_used_in_any_way_keep_the_required_gap(plane_at, seed, joint):
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    pairs = neighbour_pairs(plane)
    robots = rng.random(3) < 0.7
    angles = random_angles(rng, 3, 12)
    before = sampled_gaps(plane, pairs, angles)
    shares = shares_of(plane, joint, angles, robots)
    moved = angles.copy()
    moved[robots, joint] += shares * rng.choice([-1.0, 1.0, 0.3], shares.shape)
    after = sampled_gaps(plane, pairs, moved)
    assert np.all(after >= np.minimum(before, REQUIRED_MM) - 1e-9)


def test_printed_shares_let_two_neighbours_meet_and_safe_ones_do_not(plane_at):
    # Stretched arms that point past each other; each turns towards the other.
    plane = plane_at([[0.0, 0.0], [10.0, 0.0]])
    angles = np.array([[0.5, 0.0], [np.pi + 0.5, 0.0]])
    both = np.ones(2, dtype=bool)
    gap = {}
    for printed in (True, False):
        shares = shares_of(plane, 0, angles[:, :, None], both, printed)
        gap[printed] = gaps(plane, [[0, 1]], angles - shares * [[1.0, 0.0]])[0]
    assert gaps(plane, [[0, 1]], angles)[0] > 1.0
    assert gap[True] < 0.0  # erratum: half the distance twice is contact
    assert gap[False] >= REQUIRED_MM


def test_a_neighbour_that_keeps_its_profile_leaves_all_the_space(plane_at):
    plane = plane_at([[0.0, 0.0], [10.0, 0.0]])
    angles = np.array([[0.5, 0.0], [np.pi + 0.5, 0.0]])[:, :, None]
    shared = shares_of(plane, 0, angles, np.array([True, True]))
    alone = shares_of(plane, 0, angles, np.array([True, False]))
    np.testing.assert_allclose(alone[0], 2 * shared[0])
    assert len(alone) == 1


def test_a_robot_without_neighbours_has_the_cap(plane_at):
    plane = plane_at([[0.0, 0.0], [100.0, 0.0]])
    angles = np.zeros((2, 2, 3))
    np.testing.assert_array_equal(shares_of(plane, 0, angles, np.ones(2, bool)), np.pi)


@given(seed=st.integers(0, 2**32 - 1), joint=st.sampled_from([0, 1]))
def test_lever_is_the_farthest_an_outline_point_moves_per_radian(plane_at, seed, joint):
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE, phi_vertices=rng.uniform(-2, 4, (3, 5, 2)))
    angles = random_angles(rng, 3, 1)[:, :, 0]
    axis = plane.centers if joint == 0 else kinematics.forward(plane, angles)[0]
    turn = angles.sum(axis=1)[:, None]
    x, y = np.moveaxis(plane.phi_vertices, -1, 0)
    elbow = kinematics.forward(plane, angles)[0][:, None]
    corners = elbow + np.stack(
        [np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], axis=-1
    )
    farthest = np.linalg.norm(corners - axis[:, None], axis=-1).max(axis=1) + plane.phi_radius
    lever = lever_arms_mm(plane, joint, angles[:, 1:], np.ones(3, bool))[:, 0]
    np.testing.assert_allclose(lever, farthest)


def test_theta_lever_contains_the_theta_outline(plane_at):
    body = np.tile([[-7.0, -1.0], [1.0, -1.0], [0.0, 2.0]], (3, 1, 1))
    plane = plane_at(TRIANGLE, theta_vertices=body)
    lever = lever_arms_mm(plane, 0, np.full((3, 1), np.pi), np.ones(3, bool))
    np.testing.assert_allclose(lever, np.hypot(7, 1))


def test_tip_distances_are_between_tips_and_obstacle_centres(plane_at):
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    angles = random_angles(np.random.default_rng(1), 3, 4)
    pairs = neighbour_pairs(plane)
    assert pairs.max() == 3
    for k in range(4):
        points = np.concatenate([kinematics.forward(plane, angles[:, :, k])[1], [[-4.0, 5.0]]])
        expected = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
        np.testing.assert_allclose(tip_distances_mm(plane, pairs, angles)[:, k], expected)


@given(seed=st.integers(0, 2**32 - 1))
def test_free_space_is_a_close_lower_bound(plane_at, seed):
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    pairs = neighbour_pairs(plane)
    angles = random_angles(rng, 3, 60)
    angles[0, :, 30:] = angles[0, :, 30:31]
    required = rng.uniform(0.0, 0.3, len(pairs))
    exact = sampled_gaps(plane, pairs, angles) - required[:, None]
    bound = free_space_mm(plane, pairs, required, angles)
    assert np.all(bound <= exact + 1e-9)
    assert np.all(bound >= exact - 0.1 * np.maximum(exact, 0.0) / 0.9 - 1e-9)


def test_free_space_is_updated_where_robots_were_moved(plane_at):
    rng = np.random.default_rng(4)
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    pairs, required = neighbour_pairs(plane), np.full(4, REQUIRED_MM)
    every = np.ones(len(pairs), dtype=bool)
    angles = random_angles(rng, 3, 20)
    space = FreeSpace(plane, pairs, required, angles)
    space.space_mm(every)
    one = np.array([False, True, False])
    angles[1] = random_angles(rng, 1, 20)
    space.move(one, angles[one])
    expected = free_space_mm(plane, pairs, required, angles)
    some = space.pairs_with(np.array([True, False, False]))
    np.testing.assert_array_equal(space.space_mm(some), expected[some])
    np.testing.assert_array_equal(space.space_mm(every), expected)


@pytest.mark.parametrize("resting", [0, 1])
def test_free_space_of_a_robot_at_rest_beside_one_that_moves(plane_at, resting):
    plane = plane_at([[0.0, 0.0], [10.0, 0.0]])
    planned = random_angles(np.random.default_rng(2), 2, 30)
    still = np.repeat(planned[:, :, :1], 30, axis=2)
    mixed = planned.copy()
    mixed[resting] = still[resting]
    pair = [[resting, 1 - resting]]
    expected = sampled_gaps(plane, [[0, 1]], mixed)
    bound = free_space_mm(plane, pair, np.zeros(1), still, planned)
    assert np.all(bound <= expected + 1e-9) and np.all(bound >= 0.88 * expected - 1e-9)

# SPDX-License-Identifier: Apache-2.0
"""Spec-S5: rafts of the published sizes, whose walls no arm of another raft can cross."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fiber_core import PRESETS, LayoutError, preset
from fiber_core.walls import distances_to_walls

PLANE = preset("spec_s5")
IN_RAFT, WALLS = 63, 6


def test_numbers_pitch_and_patrol_are_as_published():
    assert PLANE.n == 12_852 == PRESETS["spec_s5"].robots and len(PLANE.walls) == 204 * WALLS
    nearest = cKDTree(PLANE.centers).query(PLANE.centers, k=2)[0][:, 1]
    assert np.allclose(nearest, 6.2)
    assert np.allclose(PLANE.reach_mm, 4.4) and np.allclose(PLANE.arms, 1.8)
    assert np.bincount(PLANE.bus).tolist() == [IN_RAFT] * 204


def test_rafts_are_triangles_of_74_mm_with_gaps_of_2_mm():
    plates = PLANE.walls[:WALLS].reshape(-1, 2)
    middle = PLANE.centers[:IN_RAFT].mean(axis=0)
    sides = PLANE.walls[:WALLS:2]  # every other plate is a cut corner
    outer = distances_to_walls(np.repeat(middle[None], 3, axis=0), sides) + 0.3
    assert np.allclose(2 * np.sqrt(3) * outer, 74.0)
    other = PLANE.walls[WALLS:].reshape(-1, 2)
    gap = distances_to_walls(np.repeat(other, 3, axis=0), np.tile(sides, (len(other), 1, 1)))
    assert gap.min() == pytest.approx(2.0) and len(plates) == 24


def test_every_robot_stands_inside_its_own_raft_clear_of_all_walls():
    tree = cKDTree(PLANE.walls.mean(axis=1))
    for raft in (0, 57, 203):
        rows = np.arange(raft * IN_RAFT, (raft + 1) * IN_RAFT)
        _, near = tree.query(PLANE.centers[rows], k=12)
        points = np.repeat(PLANE.centers[rows], 12, axis=0)
        assert distances_to_walls(points, PLANE.walls[near.ravel()]).min() > 3.0


def test_the_motor_of_phi_turns_with_theta():
    theta_only, both = PLANE.coupling[0] @ [1.0, 0.0], PLANE.coupling[0] @ [1.0, 1.0]
    assert theta_only.tolist() == [1.0, -1.5] and both.tolist() == [1.0, 0.0]


def test_the_first_robots_are_whole_rafts_with_their_walls():
    part = preset("spec_s5", 64)
    np.testing.assert_array_equal(part.centers, PLANE.centers[:64])
    assert len(part.walls) == 2 * WALLS
    with pytest.raises(LayoutError, match="has 12852 sites"):
        preset("spec_s5", 12_853)

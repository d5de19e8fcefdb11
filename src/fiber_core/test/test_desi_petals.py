# SPDX-License-Identifier: Apache-2.0
"""The plane of ten petals: walls, scatter, and robots that differ."""

import numpy as np
import pytest

from fiber_core import PRESETS, LayoutError, preset
from fiber_core.presets.desi import keepouts
from fiber_core.presets.desi_petals import petal_angle, petal_walls
from fiber_core.walls import distances_to_walls

PLANE = preset("desi_petals")
PETAL = np.arange(5020) // 502


def from_walls(points, walls):
    count = len(walls)
    far = distances_to_walls(np.repeat(points, count, axis=0), np.tile(walls, (len(points), 1, 1)))
    return far.reshape(len(points), count)


def test_every_robot_stands_inside_the_edges_of_its_petal():
    angle = -petal_angle(PETAL)
    x, y = PLANE.centers.T
    own = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)])
    walls = petal_walls(np.zeros(1) + 3.0)  # in the frame of a petal
    edge = walls[:8, 0]
    inside = distances_to_walls(own.T, np.broadcast_to(edge, (5020, 8, 2))) == 0.0
    assert inside.all()
    nearest = from_walls(own.T, walls).min(axis=1)
    assert 4.7 < nearest.min() < 5.3  # a row of sites along each side, moved by shift and scatter
    assert np.array_equal(np.bincount(PETAL), np.full(10, 502)) and np.array_equal(PLANE.bus, PETAL)


def test_walls_are_the_edges_and_cameras_of_ten_petals():
    assert len(PLANE.walls) % 10 == 0
    one = petal_walls(np.array([3.0]))
    assert np.array_equal(PLANE.walls[3 * len(one) : 4 * len(one)], one)
    lines = np.unique(one[:8].reshape(8, -1, 2), axis=1)
    assert len(np.unique(one[:8].reshape(-1, 2), axis=0)) == 8 and lines.shape[1] >= 2
    assert len(preset("desi_petals", 502).walls) == len(one)
    assert len(preset("desi_petals", 503).walls) == 2 * len(one)


def test_the_scatter_has_the_statistics_that_the_note_names():
    in_use = PLANE.enabled.mean()
    assert abs(in_use - (1 - 0.075)) < 3 * np.sqrt(0.075 / 5020)
    base, _ = keepouts(np.array([[3.0, 3.0]]))
    wider = (PLANE.theta_vertices[:, : base.shape[1]] != base).any(axis=(1, 2))
    assert abs(wider.sum() - 295) < 60 and PLANE.enabled[wider].all()
    assert abs(np.median(PLANE.arms, axis=0) - [3.0, 3.065]).max() < 0.005
    low, high = np.rad2deg(np.moveaxis(PLANE.limits, -1, 0))
    assert abs((high - low).mean(axis=0) - [392.2, 190.5]).max() < 1.0
    assert np.ptp((high + low)[:, 0] / 2) > 355  # the zeros of theta point everywhere


def test_the_plane_is_the_same_each_time_and_a_part_is_a_part():
    for name in ("centers", "arms", "limits", "phi_vertices", "theta_vertices", "enabled", "bus"):
        assert np.array_equal(getattr(preset("desi_petals", 700), name), getattr(PLANE, name)[:700])


@pytest.mark.parametrize("robots", [0, -3, 2.5, 5021])
def test_a_number_that_it_has_not_is_refused(robots):
    with pytest.raises(LayoutError, match=str(robots)):
        preset("desi_petals", robots)


def test_keepouts_grow_with_arms_and_expansions():
    arms = np.array([[3.0, 3.0], [3.1, 3.2], [2.9, 2.8], [3.0, 3.0]])
    theta, phi = keepouts(arms, theta_deg=[0, 0, 0, 5.5], phi_deg=[0, 0, 0, 5.5])
    front = phi[:, :, 0].max(axis=1)
    assert np.allclose(front - front[0], [0.0, 0.3, -0.1, 0.0])  # a shorter phi arm counts for none
    assert np.allclose(phi[:3, 3], [-1.172, 1.037])  # the back does not move
    assert np.array_equal(theta[0], theta[2])
    width = [np.abs(outline[:, 1]).max() for outline in (phi[0], phi[3])]
    assert width[1] - width[0] == pytest.approx(0.306, abs=0.001)
    reach = np.hypot(*phi[0].T)
    radial, wider = keepouts(arms, theta_mm=0.5, phi_mm=0.5)
    assert np.allclose(np.hypot(*wider[0].T), reach + 0.5)
    assert np.hypot(*radial[0].T).max() == pytest.approx(np.hypot(*theta[0].T).max() + 0.5)


def test_the_note_says_what_is_published_and_what_is_inferred():
    for word in ("Published", "Inferred", "statistics"):
        assert word in PRESETS["desi_petals"].note

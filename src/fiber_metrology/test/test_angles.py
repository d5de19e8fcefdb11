# SPDX-License-Identifier: Apache-2.0
"""Measured angles: elbow and turn are kept, and the interval holds the true angles."""

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.presets import preset
from fiber_metrology import angles_of_places
from fiber_metrology.angles import likeliest_angles


@pytest.mark.parametrize("name", ["desi", "sdss_v", "moons", "pfs"])
def test_a_place_without_error_gives_the_angles_that_made_it(name):
    plane = preset(name, 200)
    rng = np.random.default_rng(3)
    low, high = np.moveaxis(plane.limits, -1, 0)
    true = rng.uniform(low, high)
    true[:, 1] = np.where(np.abs(np.sin(true[:, 1])) < 0.1, 1.0, true[:, 1])
    places = kinematics.forward(plane, true)[1]
    near = true + rng.uniform(-0.02, 0.02, true.shape)  # a counter that is off, elbow and turn kept
    found, wide, outside = angles_of_places(plane, places, near, 0.0)
    np.testing.assert_allclose(found, true, atol=1e-9)
    assert wide.max() < 1e-9 and outside.max() < 1e-9


@pytest.mark.parametrize("name", ["desi", "sdss_v", "moons"])
def test_the_interval_holds_the_true_angles_stretched_and_folded_ones_too(name):
    plane, error_mm = preset(name, 1000), 0.02
    rng = np.random.default_rng(4)
    low, high = np.moveaxis(plane.limits, -1, 0)
    true = rng.uniform(low, high)
    true[:300, 1] = rng.choice([0.0, 1e-3, 0.02, 0.1, np.pi - 1e-3, np.pi - 0.05], 300)
    true[:, 1] = np.clip(true[:, 1], low[:, 1], high[:, 1])
    turn = rng.uniform(0, 2 * np.pi, plane.n)
    off = error_mm * rng.random(plane.n) * np.stack([np.cos(turn), np.sin(turn)])
    places = kinematics.forward(plane, true)[1] + off.T
    found, wide, _ = angles_of_places(plane, places, true, error_mm)
    assert (np.abs(found - true) <= wide + 1e-9).all()
    usual = np.abs(np.sin(true[:, 1])) > 0.5
    assert np.median(wide[usual]) < 4 * error_mm / plane.arms.min()


def test_no_place_gives_no_angles_and_one_outside_goes_to_the_rim():
    plane = preset("desi", 2)
    places = np.array([[np.nan, np.nan], plane.centers[1] + [6.3, 0.0]])
    found, wide, outside = angles_of_places(plane, places, [[0.0, 1.0], [0.1, 0.2]], 0.02)
    assert np.isnan(found[0]).all() and np.isnan(outside[0])
    np.testing.assert_allclose(found[1], [0.0, 0.0], atol=1e-6)
    assert outside[1] == pytest.approx(0.3) and wide[1, 1] > 0.4


def test_an_arm_beyond_its_stop_points_to_its_place_from_the_stop():
    plane, rng = preset("desi", 400), np.random.default_rng(5)
    low, high = plane.limits[:, 1].T
    # counters at the stops, arms a little beyond and within them
    beyond = rng.uniform(0.0, 0.05, plane.n)
    stretched = np.arange(plane.n) < 200
    phi = np.where(stretched, low - beyond, high + beyond)
    true = np.stack([rng.uniform(-3.0, 3.0, plane.n), phi], axis=1)
    places = kinematics.forward(plane, true)[1]
    near = np.stack([true[:, 0], np.where(stretched, low, high)], axis=1)
    found, wide, _ = angles_of_places(plane, places, near, 0.01)
    assert (found[:, 1] >= low).all() and (found[:, 1] <= high).all()
    off = kinematics.forward(plane, found)[1] - places
    # what the stop alone leaves: the reach of the arm differs
    reach = np.hypot(*(places - plane.centers).T)
    at_stop = np.hypot(*(kinematics.forward(plane, near)[1] - plane.centers).T)
    assert (np.hypot(*off.T) <= np.abs(reach - at_stop) + 1e-6).all()
    assert (np.abs(found - true) <= wide + 1e-9).all()


def test_angles_by_place_and_drive_together_put_the_fibre_on_its_place_where_the_arm_is_straight():
    plane, rng = preset("desi", 1000), np.random.default_rng(5)
    true = rng.uniform(*np.moveaxis(plane.limits, -1, 0))
    true[:, 1] = np.clip(rng.choice([0.05, 0.2, np.pi - 0.05], plane.n), *plane.limits[:, 1].T)
    sigma_mm, sigma_rad = np.full(plane.n, 2.5e-3), np.full((plane.n, 2), 0.012)
    expected = np.clip(
        true + 0.012 * rng.normal(size=true.shape), *np.moveaxis(plane.limits, -1, 0)
    )
    places = kinematics.forward(plane, true)[1] + 2.5e-3 * rng.normal(size=true.shape)
    rows = np.arange(plane.n)
    found = likeliest_angles(plane, rows, places, sigma_mm, expected, sigma_rad)
    assert ((found >= plane.limits[..., 0]) & (found <= plane.limits[..., 1])).all()

    def cost(angles):
        off = (kinematics.forward(plane, angles)[1] - places) / sigma_mm[:, None]
        return ((off**2) + ((angles - expected) / sigma_rad) ** 2).sum(axis=1)

    least = cost(found)
    for step in (
        [1e-4, 0.0],
        [-1e-4, 0.0],
        [0.0, 1e-4],
        [0.0, -1e-4],
        [1e-4, -1e-4],
        [-1e-4, 1e-4],
    ):
        near = np.clip(found + step, plane.limits[..., 0], plane.limits[..., 1])
        assert (least <= cost(near) + 1e-6).all(), step
    # better than each of both alone
    alone, _, _ = angles_of_places(plane, places, expected, 4 * sigma_mm)
    error = [np.sqrt(np.mean((a - true) ** 2)) for a in (found, alone, expected)]
    assert error[0] < min(error[1:])
    off_um = 1e3 * np.hypot(*(kinematics.forward(plane, found)[1] - places).T)
    assert np.sqrt(np.mean(off_um**2)) < 4.0


def test_only_the_robots_that_are_named_get_angles_by_both():
    plane = preset("desi", 7)
    true = np.tile([0.3, 0.1], (7, 1))
    rows = np.array([2, 5])
    places = kinematics.forward(plane, true)[1][rows]
    found = likeliest_angles(
        plane, rows, places, np.full(2, 1e-3), true[rows] + 1e-3, np.full((2, 2), 1e-2)
    )
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found, true[rows], atol=2e-3)

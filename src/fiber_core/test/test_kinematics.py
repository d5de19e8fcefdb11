# SPDX-License-Identifier: Apache-2.0
"""Laws of forward and inverse kinematics, and their singular points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core import PRESETS, forward, inverse, jacobian, plane_from, preset

TURN = 2 * np.pi
RADIANS = st.floats(-10.0, 10.0)


def one_robot(arms=(3.0, 3.0), theta_deg=(-194.0, 194.0), phi_deg=(0.0, 180.0), center=(0.0, 0.0)):
    limits = np.deg2rad([[theta_deg, phi_deg]])
    return plane_from(PRESETS["desi"], [0], [center], np.array([arms]), limits=limits)


def solutions_of(plane, tip):
    angles, valid = inverse(plane, np.reshape(tip, (1, 2)))
    return angles[0][valid[0]]


def random_robots(rng, n):
    # arms, ranges and places of all kinds, several turns included
    low = rng.uniform(-7, 3, (n, 2))
    limits = np.stack([low, low + rng.uniform(0.5, 14, (n, 2))], axis=2)
    centers = rng.uniform(-400, 400, (n, 2))
    plane = plane_from(
        PRESETS["desi"], np.arange(n), centers, rng.uniform(1, 15, (n, 2)), limits=limits
    )
    return plane, limits[..., 0] + rng.random((n, 2)) * (limits[..., 1] - limits[..., 0])


def test_inverse_finds_the_configuration_of_a_tip():
    plane, angles = random_robots(np.random.default_rng(1), 3000)
    found, valid = inverse(plane, forward(plane, angles)[1])
    error = np.where(valid, np.abs(found - angles[:, None]).max(axis=2), np.inf).min(axis=1)
    condition = np.abs(np.sin(angles[:, 1]))  # near singular phi the angles lose digits
    assert np.all(error * condition < 1e-10)
    assert np.all(error < 1e-5)


def test_every_solution_reaches_the_tip_and_keeps_the_limits():
    plane, angles = random_robots(np.random.default_rng(2), 3000)
    tips = forward(plane, angles)[1]
    found, valid = inverse(plane, tips)
    assert np.array_equal(np.isfinite(found).all(axis=2), valid)
    assert np.all((found >= plane.limits[:, None, :, 0]) | ~valid[..., None])
    assert np.all((found <= plane.limits[:, None, :, 1]) | ~valid[..., None])
    on_stop = (found == plane.limits[:, None, :, 0]) | (found == plane.limits[:, None, :, 1])
    for k in range(found.shape[1]):
        inside = valid[:, k] & ~on_stop[:, k].any(axis=1)
        reached = forward(plane, found[:, k])[1]
        assert np.all(np.abs(reached - tips)[inside] < 1e-9)


def test_the_number_of_solutions_is_that_of_all_elbows_and_turns():
    plane, angles = random_robots(np.random.default_rng(3), 3000)
    tips = forward(plane, angles)[1]
    # an independent count: both elbows from the law of cosines, turns by division
    offset = tips - plane.centers
    arm1, arm2 = plane.arms.T
    bend = np.arccos(((offset**2).sum(axis=1) - arm1**2 - arm2**2) / (2 * arm1 * arm2))
    expected = np.zeros(plane.n, dtype=int)
    for phi in (bend, -bend):
        elbow = arm1 + arm2 * np.exp(1j * phi)
        theta = np.angle((offset[:, 0] + 1j * offset[:, 1]) / elbow)
        turns = [
            np.floor((plane.limits[:, j, 1] - value) / TURN)
            - np.ceil((plane.limits[:, j, 0] - value) / TURN)
            + 1
            for j, value in enumerate((theta, phi))
        ]
        expected += (turns[0] * turns[1]).astype(int)
    assert np.array_equal(inverse(plane, tips)[1].sum(axis=1), expected)
    assert expected.max() > 8


@given(theta=RADIANS, phi=RADIANS)
def test_jacobian_is_the_derivative_of_forward(theta, phi):
    plane, step = one_robot((2.9, 3.1)), 1e-6
    angles = np.array([[theta, phi]])
    for joint in range(2):
        nudge = step * np.eye(2)[joint]
        slope = (forward(plane, angles + nudge)[1] - forward(plane, angles - nudge)[1]) / (2 * step)
        assert np.allclose(jacobian(plane, angles)[0, :, joint], slope[0], atol=1e-8)


def test_forward_is_equation_1():
    plane = one_robot((3.0, 2.0), center=(10.0, 20.0))
    elbow, tip = forward(plane, [[np.pi / 2, np.pi / 2]])
    assert np.allclose(elbow, [[10.0, 23.0]]) and np.allclose(tip, [[8.0, 23.0]])
    many = np.random.default_rng(0).normal(size=(5, 1, 2))
    assert np.array_equal(forward(plane, many)[1][3], forward(plane, many[3])[1])


@pytest.mark.parametrize("phi, radius", [(0.0, 5.0), (np.pi, 1.0)])
def test_both_elbows_are_the_same_on_the_rims(phi, radius):
    plane = one_robot((3.0, 2.0), theta_deg=(-170, 170), phi_deg=(-190, 190))
    found = solutions_of(plane, [radius, 0.0])
    assert np.allclose(np.unique(np.abs(found[:, 1])), phi)
    assert len(found) == (1 if phi == 0 else 2)  # folded at +180 and at -180 deg
    for angles in found:
        assert np.allclose(forward(plane, angles[None])[1], [[radius, 0.0]])


@pytest.mark.parametrize("arms, rim", [((3.0, 2.0), 5.0), ((3.0, 2.0), 1.0), ((2.0, 3.5), 1.5)])
def test_a_rim_is_as_wide_as_rounding(arms, rim):
    plane = one_robot(arms, phi_deg=(-180, 180))
    outwards = 1 if rim == sum(arms) else -1
    assert len(solutions_of(plane, [0, rim + outwards * 0.5e-9])) > 0
    assert len(solutions_of(plane, [0, rim + outwards * 2e-9])) == 0
    assert len(solutions_of(plane, [0, rim - outwards * 1e-3])) > 0


@pytest.mark.parametrize("theta_deg", [(-194, 194), (-10, 10), (200, 230)])
def test_at_the_centre_of_equal_arms_theta_is_free(theta_deg):
    plane = one_robot(theta_deg=theta_deg)
    found = solutions_of(plane, [0.0, 0.0])
    assert len(found) == 1 and found[0, 1] == np.pi
    assert np.allclose(forward(plane, found)[1], 0.0, atol=1e-12)


@pytest.mark.parametrize("center", [(0.0, 0.0), (-409.5, 407.4)])
@pytest.mark.parametrize("phi_low", [-23.0, -1e-4, 0.0, 1e-5, 1e-3, 0.05, 1.086, 49.5])
@pytest.mark.parametrize("span", [90.0, 180.0, 189.4])
def test_a_robot_on_its_stops_is_a_solution_of_its_own_tip(center, phi_low, span):
    plane = one_robot((3.0398, 3.075), (-46.5, 343.8), (phi_low, phi_low + span), center)
    for theta in plane.limits[0, 0]:
        for phi in plane.limits[0, 1]:
            angles = np.array([[theta, phi]])
            found = solutions_of(plane, forward(plane, angles)[1])
            assert np.abs(found - angles).max(axis=1).min() < 1e-6


def test_a_closed_full_turn_has_both_ends():
    plane = one_robot(theta_deg=(-180, 180), phi_deg=(90, 90))
    found = solutions_of(plane, forward(plane, [[np.pi, np.pi / 2]])[1])
    assert np.allclose(np.sort(found[:, 0]), [-np.pi, np.pi])


@pytest.mark.parametrize("tip", [(np.nan, np.nan), (np.nan, 1.0), (np.inf, 0.0), (7.0, 0.0)])
def test_a_tip_without_solution_is_not_an_error(tip):
    angles, valid = inverse(one_robot(), np.array([tip]))
    assert not valid.any() and np.isnan(angles).all() and valid.shape[1] >= 1


def test_joint_limits_choose_the_elbow():
    tip = forward(one_robot(), [[0.3, 1.0]])[1]
    assert np.allclose(solutions_of(one_robot(), tip), [[0.3, 1.0]])
    assert np.allclose(solutions_of(one_robot(phi_deg=(-180, 0)), tip), [[1.3, -1.0]])
    assert len(solutions_of(one_robot(phi_deg=(-180, 180)), tip)) == 2
    assert len(solutions_of(one_robot(phi_deg=(60, 180)), tip)) == 0


def test_a_plane_without_solutions_keeps_the_shape():
    plane = preset("desi", 3)
    angles, valid = inverse(plane, np.full((3, 2), np.nan))
    assert angles.shape == (3, 1, 2) and valid.shape == (3, 1)

# SPDX-License-Identifier: Apache-2.0
"""Fibres beside the axis of the arm, and several on one arm."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.assignment import assign
from fiber_core.errors import LayoutError
from fiber_core.fibres import ANY_FIBRE
from fiber_core.fields import random_field
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import load_problem, save_problem

NAMES = ("metrology", "first", "second")
PLACES = np.array([[14.25, 0.0], [14.91, -0.36], [14.90, 0.38]])
SAME_RAD = 1e-6


@pytest.fixture
def rng():
    return np.random.default_rng(15)


def plane_with_fibres(robots=37, places=PLACES, names=NAMES):
    plane = preset("sdss_v", robots)
    return replace(
        plane, fibres=np.broadcast_to(places, (robots, *places.shape)), fibre_names=names
    )


def angles_inside(plane, rng):
    low, high = np.moveaxis(plane.limits, -1, 0)
    return low + (high - low) * rng.uniform(0.01, 0.99, (plane.n, 2))


def test_a_fibre_on_the_axis_at_the_tip_is_the_plane_without_fibres(rng):
    plain = preset("moons", 61)
    at_tip = np.stack([plain.arms[:, 1], np.zeros(61)], axis=1)[:, None]
    fibred = replace(plain, fibres=at_tip)
    points = plain.centers + rng.uniform(-25, 25, (61, 2))
    for one, other in zip(kinematics.inverse(plain, points), kinematics.inverse(fibred, points)):
        np.testing.assert_array_equal(one, other)
    angles = angles_inside(plain, rng)
    tips = kinematics.forward(plain, angles)[1]
    np.testing.assert_array_equal(kinematics.fibre_places(plain, angles)[:, 0], tips)
    np.testing.assert_allclose(kinematics.fibre_places(fibred, angles)[:, 0], tips, atol=1e-12)


def test_a_fibre_turns_about_its_elbow(rng):
    plane = plane_with_fibres()
    angles = angles_inside(plane, rng)
    elbow, tip = kinematics.forward(plane, angles)
    arm = (tip - elbow) / plane.arms[:, 1:]
    x, y = PLACES[2]
    expected = elbow + x * arm + y * arm @ [[0.0, 1.0], [-1.0, 0.0]]
    np.testing.assert_allclose(kinematics.fibre_places(plane, angles)[:, 2], expected, atol=1e-12)


@pytest.mark.parametrize("fibre", range(3))
def test_every_solution_puts_the_named_fibre_on_the_point(fibre, rng):
    plane = plane_with_fibres().with_fibre(np.full(37, fibre))
    angles = angles_inside(plane, rng)
    points = kinematics.fibre_places(plane, angles)[:, fibre]
    found, valid = kinematics.inverse(plane, points)
    near = np.abs(found - angles[:, None]).max(axis=2) < SAME_RAD
    assert (near & valid).any(axis=1).all()
    low, high = np.moveaxis(plane.limits[:, None], -1, 0)
    assert ((found >= low) & (found <= high)).all(axis=2)[valid].all()
    for column in range(found.shape[1]):
        rows = valid[:, column]
        error = kinematics.on_target(plane, found[:, column], points).error_mm[rows]
        assert (error < 1e-6).all()


def test_a_target_for_any_fibre_has_the_solutions_of_all_fibres(rng):
    plane = plane_with_fibres()
    points = kinematics.forward(plane, angles_inside(plane, rng))[1]
    found = kinematics.solutions(plane, points)
    each = [kinematics.inverse(plane.with_fibre(np.full(37, k)), points) for k in range(3)]
    for row in range(37):
        apart = [angles[row][valid[row]] for angles, valid in each]
        np.testing.assert_array_equal(found.angles[row][found.valid[row]], np.concatenate(apart))
        numbers = np.repeat(range(3), [len(a) for a in apart])
        np.testing.assert_array_equal(found.fibre[row][found.valid[row]], numbers)


def test_the_fibre_nearest_to_the_target_counts_where_none_is_named(rng):
    plane = plane_with_fibres()
    angles = angles_inside(plane, rng)
    chosen = rng.integers(3, size=37)
    points = kinematics.fibre_places(plane, angles)[np.arange(37), chosen]
    found = kinematics.on_target(plane, angles, points)
    np.testing.assert_array_equal(found.fibre, chosen)
    assert (found.error_mm < 1e-9).all()
    named = kinematics.on_target(plane.with_fibre(np.zeros(37)), angles, points)
    assert (named.error_mm[chosen != 0] > 0.5).all()


def test_random_targets_are_for_named_fibres_and_can_be_reached(rng):
    field = random_field(plane_with_fibres(), rng)
    plane = field.problem.plane
    assert set(plane.fibre) == {0, 1, 2}
    found = kinematics.on_target(plane, field.goal, field.problem.targets)
    np.testing.assert_array_equal(found.fibre, plane.fibre)
    assert (found.error_mm < 1e-9).all()


def test_reach_is_that_of_the_fibre(rng):
    plane = plane_with_fibres(1)
    far = [[7.4 + np.hypot(14.91, 0.36) - 1e-6, 0.0]]
    start = angles_inside(plane, rng)
    reasons = {
        fibre: assign(plane.with_fibre([fibre]), start, [0], far).reason[0]
        for fibre in (ANY_FIBRE, 0, 1)
    }
    assert reasons == {ANY_FIBRE: Reason.OK, 0: Reason.UNREACHABLE, 1: Reason.OK}
    text = assign(plane.with_fibre([0]), start, [0], far).explain(0)
    assert "reach 6.85..21.65 mm" in text


def test_a_target_that_one_fibre_reaches_past_an_obstacle_is_accepted():
    plane = plane_with_fibres(1, np.array([[15.0, 0.0], [5.0, 0.0]]), ("long", "short"))
    start, target = [[3.0, np.pi]], [[11.0, 0.0]]
    blocked = replace(plane, obstacles=[[-0.44, y, 0.5] for y in (-6.1, 6.1)])
    reason = [assign(blocked.with_fibre([k]), start, [0], target).reason[0] for k in (0, 1, -1)]
    assert reason == [Reason.TARGET_ON_OBSTACLE, Reason.OK, Reason.OK]


def test_fibres_stay_in_a_problem_file(tmp_path, rng):
    problem = random_field(plane_with_fibres(), rng).problem
    save_problem(tmp_path / "problem.npz", problem)
    again = load_problem(tmp_path / "problem.npz").plane
    np.testing.assert_array_equal(again.fibres, problem.plane.fibres)
    np.testing.assert_array_equal(again.fibre, problem.plane.fibre)
    assert again.fibre_names == NAMES


def test_a_part_of_a_plane_keeps_its_fibres(rng):
    plane = plane_with_fibres().with_fibre(rng.integers(-1, 3, 37))
    order = rng.permutation(37)[:20]
    part = plane.permuted(order)
    np.testing.assert_array_equal(part.fibre, plane.fibre[order])
    assert part.fibre_names == NAMES


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"fibres": np.zeros((3, 1, 2))}, "robot 0: fibre 0 must be"),
        ({"fibres": np.full((3, 1, 2), np.nan)}, "robot 0: fibre 0 must be"),
        ({"fibres": np.ones((3, 17, 2))}, "17 fibres, expected at most 16"),
        ({"fibres": np.ones((3, 2, 2)), "fibre_names": ("a",)}, "2 different names"),
        ({"fibres": np.ones((3, 2, 2)), "fibre_names": ("a", "a")}, "2 different names"),
        ({"fibres": np.ones((3, 2, 2)), "fibre_names": ("a", "b\nc")}, "2 different names"),
        ({"fibres": np.ones((3, 2, 2)), "fibre": [0, 1, 2]}, "robot 2: fibre must be 0 to 1"),
        ({"fibre": [0, 1, 0]}, "robot 1: fibre must be 0 to 0"),
    ],
)
def test_impossible_fibres_are_refused(values, text):
    with pytest.raises(LayoutError, match=text):
        replace(preset("desi", 3), **values)

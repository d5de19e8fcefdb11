# SPDX-License-Identifier: Apache-2.0
"""The focal plane of a made-up instrument is built from a few figures."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fiber_core import PRESETS, LayoutError, hexagonal, preset, random_field


def test_a_hexagonal_plane_has_the_figures_given():
    plane = hexagonal(
        19,
        pitch_mm=12.0,
        arms_mm=(3.5, 3.0),
        radius_mm=0.8,
        limits_deg=((-185.0, 185.0), (0.0, 175.0)),
        speeds_deg_s=(90.0, 60.0),
        spacing_mm=2.5,
        obstacles=[[200.0, 0.0, 2.0]],
        name="mine",
    )
    assert plane.n == 19 and plane.name == "mine" and plane.enabled.all()
    assert np.array_equal(plane.ids, np.arange(19))
    nearest = cKDTree(plane.centers).query(plane.centers, k=2)[0][:, 1]
    assert np.allclose(nearest, 12.0)
    assert np.all(plane.arms == [3.5, 3.0]) and np.all(plane.phi_radius == 0.8)
    assert np.allclose(np.rad2deg(plane.limits), [[-185.0, 185.0], [0.0, 175.0]])
    assert np.allclose(np.rad2deg(plane.speeds), [90.0, 60.0])
    assert plane.spacing_mm == 2.5 and plane.obstacles.tolist() == [[200.0, 0.0, 2.0]]
    assert np.all(plane.phi_vertices == [[0.0, 0.0], [3.0, 0.0]])
    assert plane.theta_vertices.shape == (19, 0, 2)


def test_the_capsule_of_desi_is_the_default_for_its_arms():
    plane, desi = hexagonal(7, 10.4, (3.0, 3.0)), preset("desi", 7)
    assert np.array_equal(plane.phi_radius, desi.phi_radius)
    assert plane.spacing_mm == desi.spacing_mm


def test_the_figures_of_a_preset_make_the_same_plane():
    figures = PRESETS["sdss_v"]
    plane = hexagonal(
        figures.robots,
        figures.pitch_mm,
        figures.arms_mm,
        radius_mm=figures.radius_mm,
        limits_deg=(figures.theta_deg, figures.phi_deg),
        speeds_deg_s=figures.speeds_deg_s,
    )
    same = preset("sdss_v")
    for name in ("centers", "arms", "limits", "speeds", "phi_vertices", "phi_radius", "bus"):
        assert np.array_equal(getattr(plane, name), getattr(same, name)), name
    assert plane.spacing_mm == same.spacing_mm


@pytest.mark.parametrize("rings", [0, 1, 2, 5])
def test_a_number_that_fills_rings_makes_a_hexagon(rings):
    centers = hexagonal(3 * rings * (rings + 1) + 1, 8.0, (2.0, 2.0)).centers
    turned = centers @ np.array([[0.5, np.sqrt(0.75)], [-np.sqrt(0.75), 0.5]])
    assert cKDTree(centers).query(turned)[0].max() < 1e-9
    assert np.isclose(np.hypot(*centers.T).max(), 8.0 * rings)


def test_a_robot_stands_on_the_same_site_for_every_number():
    large = hexagonal(100, 8.0, (2.0, 2.0)).centers
    for robots in (1, 2, 50):
        assert np.array_equal(hexagonal(robots, 8.0, (2.0, 2.0)).centers, large[:robots])


def test_disabled_robots_are_named_by_id():
    plane = hexagonal(19, 12.0, (3.0, 3.0), disabled=[3, 18])
    assert np.flatnonzero(~plane.enabled).tolist() == [3, 18]
    assert hexagonal(19, 12.0, (3.0, 3.0), disabled=[]).enabled.all()


def test_disabled_robots_are_drawn_with_a_seed():
    def drawn(seed, share=0.1):
        return hexagonal(200, 12.0, (3.0, 3.0), disabled=share, seed=seed).enabled

    assert np.count_nonzero(~drawn(0)) == 20
    assert np.array_equal(drawn(0), drawn(0)) and not np.array_equal(drawn(0), drawn(1))
    assert drawn(0, 0).all() and not drawn(0, 1).any()


def test_a_random_field_can_be_drawn_on_a_hexagonal_plane():
    plane = hexagonal(61, 25.0, (8.0, 7.0), disabled=0.05, obstacles=[[12.5, 7.2, 1.0]])
    field = random_field(plane, np.random.default_rng(0))
    assert np.array_equal(field.problem.asked, plane.enabled)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"robots": 0}, "robots must be a positive integer, got 0"),
        ({"robots": 2.5}, "robots must be a positive integer, got 2.5"),
        ({"robots": "ten"}, "robots must be a positive integer, got ten"),
        ({"robots": float("nan")}, "robots must be a positive integer, got nan"),
        ({"pitch_mm": -3.0}, "pitch_mm must be positive, got -3.0"),
        ({"pitch_mm": float("inf")}, "pitch_mm must be positive, got inf"),
        ({"arms_mm": (3.0, 0.0)}, "arms_mm must be two positive numbers, got 0.0"),
        ({"arms_mm": (3.0,)}, r"arms_mm has shape \(1,\), expected \(2\)"),
        ({"radius_mm": -1.0}, "radius_mm must be 0 or more, got -1.0"),
        ({"spacing_mm": float("nan")}, "spacing_mm must be 0 or more, got nan"),
        ({"speeds_deg_s": (0.0, 1.0)}, "speeds_deg_s must be two positive numbers, got 0.0"),
        ({"limits_deg": ((0, 360), (180, 0))}, "limits_deg of phi .* got 180.0, 0.0"),
        ({"limits_deg": (0, 360)}, "limits_deg has shape"),
        ({"disabled": 1.5}, "disabled must be ids or a share from 0 to 1, got 1.5"),
        ({"disabled": [7]}, "disabled names robot 7, but the ids are 0 to 6"),
        ({"obstacles": [[0.0, 0.0, -1.0]]}, "obstacle 0"),
    ],
)
def test_a_figure_out_of_range_is_refused_with_its_value(changes, words):
    given = {"robots": 7, "pitch_mm": 12.0, "arms_mm": (3.0, 3.0)} | changes
    with pytest.raises(LayoutError, match=words):
        hexagonal(**given)

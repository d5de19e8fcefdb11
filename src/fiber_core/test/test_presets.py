# SPDX-License-Identifier: Apache-2.0
"""The figures of the presets, and the grid on which their robots stand."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, cKDTree

from fiber_core import PRESETS, LayoutError, plane_from, preset
from fiber_core.clearance import neighbour_pairs

# name: robots, pitch, neighbours from reach, theta range, phi range, speeds (as published)
FIGURES = {
    "paper": (5167, 12.0, 6, 2880.0, 2880.0, (180, 120)),
    "desi": (5000, 10.4, 6, 388.0, 180.0, (176, 176)),
    "desi_outlines": (5000, 10.4, 6, 388.0, 180.0, (176, 176)),
    "pfs": (2394, 8.0, 6, 385.0, 180.0, (180, 180)),
    "sdss_v": (547, 22.4, 18, 360.0, 180.0, (12, 12)),
    "moons": (1006, 25.3, 18, 360.0, 330.0, (16.7, 22.5)),
    "lamost": (4000, 25.6, 6, 360.0, 180.0, (180, 180)),
}


def test_every_preset_on_a_grid_is_checked_here():
    assert set(FIGURES) == {name for name in PRESETS if PRESETS[name].build is None}


@pytest.mark.parametrize("name", FIGURES)
def test_a_preset_has_the_figures_of_its_instrument(name):
    robots, pitch, neighbours, theta, phi, speeds = FIGURES[name]
    plane = preset(name)
    assert plane.n == robots and plane.name == name and plane.enabled.all()
    nearest = cKDTree(plane.centers).query(plane.centers, k=2)[0][:, 1]
    assert np.allclose(nearest, pitch)
    span = np.rad2deg(plane.limits[:, :, 1] - plane.limits[:, :, 0])
    assert np.allclose(span, [theta, phi])
    assert np.allclose(np.rad2deg(plane.speeds), speeds)
    count = np.bincount(neighbour_pairs(plane).ravel(), minlength=plane.n)
    middle = np.hypot(*plane.centers.T) < 4 * pitch
    assert np.all(count[middle] == neighbours) and count.max() == neighbours
    assert plane.envelope_mm == (4.0 if pitch <= 12 else 4 * plane.phi_radius[0])


@pytest.mark.parametrize("name", FIGURES)
def test_a_robot_keeps_its_site_for_every_number(name):
    large = preset(name, 700).centers
    for robots in (1, 2, 7, 61, 300):
        assert np.array_equal(preset(name, robots).centers, large[:robots])
    assert np.array_equal(large[0], [0.0, 0.0])


@pytest.mark.parametrize("robots", [1, 2, 10, 333, 5000])
def test_no_site_left_empty_is_nearer_the_centre(robots):
    centers = preset("desi", robots).centers
    rows = np.arange(-100, 101)[:, None]
    columns = np.arange(-100, 101) + 0.5 * (rows % 2)  # every other row is shifted
    radius = 10.4 * np.sort(np.hypot(columns, np.sqrt(0.75) * rows).ravel())
    assert np.allclose(np.sort(np.hypot(*centers.T)), radius[:robots])
    assert len(np.unique(np.round(centers, 6), axis=0)) == robots


@pytest.mark.parametrize("name, rings", [("sdss_v", 13), ("paper", 41)])
def test_whole_rings_make_a_hexagon(name, rings):
    centers = preset(name).centers
    assert len(centers) == 3 * rings * (rings + 1) + 1
    turned = centers @ np.array([[0.5, np.sqrt(0.75)], [-np.sqrt(0.75), 0.5]])
    assert cKDTree(centers).query(turned)[0].max() < 1e-9
    hull = ConvexHull(centers)
    corners = centers[hull.vertices]
    at_corner = np.isclose(np.hypot(*corners.T), rings * FIGURES[name][1])
    assert at_corner.sum() == 6


def test_outlines_of_the_capsule_follow_the_arms():
    arms = np.array([[3.0, 2.5], [3.0, 3.5]])
    for name, first in (("desi", 0.0), ("paper", None)):
        plane = plane_from(PRESETS[name], [0, 1], [[0, 0], [99, 0]], arms)
        assert np.array_equal(plane.phi_vertices[:, -1], [[2.5, 0.0], [3.5, 0.0]])
        assert plane.phi_vertices.shape[1] == (1 if first is None else 2)


def test_real_outlines_are_convex_and_hold_every_point_quoted():
    plane = preset("desi_outlines", 1)
    for vertices, quoted in (
        (plane.phi_vertices[0], PRESETS["desi_outlines"].phi_outline),
        (plane.theta_vertices[0], PRESETS["desi_outlines"].theta_outline),
    ):
        edges = np.roll(vertices, -1, axis=0) - vertices
        normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)  # outwards if counter-clockwise
        beyond = np.einsum("ik,ijk->ij", normals, np.array(quoted)[None] - vertices[:, None])
        assert beyond.max() < 1e-12
    assert np.hypot(*plane.theta_vertices[0].T).max() == pytest.approx(np.hypot(5.094, 0.54))


def test_notes_name_assumed_figures():
    for name, word in {
        "paper": "inferred",
        "pfs": "assumed",
        "sdss_v": "chosen",
        "moons": "chosen",
        "lamost": "assumed",
    }.items():
        assert word in PRESETS[name].note.lower()


@pytest.mark.parametrize("name, robots", [("keck", None), ("desi", 0), ("desi", -3), ("desi", 2.5)])
def test_an_unknown_preset_or_a_bad_number_is_refused(name, robots):
    with pytest.raises(LayoutError, match="keck" if name == "keck" else str(robots)):
        preset(name, robots)

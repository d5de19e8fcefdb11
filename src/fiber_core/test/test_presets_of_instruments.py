# SPDX-License-Identifier: Apache-2.0
"""Presets with fibres, fixed bodies or windows of their own."""

from pathlib import Path

import numpy as np
import pytest

from fiber_core import PRESETS, LayoutError, preset
from fiber_core.walls import distances_to_walls

BUILT = [name for name in PRESETS if PRESETS[name].build is not None]


@pytest.mark.parametrize("name", BUILT)
def test_a_part_of_a_plane_is_its_first_robots(name):
    whole, part = preset(name, 300), preset(name, 61)
    for field in ("centers", "arms", "limits", "phi_vertices", "fibres", "enabled"):
        assert np.array_equal(getattr(part, field), getattr(whole, field)[:61]), field
    assert whole.name == name and preset(name, 61).limits.tobytes() == part.limits.tobytes()


@pytest.mark.parametrize("name", BUILT)
@pytest.mark.parametrize("robots", [0, -1, 1.5])
def test_a_bad_number_is_refused(name, robots):
    with pytest.raises(LayoutError, match=str(robots)):
        preset(name, robots)
    with pytest.raises(LayoutError, match=f"{name} has {PRESETS[name].robots} sites"):
        preset(name, PRESETS[name].robots + 1)


@pytest.mark.parametrize("name", BUILT)
def test_its_note_says_what_is_published_and_what_is_inferred(name):
    note = PRESETS[name].note.lower()
    assert "published" in note and "inferred" in note


def test_the_apo_plane_has_fiducials_cameras_and_three_fibres():
    plane = preset("sdss_v_apo")
    assert plane.n == 500 and len(plane.obstacles) == 42 and len(plane.walls) == 6
    apart = np.hypot(*np.moveaxis(plane.centers[:, None] - plane.obstacles[:, :2], -1, 0))
    assert 21.5 < apart.min() < 23.5  # one pitch
    assert plane.fibre_names == ("APOGEE", "BOSS", "METROLOGY")
    assert np.array_equal(plane.fibres[:, 2, 0], plane.arms[:, 1])
    assert (plane.fibres[:, 0, 1] > 0.2).all() and (plane.fibres[:, 1, 1] < -0.2).all()
    reach = plane.phi_vertices.max(axis=(1, 2)) + plane.phi_radius
    assert (np.hypot(*np.moveaxis(plane.fibres, -1, 0)).max(axis=1) < reach).all()
    assert np.rad2deg(plane.limits[:, 0, 0]).mean() == pytest.approx(-89.7, abs=0.2)
    far = [
        distances_to_walls(plane.centers, np.broadcast_to(wall, (500, *wall.shape))).min()
        for wall in plane.walls
    ]
    assert np.ptp(far) < 1.5 and 20.0 < min(far) < 24.5  # an arm can just touch each camera


def test_windows_of_phi_belong_to_87_cobras():
    plane, plain = preset("pfs_windows"), preset("pfs")
    narrow = plane.limits[:, 1, 0] > plain.limits[:, 1, 0]
    assert narrow.sum() == 87
    for field in ("centers", "arms", "phi_vertices"):
        assert np.array_equal(getattr(plane, field), getattr(plain, field))
    assert np.array_equal(plane.limits[~narrow], plain.limits[~narrow])
    unfolding = np.rad2deg(np.diff(plane.limits[narrow, 1], axis=1))
    assert unfolding.min() >= 60 - 1e-9 and unfolding.max() <= 161 + 1e-9


def test_every_preset_stands_in_the_table_of_the_readme():
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    rows = readme.split("## Presets")[1].split("## Example")[0].splitlines()
    named = [row.split("|")[1:3] for row in rows if row.startswith("| `")]
    assert {name.strip(" `"): int(robots) for name, robots in named} == {
        name: figures.robots for name, figures in PRESETS.items()
    }


def test_rafts_are_triangles_of_63_that_do_not_overlap():
    plane = preset("must", 20 * 63)
    apart = np.hypot(*np.moveaxis(plane.centers[:, None] - plane.centers, -1, 0))
    np.fill_diagonal(apart, np.inf)
    assert apart.min() == pytest.approx(6.2)
    raft = np.arange(plane.n) // 63
    between = apart[raft[:, None] != raft]
    assert 6.2 < between.min() < 9.0
    assert np.array_equal(plane.bus, raft)
    middles = plane.centers.reshape(-1, 63, 2).mean(axis=1)
    assert np.diff(np.hypot(*middles.T)).min() > -1e-6  # from the centre outwards
    assert abs(np.hypot(*preset("must").centers.T).max() - 592.0) < 40.0


def test_three_robots_of_a_raft_have_long_arms():
    plane = preset("wst_mixed", 4 * 63)
    long = plane.arms[:, 0] == 3.6
    assert long.reshape(4, 63).sum(axis=1).tolist() == [3] * 4
    assert np.array_equal(plane.phi_vertices[long, 1, 0], plane.arms[long, 1])
    assert np.array_equal(plane.centers, preset("must", 4 * 63).centers)

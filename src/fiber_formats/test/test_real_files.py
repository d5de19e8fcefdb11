# SPDX-License-Identifier: Apache-2.0
"""The readers on real files of the observatories; skips where their folder is absent."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from fiber_core.clearance import Safety, gaps, neighbour_pairs
from fiber_core.fields import random_field
from fiber_core.kinematics import forward, inverse
from fiber_core.presets import preset
from fiber_formats import FormatError, convert, read_layout, read_starts, read_targets


def test_tips_of_the_desi_state_lie_where_they_were_observed(real_files):
    path = real_files / "desi" / "fp-20260219.ecsv"
    layout = read_layout(path)
    assert layout.plane.n == 5000 and (~layout.plane.enabled).sum() == 648
    starts = read_starts(path, layout.plane)
    rows = Table.read(path, format="ascii.ecsv")
    rows = rows[rows["DEVICE_TYPE"] == "POS"]
    observed = np.ma.filled(np.ma.array([rows["OBS_X"], rows["OBS_Y"]], dtype=float), np.nan).T
    gap_um = 1000 * np.hypot(*(forward(layout.plane, starts.angles)[1] - observed).T)
    assert np.isfinite(gap_um).sum() == 4979 and np.nanmedian(gap_um) < 60
    assert starts.notices[0] == "rows that are no robots and are not used: 98 FIF, 20 GIF"
    assert len(starts.notices) == 2 and starts.notices[1].endswith("20 rows")  # ETC
    calibrated = read_layout(real_files / "desi" / "calib-20260303.csv").plane
    assert np.isfinite(read_starts(path, calibrated).angles).all()


def test_the_desi_calibration_agrees_with_the_state(real_files):
    layout = read_layout(real_files / "desi" / "calib-20260303.csv")
    plane = layout.plane
    assert plane.n == 5020 and plane.enabled.sum() == 4646
    assert "18 rows are older" in layout.notices[0]
    state = read_layout(real_files / "desi" / "fp-20260219.ecsv").plane
    rows = plane.index_of(state.ids)
    assert np.all(rows >= 0)
    gap_mm = np.hypot(*(plane.centers[rows] - state.centers).T)
    assert np.median(gap_mm) < 0.1
    wired = np.unique(np.stack([plane.bus[rows], state.bus]), axis=1)
    assert (
        wired.shape[1] < 210 + 49
    )  # the same 200 buses, but for robots that the state has on none
    turn = np.rad2deg(plane.limits[rows, 0].mean(axis=1) - state.limits[:, 0].mean(axis=1))
    assert np.mean(np.abs((turn + 180) % 360 - 180) < 1e-6) > 0.95  # calibrated in between


def test_the_real_desi_plane_of_2021(real_files):
    path = real_files / "desi_2021-06-25.csv"
    plane = read_layout(path).plane
    assert plane.n == 5020 and (~plane.enabled).sum() == 829
    raw = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert np.array_equal(plane.ids, raw["location"])
    assert np.array_equal(plane.phi_vertices[:, 1, 0], raw["arm_phi_mm"])
    theta, phi = np.moveaxis(np.rad2deg(plane.limits), 1, 0)
    assert np.allclose(theta.mean(axis=1), raw["theta_zero_deg"])
    assert np.allclose(np.diff(theta)[:, 0], raw["theta_range_deg"])
    assert np.allclose(phi[:, 0], raw["phi_zero_deg"])
    assert np.allclose(np.diff(phi)[:, 0], raw["phi_range_deg"])
    together = {}
    for petal, bus, number in zip(raw["petal"], raw["bus"], plane.bus):
        together.setdefault((petal, bus), set()).add(int(number))
    assert sorted(min(numbers) for numbers in together.values()) == list(range(100))
    assert all(len(numbers) == 1 for numbers in together.values())
    outlines = read_layout(path, "desi_outlines").plane
    assert np.array_equal(outlines.phi_vertices[0], preset("desi_outlines", 1).phi_vertices[0])


def test_the_real_sdss_v_plane(real_files):
    folder = real_files / "sdss_v"
    names = ("positionerTable", "wokCoords", "fiducialCoords", "gfaCoords")
    layout = read_layout([folder / f"apo_{name}.csv" for name in names])
    assert layout.plane.n == 500 and len(layout.plane.obstacles) == 60
    assert (neighbour_pairs(layout.plane)[:, 1] >= layout.plane.n).any()
    sites = read_layout(
        real_files / "sdss_v_positioners.csv", obstacles=real_files / "sdss_v_fiducials.csv"
    )
    assert sites.plane.n == 501 and sites.plane.obstacles.shape == (60, 3)
    assert "columns not used: hole, fibres" in sites.notices


def test_the_real_sdss_v_configuration(real_files):
    folder = real_files / "sdss_v"
    plane = read_layout([folder / f"apo_{n}.csv" for n in ("positionerTable", "wokCoords")]).plane
    path = folder / "confSummary-test.par"
    of_fibres = read_targets(path, plane)
    assert len(of_fibres.ids) == 490 and set(of_fibres.fibre.tolist()) == {"BOSS", "APOGEE"}
    on = of_fibres.on(plane)
    xy_mm, known = of_fibres.of(on)
    assert np.count_nonzero(inverse(on, xy_mm)[1].any(axis=1)) >= known.sum() - 5
    plane = replace(plane, fibres=None, fibre_names=None, fibre=None)
    targets = read_targets(path, plane)
    assert len(targets.ids) == 490 and len(targets.without_target) == 10
    by_hand = read_targets(real_files / "cases" / "conf_met_ok.csv")
    assert np.array_equal(np.sort(targets.ids), np.sort(by_hand.ids))
    order = np.argsort(targets.ids), np.argsort(by_hand.ids)
    assert np.allclose(targets.xy_mm[order[0]], by_hand.xy_mm[order[1]])
    with pytest.raises(FormatError, match="48 of 500"):  # robots were replaced in between
        read_starts(path, plane)
    known = plane.permuted(np.flatnonzero(np.isin(plane.ids, targets.ids)))
    kept = plane.ids[np.isin(plane.ids, targets.ids)]
    common = type(plane)(
        **{f: getattr(known, f) for f in known.__dataclass_fields__} | {"ids": kept}
    )
    starts = read_starts(path, common)
    tips = forward(common, starts.angles)[1]
    xy_mm, _ = targets.of(common)
    gap_mm = np.hypot(*(tips - xy_mm).T)
    assert np.median(gap_mm) < 0.4  # table and configuration come from different calibrations


def test_the_real_pfs_module(real_files):
    folder = real_files / "pfs"
    layout = read_layout([folder / "SC01_final.xml", folder / "cobraInterference_20260731.csv"])
    assert layout.plane.n == 57 and layout.plane.enabled.all()
    text = "\n".join(layout.notices)
    assert "77.9 um would fit" in text and "5 robots have an interference limit" in text
    with pytest.raises(FormatError, match="no column cobraId, pfiNominal; it has fiberId"):
        read_targets(folder / "pfsConfig-0x52327a27.fits")  # an old form, with one row


@pytest.mark.parametrize("number, targets", [(1, 1006), (2, 1035), (3, 979)])
def test_the_real_moons_assignments(real_files, number, targets):
    path = real_files / "moons" / f"assignment_{number}.txt"
    plane, found = read_layout(path).plane, read_targets(path)
    assert plane.n == 1051 and len(found.ids) == targets
    assert len(found.without_target) == 1051 - targets
    reach = np.hypot(*(found.xy_mm - plane.centers[found.ids]).T)
    assert 9.0 < reach.min() and reach.max() < 25.0  # arms of 8 and 17 mm


def test_next_generation_planes(real_files):
    sites = read_layout(real_files / "nextgen" / "JUST_fiberpos.csv", "desi")
    assert sites.format_name == "JUST sites" and sites.plane.n == 2184
    assert read_layout(real_files / "nextgen" / "specs5_like.csv", "desi").plane.n == 11277


@pytest.mark.parametrize("suffix", [".ecsv"])  # the made-up files are written as all kinds
def test_a_converted_desi_state_is_the_same_plane(real_files, suffix, tmp_path):
    path = real_files / "desi" / "fp-20260219.ecsv"
    convert(path, tmp_path / f"own{suffix}")
    first, second = read_layout(path), read_layout(tmp_path / f"own{suffix}")
    assert second.preset == "desi_outlines"
    walls = tmp_path / f"own_walls{suffix}"
    whole = read_layout([tmp_path / f"own{suffix}", walls])
    for name in first.plane.__dataclass_fields__:
        if name not in ("name", "walls"):
            assert np.array_equal(getattr(first.plane, name), getattr(second.plane, name)), name
    assert np.array_equal(first.plane.walls, whole.plane.walls) and len(second.plane.walls) == 0


def test_random_fields_on_real_planes(real_files):
    for plane in (
        read_layout(real_files / "desi_2021-06-25.csv").plane,
        read_layout(
            real_files / "sdss_v_positioners.csv", obstacles=real_files / "sdss_v_fiducials.csv"
        ).plane,
    ):
        field = random_field(plane, np.random.default_rng(0))
        assert np.array_equal(field.problem.asked, plane.enabled)
        gap_mm = Safety().margin_mm + 0.1
        pairs = neighbour_pairs(plane, 1.0)
        for angles in (field.problem.start, field.goal):
            assert gaps(plane, pairs, angles).min() >= gap_mm - 1e-12

# SPDX-License-Identifier: Apache-2.0
"""Results written and read back, and tables converted into our own columns."""

import numpy as np
import pytest
from astropy.table import Table

from fiber_core.errors import FiberError
from fiber_core.kinematics import forward
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.presets import preset
from fiber_formats import (
    FormatError,
    check_results,
    convert,
    read_layout,
    read_results,
    read_starts,
    read_targets,
    write_results,
)


@pytest.fixture
def plan():
    plane = preset("desi", 6).with_enabled([True] * 5 + [False])
    rng = np.random.default_rng(4)
    angles = np.stack([rng.uniform(-3, 3, 6), rng.uniform(0.1, 3, 6)], axis=1)
    outcome = PlanOutcome(
        1,
        plane.ids[::-1],
        np.array([Outcome.HELD] * 3 + [Outcome.FAILED] + [Outcome.REACHED] * 2),
        np.array([Reason.DISABLED, Reason.NO_TARGET, Reason.UNSAFE, Reason.OFF_TARGET, 0, 0]),
        np.array([2.5, np.nan, 0.05, 0.2, 1e-4, 0.0]),
    )
    return plane, outcome, angles


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits", ".csv.gz", ".fits.gz"])
@pytest.mark.parametrize("form", [None, "desi", "sdss_v"])
def test_results_come_back_exactly(plan, suffix, form, tmp_path):
    plane, outcome, angles = plan
    path = tmp_path / f"results{suffix}"
    written, read = write_results(path, plane, outcome, angles, form), read_results(path)
    for name in ("ids", "outcome", "reason", "reached_mm", "error_um", "angles_deg"):
        first, second = getattr(written, name), getattr(read, name)
        assert np.array_equal(first, second, equal_nan=first.dtype.kind == "f"), name
    assert np.array_equal(written.reached_mm, forward(plane, angles)[1])
    assert written.reason.tolist() == [0, 0, 65, 40, 1, 13]
    starts = read_starts(path, plane)
    assert np.allclose(starts.angles, angles, rtol=0, atol=1e-15)


def test_results_in_the_form_of_desi(plan, tmp_path):
    write_results(tmp_path / "results.csv", *plan, "desi")
    table = Table.read(tmp_path / "results.csv")
    assert table["LOCATION"].tolist() == [0, 1, 2, 3, 4, 5]
    assert table["FIBERSTATUS"].tolist() == [0, 0, 512 + 1024, 1024, 1, 2 + 512 + 1024]
    assert np.array_equal(table["FIBER_X"], table["reached_x_mm"])


def test_results_in_the_form_of_sdss_v(plan, tmp_path):
    plane, outcome, angles = plan
    write_results(tmp_path / "results.ecsv", plane, outcome, angles, "sdss_v")
    table = Table.read(tmp_path / "results.ecsv", format="ascii.ecsv")
    assert np.allclose(np.deg2rad(table["alpha"]) + plane.limits[:, 0, 0], angles[:, 0])
    assert table["assigned"].tolist() == [1, 1, 1, 1, 0, 1]
    assert table["on_target"].tolist() == [1, 1, 0, 0, 0, 0]
    assert table["valid"].tolist() == [1, 1, 0, 1, 1, 1]
    assert table["decollided"].tolist() == [0, 0, 0, 1, 0, 1]


def test_results_in_the_form_of_pfs(plan, tmp_path):
    plane = plan[0]
    write_results(tmp_path / "results.fits", *plan, "pfs")
    table = Table.read(tmp_path / "results.fits")
    assert np.array_equal(table["pfiCenter"], forward(plane, plan[2])[1])
    assert table["fiberStatus"].tolist() == [1, 1, 7, 7, 1, 6]
    with pytest.raises(FormatError, match="pfiCenter has several numbers a row"):
        write_results(tmp_path / "results.csv", *plan, "pfs")


def test_results_that_cannot_be_written_are_refused(plan, tmp_path):
    plane, outcome, angles = plan
    with pytest.raises(FormatError, match=r"a table is written as \.csv"):
        write_results(tmp_path / "results.xlsx", plane, outcome, angles)
    with pytest.raises(FormatError, match="cannot be written"):
        write_results(tmp_path / "absent" / "results.csv", plane, outcome, angles)
    with pytest.raises(FormatError, match="no form is named 'keck'"):
        write_results(tmp_path / "results.csv", plane, outcome, angles, "keck")
    with pytest.raises(FormatError, match=r"angles have shape \(2, 6\)"):
        write_results(tmp_path / "results.csv", plane, outcome, angles.T)
    with pytest.raises(FiberError, match="robot 6 has no outcome"):
        write_results(tmp_path / "results.csv", preset("desi", 7), outcome, np.zeros((7, 2)))
    assert not list(tmp_path.iterdir())


def test_results_that_cannot_be_written_are_refused_before_the_work(plan, tmp_path):
    with pytest.raises(FormatError, match="pfiCenter has several numbers a row: write ECSV or"):
        check_results(tmp_path / "results.csv", "pfs")
    with pytest.raises(FormatError, match="there is no folder .*absent"):
        check_results(tmp_path / "absent" / "results.csv")
    check_results(tmp_path / "results.par", "sdss_v")
    with pytest.raises(FormatError, match="the plane has none"):
        check_results(tmp_path / "results.par", "sdss_v", plan[0])


def test_a_word_that_is_no_outcome_is_refused(plan, tmp_path):
    write_results(tmp_path / "results.csv", *plan)
    text = (tmp_path / "results.csv").read_text()
    (tmp_path / "results.csv").write_text(text.replace("unsafe", "unsave"))
    with pytest.raises(FormatError, match="column reason is not one of .*: robot 3: unsave"):
        read_results(tmp_path / "results.csv")


def same_plane(first, second):
    for name in first.__dataclass_fields__:
        if name != "name":
            assert np.array_equal(getattr(first, name), getattr(second, name)), name


SDSS = ("positionerTable", "wokCoords", "fiducialCoords", "gfaCoords")


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits", ".fits.gz"])
@pytest.mark.parametrize(
    "names, preset_name",
    [
        (["desi_state.ecsv"], None),
        (["desi_calibration.csv"], "desi"),
        ([f"sdss_{name}.csv" for name in SDSS], None),
        (["pfs_cobras.xml", "pfs_interference.csv"], None),
        (["moons_assignment.txt"], None),
        (["just_sites.csv"], "desi"),
    ],
)
def test_a_converted_layout_is_the_same_plane(made_up, suffix, names, preset_name, tmp_path):
    files = [made_up / name for name in names]
    own = tmp_path / f"own{suffix}"
    lines = convert(files, own, preset_name, what="layout")
    first = read_layout(files, preset_name)
    assert lines[0] == first.summary
    discs, walls = (tmp_path / f"own_{kind}{suffix}" for kind in ("obstacles", "walls"))
    second = read_layout([path for path in (own, walls, discs) if path.exists()])
    assert second.format_name == "own columns" and second.notices == ()
    assert discs.exists() == (len(first.plane.obstacles) > 0)
    assert walls.exists() == (len(first.plane.walls) > 0)
    same_plane(first.plane, second.plane)


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits"])
@pytest.mark.parametrize("name", ["sdss_confSummary.par", "moons_assignment.txt"])
def test_converted_targets_are_the_same(made_up, suffix, name, tmp_path):
    convert(made_up / name, tmp_path / f"own{suffix}", what="targets")
    first, second = read_targets(made_up / name), read_targets(tmp_path / f"own{suffix}")
    assert np.array_equal(first.ids, second.ids)
    assert np.array_equal(first.xy_mm, second.xy_mm)
    assert np.array_equal(first.without_target, second.without_target)


def test_converted_starts_are_the_same(made_up, tmp_path):
    source = made_up / "desi_state.ecsv"
    plane = read_layout(source).plane
    convert(source, tmp_path / "starts.ecsv", what="starts")
    first, second = read_starts(source, plane), read_starts(tmp_path / "starts.ecsv", plane)
    assert np.array_equal(first.angles, second.angles)


def test_starts_that_count_from_the_stops_are_converted_with_their_layout(made_up, tmp_path):
    source, own = made_up / "sdss_confSummary.par", tmp_path / "starts.csv"
    with pytest.raises(FormatError, match="angles count from the stops of a layout"):
        convert(source, own, what="starts")
    files = [made_up / f"sdss_{name}.csv" for name in SDSS]
    convert(source, own, what="starts", layout=files)
    plane = read_layout(files).plane
    first, second = read_starts(source, plane), read_starts(own, plane)
    assert np.allclose(first.angles, second.angles, rtol=0, atol=1e-15)


def test_convert_says_what_else_there_is(made_up, tmp_path):
    lines = convert(made_up / "desi_state.ecsv", tmp_path / "own.csv")
    assert "layout is written; the format also holds starts" in lines
    with pytest.raises(FormatError, match="which holds no targets"):
        convert(made_up / "desi_state.ecsv", tmp_path / "own.csv", what="targets")
    with pytest.raises(FormatError, match="'all' is not one of"):
        convert(made_up / "desi_state.ecsv", tmp_path / "own.csv", what="all")


def test_convert_does_not_write_over_its_source(made_up, tmp_path):
    own = tmp_path / "own.csv"
    convert(made_up / "desi_state.ecsv", own)
    with pytest.raises(FormatError, match="is read and cannot be written"):
        convert(own, own)


def test_own_tables_are_converted_by_what_they_hold(tmp_path):
    (tmp_path / "targets.csv").write_text("ID;X_MM;Y_MM\n3;1.5;2\n4;;\n")
    lines = convert(tmp_path / "targets.csv", tmp_path / "targets.ecsv")
    assert lines == ("targets.csv: 1 targets, 1 robots without target",)
    (tmp_path / "starts.csv").write_text("id,theta_deg,phi_deg\n3,1.5,2\n")
    convert(tmp_path / "starts.csv", tmp_path / "starts.fits")
    assert Table.read(tmp_path / "starts.fits").colnames == ["id", "theta_deg", "phi_deg"]
    (tmp_path / "sites.csv").write_text("id,x_mm,y_mm\n3,1.5,2\n")
    assert "1 robots" in convert(tmp_path / "sites.csv", tmp_path / "own.csv", "desi")[0]

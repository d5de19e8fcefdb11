# SPDX-License-Identifier: Apache-2.0
"""Every file of the folder of cases, with the right answer; skips where the folder is absent."""

import numpy as np
import pytest

from fiber_core.kinematics import inverse
from fiber_core.presets import preset
from fiber_formats import FormatError, read_layout, read_targets


def hand_read(path):
    """Return the rows of a plain CSV of numbers and words, read with nothing of this package."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    return [line.split(",") for line in lines if line.strip()]


@pytest.mark.parametrize(
    "name, disabled",
    [
        ("s_ids_ok", [24, 27, 36]),
        ("s_ids_bom", [24, 27, 36]),
        ("s_upper", [24, 27, 36]),
        ("s_inverse", "all but 24, 27, 36"),
        ("l_enabled_TF", None),
        ("l_enabled_yes", None),
    ],
)
def test_layouts_that_are_read(real_files, name, disabled):
    path = real_files / "cases" / "layouts" / f"{name}.csv"
    plane = read_layout(path).plane
    head, *rows = hand_read(path)
    flag = {row[0]: row[head.index(head[-1])].lower()[0] in "ty1" for row in rows}
    assert sorted(plane.ids) == sorted(int(key) for key in flag)
    inverse = head[-1] == "nonfunctional"
    expected = sorted(int(key) for key, value in flag.items() if value == inverse)
    assert plane.ids[~plane.enabled].tolist() == expected
    if isinstance(disabled, list):
        assert expected == disabled
    place = {int(row[0]): [float(row[1]), float(row[2])] for row in rows}
    assert plane.centers.tolist() == [place[robot] for robot in plane.ids.tolist()]


@pytest.mark.parametrize(
    "name, words",
    [
        ("l_id_over_u32", "column id is not a number from 0 to 4294967295: .*: 5000000000"),
        ("l_negative_id", "column id is not a number from 0 to 4294967295: line 2: -1"),
        ("l_func_levels", "column functional is neither true nor false: robot 35, 36: 2, 3"),
        ("l_hole_names", "column id is not a number from 0 to 4294967295: .*: R-13C0"),
    ],
)
def test_layouts_that_are_refused(real_files, name, words):
    with pytest.raises(FormatError, match=f"{name}.csv: {words}"):
        read_layout(real_files / "cases" / "layouts" / f"{name}.csv")


@pytest.mark.parametrize(
    "name, targets, without",
    [
        ("t_bom.csv", 61, 0),
        ("t_upper.csv", 61, 0),
        ("t_ok.csv.gz", 61, 0),
        ("t_ok.fits.gz", 61, 0),
        ("fiberassign-000001.fits", 61, 0),
        ("t_nan.csv", 56, 5),
        ("t_empty.csv", 56, 5),
        ("t_masked.ecsv", 58, 3),
        ("t_blankline.csv", 30, 0),
        ("s_targets.csv", 34, 0),
        ("conf_met_ok.csv", 490, 0),
        ("desi_tile0.csv", 4667, 0),
    ],
)
def test_targets_that_are_read(real_files, name, targets, without):
    found = read_targets(real_files / "cases" / name)
    assert len(found.ids) == targets and len(found.without_target) == without
    assert len(np.unique(found.ids)) == targets


def test_the_same_targets_in_five_files_are_the_same(real_files):
    plain = read_targets(real_files / "cases" / "t_bom.csv")
    for name in ("t_upper.csv", "t_ok.csv.gz", "t_ok.fits.gz", "fiberassign-000001.fits"):
        other = read_targets(real_files / "cases" / name)
        assert np.array_equal(other.ids, plain.ids), name
        assert np.allclose(other.xy_mm, plain.xy_mm, atol=1e-4), name


def test_targets_of_the_cases_lie_in_reach_of_their_robots(real_files):
    plane = preset("desi", 61)
    found = read_targets(real_files / "cases" / "t_nan.csv", plane)
    assert found.notices == ()
    xy_mm, known = found.of(plane)
    reachable = inverse(plane, xy_mm)[1].any(axis=1)
    assert known.all() and np.array_equal(np.flatnonzero(reachable), np.sort(found.ids))


@pytest.mark.parametrize(
    "name, words",
    [
        ("t_vector.fits", "column x_mm has 2 values a row, expected one"),
        ("t_ascii.fits", "line 1 holds values and no names of columns"),
        ("sdss_apo_2024r.csv", "it is a layout and no table of targets"),
    ],
)
def test_targets_that_are_refused(real_files, name, words):
    with pytest.raises(FormatError, match=words):
        read_targets(real_files / "cases" / name)


def test_every_case_is_tested(real_files):
    source = __import__("pathlib").Path(__file__).read_text()
    names = [path.name for path in (real_files / "cases").rglob("*") if path.is_file()]
    absent = [n for n in names if n.removesuffix(".csv") not in source and n != "INDEX.md"]
    assert not absent


def test_the_layouts_of_the_cases_are_what_the_readers_give(real_files):
    by_hand = read_layout(real_files / "cases" / "desi_20260219.csv", "desi_outlines").plane
    state = read_layout(real_files / "desi" / "fp-20260219.ecsv").plane
    assert state.n == 5000 and np.array_equal(state.ids, by_hand.ids)
    for name in ("centers", "arms", "enabled", "bus"):
        assert np.array_equal(getattr(state, name), getattr(by_hand, name)), name
    turns = (state.limits[:, 0] - by_hand.limits[:, 0]) / (2 * np.pi)
    assert np.allclose(turns, np.rint(turns), atol=1e-9)  # zeros by hand are within one turn
    assert np.allclose(state.limits[:, 1], by_hand.limits[:, 1])


def test_the_sdss_v_layout_of_the_cases_is_what_the_reader_gives(real_files):
    by_hand = read_layout(real_files / "cases" / "sdss_apo_2024r.csv").plane
    folder = real_files / "sdss_v"
    files = [folder / f"apo_{name}.csv" for name in ("positionerTable", "wokCoords")]
    plane = read_layout(files).plane
    rows = by_hand.index_of(plane.ids)  # by hand, robots of another date were added
    assert np.count_nonzero(rows >= 0) == 461 and by_hand.n == plane.n
    for name in ("arms", "centers", "limits"):
        first, second = getattr(plane, name)[rows >= 0], getattr(by_hand, name)[rows[rows >= 0]]
        assert np.allclose(first, second, rtol=0, atol=1e-9), name

# SPDX-License-Identifier: Apache-2.0
"""Several fibres a robot in our own tables: places in the layout, names in targets."""

import numpy as np
import pytest

from fiber_formats import FormatError, convert, problem_from, read_layout, read_targets

LAYOUT = "id,x_mm,y_mm,fibre_places_mm\n3,0,0,A 3 0 B 3 -0.4\n4,10.4,0,A 3.1 0 B 3 -0.3\n"


def read(tmp_path, layout=LAYOUT, targets="id,x_mm,y_mm,fibre\n4,12,1,B\n3,1,2,\n"):
    (tmp_path / "own.csv").write_text(layout)
    (tmp_path / "targets.csv").write_text(targets)
    plane = read_layout(tmp_path / "own.csv", "desi").plane
    return plane, read_targets(tmp_path / "targets.csv", plane)


def test_places_and_names_come_from_the_tables(tmp_path):
    plane, targets = read(tmp_path)
    assert plane.fibre_names == ("A", "B")
    assert plane.fibres.tolist() == [[[3, 0], [3, -0.4]], [[3.1, 0], [3, -0.3]]]
    assert targets.fibre.tolist() == ["B", ""] and targets.notices == ()
    assert targets.on(plane).fibre.tolist() == [-1, 1]
    files = {"layout": tmp_path / "own.csv", "targets": tmp_path / "targets.csv"}
    assert problem_from(preset="desi", **files).problem.plane.fibre.tolist() == [-1, 1]


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits"])
def test_converted_fibres_are_the_same(tmp_path, suffix):
    plane, targets = read(tmp_path)
    convert(tmp_path / "own.csv", tmp_path / f"again{suffix}", "desi")
    again = read_layout(tmp_path / f"again{suffix}").plane
    assert np.array_equal(again.fibres, plane.fibres) and again.fibre_names == plane.fibre_names
    convert(tmp_path / "targets.csv", tmp_path / f"t{suffix}", what="targets")
    back = read_targets(tmp_path / f"t{suffix}", plane)
    assert back.fibre.tolist() == targets.fibre.tolist()
    assert np.array_equal(back.xy_mm, targets.xy_mm)


@pytest.mark.parametrize(
    "text",
    ["A 3 0 C 3 0", "B 3 -0.4 A 3 0", "A 3 0", "A 3 0 B 3", "A 3 0 B 3 x", "A 1_0 0 B 3 0", ""],
)
def test_bad_fibres_are_refused_by_robot(tmp_path, text):
    with pytest.raises(FormatError, match="column fibre_places_mm .*: robot 4"):
        read(tmp_path, LAYOUT.replace("A 3.1 0 B 3 -0.3", text))


@pytest.mark.parametrize("name", ["NA", "none", "--"])
def test_a_fibre_is_not_named_by_a_word_for_a_missing_value(tmp_path, name):
    # a target for it would be read as one for any fibre
    with pytest.raises(FormatError, match=f"{name} is no name, it stands for a missing value"):
        read(tmp_path, LAYOUT.replace("B 3", f"{name} 3"))


def test_a_fibre_that_the_plane_has_not_is_refused(tmp_path):
    with pytest.raises(FormatError, match="the plane has no fibre C; it has A, B"):
        read(tmp_path, targets="id,x_mm,y_mm,fibre\n4,12,1,C\n")
    with pytest.raises(FormatError, match="no fibre B; it has one fibre at each tip"):
        read(tmp_path, layout="id,x_mm,y_mm\n3,0,0\n4,10.4,0\n")


def test_a_misspelt_column_of_fibres_is_refused(tmp_path):
    with pytest.raises(FormatError, match="column fiber is not known; is fibre meant"):
        read(tmp_path, targets="id,x_mm,y_mm,fiber\n4,12,1,B\n")

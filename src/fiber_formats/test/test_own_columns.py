# SPDX-License-Identifier: Apache-2.0
"""Tables of our own columns: every container, and every kind of damage."""

import gzip

import numpy as np
import pytest
from astropy.table import MaskedColumn, Table

from fiber_core.presets import preset
from fiber_formats import FormatError, read_layout, read_obstacles, read_starts, read_targets


def layout_table(n=9):
    rng = np.random.default_rng(3)
    centers = preset("desi", n).centers
    return Table(
        {
            "id": 10 + 3 * np.arange(n)[::-1],
            "x_mm": centers[:, 0],
            "y_mm": centers[:, 1],
            "arm_theta_mm": rng.normal(3.0, 0.02, n),
            "arm_phi_mm": rng.normal(3.06, 0.02, n),
            "theta_zero_deg": rng.uniform(-180, 500, n),
            "theta_range_deg": rng.uniform(385, 395, n),
            "phi_min_deg": rng.uniform(-5, 5, n),
            "phi_max_deg": rng.uniform(180, 190, n),
            "theta_speed_deg_s": rng.uniform(100, 200, n),
            "enabled": rng.random(n) < 0.7,
            "radius_mm": rng.uniform(0.9, 1.6, n),
            "petal": np.arange(n) // 4,
            "bus": np.array(["can10", "can11"])[np.arange(n) % 2],
        }
    )


def write(table, path):
    kinds = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits"}
    plain = path.with_suffix("") if path.suffix == ".gz" else path
    table.write(plain, format=kinds[plain.suffix], overwrite=True)
    if plain != path:
        path.write_bytes(gzip.compress(plain.read_bytes()))
        plain.unlink()
    return path


SUFFIXES = [".csv", ".ecsv", ".fits", ".csv.gz", ".ecsv.gz", ".fits.gz"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_container_gives_the_same_plane(suffix, tmp_path):
    table = layout_table()
    layout = read_layout(write(table, tmp_path / f"plane{suffix}"))
    plane = layout.plane
    order = np.argsort(table["id"])
    assert plane.name == "plane" and np.array_equal(plane.ids, table["id"][order])
    table = table[order]
    assert np.array_equal(plane.centers, np.stack([table["x_mm"], table["y_mm"]], axis=1))
    assert np.array_equal(plane.enabled, table["enabled"])
    assert np.array_equal(plane.phi_radius, table["radius_mm"])
    assert np.array_equal(plane.phi_vertices[:, 1, 0], table["arm_phi_mm"])
    half = table["theta_range_deg"] / 2
    zero = table["theta_zero_deg"]
    expected = [[zero - half, zero + half], [table["phi_min_deg"], table["phi_max_deg"]]]
    assert np.allclose(np.rad2deg(plane.limits), np.moveaxis(np.array(expected), 2, 0))
    assert np.allclose(np.rad2deg(plane.speeds[:, 0]), table["theta_speed_deg_s"])
    assert np.allclose(np.rad2deg(plane.speeds[:, 1]), 176.0)  # from the preset
    assert len(np.unique(plane.bus)) == 6 - 1  # the last of three petals has one robot
    assert layout.summary.endswith("from preset desi: phi_speed_deg_s")
    assert layout.notices == ()


@pytest.mark.parametrize("suffix", [".ecsv", ".fits"])
def test_a_unit_beside_the_name_is_converted_or_refused(suffix, tmp_path):
    table = layout_table()
    table["x_mm"] = table["x_mm"] / 1000
    table["x_mm"].unit = "m"
    plane = read_layout(write(table, tmp_path / f"metres{suffix}")).plane
    assert np.allclose(np.sort(plane.centers[:, 0]), np.sort(1000 * np.array(table["x_mm"])))
    for unit in ("s", "furlong") if suffix == ".ecsv" else ("s",):
        table["x_mm"].unit = unit
        with pytest.raises(FormatError, match=f"column x_mm in {unit}"):
            read_layout(write(table, tmp_path / f"wrong{suffix}"))


def test_spacing_is_a_column_and_the_same_for_all_robots(tmp_path):
    table = layout_table()
    assert read_layout(write(table, tmp_path / "plane.csv")).plane.spacing_mm == 0.0
    table["spacing_mm"] = 5.5
    assert read_layout(write(table, tmp_path / "apart.csv")).plane.spacing_mm == 5.5
    table["spacing_mm"][1] = 5.0
    with pytest.raises(FormatError, match="spacing_mm is 5.0 to 5.5"):
        read_layout(write(table, tmp_path / "mixed.csv"))


def test_two_columns_are_a_plane_once_a_preset_is_named(tmp_path):
    path = write(layout_table()["x_mm", "y_mm"], tmp_path / "sites.csv")
    usual = preset("pfs", 9)
    layout = read_layout(path, "pfs")
    for name in ("arms", "limits", "speeds", "phi_vertices", "phi_radius", "enabled", "bus"):
        assert np.array_equal(getattr(layout.plane, name), getattr(usual, name)), name
    assert layout.notices == ("no column id: robots have the numbers of their rows, from 0",)
    assert "arms, range of theta, range of phi, speeds, outlines" in layout.summary
    with pytest.raises(FormatError, match="no column arm_theta_mm nor arm_phi_mm: name a preset"):
        read_layout(path)


def test_a_zero_without_a_range_turns_the_limits_of_the_preset(tmp_path):
    table = layout_table()["x_mm", "y_mm", "theta_zero_deg"]
    plane = read_layout(write(table, tmp_path / "zeros.csv"), "sdss_v").plane
    low, high = np.rad2deg(plane.limits[:, 0]).T
    assert np.allclose(low, table["theta_zero_deg"]) and np.allclose(high, low + 360)


def without(name):
    def damage(table):
        table.remove_column(name)

    return damage


def with_value(name, value, row=4):
    def damage(table):
        column = [str(v) for v in table[name]]
        column[row] = value
        table.replace_column(name, column)

    return damage


def renamed(name, other):
    def damage(table):
        table.rename_column(name, other)

    return damage


ROW_4 = "22"  # its id


@pytest.mark.parametrize(
    "damage, words",
    [
        (without("x_mm"), ["no column x_mm; it has id, y_mm, arm_theta_mm"]),
        (with_value("y_mm", "nan"), ["column y_mm is not a number: robot " + ROW_4, "nan"]),
        (with_value("y_mm", "inf"), ["column y_mm is not a number: robot " + ROW_4, "inf"]),
        (with_value("y_mm", "1_000"), ["column y_mm", "robot " + ROW_4, "1_000"]),
        (with_value("y_mm", "1,5"), ["column y_mm", "robot " + ROW_4, "1,5"]),
        (with_value("y_mm", "1+2j"), ["column y_mm", "robot " + ROW_4, "1+2j"]),
        (with_value("y_mm", "\u0661"), ["column y_mm", "robot " + ROW_4]),
        (with_value("y_mm", ""), ["column y_mm", "robot " + ROW_4, "nothing"]),
        (with_value("y_mm", "here"), ["column y_mm", "robot " + ROW_4, "here"]),
        (with_value("arm_phi_mm", "0.0"), ["robot " + ROW_4, "arms"]),
        (with_value("id", "10"), ["more than one row for robot 10"]),
        (with_value("id", "2.5"), ["column id is not a number from 0 to 4294967295: line 6: 2.5"]),
        (with_value("id", "-1"), ["column id", "line 6: -1"]),
        (with_value("id", "4294967296"), ["column id", "4294967296"]),
        (with_value("id", "18446744073709551617"), ["column id", "18446744073709551617"]),
        (with_value("id", "R-13C1"), ["column id", "R-13C1"]),
        (with_value("id", ""), ["column id", "line 6: nothing"]),
        (with_value("enabled", "perhaps"), ["column enabled", "robot " + ROW_4, "perhaps"]),
        (with_value("enabled", ""), ["column enabled", "robot " + ROW_4]),
        (with_value("radius_mm", "-1"), ["robot " + ROW_4, "phi_radius", "-1"]),
        (with_value("theta_range_deg", "-5"), ["robot " + ROW_4, "limits"]),
        (with_value("theta_speed_deg_s", "0"), ["robot " + ROW_4, "speeds"]),
        (with_value("bus", ""), ["column bus is missing: robot " + ROW_4]),
        (without("phi_min_deg"), ["no column phi_min_deg"]),
        (renamed("enabled", "enabeld"), ["column enabeld is not known; is enabled meant?"]),
        (renamed("enabled", "enable"), ["column enable is not known; is enabled meant?"]),
        (renamed("theta_zero_deg", "theta_zero_rad"), ["is theta_zero_deg meant?"]),
        (renamed("radius_mm", "radius_um"), ["column radius_um is not known; is radius_mm meant?"]),
        (renamed("id", "positionerID"), ["no column id; is positionerID meant?"]),
        (renamed("x_mm", "x_m"), ["no column x_mm; it has", "is x_m meant as x_mm?"]),
    ],
)
def test_damage_is_refused_by_file_column_and_robot(damage, words, tmp_path):
    table = layout_table()
    damage(table)
    with pytest.raises(FormatError) as refusal:
        read_layout(write(table, tmp_path / "damaged.csv"))
    message = str(refusal.value)
    assert "damaged.csv" in message and all(word in message for word in words), message


def test_all_that_is_wrong_is_said_at_once(tmp_path):
    table = layout_table()
    for damage in (
        without("x_mm"),
        with_value("y_mm", "here"),
        with_value("enabled", "maybe"),
        renamed("petal", "petall"),
    ):
        damage(table)
    with pytest.raises(FormatError) as refusal:
        read_layout(write(table, tmp_path / "damaged.csv"))
    for words in ("no column x_mm", "here", "maybe", "is petal meant?"):
        assert words in str(refusal.value)


def test_a_missing_value_of_a_fits_table_is_refused(tmp_path):
    table = layout_table()
    table["x_mm"] = MaskedColumn(table["x_mm"], mask=np.arange(9) == 4)
    with pytest.raises(FormatError, match=f"column x_mm is not a number: robot {ROW_4}"):
        read_layout(write(table, tmp_path / "masked.fits"))


@pytest.mark.parametrize(
    "values, words",
    [
        (np.ones((9, 2)), "2 values a row"),
        (np.ones(9, dtype=complex), "complex numbers"),
        (np.ones(9, dtype=bool), "is not a number"),
        (np.array(["a"] * 9), "is not a number"),
    ],
)
def test_a_column_of_the_wrong_kind_is_refused_by_name(values, words, tmp_path):
    table = layout_table()
    table["y_mm"] = values
    with pytest.raises(FormatError, match=f"column y_mm .*{words}"):
        read_layout(write(table, tmp_path / "kinds.fits"))


def test_complex_and_vector_columns_of_ecsv_are_refused(tmp_path):
    for values in (np.ones(9, dtype=complex), np.ones((9, 2))):
        table = layout_table()
        table["y_mm"] = values
        with pytest.raises(FormatError, match="column y_mm"):
            read_layout(write(table, tmp_path / "kinds.ecsv"))


def test_names_may_differ_in_case_blanks_and_a_byte_order_mark(tmp_path):
    table = layout_table()
    plane = read_layout(write(table, tmp_path / "plain.csv")).plane
    text = (tmp_path / "plain.csv").read_text()
    head, rest = text.split("\n", 1)
    (tmp_path / "other.csv").write_text("\ufeff" + head.upper().replace(",", " , ") + "\n" + rest)
    other = read_layout(tmp_path / "other.csv").plane
    assert np.array_equal(other.ids, plane.ids) and np.array_equal(other.enabled, plane.enabled)
    (tmp_path / "utf16.csv").write_bytes(text.encode("utf-16"))
    assert np.array_equal(read_layout(tmp_path / "utf16.csv").plane.ids, plane.ids)


@pytest.mark.parametrize("mark", [";", "\t", " ", ","])
def test_marks_between_values_comments_and_blank_lines(mark, tmp_path):
    table = layout_table()
    plane = read_layout(write(table, tmp_path / "plain.csv")).plane
    lines = (tmp_path / "plain.csv").read_text().splitlines()
    lines = ["# made up", "", *[line.replace(",", mark) for line in lines], "# end", "   ", ""]
    lines.insert(5, "# between")
    (tmp_path / "marks.csv").write_text("\r\n".join(lines))
    other = read_layout(tmp_path / "marks.csv").plane
    assert np.array_equal(other.centers, plane.centers)
    assert np.array_equal(other.bus, plane.bus)


@pytest.mark.parametrize("yes, no", [("T", "F"), ("yes", "No"), ("1", "0"), ("TRUE", "false")])
@pytest.mark.parametrize("name", ["enabled", "functional", "nonfunctional", "disabled", "Disabled"])
def test_flags_and_inverse_flags(yes, no, name, tmp_path):
    table = layout_table()
    table.remove_column("enabled")
    table[name] = [yes] * 4 + [no] * 5
    plane = read_layout(write(table, tmp_path / "flags.csv")).plane
    out_of_use = [4, 5, 6, 7, 8] if name in ("enabled", "functional") else [0, 1, 2, 3]
    assert sorted(plane.ids[~plane.enabled]) == sorted(table["id"][out_of_use])


def test_two_flags_are_both_obeyed(tmp_path):
    table = layout_table()
    table["enabled"] = [True] * 8 + [False]
    table["disabled"] = [True] + [False] * 8
    plane = read_layout(write(table, tmp_path / "flags.csv")).plane
    assert (~plane.enabled).sum() == 2


def test_a_column_that_is_not_known_is_named(tmp_path):
    table = layout_table()
    table["colour"] = "red"
    layout = read_layout(write(table, tmp_path / "extra.csv"))
    assert layout.notices == ("columns not used: colour",)


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "empty"),
        ("\n\n# only\n", "empty"),
        ("id,x_mm,y_mm\n", "has no robots"),
        ("id,x_mm,ID,y_mm\n1,2,3,4\n", "a column stands twice: id and ID"),
        ("id,x_mm,x_mm,y_mm\n1,2,3,4\n", "a column stands twice: x_mm and x_mm"),
        ("1,2,3\n4,5,6\n", "line 1 holds values"),
        ("# id,x_mm,y_mm\n1,2,3\n", "line 2 holds values .* without #"),
        ("id,x_mm,y_mm\n1,2\n", "line 2 has 2 values, the header names 3 columns"),
        ("id,x_mm,y_mm\n1,2,3,4\n", "line 2 has 4 values, the header names 3 columns"),
        ('id,x_mm,y_mm\n1,2,3\n2,3,"4\n', "line 3: a quote is not closed"),
        ('id,x_mm,y_mm\n1,2,"3\n2,3,"4\n5,6,7\n', "line 2: a quote is not closed"),
        ('id,x_mm,y_mm\n1,2,"3"x\n', "line 2"),
        ("id,x_mm,y_mm\n1,2,3\n2,2.0,3.0\n", "two robots stand on one place: 1 and 2 at"),
        ("id,x_mm,y_mm\n1,2\x00,3\n", "neither UTF-8 text nor FITS"),
        ("id," + "x" * 2_000_000 + "\n1,2\n", "the header has 2000004 bytes, more than 1048576"),
        ("# " + "x" * 2_000_000 + "\nid,x_mm,y_mm\n1,2,3\n", "the header has"),
    ],
)
def test_a_text_that_is_no_table_is_refused(text, words, tmp_path):
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(FormatError, match=words):
        read_layout(tmp_path / "table.csv", "desi")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_targets_keep_the_order_of_the_file(suffix, tmp_path):
    table = Table({"id": [7, 3, 5], "x_mm": [1.5, -2.0, 3.25], "y_mm": [0.0, 1e-3, 9.0]})
    targets = read_targets(write(table, tmp_path / f"targets{suffix}"))
    assert targets.ids.dtype == np.int64 and targets.ids.tolist() == [7, 3, 5]
    assert np.array_equal(targets.xy_mm, [[1.5, 0.0], [-2.0, 1e-3], [3.25, 9.0]])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_row_without_a_place_is_a_robot_without_target(suffix, tmp_path):
    table = Table({"id": [7, 3, 5], "x_mm": [1.5, np.nan, 3.25], "y_mm": [0.0, np.nan, 9.0]})
    targets = read_targets(write(table, tmp_path / f"nan{suffix}"))
    assert targets.ids.tolist() == [7, 5] and targets.without_target.tolist() == [3]
    for name in ("x_mm", "y_mm"):
        table[name] = MaskedColumn([1.0, 2.0, 3.0], mask=[False, False, True])
    targets = read_targets(write(table, tmp_path / f"masked{suffix}"))
    assert targets.ids.tolist() == [7, 3] and targets.without_target.tolist() == [5]


@pytest.mark.parametrize("word", ["", "nan", "NaN", "null", "None", "N/A", "--"])
def test_words_for_no_target(word, tmp_path):
    (tmp_path / "targets.csv").write_text(f"id,x_mm,y_mm\n1,{word},{word}\n2,3,4\n")
    assert read_targets(tmp_path / "targets.csv").without_target.tolist() == [1]


@pytest.mark.parametrize(
    "text, words",
    [
        ("id,x_mm,y_mm\n7,1,2\n3,nan,2\n", "x_mm and y_mm must both .*: robot 3: nan"),
        ("id,x_mm,y_mm\n7,1,2\n3,inf,2\n", "column x_mm is not a number: robot 3: inf"),
        ("id,x_mm,y_mm\n7,1,2\n7,3,4\n", "more than one row for robot 7"),
        ("x_mm,y_mm\n1,2\n", "no column id; it has x_mm, y_mm"),
        ("id,x_mm,y_mmm\n1,2,3\n", "no column y_mm; it has id, x_mm, y_mmm; is y_mmm meant"),
        ("ids,x_mm,y_mm\n1,2,3\n", "is ids meant as id"),
        ("id,x_mm,y_mm,arm_phi_mm\n1,2,3,4\n", "it is a layout and no table of targets"),
        ("id,x_mm,y_mm,enabled\n1,2,3,1\n", "it is a layout and no table of targets"),
    ],
)
def test_bad_targets_are_refused(text, words, tmp_path):
    (tmp_path / "targets.csv").write_text(text)
    with pytest.raises(FormatError, match=words):
        read_targets(tmp_path / "targets.csv")


def test_starts_are_angles_in_the_focal_plane(tmp_path):
    plane = preset("desi", 3)
    (tmp_path / "starts.csv").write_text("id,theta_deg,phi_deg\n2,10,170\n0,-20,160\n1,0,150\n")
    starts = read_starts(tmp_path / "starts.csv", plane)
    assert np.allclose(np.rad2deg(starts.angles), [[-20, 160], [0, 150], [10, 170]])
    (tmp_path / "starts.csv").write_text("id,theta_deg,phi_deg\n2,10,190\n0,-20,160\n1,0,150\n")
    notice = read_starts(tmp_path / "starts.csv", plane).notices
    assert notice == ("starts outside the joint ranges, so held: robot 2",)
    (tmp_path / "starts.csv").write_text("id,theta_deg,phi_deg\n2,10,170\n0,nan,nan\n1,0,150\n")
    with pytest.raises(FormatError, match="no present angles for robot 0, 1 of 3"):
        read_starts(tmp_path / "starts.csv", plane)
    (tmp_path / "starts.csv").write_text("id,theta_rad,phi_rad\n2,1,2\n")
    with pytest.raises(FormatError, match="no column theta_deg, phi_deg"):
        read_starts(tmp_path / "starts.csv", plane)


def test_obstacles_beside_a_layout(tmp_path):
    table = write(layout_table(), tmp_path / "plane.csv")
    discs = tmp_path / "discs.csv"
    discs.write_text("fiducial,x_mm,y_mm,radius_mm\nF0,1,2,2.5\nF1,-3,4,2.5\n")
    layout = read_layout(f"{table},{discs}")
    assert layout.plane.obstacles.tolist() == [[1, 2, 2.5], [-3, 4, 2.5]]
    assert "2 obstacles" in layout.summary and layout.notices == ("columns not used: fiducial",)
    again = read_layout(table, obstacles=discs).plane
    assert np.array_equal(again.obstacles, layout.plane.obstacles)
    assert np.array_equal(read_obstacles(discs), layout.plane.obstacles)
    discs.write_text("x_mm,y_mm,radius_mm\n1,2,-2.5\n")
    with pytest.raises(FormatError, match="radius_mm is negative: line 2"):
        read_layout(f"{table},{discs}")

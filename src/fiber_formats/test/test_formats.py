# SPDX-License-Identifier: Apache-2.0
"""Every format, on a small made-up file in the shape of a real one."""

import gzip
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from fiber_core.fields import random_problem
from fiber_core.kinematics import forward
from fiber_core.presets import preset
from fiber_core.problem import save_problem
from fiber_formats import FormatError, read_layout, read_starts, read_targets


def joined(folder, *names) -> str:
    return ",".join(str(folder / name) for name in names)


def sdss(folder, *more) -> str:
    return joined(folder, "sdss_positionerTable.csv", "sdss_wokCoords.csv", *more)


def test_desi_state_gives_the_observed_tips(made_up):
    path = made_up / "desi_state.ecsv"
    layout = read_layout(path)
    plane = layout.plane
    assert layout.format_name == "DESI state" and layout.preset == "desi_outlines"
    assert plane.ids.tolist() == [3001, 3002, 4001, 4002, 7001, 9001]
    assert plane.enabled.tolist() == [True, False, True, True, True, False]
    assert len(set(plane.bus.tolist())) == 4  # petals 3, 4, 7, and the robot without a bus
    starts = read_starts(path, plane)
    rows = Table.read(path, format="ascii.ecsv")[:6]
    tips = forward(plane, starts.angles)[1]
    assert np.allclose(tips, np.array([rows["OBS_X"], rows["OBS_Y"]]).T, atol=1e-5)
    middle = np.rad2deg(plane.limits[:, 0]).mean(axis=1)
    assert np.allclose(middle, rows["OFFSET_T"] + 36 * (rows["PETAL_LOC"] - 3))
    assert np.allclose(np.rad2deg(plane.limits[:, 1, 0]), rows["OFFSET_P"])


def test_desi_state_gives_starts_of_robots_that_guide_too(made_up, tmp_path):
    # a calibration holds them as robots, a layout of a state does not
    whole = made_up / "desi_state.ecsv"
    text = whole.read_text().replace(" M01005 POS ", " M01005 ETC ")
    (tmp_path / "state.ecsv").write_text(text)
    plane = read_layout(whole).plane
    starts = read_starts(tmp_path / "state.ecsv", plane)
    assert np.array_equal(starts.angles, read_starts(whole, plane).angles)
    assert 9001 not in read_layout(tmp_path / "state.ecsv").plane.ids


def test_desi_state_names_what_it_does_not_use(made_up):
    layout = read_layout(made_up / "desi_state.ecsv")
    assert layout.summary == (
        "desi_state.ecsv: 6 robots, 2 disabled, 48 walls; from preset desi_outlines: speeds"
    )
    text = "\n".join(layout.notices)
    for words in (
        "1 FIF",
        "2 robots have larger ones",
        "1 robots have a linear motor (LINPHI)",
        "1 robots have no BUS_ID",
        "petal edges and GFAs are those published: the file has none",
        "columns not used: DEVICE_ID, DEVICE_LOC, ENABLED, POS_NEIGHBORS, OBS_X",
    ):
        assert words in text, text


def test_the_newest_row_of_a_desi_calibration_counts(made_up):
    layout = read_layout(made_up / "desi_calibration.csv")
    state = read_layout(made_up / "desi_state.ecsv").plane
    plane = layout.plane
    assert np.array_equal(plane.ids, state.ids)
    for name in ("centers", "arms", "limits"):
        assert np.allclose(getattr(plane, name), getattr(state, name)), name
    assert plane.enabled.tolist() == [True, False, True, True, True, True]
    assert "2 rows are older" in layout.notices[0]


def test_two_calibration_rows_of_one_time_are_refused(made_up, tmp_path):
    text = (made_up / "desi_calibration.csv").read_text()
    text = text.replace("2022-06-25 21:37:32+00:00", "2023-05-03 17:30:37.194127+00:00")
    (tmp_path / "calibration.csv").write_text(text)
    with pytest.raises(FormatError, match="time_recorded is the same in two rows"):
        read_layout(tmp_path / "calibration.csv")


def write_tile(path, **tables):
    hdus = [fits.PrimaryHDU(), *(fits.table_to_hdu(Table(rows)) for rows in tables.values())]
    for hdu, name in zip(hdus[1:], tables):
        hdu.name = name
    fits.HDUList(hdus).writeto(path)
    return path


def assignment(target_id=(39627000000000000, 1, 2), status=(0, 0, 0), x=(210.0, np.nan, 195.5)):
    return {
        "TARGETID": np.array(target_id, dtype=np.int64),
        "LOCATION": np.array([3002, 4001, 9001], dtype=np.int32),
        "FIBERSTATUS": np.array(status, dtype=np.int32),
        "FIBERASSIGN_X": np.array(x, dtype=np.float32),
        "FIBERASSIGN_Y": np.array([101.0, np.nan, 92.25], dtype=np.float32),
    }


@pytest.fixture
def tile(tmp_path):
    return write_tile(
        tmp_path / "tile.fits", FIBERASSIGN=assignment(), TARGETS={"TARGETID": [1, 2]}
    )


@pytest.mark.parametrize("name", ["tile.fits", "tile.fits.gz", "tile.dat"])
def test_a_desi_tile_is_known_by_its_content(tile, name):
    path = tile.with_name(name)
    if name.endswith(".gz"):
        path.write_bytes(gzip.compress(tile.read_bytes()))
    elif path != tile:
        shutil.copy(tile, path)
    targets = read_targets(path)
    assert targets.format_name == "DESI fiberassign tile"
    assert targets.ids.tolist() == [3002, 9001] and targets.without_target.tolist() == [4001]
    assert targets.xy_mm.tolist() == [[210.0, 101.0], [195.5, 92.25]]
    assert targets.notices == (f"tables not used: {path} HDU 2 TARGETS",)


def test_a_fibre_that_a_desi_tile_marks_as_unassigned_has_no_target(tmp_path):
    # fiberassign gives it the centre of its robot
    columns = assignment(target_id=(7, 1, -2000009001), status=(0, 0, 1 | 2))
    targets = read_targets(write_tile(tmp_path / "tile.fits", FIBERASSIGN=columns))
    assert targets.ids.tolist() == [3002] and targets.without_target.tolist() == [4001, 9001]
    assert targets.notices == ()
    del columns["TARGETID"]
    targets = read_targets(write_tile(tmp_path / "other.fits", FIBERASSIGN=columns))
    assert targets.ids.tolist() == [3002] and targets.without_target.tolist() == [4001, 9001]
    lacks = "columns that such a table can have, and this one has not: TARGETID"
    assert targets.notices == (lacks,)


def test_a_tile_with_doubtful_marks_is_refused_or_named(tmp_path):
    columns = assignment(status=(1, 0, 0))
    targets = read_targets(write_tile(tmp_path / "tile.fits", FIBERASSIGN=columns))
    assert targets.ids.tolist() == [3002, 9001]
    assert targets.notices[0].startswith("1 rows have a TARGETID and the bit of FIBERSTATUS")
    columns["TARGETIDS"] = columns.pop("TARGETID")
    with pytest.raises(FormatError, match="column TARGETIDS is not known; is TARGETID meant?"):
        read_targets(write_tile(tmp_path / "other.fits", FIBERASSIGN=columns))


def test_of_a_merged_tile_the_assignment_counts_and_the_others_are_named(tmp_path):
    # sky monitors and the copy of the raw assignment have the same columns
    raw = assignment(x=(1.0, 2.0, 3.0)) | {"DEVICE_TYPE": np.array(["POS", "POS", "ETC"])}
    path = write_tile(
        tmp_path / "tile.fits", FASSIGN=raw, SKY_MONITOR=raw, FIBERASSIGN=assignment()
    )
    targets = read_targets(path)
    assert targets.xy_mm[:, 0].tolist() == [210.0, 195.5]
    assert targets.notices[0].endswith("HDU 1 FASSIGN, " + f"{path} HDU 2 SKY_MONITOR")


def test_sdss_v_needs_two_files_and_takes_four(made_up):
    layout = read_layout(sdss(made_up, "sdss_fiducialCoords.csv", "sdss_gfaCoords.csv"))
    plane = layout.plane
    assert plane.ids.tolist() == [3, 16, 40, 97, 252]
    assert plane.obstacles.tolist() == [[11.2, -19.398, 2.5]]
    (corners,) = plane.walls
    front, back = corners[:2].mean(axis=0), corners[2:].mean(axis=0)
    away = np.array([-0.87, 0.49])  # j of the table; the front is nearer the centre of the wok
    assert np.allclose(back - front, 54.32 * away, atol=0.02)
    assert np.allclose(back, [-284.7, 163.4], atol=0.02)
    assert "GFAs are walls" in "\n".join(layout.notices)
    assert np.allclose(np.rad2deg(np.diff(plane.limits, axis=2)[:, :, 0]), [360, 180])
    with pytest.raises(FormatError, match="name the file with wokCoords too"):
        read_layout(made_up / "sdss_positionerTable.csv")


def test_what_sdss_v_tables_lack_and_what_of_them_is_not_used_is_named(made_up, tmp_path):
    table = Table.read(made_up / "sdss_positionerTable.csv")
    table.remove_columns(["dx", "dy", "bossX"])
    table.write(tmp_path / "sdss_positionerTable.csv")
    holes = Table.read(made_up / "sdss_wokCoords.csv")
    holes["odd"] = 1
    holes.write(tmp_path / "sdss_wokCoords.csv")

    text = "\n".join(read_layout(sdss(tmp_path)).notices)
    assert "no column dx, dy: taken as 0" in text
    assert "the fibres need all of their columns, there are only apX, apY, bossY" in text
    assert re.search("sdss_wokCoords.csv: columns not used: .*odd", text)
    complete = "\n".join(read_layout(sdss(made_up)).notices)
    assert "taken as 0" not in complete and "need all" not in complete
    with pytest.raises(FormatError, match=r"moons_assignment.txt is none of"):
        read_layout(sdss(made_up, "moons_assignment.txt"))
    with pytest.raises(FormatError, match="named twice"):
        read_layout(sdss(made_up, "sdss_wokCoords.csv"))


def with_flags(made_up, folder, name, words):
    head, *rows = (made_up / "sdss_positionerTable.csv").read_text().splitlines()
    path = folder / "positionerTable.csv"
    rows = [f"{row},{words[k % 2]}" for k, row in enumerate(rows)]
    path.write_text("\n".join([f"{head},{name}", *rows]) + "\n")
    return [path, made_up / "sdss_wokCoords.csv"]


def test_a_flag_that_was_added_to_a_positioner_table_is_understood_or_refused(made_up, tmp_path):
    usual = read_layout(sdss(made_up)).plane
    for name, words in (("enabled", "TF"), ("disabled", "FT")):
        plane = read_layout(with_flags(made_up, tmp_path, name, words)).plane
        rows = plane.index_of(usual.ids)
        assert np.count_nonzero(plane.enabled[rows]) == (plane.n + 1) // 2
    with pytest.raises(FormatError, match="offline may tell which robots are out of use"):
        read_layout(with_flags(made_up, tmp_path, "offline", "FT"))


def test_a_petal_that_is_not_that_of_the_location_is_refused(made_up, tmp_path):
    table = Table.read(made_up / "desi_state.ecsv", format="ascii.ecsv")
    row = int(np.flatnonzero(table["DEVICE_TYPE"] == "POS")[0])
    table["PETAL_LOC"][row] = (table["PETAL_LOC"][row] + 1) % 10
    table.write(tmp_path / "state.ecsv", format="ascii.ecsv")
    words = f"PETAL_LOC is not the thousands of LOCATION: robot {table['LOCATION'][row]}:"
    for read in (read_layout, lambda path: read_starts(path, preset("desi", 3))):
        with pytest.raises(FormatError, match=words):
            read(tmp_path / "state.ecsv")


def test_the_order_of_the_sdss_v_files_does_not_matter(made_up):
    backwards = joined(made_up, "sdss_wokCoords.csv", "sdss_positionerTable.csv")
    first, second = read_layout(sdss(made_up)).plane, read_layout(backwards).plane
    assert np.array_equal(first.centers, second.centers)


def test_a_hole_without_place_is_refused_by_robot(made_up, tmp_path):
    text = (made_up / "sdss_wokCoords.csv").read_text().replace("R+1C2", "R+1C9")
    (tmp_path / "wok.csv").write_text(text)
    with pytest.raises(FormatError, match=r"column holeID is not in .*: robot 40: R\+1C2"):
        read_layout(f"{made_up / 'sdss_positionerTable.csv'},{tmp_path / 'wok.csv'}")


def test_sdss_v_configuration_gives_starts_and_targets_of_its_fibres(made_up):
    plane = read_layout(sdss(made_up)).plane
    path = made_up / "sdss_confSummary.par"
    starts, targets = read_starts(path, plane), read_targets(path, plane)
    assert targets.ids.tolist() == [16, 3, 252]
    assert targets.fibre.tolist() == ["BOSS", "APOGEE", "BOSS"]
    assert targets.notices[0] == "targets: 2 for BOSS, 1 for APOGEE"
    rows = plane.index_of(targets.ids)
    fibre = targets.fibre_numbers(plane)
    assert np.array_equal(targets.on(plane).fibre[rows], fibre)
    for row, number, xy_mm in zip(rows, fibre, targets.xy_mm):
        x, y = plane.fibres[row, number]
        turn = starts.angles[row].sum()
        elbow = plane.centers[row] + plane.arms[row, 0] * np.array(
            [np.cos(starts.angles[row, 0]), np.sin(starts.angles[row, 0])]
        )
        place = elbow + [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)]
        assert np.allclose(place, xy_mm, atol=0.02)


def test_sdss_v_configuration_gives_places_of_tips_to_a_plane_without_fibres(made_up):
    plane = replace(read_layout(sdss(made_up)).plane, fibres=None, fibre_names=None, fibre=None)
    path = made_up / "sdss_confSummary.par"
    starts, targets = read_starts(path, plane), read_targets(path, plane)
    assert targets.ids.tolist() == [16, 3, 252]
    assert targets.without_target.tolist() == [40, 97]  # not assigned; assigned but not valid
    tips = forward(plane, starts.angles)[1]
    assert np.allclose(tips[plane.index_of(targets.ids)], targets.xy_mm, atol=1e-6)
    assert (
        targets.notices[-1] == "targets are places of the tips: the plane has no fibre APOGEE, BOSS"
    )
    assert np.all(starts.angles >= plane.limits[:, :, 0])


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('"two words # no comment"', '"two words', "line 31: a quote or brace is not closed"),
        ("FIBERMAP 16 ", "FIBERMAP ", "line 31 has 12 values, 13 are declared"),
        ("{-999.0", "-999.0 {", "line 31"),
        (" 16 R0C3 METROLOGY", " 3 R0C3 METROLOGY", "more than one row for robot 3"),
        (" BOSS 1", " BOS 1", "column fiberType is not a fibre of a robot: line 32: BOS"),
    ],
)
def test_damage_of_a_yanny_file_is_refused_by_line(made_up, tmp_path, old, new, words):
    text = (made_up / "sdss_confSummary.par").read_text()
    assert old in text
    (tmp_path / "damaged.par").write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError, match=words):
        read_targets(tmp_path / "damaged.par")


def test_pfs_cobras_count_phi_from_the_stretched_arm(made_up):
    plane = read_layout(made_up / "pfs_cobras.xml").plane
    assert plane.ids.tolist() == [1, 3, 7, 59]  # 57 (module - 1) + position
    assert plane.enabled.tolist() == [True, False, True, True]
    low, high = np.moveaxis(np.rad2deg(plane.limits), 2, 0)
    assert np.allclose(low[:, 0], [78.03, 10.25, 350.5, 200.0])
    assert np.allclose(high[:, 0] - low[:, 0], [376.9, 380.5, 372.0, 385.8], atol=1e-3)
    assert np.allclose(low[:, 1], [-182.5, -181.0, -179.5, -183.0])
    assert np.allclose(high[:, 1], [1.0, 2.25, -0.5, 0.0])
    gaps = np.hypot(*(plane.centers[1:] - plane.centers[0]).T)
    assert np.isclose(gaps.min(), 8.0, atol=1e-3)


def test_an_interference_limit_narrows_phi_of_its_cobra(made_up):
    free = read_layout(made_up / "pfs_cobras.xml").plane
    layout = read_layout(joined(made_up, "pfs_cobras.xml", "pfs_interference.csv"))
    change = np.rad2deg(free.limits - layout.plane.limits)
    assert np.flatnonzero(change.any(axis=(1, 2))).tolist() == [2]
    assert np.isclose(np.rad2deg(layout.plane.limits[2, 1, 1]), -179.5 + 141)
    assert "1 robots have an interference limit" in "\n".join(layout.notices)


def test_a_wrong_pixel_scale_of_pfs_is_named(made_up, tmp_path):
    text = (made_up / "pfs_cobras.xml").read_text()
    assert not any(
        "Pixel_scale" in line for line in read_layout(made_up / "pfs_cobras.xml").notices
    )
    (tmp_path / "scale.xml").write_text(text.replace(">80.0<", ">90.0<"))
    notices = read_layout(tmp_path / "scale.xml").notices
    assert "neighbours stand 9.00 mm apart" in notices[0] and "80.0 um would fit" in notices[0]


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("<Link1_Link_Length>", "<Link1_Link_Lenth>", "is not XML"),
        (">80.0<", ">eighty<", "container 1: Pixel_scale is not a number: eighty"),
        ("Status>1<", "Status>1_0<", "container 1: Status is not a number"),
        ("Positioner_Id>7<", "Positioner_Id>1<", "a cobra stands twice"),
    ],
)
def test_damage_of_cobras_is_refused(made_up, tmp_path, old, new, words):
    text = (made_up / "pfs_cobras.xml").read_text()
    (tmp_path / "damaged.xml").write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError, match=words):
        read_layout(tmp_path / "damaged.xml")


def pfs_design(path, cobras, nominal):
    count = len(cobras)
    table = Table(
        {
            "fiberId": np.arange(1, count + 1),
            "cobraId": cobras,
            "catId": np.zeros(count, dtype=int),
            "objId": np.arange(count),
            "pfiNominal": np.array(nominal, dtype=np.float32),
        }
    )
    design = fits.table_to_hdu(table)
    design.name = "DESIGN"
    photometry = fits.table_to_hdu(Table({"fiberId": [1], "fiberFlux": [1.5]}))
    fits.HDUList([fits.PrimaryHDU(), photometry, design]).writeto(path)
    return path


def test_pfs_design_is_read_from_a_later_hdu(tmp_path):
    nominal = [[1.5, 2.5], [np.nan, np.nan], [np.nan, np.nan], [3.0, -4.0]]
    path = pfs_design(tmp_path / "pfsDesign.fits", [59, 3, 65533, 1], nominal)
    targets = read_targets(path)
    assert targets.format_name == "PFS pfsConfig" and targets.ids.tolist() == [59, 1]
    assert targets.without_target.tolist() == [3]
    assert targets.xy_mm.tolist() == [[1.5, 2.5], [3.0, -4.0]]
    assert "1 fibres have no cobra" in "\n".join(targets.notices)
    half = pfs_design(tmp_path / "half.fits", [1, 2], [[1.0, np.nan], [1.0, 2.0]])
    with pytest.raises(FormatError, match="pfiNominal has one number of two: robot 1"):
        read_targets(half)
    with pytest.raises(FormatError, match="holds no layout"):
        read_layout(path)


def test_moons_holds_places_and_targets(made_up):
    path = made_up / "moons_assignment.txt"
    plane, targets = read_layout(path).plane, read_targets(path)
    assert plane.n == 7 and targets.without_target.tolist() == [4]
    assert np.all(np.hypot(*(targets.xy_mm - plane.centers[targets.ids]).T) < 25)
    assert np.allclose(plane.centers[0], [60, 0])
    with pytest.raises(FormatError, match="holds no starts"):
        read_starts(path, plane)


def test_just_sites_need_a_preset(made_up):
    path = made_up / "just_sites.csv"
    with pytest.raises(FormatError, match="name a preset"):
        read_layout(path)
    layout = read_layout(path, "desi")
    assert layout.format_name == "JUST sites" and layout.plane.n == 7
    assert layout.plane.centers[1].tolist() == [10.4, 0.0]
    assert "the first column, 4.45 in every row, is not used" in layout.notices


def test_ids_without_header_are_not_taken_for_sites(tmp_path):
    (tmp_path / "targets.csv").write_text("1,2.5,3.5\n2,4.5,5.5\n3,6.5,7.5\n")
    with pytest.raises(FormatError, match="line 1 holds values and no names of columns"):
        read_layout(tmp_path / "targets.csv", "desi")


def test_a_problem_holds_starts_and_targets(tmp_path):
    asked = np.arange(20) % 4 != 0
    problem = random_problem(preset("desi", 20), np.random.default_rng(0), asked=asked)
    save_problem(tmp_path / "problem.npz", problem)
    targets = read_targets(tmp_path / "problem.npz", problem.plane)
    assert np.array_equal(targets.ids, np.flatnonzero(asked))
    assert np.array_equal(targets.xy_mm, problem.targets[asked])
    starts = read_starts(tmp_path / "problem.npz", problem.plane)
    assert np.allclose(starts.angles, problem.start, rtol=0, atol=1e-14)
    xy_mm, known = targets.of(problem.plane)
    assert np.array_equal(xy_mm, problem.targets, equal_nan=True) and known.all()
    (tmp_path / "torn.npz").write_bytes(b"PK\x03\x04no")
    with pytest.raises(FormatError, match="torn.npz"):
        read_targets(tmp_path / "torn.npz")


def test_a_problem_that_is_packed_is_read_as_any_other_file(tmp_path):
    problem = random_problem(preset("desi", 7), np.random.default_rng(1))
    save_problem(tmp_path / "problem.npz", problem)
    packed = tmp_path / "problem.npz.gz"
    packed.write_bytes(gzip.compress((tmp_path / "problem.npz").read_bytes()))
    found = read_starts(packed, problem.plane).angles
    assert np.allclose(found, problem.start, rtol=0, atol=1e-12)
    packed.write_bytes(gzip.compress((tmp_path / "problem.npz").read_bytes()[:-99]))
    with pytest.raises(FormatError, match="problem.npz.gz is not a problem or plan file"):
        read_targets(packed)


def test_starts_must_be_there_for_every_robot(made_up):
    plane = preset("desi", 7)
    with pytest.raises(
        FormatError, match="no present angles for robot 0, 1, 2, 3, 4, 5, 6, 7 of 7"
    ):
        read_starts(made_up / "desi_state.ecsv", plane)


def test_robots_that_the_plane_lacks_are_named(made_up, tile):
    plane = read_layout(made_up / "desi_state.ecsv").plane.permuted([0, 1, 2])
    assert read_targets(tile, plane).notices[-1] == "not in the plane: robot 3002, 9001, 2 rows"


def test_a_preset_of_the_user_stands_before_that_of_the_format(made_up):
    layout = read_layout(made_up / "desi_state.ecsv", "desi")
    assert layout.preset == "desi" and layout.plane.phi_vertices.shape[1] == 2
    with pytest.raises(FormatError, match="no preset is named 'keck'"):
        read_layout(made_up / "desi_state.ecsv", "keck")

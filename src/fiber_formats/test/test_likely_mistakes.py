# SPDX-License-Identifier: Apache-2.0
"""Mistakes that a user is likely to make with tables: refused or named, each with what to do."""

import zipfile

import numpy as np
import pytest
from astropy.table import Table

from fiber_core.presets import preset
from fiber_formats import FormatError, read_layout, read_starts, read_targets

PLANE = preset("desi", 37)
HEAD = "id,x_mm,y_mm,arm_theta_mm,arm_phi_mm"


def written(folder, head, rows):
    path = folder / "table.csv"
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def layout_rows(scale=1.0, arms=1.0):
    return [
        [i, *(scale * place), 3.0 * arms, 3.0 * arms]
        for i, place in zip(PLANE.ids.tolist(), PLANE.centers)
    ]


@pytest.mark.parametrize(
    "name, values",
    [
        ("broken", "FT"),
        ("status", [0, 2]),
        ("in_use", [0, 1]),
        ("laser", ["yes", "yes"]),
        ("spare_1", [1, 0]),
    ],
)
def test_a_column_that_may_tell_what_is_out_of_use_is_refused(tmp_path, name, values):
    rows = [[*row, values[k % 2]] for k, row in enumerate(layout_rows())]
    with pytest.raises(FormatError, match=f"{name} may tell which robots are out of use"):
        read_layout(written(tmp_path, f"{HEAD},{name}", rows))
    told = [[*row, "yes"] for row in rows]
    layout = read_layout(written(tmp_path, f"{HEAD},{name},enabled", told))
    assert layout.plane.enabled.all() and layout.notices == (f"columns not used: {name}",)


def test_a_column_of_zeros_or_of_other_numbers_tells_no_flag(tmp_path):
    rows = [[*row, 0, k] for k, row in enumerate(layout_rows())]
    layout = read_layout(written(tmp_path, f"{HEAD},dz,count", rows))
    assert layout.notices == ("columns not used: dz, count",)


@pytest.mark.parametrize("scale, arms", [(1e-3, 1.0), (1e3, 1.0), (1.0, 1e-3), (1.0, 1e3)])
def test_places_and_arms_in_different_units_are_refused(tmp_path, scale, arms):
    path = written(tmp_path, HEAD, layout_rows(scale, arms))
    with pytest.raises(FormatError, match="are places and arms in mm"):
        read_layout(path, "desi")


def test_starts_in_radians_and_targets_of_another_plane_are_named(tmp_path):
    rng = np.random.default_rng(4)
    angles = np.stack([rng.uniform(-180, 180, PLANE.n), rng.uniform(0, 180, PLANE.n)], axis=1)
    for unit, words in ((1.0, []), (np.pi / 180, ["are they in radians"])):
        rows = np.column_stack([PLANE.ids, unit * angles]).tolist()
        path = written(tmp_path, "id,theta_deg,phi_deg", [[int(r[0]), *r[1:]] for r in rows])
        said = [n for n in read_starts(path, PLANE).notices if "radians" in n]
        assert len(said) == len(words) and all(w in n for w, n in zip(words, said))
    for scale, far in ((1.0, 0), (1e3, PLANE.n - 1)):  # one robot stands at the origin
        rows = [[i, *(scale * p)] for i, p in zip(PLANE.ids.tolist(), PLANE.centers)]
        notices = read_targets(written(tmp_path, "id,x_mm,y_mm", rows), PLANE).notices
        assert (f"{far} of {PLANE.n} targets: is it a table of this plane" in str(notices)) == bool(
            far
        )


def test_a_file_that_lacks_a_column_of_an_instrument_says_which(made_up, tmp_path):
    text = (made_up / "desi_state.ecsv").read_text()
    path = tmp_path / "state.ecsv"
    path.write_text(text.replace("OFFSET_T", "OFFSETT"))
    with pytest.raises(FormatError, match="as a file of format DESI state it lacks OFFSET_T"):
        read_layout(path)


def test_files_that_do_not_belong_together_are_told_so(made_up):
    state, tile = made_up / "desi_state.ecsv", made_up / "desi_calibration.csv"
    with pytest.raises(FormatError, match="which needs other files beside it, or none"):
        read_layout([state, tile])
    with pytest.raises(FormatError, match="sdss_wokCoords.csv is of format SDSS-V positioner"):
        read_layout(made_up / "sdss_wokCoords.csv")


@pytest.mark.parametrize("kind, most", [("f4", 2**24), ("f8", 2**32)])
def test_ids_in_floats_are_read_as_far_as_they_are_exact(tmp_path, kind, most):
    for robot in (most - 1, most):
        table = Table({"id": np.array([robot], kind), "x_mm": [1.0], "y_mm": [2.0]})
        table.write(tmp_path / "t.fits", overwrite=True)
        if robot < most:
            assert read_targets(tmp_path / "t.fits").ids.tolist() == [robot]
        else:
            with pytest.raises(FormatError, match="column id is not a number from 0 to"):
                read_targets(tmp_path / "t.fits")


def test_a_misspelt_column_that_a_file_may_lack_is_refused_and_a_lacking_one_is_named(
    made_up, tmp_path
):
    text = (made_up / "desi_state.ecsv").read_text()
    path = tmp_path / "state.ecsv"
    name = "KEEPOUT_EXPANSION_PHI_ANGULAR"
    path.write_text(text.replace(name, name.replace("LA", "AL")))
    with pytest.raises(FormatError, match=f"column .*ANGUALR is not known; is {name} meant"):
        read_layout(path)
    path.write_text(text.replace(name, "BODY"))
    (said,) = [n for n in read_layout(path).notices if "this one has not" in n]
    assert name in said


def test_a_file_of_sdss_v_that_lacks_a_column_says_which(made_up, tmp_path):
    places = tmp_path / "places.csv"
    places.write_text((made_up / "sdss_wokCoords.csv").read_text().replace("xWok", "xWk"))
    with pytest.raises(FormatError, match="as a wokCoords it lacks xWok"):
        read_layout([made_up / "sdss_positionerTable.csv", places])


def test_a_spreadsheet_and_an_address_are_refused_with_what_to_do(tmp_path):
    book = tmp_path / "robots.xlsx"
    with zipfile.ZipFile(book, "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    with pytest.raises(FormatError, match="save it as CSV, ECSV or FITS"):
        read_layout(book)
    with pytest.raises(FormatError, match="https://example.org/a.csv: fetch it first"):
        read_layout("https://example.org/a.csv")


def test_rows_without_ids_are_named_by_their_lines(tmp_path):
    rows = [["", "mm", "mm", "mm", "mm"], *layout_rows()]
    with pytest.raises(FormatError, match="column x_mm is not a number: line 2: mm"):
        read_layout(written(tmp_path, HEAD, rows))


@pytest.mark.parametrize("name, value", [("theta_range_deg", 6.8), ("phi_range_deg", 3.1)])
def test_ranges_that_may_be_in_radians_are_named(tmp_path, name, value):
    for factor, said in ((1.0, 1), (180 / np.pi, 0)):
        rows = [[*row, factor * value] for row in layout_rows()]
        notices = read_layout(written(tmp_path, f"{HEAD},{name}", rows)).notices
        assert len(notices) == said
        assert all(f"{name} is within {value:.2f} degrees in every row" in n for n in notices)


def test_zeros_that_may_be_in_radians_are_named_and_aligned_ones_are_not(tmp_path):
    zeros = np.linspace(-3.1, 3.1, PLANE.n)
    for values, said in ((zeros, 1), (np.rad2deg(zeros), 0), (0.1 * zeros, 0)):
        rows = [[*row, zero] for row, zero in zip(layout_rows(), values.tolist())]
        notices = read_layout(written(tmp_path, f"{HEAD},theta_zero_deg", rows)).notices
        assert len(notices) == said and all("is it in radians?" in n for n in notices)


@pytest.mark.parametrize("x, y", [(-999, -999), (9999.9, 9999.9), (0, 300)])
def test_a_robot_far_from_all_others_is_named(tmp_path, x, y):
    rows = layout_rows()
    rows[3][1:3] = x, y
    (said,) = read_layout(written(tmp_path, HEAD, rows)).notices
    assert said == "far from all others: robot 3: is their place known?"


@pytest.mark.parametrize("apart", [0.0004, 0.0006, 0.05])
def test_two_robots_on_nearly_one_place_are_refused(tmp_path, apart):
    rows = layout_rows()
    rows[4][1:3] = rows[3][1] + apart, rows[3][2]
    with pytest.raises(FormatError, match="two robots stand on one place: 3 and 4 at"):
        read_layout(written(tmp_path, HEAD, rows))


@pytest.mark.parametrize("joint, angle", [(1, -999), (2, -999), (1, 9999.9), (1, 1e20)])
def test_an_angle_that_stands_for_an_unknown_one_is_refused(tmp_path, joint, angle):
    rows = [[i, 10.0, 90.0] for i in PLANE.ids.tolist()]
    rows[3][joint] = angle
    with pytest.raises(
        FormatError, match=f"no place is known: robot 3: .*{angle:.5g}".replace("+", ".")
    ):
        read_starts(written(tmp_path, "id,theta_deg,phi_deg", rows), PLANE)


@pytest.mark.parametrize("digits", [100, 5000])
def test_an_id_of_thousands_of_digits_is_refused(tmp_path, digits):
    with pytest.raises(FormatError, match="column id is not a number from 0 to 4294967295: line 2"):
        read_targets(written(tmp_path, "id,x_mm,y_mm", [["9" * digits, 1, 2]]))


@pytest.mark.parametrize(
    "encoding, words", [("latin-1", "line 3 holds the byte 0xb0"), ("utf-16-le", "zero bytes")]
)
def test_a_text_of_another_encoding_is_refused_with_the_place(tmp_path, encoding, words):
    path = tmp_path / "table.csv"
    path.write_bytes(
        "id,x_mm,y_mm\n1,2,3\n# turned by 30°\n"[: 19 if "16" in encoding else None].encode(
            encoding
        )
    )
    with pytest.raises(FormatError, match=words):
        read_targets(path)


def test_of_a_range_that_is_told_twice_the_stops_count_and_the_other_is_named(tmp_path):
    head = f"{HEAD},theta_zero_deg,theta_range_deg,theta_min_deg,theta_max_deg"
    layout = read_layout(written(tmp_path, head, [[*row, 7, 8, -90, 90] for row in layout_rows()]))
    assert np.allclose(np.rad2deg(layout.plane.limits[:, 0]), [-90, 90])
    assert layout.notices == ("columns not used: theta_zero_deg, theta_range_deg",)


def test_a_petal_without_a_bus_is_named(tmp_path):
    rows = [[*row, k % 3] for k, row in enumerate(layout_rows())]
    (said,) = read_layout(written(tmp_path, f"{HEAD},petal", rows)).notices
    assert said.startswith("petal is not used")
    rows = [[*row, 4] for row in rows]
    layout = read_layout(written(tmp_path, f"{HEAD},petal,bus", rows))
    assert layout.notices == () and len(np.unique(layout.plane.bus)) == 3

# SPDX-License-Identifier: Apache-2.0
"""Files of instruments that are no tables with a header: lines lost, changed, or renamed.

Each damage leaves one of three: what the undamaged file gives, a refusal, or what a changed file
says as it stands.
"""

import tempfile
import xml.etree.ElementTree as ElementTree
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.presets import preset
from fiber_formats import FormatError, read_layout, read_starts, read_targets
from fiber_formats.yanny import yanny_tables

FOLDER = Path(__file__).parent / "data"
CONFIGURATION = (FOLDER / "sdss_confSummary.par").read_text()
COBRAS = (FOLDER / "pfs_cobras.xml").read_text()
ASSIGNMENT = (FOLDER / "moons_assignment.txt").read_text()
SITES = (FOLDER / "just_sites.csv").read_text(encoding="utf-8-sig")
POSITIONERS = preset("sdss_v", 547)
JUNK = st.text(st.characters(codec="ascii", categories=["L", "N"]), min_size=1, max_size=9)


def read(reader, name, content, *others):
    """Read what stands in a file of that name, None where it is refused."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        try:
            return reader([path, *others] if others else path)
        except FormatError as refusal:
            assert name in str(refusal)
            return None


def places(targets):
    """Robots with their targets, None for none, in no order."""
    known = np.isfinite(targets.xy_mm).all(axis=1)
    return {
        robot: tuple(xy) if has else None
        for robot, xy, has in zip(targets.ids.tolist(), targets.xy_mm.tolist(), known)
    }


def configuration(text):
    found = read(read_targets, "confSummary.par", text)
    return None if found is None else places(found)


@cache
def undamaged():
    return configuration(CONFIGURATION)


def rows_of_fibres():
    lines = CONFIGURATION.splitlines()
    return lines, [k for k, line in enumerate(lines) if line.startswith("FIBERMAP")]


# --- SDSS-V: yanny


@given(row=st.integers(0, 14), key=st.one_of(JUNK, st.sampled_from(["FIBERMPA", "FIBREMAP", "F"])))
def test_a_row_under_another_name_is_refused(row, key):
    lines, rows = rows_of_fibres()
    at = rows[row]
    if key.upper() == "FIBERMAP":
        return
    lines[at] = lines[at].replace("FIBERMAP", key)
    assert configuration("\n".join(lines)) is None


def test_a_misspelt_row_without_a_list_is_refused():
    text = "typedef struct {\n int positionerId;\n double x;\n} ROBOTS;\nROBOTS 1 2\nROBOST 2 3\n"
    with pytest.raises(FormatError, match="line 6 is of no structure: ROBOST; is ROBOTS meant"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robots.par"
            path.write_text(text)
            read_targets(path)


@pytest.mark.parametrize("row", ["XQ 2 3", "XQ 2", "XQ 2 3 4 5"])
def test_a_row_under_a_quite_different_name_is_no_keyword(row):
    head = "raCen 12.5\nnote an old plate today\n"
    head += "typedef struct {\n int positionerId;\n double xFocal;\n double yFocal;\n} ROBOTS;\n"
    head += "ROBOTS 1 2 3\n"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robots.par"
        path.write_text(head + "cadence dark\n")
        assert list(yanny_tables(str(path), path.read_text())[0].lines) == [8]
        path.write_text(head + f"{row} 4\n")
        with pytest.raises(FormatError, match="line 9 is of no structure: XQ"):
            yanny_tables(str(path), path.read_text())
        path.write_text(head.replace("an old plate today", "2 3 4"))  # before the rows, too
        with pytest.raises(FormatError, match="note; it has the 3 values of a row of ROBOTS"):
            yanny_tables(str(path), path.read_text())


@given(size=st.integers(0, len(CONFIGURATION)))
def test_a_configuration_that_ends_early_is_refused_or_lacks_whole_rows(size):
    found = configuration(CONFIGURATION[:size])
    if found is not None:
        whole = CONFIGURATION[:size].rsplit("\n", 1)[0].splitlines()
        ids = {int(line.split()[1]) for line in whole if line.startswith("FIBERMAP")}
        last = CONFIGURATION[:size].rsplit("\n", 1)[1].split()
        assert set(found) <= ids | {int(last[1]) for _ in last[1:2] if last[0] == "FIBERMAP"}


def test_a_last_row_that_goes_on_is_refused():
    lines, _ = rows_of_fibres()
    assert configuration("\n".join([*lines[:-1], lines[-1] + " \\"])) is None


@given(order=st.permutations(range(15)), blank=st.booleans(), ending=st.sampled_from("\n\r"))
def test_order_and_form_of_rows_do_not_matter(order, blank, ending):
    lines, rows = rows_of_fibres()
    shuffled = [lines[rows[k]] for k in order]
    if blank:
        shuffled = [f"  {line.replace(' ', '   ', 3)}  # note" for line in shuffled]
    text = "\n".join(lines[: rows[0]]) + "\n" + ending.join(shuffled) + ending
    assert configuration(text) == undamaged()


@given(row=st.integers(0, 14), word=st.integers(1, 13), value=JUNK)
def test_a_changed_word_is_refused_or_stands_as_it_is(row, word, value):
    lines, rows = rows_of_fibres()
    words = lines[rows[row]].split(" ")
    words[word] = value
    lines[rows[row]] = " ".join(words)
    found = configuration("\n".join(lines))
    if found is None or found == undamaged():
        return
    changed = {robot for robot in found.keys() | undamaged().keys()
               if found.get(robot) != undamaged().get(robot)}  # fmt: skip
    assert len(changed) <= 2  # a robot that was renamed is lost, and another stands there


def test_the_starts_of_a_configuration_need_both_angles():
    for name in ("alpha", "beta"):
        text = CONFIGURATION.replace(f"float {name};", f"float q{name};")
        assert read(lambda path: read_starts(path, POSITIONERS), "c.par", text) is None


# --- PFS: XML


def cobras(text):
    layout = read(read_layout, "cobras.xml", text)
    return None if layout is None else layout.plane


@given(k=st.integers(0, 3), tag=st.integers(0, 13), how=st.sampled_from(["drop", "name", "twice"]))
def test_an_element_that_is_lost_or_doubled_is_refused(k, tag, how):
    root = ElementTree.fromstring(COBRAS)
    parts = [(part, child) for part in root[k] for child in part]
    part, child = parts[tag % len(parts)]
    if how == "drop":
        part.remove(child)
    elif how == "name":
        child.tag += "q"
    else:
        part.append(ElementTree.fromstring(f"<{child.tag}>7</{child.tag}>"))
    plane = cobras(ElementTree.tostring(root, encoding="unicode"))
    if plane is not None:  # an element that is not read
        assert child.tag.rstrip("q") in ("Serial_Number", "Joint1_CW_limit_angle")
        assert np.array_equal(plane.limits, cobras(COBRAS).limits)


def test_a_container_under_another_name_is_refused():
    assert cobras(COBRAS.replace("ARM_DATA_CONTAINER", "ARM_DATA_CONTAINERS", 2)) is None
    assert cobras(COBRAS.replace("DATA_HEADER", "DATA_HEADERS", 2)) is None


@given(size=st.integers(1, len(COBRAS) - 12))
def test_a_file_of_cobras_that_ends_early_is_refused(size):
    assert cobras(COBRAS[:size]) is None


def test_an_interference_limit_of_a_cobra_that_is_not_there_is_named():
    table = (FOLDER / "pfs_interference.csv").read_text().replace("\n7,", "\n8,")
    layout = read(read_layout, "limits.csv", table, FOLDER / "pfs_cobras.xml")
    assert any("not there: [8]" in notice for notice in layout.notices), layout.notices


# --- MOONS and JUST: numbers without header


def without_target(row):
    """Whether a row of MOONS has the place that stands for no target, however it is written."""
    try:
        return [float(value) for value in row[2:4]] == [1e6, 1e6]
    except ValueError:
        return False


@given(
    name=st.sampled_from(["moons.txt", "just.csv"]),
    row=st.integers(0, 6),
    column=st.integers(0, 6),
    value=st.one_of(JUNK, st.sampled_from(["", "nan", "-1", "1_0", "1,5", "inf", "1e6"])),
)
def test_a_changed_number_is_refused_or_stands_as_it_is(name, row, column, value):
    text, mark = (ASSIGNMENT, None) if name == "moons.txt" else (SITES, ",")
    rows = [line.split(mark) for line in text.splitlines()]
    before = rows[row][column % len(rows[row])]
    rows[row][column % len(rows[row])] = value
    read_sites = partial(read_layout, preset="desi")
    reader = read_targets if name == "moons.txt" else read_sites
    found = read(reader, name, "\n".join((mark or " ").join(line) for line in rows) + "\n")
    if found is not None:  # the number stands where another one did
        assert np.isfinite(float(value)) and before != ""
        without = sum(without_target(row) for row in rows)
        ids = found.ids if name == "moons.txt" else found.plane.ids
        assert len(ids) == len(rows) - without


def test_a_negative_radius_is_refused():
    for radius in ("60", "73.2053"):
        assert read(read_targets, "moons.txt", ASSIGNMENT.replace(radius, f"-{radius}", 1)) is None


# --- FITS


def tile(**changes):
    columns = {
        "LOCATION": np.array([4001, 4002, 4003]),
        "FIBERASSIGN_X": np.array([1.0, 2.0, np.nan]),
        "FIBERASSIGN_Y": np.array([3.0, 4.0, np.nan]),
        "DEVICE_TYPE": np.array(["POS", "POS", "ETC"]),
        "TARGETID": np.array([2**61, 2**60, 5]),
    }
    table = Table({changes.get(name, name): values for name, values in columns.items()})
    hdus = fits.HDUList([fits.PrimaryHDU(), fits.table_to_hdu(table)])
    hdus[1].name = "FIBERASSIGN"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tile.fits"
        hdus.writeto(path)
        return path.read_bytes()


@given(
    name=st.sampled_from(["LOCATION", "FIBERASSIGN_X", "FIBERASSIGN_Y", "DEVICE_TYPE"]), new=JUNK
)
def test_a_renamed_column_of_a_tile_is_refused_or_named(name, new):
    if new.upper() in (name, "TARGETID"):
        return
    found = read(read_targets, "tile.fits", tile(**{name: new}))
    assert found is None or any(new in notice for notice in found.notices)


@given(at=st.integers(0, 5759), value=st.integers(0, 255))
def test_a_damaged_byte_of_a_header_is_refused_or_changes_nothing_unsaid(at, value):
    data = bytearray(tile())
    data[at] = value
    found, whole = (
        read(read_targets, "tile.fits", bytes(data)),
        read(read_targets, "t.fits", tile()),
    )
    if found is not None and places(found) != places(whole):
        assert set(found.notices) != set(whole.notices)

# SPDX-License-Identifier: Apache-2.0
"""Tables of instruments with columns renamed, dropped, reordered or encoded anew.

Each damage leaves one of three: the very same plane, a refusal, or a plane with a notice that the
undamaged table does not give.
"""

import csv
import gzip
import io
import string
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table
from hypothesis import given, settings
from hypothesis import strategies as st

from fiber_formats import FormatError, read_layout

FOLDER = Path(__file__).parent / "data"
SDSS = ("positionerTable", "wokCoords", "fiducialCoords", "gfaCoords")
INSTRUMENTS = {
    "calibration": ("desi_calibration.csv",),
    "state": ("desi_state.ecsv",),
    "sdss": tuple(f"sdss_{name}.csv" for name in SDSS),
    "pfs": ("pfs_cobras.xml", "pfs_interference.csv"),
}
TABLES = [
    (kind, name)
    for kind, files in INSTRUMENTS.items()
    for name in files
    if name != "pfs_cobras.xml"
]


@cache
def undamaged(name) -> Table:
    """Return a table as texts, with its header."""
    path = FOLDER / name
    if path.suffix == ".ecsv":
        return Table.read(path, format="ascii.ecsv")
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    head, *rows = csv.reader(lines)
    return Table(rows=rows, names=[key or "nameless" for key in head], dtype=["U99"] * len(head))


def written(name, table, mark=",", ending="\n", encoding="utf-8") -> bytes:
    """Return the bytes of a table, in the form of the file of that name."""
    out = io.StringIO()
    if name.endswith(".ecsv"):
        table.write(out, format="ascii.ecsv")
        return out.getvalue().encode()
    writer = csv.writer(out, delimiter=mark, lineterminator=ending)
    writer.writerow(["" if key == "nameless" else key for key in table.colnames])
    writer.writerows(table.iterrows())
    return out.getvalue().encode(encoding)


def read(kind, name=None, data=b""):
    """Read the files of an instrument, one of them with other bytes."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [FOLDER / other for other in INSTRUMENTS[kind]]
        if name is not None:
            paths[INSTRUMENTS[kind].index(name)] = Path(folder) / name
            (Path(folder) / name).write_bytes(data)
        return read_layout(paths)


@cache
def whole(kind):
    return read(kind)


def said(layout) -> set[str]:
    return {layout.summary, *layout.notices}


def is_same(plane, other) -> bool:
    rows, others = np.argsort(plane.ids), np.argsort(other.ids)
    plane, other = plane.permuted(rows), other.permuted(others)
    return all(
        np.array_equal(getattr(plane, field), getattr(other, field))
        for field in plane.__dataclass_fields__
        if field not in {"name", "address", "drive"}
    )


@pytest.mark.parametrize(("kind", "name"), TABLES)
@settings(max_examples=4)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_form_of_a_table_does_not_change_the_plane(kind, name, seed):
    table, rng = undamaged(name), np.random.default_rng(seed)
    order = rng.permutation(table.colnames).tolist()
    table = table[order][rng.permutation(len(table))]
    if name.endswith(".ecsv"):
        content = written(name, table)
    else:
        loud = [key for key in order if key != "nameless" and rng.random() < 0.5]
        for key in loud:
            table.rename_column(key, key.upper())
        content = written(
            name,
            table,
            str(rng.choice([",", ";", "\t"])),
            str(rng.choice(["\n", "\r\n"])),
            str(rng.choice(["utf-8", "utf-8-sig", "utf-16"])),
        )
    if rng.random() < 0.5:
        content = gzip.compress(content)
    layout = read(kind, name, content)
    assert is_same(layout.plane, whole(kind).plane)
    assert len(layout.notices) == len(whole(kind).notices), layout.notices


@pytest.mark.parametrize(("kind", "name"), TABLES)
@settings(max_examples=1)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_renamed_column_is_refused_or_named(kind, name, seed):
    table, rng = undamaged(name), np.random.default_rng(seed)
    for column in table.colnames:
        letters, at = "".join(rng.choice(list(string.ascii_lowercase), 7)), int(rng.integers(30))
        place = at % len(column)
        for other in (letters, column[:place] + "q" + column[place + 1 :]):
            if column == "nameless" or other.casefold() in map(str.casefold, table.colnames):
                continue
            renamed = table.copy()
            renamed.rename_column(column, other)
            try:
                layout = read(kind, name, written(name, renamed))
            except FormatError:
                continue
            assert any(other in notice for notice in layout.notices), (column, layout.notices)


@pytest.mark.parametrize(("kind", "name"), TABLES)
def test_a_dropped_column_is_refused_or_said(kind, name):
    table, refused = undamaged(name), 0
    for column in table.colnames:
        left = table.copy()
        left.remove_column(column)
        try:
            layout = read(kind, name, written(name, left))
        except FormatError:  # also of a column that only tells what file it is
            refused += 1
            continue
        if not is_same(layout.plane, whole(kind).plane):
            assert said(layout) - said(whole(kind)), f"nothing says that {column} is missing"
    assert refused > 0


@pytest.mark.parametrize("scale", ["SZ_CW_P", "SZ_CCW_P"])
def test_a_lost_scale_of_linear_motors_is_named(scale):
    name = "desi_calibration.csv"
    table = undamaged(name).copy()
    table["zeno_motor_p"] = ["True"] * len(table)
    for way in ("sz_cw_p", "sz_ccw_p"):
        table[way] = ["0.5"] * len(table)
    complete = read("calibration", name, written(name, table))
    assert not any(scale in notice for notice in complete.notices)
    table.remove_column(scale.lower())
    layout = read("calibration", name, written(name, table))
    assert any(f"no column {scale}" in notice for notice in layout.notices), layout.notices

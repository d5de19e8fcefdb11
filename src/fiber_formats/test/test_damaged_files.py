# SPDX-License-Identifier: Apache-2.0
"""Files that are no files, end early, or claim to be what they are not."""

import gzip
import os

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from fiber_core.presets import preset
from fiber_formats import (
    FormatError,
    read_layout,
    read_obstacles,
    read_results,
    read_starts,
    read_targets,
)


def starts_of(path):
    return read_starts(path, preset("desi", 3))


READERS = [read_layout, read_obstacles, read_targets, read_results, starts_of]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("name", ["absent.csv", "empty.csv", "noise.fits", "noise.ecsv", "a.xlsx"])
def test_a_file_that_is_no_table_is_refused(name, read, tmp_path):
    if name != "absent.csv":
        (tmp_path / name).write_bytes(b"" if "empty" in name else bytes(range(256)) * 20)
    with pytest.raises(FormatError, match=name):
        read(tmp_path / name)


@pytest.mark.parametrize("read", READERS)
def test_a_folder_and_a_pipe_are_refused(read, tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    for path in (tmp_path, tmp_path / "pipe.csv"):
        with pytest.raises(FormatError, match="is not a regular file"):
            read(path)


def test_names_that_name_nothing_are_refused(tmp_path):
    for name in ("", " , ", "\0"):
        with pytest.raises(FormatError):
            read_layout(name)
    with pytest.raises(FormatError, match="2 files are named, one is read"):
        (tmp_path / "a.csv").write_text("id,x_mm,y_mm\n1,2,3\n")
        (tmp_path / "b.csv").write_text("id,x_mm,y_mm\n1,2,3\n")
        read_targets(f"{tmp_path / 'a.csv'},{tmp_path / 'b.csv'}")


def test_a_comma_in_a_name_is_part_of_it_where_such_a_file_is(tmp_path):
    path = tmp_path / "a,b.csv"
    path.write_text("id,x_mm,y_mm\n1,2,3\n")
    assert read_targets(path).ids.tolist() == [1]


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "targets.fits"
    Table({"id": np.arange(500), "x_mm": np.ones(500), "y_mm": np.ones(500)}).write(path)
    return path


@pytest.mark.parametrize("size", [80, 2000, 2880, 4000, 8640, 12000])
def test_a_fits_file_that_ends_early_is_refused(table, size):
    table.write_bytes(table.read_bytes()[:size])
    with pytest.raises(FormatError, match="ends within|no table HDU"):
        read_targets(table)


def test_a_gzip_file_that_ends_early_or_is_damaged_is_refused(table):
    data = gzip.compress(table.read_bytes())
    path = table.with_suffix(".fits.gz")
    path.write_bytes(data[:-20])
    with pytest.raises(FormatError, match="without its end|cannot be unpacked"):
        read_targets(path)
    path.write_bytes(data[:500] + bytes(20) + data[520:])
    with pytest.raises(FormatError, match="targets.fits.gz"):
        read_targets(path)


def test_several_gzip_members_are_one_file(tmp_path):
    parts = [gzip.compress(text.encode()) for text in ("id,x_mm,y_mm\n1,2,3\n", "4,5,6\n")]
    (tmp_path / "targets.csv.gz").write_bytes(b"".join(parts))
    assert read_targets(tmp_path / "targets.csv.gz").ids.tolist() == [1, 4]


def test_a_fits_header_over_one_megabyte_is_refused(tmp_path):
    hdu = fits.table_to_hdu(Table({"id": [1], "x_mm": [1.0], "y_mm": [2.0]}))
    cards = "".join(f"{'COMMENT made up':<80}" for _ in range(14000)).encode()
    primary = fits.PrimaryHDU().header.tostring().encode()
    end = primary.index(b"END" + b" " * 77)
    text = primary[:end] + cards + primary[end : end + 80]
    text += b" " * (-len(text) % 2880)
    (tmp_path / "hdu.fits").write_bytes(b"")
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(tmp_path / "hdu.fits", overwrite=True)
    rest = (tmp_path / "hdu.fits").read_bytes()[len(primary) :]
    (tmp_path / "long.fits").write_bytes(text + rest)
    with pytest.raises(FormatError, match="the header of HDU 0 is over 1048576 bytes"):
        read_targets(tmp_path / "long.fits")


def test_two_fits_tables_of_the_same_kind_are_refused(tmp_path):
    one = fits.table_to_hdu(Table({"id": [1], "x_mm": [1.0], "y_mm": [2.0]}))
    fits.HDUList([fits.PrimaryHDU(), one, one.copy()]).writeto(tmp_path / "two.fits")
    with pytest.raises(FormatError, match="2 tables of the same kind: .*HDU 1, .*HDU 2"):
        read_targets(tmp_path / "two.fits")


def test_a_fits_column_that_stands_twice_is_refused(tmp_path):
    columns = [fits.Column(name, "D", array=[1.0]) for name in ("x_mm", "X_MM", "y_mm")]
    columns.append(fits.Column("id", "K", array=[1]))
    fits.BinTableHDU.from_columns(columns).writeto(tmp_path / "twice.fits")
    with pytest.raises(FormatError, match="a column stands twice"):
        read_targets(tmp_path / "twice.fits")


def test_rows_of_varying_length_are_refused_by_column(tmp_path):
    arrays = np.array([np.array([1.0]), np.array([1.0, 2.0])], dtype=object)
    columns = [
        fits.Column("id", "K", array=[1, 2]),
        fits.Column("x_mm", "PD()", array=arrays),
        fits.Column("y_mm", "D", array=[1.0, 2.0]),
    ]
    fits.BinTableHDU.from_columns(columns).writeto(tmp_path / "varying.fits")
    with pytest.raises(FormatError, match="column x_mm"):
        read_targets(tmp_path / "varying.fits")


@pytest.mark.parametrize(
    "old, new",
    [
        ("# datatype:", "# datatyp:"),
        ("name: x_mm", "nam: x_mm"),
        ("name: x_mm", "name: z_mm"),
        ("name: x_mm", "name: y_mm"),
        ("- {name: x_mm", "- [name: x_mm"),
    ],
)
def test_a_damaged_ecsv_header_is_refused(old, new, tmp_path):
    path = tmp_path / "targets.ecsv"
    Table({"id": [1, 2], "x_mm": [1.0, 2.0], "y_mm": [2.0, 3.0]}).write(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(FormatError, match="ECSV header"):
        read_targets(path)

# SPDX-License-Identifier: Apache-2.0
"""Files as bytes, text and tables, whatever their suffix: plain or gzip, text or FITS."""

import os
import re
import stat
import zlib
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from fiber_formats.errors import FormatError
from fiber_formats.fits_tables import fits_tables
from fiber_formats.table import Table, folded
from fiber_formats.text_tables import text_tables
from fiber_formats.yanny import is_yanny, yanny_tables

__all__ = ["DataFile", "Source"]

_MOST_BYTES = 1 << 29  # a file that unpacks to more is refused
_BLANK = re.compile(r"^\s*(#|$)")


class DataFile:
    """One file, unpacked if it is gzip by content.

    Args:
        path: a regular file.

    Raises:
        FormatError: there is no such file, it is a folder or a pipe, or it cannot be unpacked.
    """

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)
        self.data = _unpacked(self.path, _bytes_of(self.path))

    @property
    def name(self) -> str:
        """The path, as messages show it."""
        return str(self.path)

    @property
    def is_fits(self) -> bool:
        """Whether the content begins as FITS does."""
        return self.data.startswith(b"SIMPLE  =")

    @property
    def is_zip(self) -> bool:
        """Whether the content begins as a zip archive does, and so as .npz does."""
        return self.data.startswith(b"PK\x03\x04")

    @cached_property
    def text(self) -> str | None:
        """The content as text without byte order mark, None where it is not text."""
        if self.is_fits or self.is_zip:
            return None
        utf16 = self.data.startswith((b"\xff\xfe", b"\xfe\xff"))
        try:
            text = self.data.decode("utf-16" if utf16 else "utf-8-sig")
        except UnicodeDecodeError:
            return None
        return None if "\0" in text else text

    @cached_property
    def data_lines(self) -> list[str]:
        """Lines of the text without comments and blank lines; empty where it is not text."""
        lines = re.split(r"\r\n|\n|\r", self.text or "")
        return [line.strip() for line in lines if not _BLANK.match(line)]

    @property
    def tables(self) -> tuple[Table, ...]:
        """The tables in the file: one in a text, one a yanny structure, one a table HDU of FITS.

        Raises:
            FormatError: the content is no table; says why.
        """
        found = self._tables_or_error
        if isinstance(found, FormatError):
            raise found
        return found

    @cached_property
    def _tables_or_error(self) -> tuple[Table, ...] | FormatError:
        try:
            return self._read_tables()
        except FormatError as error:  # kept, as every format asks
            return error

    def _read_tables(self) -> tuple[Table, ...]:
        if self.is_fits:
            return fits_tables(self.name, self.data)
        if self.text is None:
            raise FormatError(
                f"{self.name} is neither UTF-8 text nor FITS"
                + ("" if self.is_zip else _first_odd_byte(self.data))
                + ": save it as CSV, ECSV or FITS"
                + " (a spreadsheet is a zip archive)" * self.is_zip
            )
        if is_yanny(self.text):
            return yanny_tables(self.name, self.text)
        return text_tables(self.name, self.text)

    def has_columns(self, *names: str) -> bool:
        """Return whether one table of the file has all these columns, whatever their case."""
        try:
            tables = self.tables
        except FormatError:
            return False
        return any(table.has(*names) for table in tables)

    def lacking(self, *names: str) -> tuple[str, ...]:
        """Return which of some columns are in no table, or not in that which has most of them."""
        try:
            tables = self.tables
        except FormatError:
            return names
        absent = [tuple(n for n in names if n not in table) for table in tables]
        return min(absent, key=len, default=names)

    def table_with(self, *names: str) -> Table:
        """Return the only table with these columns.

        Raises:
            FormatError: no table has them, or two tables do.
        """
        found = [table for table in self.tables if table.has(*names)]
        if len(found) > 1:
            where = ", ".join(table.label for table in found)
            raise FormatError(f"{self.name} has {len(found)} tables of the same kind: {where}")
        if found:
            return found[0]
        have = "; ".join(f"{table.label} has {', '.join(table.names)}" for table in self.tables)
        raise FormatError(f"{self.name} has no table with columns {', '.join(names)}: {have}")

    def likely_table(self, *names: str) -> Table:
        """Return the only table of the file, or of several the one with these columns.

        Raises:
            FormatError: as table_with.
        """
        tables = self.tables
        return tables[0] if len(tables) == 1 else self.table_with(*names)

    def other_tables(self, table: Table) -> tuple[str, ...]:
        """Return a notice of the tables that are not the given one; empty without any."""
        others = [other.label for other in self.tables if other is not table]
        return (f"tables not used: {', '.join(others)}",) if others else ()


class Source:
    """The files that together describe one thing, in the order in which they are named.

    Args:
        paths: one path, several joined by commas, or a sequence of paths.

    Raises:
        FormatError: as DataFile; or a file is named twice.
    """

    def __init__(self, paths: "str | os.PathLike[str] | Iterable[str | os.PathLike[str]]"):
        names = _names(paths)
        if not names:
            raise FormatError("no file is named")
        addresses = [name for name in names if "://" in name]
        if addresses:
            raise FormatError(f"{', '.join(addresses)}: fetch it first, only files are read")
        if len(set(names)) < len(names):
            raise FormatError(f"a file is named twice: {', '.join(names)}")
        self.files: tuple[DataFile, ...] = tuple(DataFile(name) for name in names)

    @property
    def name(self) -> str:
        """The paths, as messages show them."""
        return ",".join(file.name for file in self.files)

    @property
    def stem(self) -> str:
        """Name of the first file without its suffixes."""
        return re.sub(r"(\.(csv|ecsv|fits?|txt|par|xml|npz|gz))+$", "", self.files[0].path.name)

    @property
    def only(self) -> DataFile:
        """The file of a format that takes one.

        Raises:
            FormatError: there are several.
        """
        first, *others = self.files
        if others:
            raise FormatError(f"{self.name}: {len(self.files)} files are named, one is read")
        return first

    def with_columns(self, *names: str) -> DataFile | None:
        """Return the first file of which a table has these columns, None without one."""
        wanted = [folded(name) for name in names]
        return next((file for file in self.files if file.has_columns(*wanted)), None)


def _first_odd_byte(data: bytes) -> str:
    # where a text of another encoding ceases to be UTF-8
    try:
        data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        return f", line {line} holds the byte 0x{data[error.start]:02x}"
    return ", it holds zero bytes" if b"\0" in data else ""


def _names(paths: "str | os.PathLike[str] | Iterable[str | os.PathLike[str]]") -> list[str]:
    if not isinstance(paths, str | os.PathLike):
        return [os.fspath(path) for path in paths]
    name = os.fspath(paths)
    if os.path.lexists(name):
        return [name]
    return [part for part in (piece.strip() for piece in name.split(",")) if part]


def _bytes_of(path: Path) -> bytes:
    try:
        kind = os.stat(path).st_mode
        if not stat.S_ISREG(kind):
            raise FormatError(f"{path} is not a regular file")
        return path.read_bytes()
    except FileNotFoundError:
        raise FormatError(f"there is no file {path}") from None
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read: {error}") from None


def _unpacked(path: Path, data: bytes) -> bytes:
    if not data.startswith(b"\x1f\x8b"):
        return data
    parts, left, size = [], data, 0
    try:
        while left:
            unpacker = zlib.decompressobj(wbits=31)
            part = unpacker.decompress(left, _MOST_BYTES - size + 1)
            size += len(part)
            if size > _MOST_BYTES:
                raise FormatError(f"{path} unpacks to more than {_MOST_BYTES >> 20} MB")
            if not unpacker.eof:
                raise FormatError(f"{path} is a gzip file without its end")
            parts.append(part)
            left = unpacker.unused_data.lstrip(b"\0")
    except zlib.error as error:
        raise FormatError(f"{path} cannot be unpacked: {error}") from None
    return b"".join(parts)

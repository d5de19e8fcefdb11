# SPDX-License-Identifier: Apache-2.0
"""Tables of a FITS file: every binary or text table HDU."""

import io
import re
import warnings

import numpy as np

from fiber_formats.errors import FormatError
from fiber_formats.table import Column, Table

__all__ = ["fits_tables"]

_BLOCK = 2880
_MOST_HEADER = 1 << 20


def fits_tables(name: str, data: bytes) -> tuple[Table, ...]:
    """Return all tables of a FITS file.

    Args:
        name: path of the file, for messages.
        data: its content.

    Raises:
        FormatError: a header is over 1 MB, the file ends early, or it has no table.
    """
    _check_size(name, data)
    from astropy.io import fits  # slow to import
    from astropy.table import Table as AstropyTable

    tables = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with fits.open(io.BytesIO(data), memmap=False) as hdus:
                for number, hdu in enumerate(hdus):
                    if not isinstance(hdu, fits.BinTableHDU | fits.TableHDU):
                        continue
                    label = f"{name} HDU {number}" + (f" {hdu.name}" if hdu.name else "")
                    names = [str(column.name) for column in hdu.columns]
                    if len({text.casefold() for text in names}) < len(names):
                        raise FormatError(f"{label}: a column stands twice: {', '.join(names)}")
                    columns = AstropyTable.read(hdu)
                    tables.append(Table(label, [_column(columns[key]) for key in columns.colnames]))
    except FormatError:
        raise
    except Exception as error:  # damaged files raise errors of many types
        raise FormatError(f"{name} cannot be read as FITS: {error}") from None
    if not tables:
        raise FormatError(f"{name} has no table HDU")
    return tuple(tables)


def _column(column) -> Column:  # an astropy Column or MaskedColumn
    masked = np.asarray(np.ma.getmaskarray(column))
    values = np.ma.getdata(np.asarray(column) if not masked.any() else column.data)
    if values.dtype.kind == "S":
        values = np.char.strip(np.char.decode(values, "ascii", "replace"))
    missing = masked.copy()
    if values.ndim > 1:
        missing = np.asarray(masked.reshape(len(values), -1).all(axis=1))
    if values.ndim == 1 and values.dtype.kind == "f":
        missing = missing | np.isnan(values)
    if values.ndim == 1 and values.dtype.kind == "U":
        missing = missing | (values == "")
    unit = None if column.unit is None else str(column.unit)
    return Column(str(column.name), values, missing, unit)


def _check_size(name: str, data: bytes) -> None:
    # Headers are blocks of 2880 bytes that end with the card END; data follow in whole blocks.
    start, number = 0, 0
    while start < len(data) and data[start : start + _BLOCK].strip(b"\0 "):
        size, header_end = _header(name, number, data, start)
        end = header_end + -(-size // _BLOCK) * _BLOCK
        if header_end + size > len(data):
            raise FormatError(
                f"{name} ends within HDU {number}: {len(data)} bytes of {header_end + size}"
            )
        start, number = end, number + 1


def _header(name: str, number: int, data: bytes, start: int) -> tuple[int, int]:
    for first in range(start, min(len(data), start + _MOST_HEADER), _BLOCK):
        cards = [data[at : at + 80] for at in range(first, first + _BLOCK, 80)]
        if any(card.rstrip() == b"END" for card in cards):
            text = data[start : first + _BLOCK]
            return _data_size(text), first + _BLOCK
    if len(data) - start > _MOST_HEADER:
        raise FormatError(f"{name}: the header of HDU {number} is over {_MOST_HEADER} bytes")
    raise FormatError(f"{name} ends within the header of HDU {number}")


def _data_size(header: bytes) -> int:
    def value(key: bytes, otherwise: int) -> int:
        for at in range(0, len(header), 80):
            card = header[at : at + 80]
            found = re.match(key.ljust(8) + rb"= *(-?\d+)", card)
            if found:
                return int(found.group(1))
        return otherwise

    axes = [value(b"NAXIS%d" % k, 0) for k in range(1, value(b"NAXIS", 0) + 1)]
    elements = int(np.prod([int(axis) for axis in axes], dtype=object)) if axes else 0
    return abs(value(b"BITPIX", 8)) // 8 * value(b"GCOUNT", 1) * (value(b"PCOUNT", 0) + elements)

# SPDX-License-Identifier: Apache-2.0
"""Write tables as CSV, ECSV or FITS, plain or gzip, by the suffix of the path."""

import gzip
import io
import os
import warnings
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiber_formats.errors import FormatError

__all__ = ["check_width", "kind_of", "write_table", "write_whole"]

_KINDS = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits", ".fit": "fits"}
_UNITS = {"_deg_s2": "deg / s2", "_deg_s": "deg / s", "_deg": "deg", "_mm": "mm", "_um": "um"}


def kind_of(path: str | os.PathLike[str]) -> str:
    """Return how astropy calls the kind of table that a path names.

    Raises:
        FormatError: the suffix is none of .csv, .ecsv, .fits, .fit, with or without .gz.
    """
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    if suffixes and suffixes[-1] == ".gz":
        suffixes.pop()
    kind = _KINDS.get(suffixes[-1]) if suffixes else None
    if kind is None:
        raise FormatError(f"{path}: a table is written as {', '.join(_KINDS)}, also with .gz")
    return kind


def check_width(path: str | os.PathLike[str], wide: Collection[str]) -> None:
    """Check that a table with columns of several numbers a row can be written to a path.

    Args:
        path: where to.
        wide: names of such columns.

    Raises:
        FormatError: the suffix is not known, or it is that of CSV and there are such columns.
    """
    if kind_of(path) == "ascii.csv" and wide:
        raise FormatError(
            f"{path}: {', '.join(wide)} has several numbers a row: write ECSV or FITS"
        )


def write_table(path: str | os.PathLike[str], columns: Mapping[str, NDArray]) -> None:
    """Write columns of equal length; units in the names go into ECSV and FITS as well.

    Args:
        path: where to; an existing file is replaced.
        columns: arrays by name.

    Raises:
        FormatError: the suffix is not known, or the file cannot be written.
    """
    kind = kind_of(path)
    from astropy.table import Table  # slow to import

    check_width(path, [name for name, values in columns.items() if np.ndim(values) > 1])
    table = Table({name: np.asarray(values) for name, values in columns.items()})
    for name in columns:
        unit = next((_UNITS[end] for end in _UNITS if name.endswith(end)), None)
        if unit is not None and kind != "ascii.csv":
            table[name].unit = unit
    data = io.BytesIO() if kind == "fits" else io.StringIO()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table.write(data, format=kind)
    except (OSError, ValueError, TypeError) as error:
        raise FormatError(f"{path} cannot be written: {error}") from None
    content = data.getvalue()
    write_whole(path, content if isinstance(content, bytes) else content.encode())


def write_whole(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file, compressed if its suffix is .gz; what was there is replaced as a whole.

    Args:
        path: where to.
        content: what the file holds when it is not compressed.

    Raises:
        FormatError: the file cannot be written.
    """
    if Path(path).suffix.lower() == ".gz":
        content = gzip.compress(content, mtime=0)
    partial = Path(f"{os.fspath(path)}.partial")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        raise FormatError(f"{path} cannot be written: {error}") from None

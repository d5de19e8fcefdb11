# SPDX-License-Identifier: Apache-2.0
"""JUST: sites of the robots, three numbers a row without header.

The first number is the same in every row and has no documented meaning; the others are x and y
[mm]. The file has no arms: a preset must be named.
"""

import numpy as np

from fiber_formats.errors import FormatError
from fiber_formats.formats.numbers import numbers_of
from fiber_formats.interface import Format
from fiber_formats.records import LayoutColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]

_FEWEST = 3  # fewer rows tell too little


def matches(source: Source) -> bool:
    """Return whether the one file has three numbers a row, the first constant and not whole.

    A column of ids, which a table without header would have, is neither.
    """
    rows = numbers_of(source.files[0], 3) if len(source.files) == 1 else None
    if rows is None or len(rows) < _FEWEST:
        return False
    first = rows[:, 0]
    return bool(np.all(first == first[0]) and first[0] != np.rint(first[0]))


def layout(source: Source) -> LayoutColumns:
    """Read the places of the robots."""
    rows = numbers_of(source.only, 3)
    if rows is None:
        raise FormatError(f"{source.name} has not three numbers in each row")
    found = {"id": np.arange(len(rows)), "x_mm": rows[:, 1], "y_mm": rows[:, 2]}
    notices = (
        "no ids: robots have the numbers of their rows, from 0",
        f"the first column, {rows[0, 0]} in every row, is not used",
    )
    return LayoutColumns(found, notices=notices)


FORMAT = Format("JUST sites", matches, layout=layout)

# SPDX-License-Identifier: Apache-2.0
"""DESI: targets of a fiberassign tile, FITS or a table with the same columns.

A row has no target where FIBERASSIGN_X and FIBERASSIGN_Y are not numbers. DEVICE_TYPE, where it
is there, tells rows that are no positioners.
"""

import numpy as np

from fiber_formats.columns import Columns
from fiber_formats.interface import Format
from fiber_formats.records import TargetColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]

_SIGN = ("LOCATION", "FIBERASSIGN_X", "FIBERASSIGN_Y")


def matches(source: Source) -> bool:
    """Return whether one table of the one file has the columns of a tile."""
    return len(source.files) == 1 and source.files[0].has_columns(*_SIGN)


def targets(source: Source) -> TargetColumns:
    """Read where the fibres of a tile go."""
    table = source.only.table_with(*_SIGN)
    notices = source.only.other_tables(table)
    keep = None
    if "DEVICE_TYPE" in table:
        every = Columns(table)
        keep = every.words("DEVICE_TYPE") == "POS"
        every.check()
        if not keep.all():
            notices += (f"{np.count_nonzero(~keep)} rows are no positioners and are not used",)
    columns = Columns(table, keep)
    if "DEVICE_TYPE" in table:
        columns.words("DEVICE_TYPE")
    ids = columns.ids("LOCATION")
    x_mm = columns.numbers("FIBERASSIGN_X", "mm", missing=True)
    y_mm = columns.numbers("FIBERASSIGN_Y", "mm", missing=True)
    half = np.isnan(x_mm) != np.isnan(y_mm)
    columns.refuse_rows(half, "FIBERASSIGN_X", "and FIBERASSIGN_Y must both be given or missing")
    columns.check()
    xy_mm = np.stack([x_mm, y_mm], axis=1)
    return TargetColumns(ids, xy_mm, notices + columns.unused_notice())


FORMAT = Format("DESI fiberassign tile", matches, targets=targets, signs=(_SIGN,))

# SPDX-License-Identifier: Apache-2.0
"""DESI: targets of a fiberassign tile, FITS or a table with the same columns.

fiberassign gives a fibre without target a negative TARGETID, bit 0 of FIBERSTATUS, and the centre
of its robot as FIBERASSIGN_X and FIBERASSIGN_Y. A row has no target where TARGETID is negative, in
a table without TARGETID where the bit is set, and where the place is not a number. DEVICE_TYPE,
where it is there, tells rows that are no positioners. Of the tables of a merged file FIBERASSIGN
counts, before FASSIGN, its copy of the raw assignment; SKY_MONITOR has the same columns for the
fibres of the exposure-time calculator.
"""

import numpy as np

from fiber_core.array_types import Bools
from fiber_formats.columns import Columns
from fiber_formats.interface import Format
from fiber_formats.records import TargetColumns
from fiber_formats.source import DataFile, Source
from fiber_formats.table import Table

__all__ = ["FORMAT"]

_SIGN = ("LOCATION", "FIBERASSIGN_X", "FIBERASSIGN_Y")
_TABLES = ("FIBERASSIGN", "FASSIGN")  # HDUs of the assignment, that which counts first
_UNASSIGNED = 1  # bit of FIBERSTATUS


def matches(source: Source) -> bool:
    """Return whether one table of the one file has the columns of a tile."""
    return len(source.files) == 1 and source.files[0].has_columns(*_SIGN)


def targets(source: Source) -> TargetColumns:
    """Read where the fibres of a tile go."""
    table = _assignment(source.only)
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
    unassigned, more = _unassigned(columns)
    columns.check()
    xy_mm = np.stack([x_mm, y_mm], axis=1)
    xy_mm[unassigned] = np.nan
    notices += more + columns.absent_notice() + columns.unused_notice()
    return TargetColumns(ids, xy_mm, notices)


def _assignment(file: DataFile) -> Table:
    found = [table for table in file.tables if table.has(*_SIGN)]
    for name in _TABLES:
        named = [table for table in found if table.label.endswith(f" {name}")]
        if len(named) == 1:
            return named[0]
    return file.table_with(*_SIGN)


def _unassigned(columns: Columns) -> tuple[Bools, tuple[str, ...]]:
    # rows that fiberassign marks as without target; a TARGETID that is missing is none either
    marked = np.zeros(len(columns), dtype=bool)
    if columns.optional("FIBERSTATUS"):
        marked = (columns.whole("FIBERSTATUS", otherwise=0) & _UNASSIGNED) != 0
    if not columns.optional("TARGETID"):
        return marked, ()
    unassigned = ~(columns.numbers("TARGETID", missing=True) >= 0)  # nan is not
    doubtful = np.count_nonzero(marked & ~unassigned)
    if not doubtful:
        return unassigned, ()
    return unassigned, (
        f"{doubtful} rows have a TARGETID and the bit of FIBERSTATUS for unassigned: they are "
        "taken as targets",
    )


FORMAT = Format("DESI fiberassign tile", matches, targets=targets, signs=(_SIGN,))

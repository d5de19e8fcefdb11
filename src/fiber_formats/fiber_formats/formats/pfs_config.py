# SPDX-License-Identifier: Apache-2.0
"""PFS: targets of a pfsConfig or pfsDesign: pfiNominal [mm] of each cobraId.

A row with a pfiNominal that is not a number has no target; a row without cobraId, or with one from
65533 to 65535, is a fibre that no robot carries.
"""

import numpy as np

from fiber_formats.columns import Columns
from fiber_formats.interface import Format
from fiber_formats.records import TargetColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]

_SIGN = ("fiberId", "objId", "catId")
_MOST_COBRA = 65532  # above: engineering fibres, not connected, not set
_NO_COBRA = 65535


def matches(source: Source) -> bool:
    """Return whether a table of the one file has the columns that every pfsConfig has."""
    return len(source.files) == 1 and source.files[0].has_columns(*_SIGN)


def targets(source: Source) -> TargetColumns:
    """Read where the fibres of the design go."""
    table = source.only.table_with(*_SIGN)
    every = Columns(table)
    cobras = every.whole("cobraId", least=0, most=_NO_COBRA, otherwise=_NO_COBRA)
    every.vectors("pfiNominal", 2, "mm")
    every.check()
    columns = Columns(table, keep=cobras <= _MOST_COBRA)
    ids = columns.ids("cobraId")
    xy_mm = columns.vectors("pfiNominal", 2, "mm")
    half = np.isnan(xy_mm[:, 0]) != np.isnan(xy_mm[:, 1])
    columns.refuse_rows(half, "pfiNominal", "has one number of two")
    columns.check()
    notices = source.only.other_tables(table)
    engineering = np.count_nonzero(cobras > _MOST_COBRA)
    if engineering:
        notices += (f"{engineering} fibres have no cobra and are not used",)
    return TargetColumns(ids, xy_mm, notices + columns.unused_notice())


FORMAT = Format("PFS pfsConfig", matches, targets=targets, signs=(_SIGN,))

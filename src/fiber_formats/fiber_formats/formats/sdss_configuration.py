# SPDX-License-Identifier: Apache-2.0
"""SDSS-V: confSummary, a yanny file with three rows a robot, one for each fibre.

The start of a robot are alpha and beta, counted from the lower stops of its joints. A robot has a
target if one of its fibres is assigned; the target is where the metrology fibre then is, because
the metrology fibre is the tip of our planes. -999 stands for a value that is missing.
"""

import numpy as np

from fiber_core.array_types import Bools
from fiber_formats.columns import Columns
from fiber_formats.interface import Format
from fiber_formats.records import StartColumns, TargetColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]

_SIGN = ("positionerId", "fiberType", "assigned", "xwok", "ywok", "alpha", "beta")
_MISSING = -999.0


def matches(source: Source) -> bool:
    """Return whether the one file has the structure of a confSummary."""
    return len(source.files) == 1 and source.files[0].has_columns(*_SIGN)


def starts(source: Source) -> StartColumns:
    """Read alpha and beta."""
    every, kinds = _fibres(source)
    columns = Columns(every.table, keep=kinds == "METROLOGY")
    ids = columns.ids("positionerId")
    angles = [columns.numbers(name, "deg", missing=True) for name in ("alpha", "beta")]
    columns.check()
    angles_deg = np.stack(angles, axis=1)
    angles_deg[(angles_deg == _MISSING).any(axis=1)] = np.nan
    return StartColumns(ids, angles_deg, from_lower_stop=True)


def targets(source: Source) -> TargetColumns:
    """Read where the metrology fibre of each robot with an assigned fibre is."""
    every, kinds = _fibres(source)
    robots = every.whole("positionerId")
    assigned = every.flags("assigned")
    every.check()
    columns = Columns(every.table, keep=kinds == "METROLOGY")
    ids = columns.ids("positionerId")
    xy_mm = np.stack([columns.numbers(k, "mm", missing=True) for k in ("xwok", "ywok")], axis=1)
    columns.check()
    xy_mm[(xy_mm == _MISSING).any(axis=1)] = np.nan
    half = np.isnan(xy_mm[:, 0]) != np.isnan(xy_mm[:, 1])
    columns.refuse_rows(half, "xwok", "and ywok must both be given or both be missing")
    columns.check()
    xy_mm[~np.isin(ids, robots[assigned])] = np.nan
    counts = [
        f"{np.count_nonzero(_served(robots, assigned & (kinds == kind), ids, xy_mm))} for {kind}"
        for kind in ("BOSS", "APOGEE")
    ]
    notices = (f"targets are places of the metrology fibre: {', '.join(counts)}",)
    for name in ("fiberType", "assigned", "alpha", "beta"):
        columns.words(name, missing=True)
    return TargetColumns(ids, xy_mm, notices + columns.unused_notice())


def _fibres(source: Source) -> tuple[Columns, np.ndarray]:
    columns = Columns(source.only.table_with(*_SIGN))
    kinds = columns.words("fiberType")
    bad = ~np.isin(kinds, ("BOSS", "APOGEE", "METROLOGY"))
    columns.refuse_rows(bad, "fiberType", "is not a fibre of a robot")
    columns.check()
    return columns, kinds


def _served(robots: np.ndarray, fibres: Bools, ids: np.ndarray, xy_mm: np.ndarray) -> Bools:
    return np.isin(ids, robots[fibres]) & np.isfinite(xy_mm).all(axis=1)


FORMAT = Format("SDSS-V confSummary", matches, starts=starts, targets=targets)

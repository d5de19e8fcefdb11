# SPDX-License-Identifier: Apache-2.0
"""SDSS-V: confSummary, a yanny file with three rows a robot, one for each fibre.

The start of a robot are alpha and beta, counted from the lower stops of its joints. A robot has a
target if one of its fibres is assigned: the place of that fibre, and on a plane that does not know
its fibres that of the metrology fibre, which is the tip. -999 stands for a value that is missing.
"""

import numpy as np

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
    """Read where the assigned fibre of each robot is, and its metrology fibre."""
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
    xy_mm[~np.isin(ids, robots[assigned])] = np.nan
    served = Columns(every.table, keep=assigned & (kinds != "METROLOGY"))
    places = np.stack([served.numbers(k, "mm", missing=True) for k in ("xwok", "ywok")], axis=1)
    places[(places == _MISSING).any(axis=1)] = np.nan
    rows = {robot: k for k, robot in enumerate(robots[assigned & (kinds != "METROLOGY")].tolist())}
    if len(rows) < len(served):
        served.refuse_rows(
            np.array([rows[r] != k for k, r in enumerate(served.whole("positionerId").tolist())]),
            "assigned",
            "holds for two fibres of one robot",
        )
    served.check()
    columns.check()
    row = np.array([rows.get(robot, -1) for robot in ids.tolist()], dtype=int)
    own_mm, fibre = np.full(xy_mm.shape, np.nan), np.full(len(ids), "", dtype="U9")
    own_mm[row >= 0] = places[row[row >= 0]]
    own_mm[np.isnan(xy_mm).any(axis=1)] = np.nan  # the instrument found no angles for it
    fibre[row >= 0] = served.words("fiberType")[row[row >= 0]]
    fibre[np.isnan(own_mm).any(axis=1)] = ""
    counts = [f"{np.count_nonzero(fibre == kind)} for {kind}" for kind in ("BOSS", "APOGEE")]
    notices = (f"targets: {', '.join(counts)}",)
    for name in ("fiberType", "assigned", "alpha", "beta"):
        columns.words(name, missing=True)
    return TargetColumns(ids, own_mm, notices + columns.unused_notice(), fibre, xy_mm)


def _fibres(source: Source) -> tuple[Columns, np.ndarray]:
    columns = Columns(source.only.table_with(*_SIGN))
    kinds = columns.words("fiberType")
    bad = ~np.isin(kinds, ("BOSS", "APOGEE", "METROLOGY"))
    columns.refuse_rows(bad, "fiberType", "is not a fibre of a robot")
    columns.check()
    return columns, kinds


FORMAT = Format("SDSS-V confSummary", matches, starts=starts, targets=targets, signs=(_SIGN,))

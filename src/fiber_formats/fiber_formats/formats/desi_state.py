# SPDX-License-Identifier: Apache-2.0
"""DESI: state of the whole plane on one night (`fp-*.ecsv` of desihub/fpoffline).

Robots are the rows of DEVICE_TYPE POS; starts are also those of ETC, which a calibration holds as
robots. The zero of theta is OFFSET_T in the frame of the petal,
which is turned by 36 (PETAL_LOC - 3) degrees. Present angles are POS_T and POS_P, counted from
that zero and from OFFSET_P: tips from them lie 58 um (median) from the observed ones.
"""

import numpy as np

from fiber_core.array_types import Ids, Ints
from fiber_formats.columns import Columns
from fiber_formats.formats.desi_frame import motor_notices, petal_angle_deg
from fiber_formats.formats.desi_keepouts import (
    expanded_outlines,
    file_outlines,
    file_walls,
    polygons_of,
)
from fiber_formats.interface import Format
from fiber_formats.records import LayoutColumns, StartColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]

_SIGN = ("LOCATION", "X_FP", "Y_FP", "DEVICE_TYPE", "LENGTH_R1", "OFFSET_T", "POS_T")
_NO_BUS = -1


def matches(source: Source) -> bool:
    """Return whether the one file is a table with the columns of a state."""
    return len(source.files) == 1 and source.files[0].has_columns(*_SIGN)


def layout(source: Source) -> LayoutColumns:
    """Read the positioners; disabled are those with DEVICE_CLASSIFIED_NONFUNCTIONAL."""
    columns, notices = _positioners(source, "POS")
    ids, petal = _ids_and_petals(columns)
    bus = columns.whole("BUS_ID", otherwise=_NO_BUS)
    found = {
        "id": ids,
        "x_mm": columns.numbers("X_FP", "mm"),
        "y_mm": columns.numbers("Y_FP", "mm"),
        "arm_theta_mm": columns.numbers("LENGTH_R1", "mm"),
        "arm_phi_mm": columns.numbers("LENGTH_R2", "mm"),
        "theta_zero_deg": columns.numbers("OFFSET_T", "deg") + petal_angle_deg(petal),
        "phi_zero_deg": columns.numbers("OFFSET_P", "deg"),
        "theta_range_deg": columns.numbers("PHYSICAL_RANGE_T", "deg"),
        "phi_range_deg": columns.numbers("PHYSICAL_RANGE_P", "deg"),
        "enabled": ~columns.flags("DEVICE_CLASSIFIED_NONFUNCTIONAL"),
        "petal": petal,
        "bus": bus,
    }
    arms = np.stack([found["arm_theta_mm"], found["arm_phi_mm"]], axis=1)
    polygons = polygons_of(source.only.text or "")
    outlines = file_outlines(columns, polygons)
    linear = (
        columns.flags("LINPHI")
        if columns.optional("LINPHI")
        else np.zeros(len(columns), dtype=bool)
    )
    expanded, more = expanded_outlines(columns, arms, linear)  # asks the columns in any case
    notices += motor_notices(columns) + (() if outlines else more)
    columns.check()
    centers = np.stack([found["x_mm"], found["y_mm"]], axis=1)
    walls, more = file_walls(columns.every(), polygons, petal, centers)
    notices += more
    if np.any(bus == _NO_BUS):
        notices += (
            f"{np.count_nonzero(bus == _NO_BUS)} robots have no BUS_ID: those of a petal are put "
            "on a bus of their own",
        )
    notices += columns.absent_notice() + columns.unused_notice()
    found |= outlines or expanded
    return LayoutColumns(found, preset="desi_outlines", notices=notices, walls=walls)


def starts(source: Source) -> StartColumns:
    """Read the angles after the last move of the night."""
    columns, notices = _positioners(source, "POS", "ETC")
    ids, petal = _ids_and_petals(columns)
    theta = columns.numbers("POS_T", "deg", missing=True) + columns.numbers("OFFSET_T", "deg")
    phi = columns.numbers("POS_P", "deg", missing=True) + columns.numbers("OFFSET_P", "deg")
    columns.check()
    angles = np.stack([theta + petal_angle_deg(petal), phi], axis=1)
    return StartColumns(ids, angles, notices=notices)


def _ids_and_petals(columns: Columns) -> tuple[Ids, Ints]:
    # a wrong petal would turn the zero of theta by multiples of 36 degrees
    petal = columns.whole("PETAL_LOC", least=0, most=9, what="is not a petal from 0 to 9")
    ids = columns.ids("LOCATION")
    columns.refuse_rows(ids // 1000 != petal, "PETAL_LOC", "is not the thousands of LOCATION")
    return ids, petal


def _positioners(source: Source, *robots: str) -> tuple[Columns, tuple[str, ...]]:
    # the rows of some types, and which others there are
    table = source.only.table_with(*_SIGN)
    every = Columns(table)
    kinds = every.words("DEVICE_TYPE")
    every.check()
    wanted = np.isin(kinds, robots)
    columns = Columns(table, keep=wanted)
    columns.words("DEVICE_TYPE")
    others, counts = np.unique(kinds[~wanted], return_counts=True)
    if not len(others):
        return columns, ()
    listed = ", ".join(f"{count} {kind}" for kind, count in zip(others, counts))
    return columns, (f"rows that are no robots and are not used: {listed}",)


FORMAT = Format("DESI state", matches, layout=layout, starts=starts, signs=(_SIGN,))

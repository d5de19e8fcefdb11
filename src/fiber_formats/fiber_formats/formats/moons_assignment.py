# SPDX-License-Identifier: Apache-2.0
"""MOONS: an assignment of robots to targets, seven numbers a row without header.

Radius [mm] and angle [deg] of the robot, radius and angle of its target, three flags. 1000000
stands for no target. Rows have no ids: robots have the numbers of their rows, from 0.
"""

import numpy as np

from fiber_core.array_types import Floats, Points
from fiber_formats.errors import FormatError
from fiber_formats.formats.numbers import numbers_of
from fiber_formats.interface import Format
from fiber_formats.records import LayoutColumns, TargetColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]

_COLUMNS = 7
_NO_TARGET = 1e6
_NOTICES = (
    "no ids: robots have the numbers of their rows, from 0",
    "the last three columns, flags, are not used",
)


def matches(source: Source) -> bool:
    """Return whether the one file has seven numbers a row, of which the last three are flags."""
    rows = numbers_of(source.files[0], _COLUMNS) if len(source.files) == 1 else None
    return rows is not None and bool(np.isin(rows[:, 4:], (0, 1)).all())


def layout(source: Source) -> LayoutColumns:
    """Read the places of the robots."""
    rows = _rows(source)
    x_mm, y_mm = _points(rows[:, 0], rows[:, 1]).T
    found = {"id": np.arange(len(rows)), "x_mm": x_mm, "y_mm": y_mm}
    return LayoutColumns(found, preset="moons", notices=_NOTICES)


def targets(source: Source) -> TargetColumns:
    """Read the targets of the robots."""
    rows = _rows(source)
    none = rows[:, 2:4] == _NO_TARGET
    half = none.any(axis=1) & ~none.all(axis=1)
    if half.any():
        at = int(np.argmax(half))
        raise FormatError(f"{source.name}: robot {at}: half a target: {rows[at, 2:4].tolist()}")
    xy_mm = _points(rows[:, 2], rows[:, 3])
    xy_mm[none.all(axis=1)] = np.nan
    return TargetColumns(np.arange(len(rows)), xy_mm, _NOTICES)


def _rows(source: Source) -> Floats:
    rows = numbers_of(source.only, _COLUMNS)
    if rows is None:
        raise FormatError(f"{source.name} has not {_COLUMNS} numbers in each row")
    negative = (rows[:, [0, 2]] < 0.0).any(axis=1)
    if negative.any():
        at = int(np.argmax(negative))
        raise FormatError(f"{source.name}: robot {at}: a radius is negative: {rows[at].tolist()}")
    return rows


def _points(radius_mm: Floats, angle_deg: Floats) -> Points:
    angle = np.deg2rad(angle_deg)
    return np.stack([radius_mm * np.cos(angle), radius_mm * np.sin(angle)], axis=1)


FORMAT = Format("MOONS assignment", matches, layout=layout, targets=targets)

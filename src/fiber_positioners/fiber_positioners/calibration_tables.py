# SPDX-License-Identifier: Apache-2.0
"""Tables of a calibration: the points, the history of places, and what was fitted to it."""

import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Angles, Bools, Codes, Floats, Ids, Points, Rows
from fiber_core.focal_plane import FocalPlane
from fiber_formats import FormatError, read_columns, write_table
from fiber_metrology import NUMBERS, Calibration, GearVerdict, Trend

__all__ = [
    "counts_of",
    "draw_trend",
    "fits_of",
    "layout_changes",
    "read_history",
    "write_fit",
    "write_points",
    "write_trend",
]

_DPI = 150
# angles are in degrees in files
_FILE_NAMES = tuple(name.replace("_rad", "_deg") for name in NUMBERS)
_FACTORS = np.array([np.rad2deg(1.0) if name.endswith("_rad") else 1.0 for name in NUMBERS])


def write_points(path: str | os.PathLike[str], plane: FocalPlane, counters: Angles) -> None:
    """Write the points that robots shall go to: point, id, theta_deg, phi_deg.

    Args:
        path: the table.
        plane: the focal plane.
        counters: joint angles at the start and at every point [rad], shape (p + 1, n, 2).
    """
    p, n = counters.shape[:2]
    theta, phi = np.rad2deg(counters).reshape(-1, 2).T
    columns = {
        "point": np.repeat(np.arange(p), n), "id": np.tile(plane.ids, p),
        "theta_deg": theta, "phi_deg": phi,
    }  # fmt: skip
    write_table(path, columns)


def read_history(path: str | os.PathLike[str], plane: FocalPlane) -> tuple[Angles, Points, Bools]:
    """Read a history: point, id, theta_deg and phi_deg as ordered, x_mm and y_mm as measured.

    Point 0 is the start; its place is not used. A place that was not measured is empty. Robots
    without rows are not calibrated.

    Args:
        path: the table.
        plane: the focal plane.

    Returns:
        Counters [rad], shape (p + 1, n, 2), places [mm], shape (p, n, 2), and the robots with rows.

    Raises:
        FormatError: a column is missing, a value is refused, a robot is not of the plane, or lacks
            a point or has it twice; names robot and point.
    """
    columns = read_columns(path, "point", "id", "theta_deg", "phi_deg")
    point, ids = columns.whole("point", 0, 100_000), columns.whole("id", 0, 2**32 - 1)
    angles = np.deg2rad(np.stack([columns.numbers(f"{j}_deg", "deg") for j in ("theta", "phi")], 1))
    xy_mm = np.stack([columns.numbers(f"{a}_mm", "mm", missing=True) for a in "xy"], axis=1)
    columns.check()
    rows = plane.index_of(ids)
    if (rows < 0).any():
        raise FormatError(f"{path}: robot {ids[rows < 0][0]} is not of this plane")
    points = int(point.max(initial=0)) + 1
    count = np.zeros((points, plane.n), dtype=np.int64)
    np.add.at(count, (point, rows), 1)
    there = np.any(count > 0, axis=0)
    wrong = np.argwhere((count != 1) & there)
    if len(wrong):
        at, row = wrong[0]
        raise FormatError(
            f"{path}: robot {plane.ids[row]} has point {at} {count[at, row]} times, expected once"
        )
    counters = np.zeros((points, plane.n, 2))
    places = np.full((points, plane.n, 2), np.nan)
    counters[point, rows], places[point, rows] = angles, xy_mm
    return counters, places[1:], there


def layout_changes(plane: FocalPlane, found: Calibration) -> dict[str, NDArray]:
    """Return what a calibration changes in the table of a layout, by the names of its columns.

    Robots that keep to no model stay as they were; zeros turn the ranges of joints.

    Args:
        plane: the plane that was calibrated.
        found: its calibration.
    """
    new, drive = found.applied_to(plane), plane.drive
    good = np.isin(found.verdict, (GearVerdict.GOOD, GearVerdict.LINEAR))
    columns = {
        "x_mm": new.centers[:, 0], "y_mm": new.centers[:, 1],
        "arm_theta_mm": new.arms[:, 0], "arm_phi_mm": new.arms[:, 1],
    }  # fmt: skip
    for j, joint in enumerate(("theta", "phi")):
        for k, end in enumerate(("min", "max")):
            columns[f"{joint}_{end}_deg"] = np.rad2deg(new.limits[:, j, k])
        lost = np.rad2deg(np.maximum(found.backlash_rad[:, j], 0.0))
        columns[f"{joint}_lost_motion_deg"] = np.where(
            good, lost, np.rad2deg(drive.lost_motion_rad[:, j])
        )
        for k, way in enumerate(("falling", "rising")):
            columns[f"{joint}_scale_{way}"] = np.where(
                good, found.scale[:, j, k], drive.scale[:, j, k]
            )
    return columns


def write_fit(path: str | os.PathLike[str], plane: FocalPlane, found: Calibration) -> None:
    """Write the numbers of every robot with their errors and a verdict.

    Args:
        path: the table.
        plane: the plane that was calibrated.
        found: its calibration.
    """
    columns: dict[str, NDArray] = {
        "id": plane.ids,
        "gears": np.array([GearVerdict(code).name.lower() for code in found.verdict]),
        "points": found.points, "rms_um": found.rms_um,
    }  # fmt: skip
    unfit = (found.verdict == GearVerdict.UNMEASURED)[:, None]
    numbers = np.where(unfit, np.nan, found.numbers * _FACTORS)
    errors = np.where(unfit, np.nan, found.errors * _FACTORS)
    for k, name in enumerate(_FILE_NAMES):
        columns[name], columns["error_of_" + name] = numbers[:, k], errors[:, k]
    write_table(path, columns)


def _read_fit(path: str | os.PathLike[str]) -> tuple[Ids, Floats, Floats]:
    """Read a table of `write_fit`: ids, numbers and their errors in the units of `NUMBERS`.

    Raises:
        FormatError: a column is missing or a value is refused.
    """
    columns = read_columns(path, "id", "gears")
    ids = columns.ids("id")
    read = [
        np.stack([columns.numbers(prefix + name, missing=True) for name in _FILE_NAMES], axis=1)
        for prefix in ("", "error_of_")
    ]
    columns.check()
    return ids, read[0] / _FACTORS, read[1] / _FACTORS


def write_trend(path: str | os.PathLike[str], ids: Ids, found: Trend) -> None:
    """Write the change of each number a night, its error, and what drifts.

    Args:
        path: the table.
        ids: robot ids, shape (n,).
        found: their trend.
    """
    columns: dict[str, NDArray] = {"id": ids, "nights": found.nights}
    columns["drifts"] = np.array([_named(row) for row in found.drifts])
    for k, name in enumerate(_FILE_NAMES):
        columns[name + "_a_night"] = found.per_night[:, k] * _FACTORS[k]
        columns["error_of_" + name + "_a_night"] = found.error[:, k] * _FACTORS[k]
    write_table(path, columns)


def _named(drifts: Bools) -> str:
    return " ".join(name for name, each in zip(_FILE_NAMES, drifts) if each) or "no"


def fits_of(paths: Sequence[str]) -> tuple[Ids, Floats, Floats]:
    """Read tables of some nights: all ids, numbers and errors, shape (nights, n, 12).

    Raises:
        FormatError: a column is missing or a value is refused.
    """
    read = [_read_fit(path) for path in paths]
    ids = np.unique(np.concatenate([each[0] for each in read]))
    numbers = np.full((len(read), len(ids), len(NUMBERS)), np.nan)
    errors = np.full_like(numbers, np.nan)
    for night, (known, values, error) in enumerate(read):
        at = np.searchsorted(ids, known)
        numbers[night, at], errors[night, at] = values, error
    return ids, numbers, errors


def draw_trend(
    path: str | os.PathLike[str], ids: Ids, numbers: Floats, errors: Floats, found: Trend,
    rows: Rows,
) -> None:  # fmt: skip
    """Draw the numbers of some robots over nights, with their errors and the lines of the trend.

    Args:
        path: the figure; .pdf or .png.
        ids: robot ids, shape (n,).
        numbers, errors: numbers of each night and their errors, shape (nights, n, 12).
        found: their trend.
        rows: the robots to draw, shape (k,).

    Raises:
        FormatError: the suffix is not known, or the figure cannot be written.
    """
    if os.path.splitext(path)[1].lower() not in (".pdf", ".png"):
        raise FormatError(f"{path}: a figure is written as .pdf or .png")
    from fiber_viewer.figures import trends  # matplotlib is slow to import

    figure = trends(
        _FILE_NAMES, ids[rows], numbers[:, rows] * _FACTORS, errors[:, rows] * _FACTORS,
        found.per_night[rows] * _FACTORS, found.drifts[rows],
    )  # fmt: skip
    try:
        figure.savefig(path, dpi=_DPI)
    except OSError as error:
        raise FormatError(f"{path} cannot be written: {error}") from None


def counts_of(verdict: Codes) -> str:
    """Return how many robots have each verdict, in words."""
    return ", ".join(
        f"{np.count_nonzero(verdict == each)} {each.name.lower()}"
        for each in GearVerdict
        if (verdict == each).any()
    )

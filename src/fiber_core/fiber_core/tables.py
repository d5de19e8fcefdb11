"""Focal planes, obstacles and targets from table files: CSV, ECSV or FITS.

Column names carry their units. A layout needs ``x_mm`` and ``y_mm``; every other column
is optional and falls back to a preset:

=========================================  ==================================================
``id`` or ``location``                     robot id; by default the row number
``arm_theta_mm``, ``arm_phi_mm``           lengths of both arms
``theta_zero_deg``, ``phi_zero_deg``       angle of each joint's zero
``theta_range_deg``                        range of theta, half of it either side of its zero
``phi_range_deg``                          range of phi, upwards from its zero
``theta_min_deg``, ``theta_max_deg``, ...  stops of a joint in the focal plane frame instead
``theta_speed_deg_s``, ``phi_speed_deg_s`` highest speeds
``radius_mm``                              half width of a capsule in place of the preset's outline
``enabled`` or ``functional``              whether a robot may be moved
``petal``, ``bus``, ``address``            where it hangs; buses of several petals are told apart
=========================================  ==================================================
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fiber_core.errors import FiberError, LayoutError, TargetsError
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import PRESETS, Preset, plane_from
from fiber_core.problem import load_problem

__all__ = ["read_layout", "read_obstacles", "read_targets"]

_FORMATS = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits", ".fit": "fits"}
_UNITS = {"_mm": "mm", "_deg": "deg", "_deg_s": "deg / s"}
_NAMED = 10  # how many offending rows a message lists
_ARMS_ALIKE = 0.1  # relative difference of arm lengths up to which a preset is taken for granted


def read_layout(path, preset: str | None = None, obstacles=None) -> FocalPlane:
    """Read a focal plane from a table, one row per robot, in any order of ids.

    Args:
        path: a .csv, .ecsv or .fits file; the module says which columns it may have.
        preset: whose figures and outlines stand in for missing columns; by default the
            instrument whose arms are as long.
        obstacles: file of fixed discs, as for read_obstacles.

    Raises:
        LayoutError: the file cannot be read, or a value is missing or out of range;
            names the file, the column and the robot.
    """
    table = _Table(path, LayoutError)
    if len(table) == 0:
        raise LayoutError(f"{path} has no robots")
    table.sort_by_id()
    figures = _figures(table, preset)
    columns = {
        "limits": _limits(table, figures),
        "speeds": np.deg2rad(
            _pair(table, "theta_speed_deg_s", "phi_speed_deg_s", figures.speeds_deg_s)
        ),
        "enabled": table.flags("enabled") & table.flags("functional"),
        "bus": _buses(table),
        "address": table.whole("address") if "address" in table else None,
        "obstacles": np.zeros((0, 3)) if obstacles is None else read_obstacles(obstacles),
        "name": Path(path).stem,
    }
    if "radius_mm" in table:
        outline = figures.phi_outline if figures.phi_outline == "tip" else "capsule"
        figures = replace(figures, phi_outline=outline, theta_outline=())
        columns["phi_radius"] = table.numbers("radius_mm")
    centers = np.stack([table.numbers("x_mm"), table.numbers("y_mm")], axis=1)
    arms = _pair(table, "arm_theta_mm", "arm_phi_mm", figures.arms_mm)
    try:
        return plane_from(figures, table.ids, centers, arms, **columns)
    except LayoutError as reason:
        raise LayoutError(f"{path}: {reason}") from None


def read_obstacles(path) -> np.ndarray:
    """Read fixed discs from columns x_mm, y_mm, radius_mm: [mm], shape (k, 3).

    Raises:
        LayoutError: as read_layout.
    """
    table = _Table(path, LayoutError)
    return np.stack([table.numbers(name) for name in ("x_mm", "y_mm", "radius_mm")], axis=1)


def read_targets(path) -> tuple[np.ndarray, np.ndarray]:
    """Read where fibres should go, from columns id, x_mm, y_mm or from a problem.npz.

    Returns:
        Robot ids, shape (k,), in the order of the file, and points [mm], shape (k, 2).

    Raises:
        TargetsError: the file cannot be read or a value is missing; names file, column
            and robot.
    """
    if Path(path).suffix == ".npz":
        try:
            problem = load_problem(path)
        except LayoutError as reason:
            raise TargetsError(str(reason)) from None
        return problem.plane.ids[problem.asked], problem.targets[problem.asked]
    table = _Table(path, TargetsError)
    if not table.has_ids:
        raise TargetsError(f"{path} has no column id")
    return table.ids, np.stack([table.numbers("x_mm"), table.numbers("y_mm")], axis=1)


def _figures(table, preset) -> Preset:
    if preset is not None:
        if preset not in PRESETS:
            raise LayoutError(f"no preset is named {preset!r}; there are {', '.join(PRESETS)}")
        return PRESETS[preset]
    lacks = [name for name in ("arm_theta_mm", "arm_phi_mm") if name not in table]
    if lacks:
        raise LayoutError(f"{table.path} has no column {' nor '.join(lacks)}: name a preset")
    arms = _pair(table, "arm_theta_mm", "arm_phi_mm", (np.nan, np.nan))
    usual = np.median(arms, axis=0)
    for name in ("desi", "pfs", "sdss_v", "moons", "lamost"):
        if np.allclose(usual, PRESETS[name].arms_mm, rtol=_ARMS_ALIKE, atol=0.0):
            return PRESETS[name]
    raise LayoutError(
        f"{table.path}: no instrument is known by arms of {usual.tolist()} mm; name a preset"
    )


def _pair(table, first, second, otherwise):
    values = [
        table.numbers(name) if name in table else np.full(len(table), value)
        for name, value in zip((first, second), otherwise)
    ]
    return np.stack(values, axis=1)


def _limits(table, figures):
    limits = np.empty((len(table), 2, 2))
    for j, (joint, usual) in enumerate((("theta", figures.theta_deg), ("phi", figures.phi_deg))):
        if f"{joint}_min_deg" in table or f"{joint}_max_deg" in table:
            limits[:, j] = np.stack(
                [table.numbers(f"{joint}_{end}_deg") for end in ("min", "max")]
            ).T
            continue
        zero = table.numbers(f"{joint}_zero_deg") if f"{joint}_zero_deg" in table else 0.0
        if f"{joint}_range_deg" in table:
            span = table.numbers(f"{joint}_range_deg")
            low = zero - span / 2 if joint == "theta" else zero + np.zeros(len(table))
            limits[:, j] = np.stack([low, low + span]).T
        else:
            limits[:, j] = np.add.outer(zero + np.zeros(len(table)), usual)
    return np.deg2rad(limits)


def _buses(table):
    if "bus" not in table:
        return None
    if "petal" not in table and table.is_numeric("bus"):
        return table.whole("bus")
    keys = [table.keys(name) for name in ("petal", "bus") if name in table]
    _, number = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)
    return number.reshape(-1)


class _Table:
    """Columns of a file as checked arrays; messages name the file, the column and the robots."""

    def __init__(self, path, error: type[FiberError]):
        self.path, self.error = path, error
        kind = _FORMATS.get(Path(path).suffix.lower())
        if kind is None:
            raise error(f"{path}: a table ends in {', '.join(_FORMATS)}")
        from astropy.table import Table  # slow to import, and only files need it

        try:
            self.columns = Table.read(path, format=kind)
        except (OSError, ValueError, TypeError, KeyError, IndexError) as reason:
            raise error(f"{path} cannot be read: {reason}") from None
        self.has_ids, self.ids = False, np.arange(len(self))
        for name in ("id", "location"):
            if name in self and not self.has_ids:
                self.ids, self.has_ids = self.whole(name), True

    def __len__(self):
        return len(self.columns)

    def __contains__(self, name):
        return name in self.columns.colnames

    def sort_by_id(self):
        order = np.argsort(self.ids, kind="stable")
        self.columns, self.ids = self.columns[order], self.ids[order]
        again = np.flatnonzero(np.diff(self.ids) == 0)
        if len(again):
            raise self.error(f"{self.path}: more than one row for {self._named(again)}")

    def numbers(self, name) -> np.ndarray:
        """Finite values of a column in the unit of its name, shape (rows,)."""
        column = self._column(name)
        missing = np.ma.getmaskarray(column)
        values = np.array(
            [np.nan if absent else _number(value) for value, absent in zip(column, missing)],
            dtype=float,
        )
        unit = next((_UNITS[end] for end in _UNITS if name.endswith(end)), None)
        if column.unit is not None and unit is not None:
            try:
                values = values * column.unit.to(unit)
            except (ValueError, TypeError) as reason:
                raise self.error(f"{self.path}: column {name}: {reason}") from None
        self._refuse(~np.isfinite(values), name, "is not a number")
        return values

    def whole(self, name) -> np.ndarray:
        """Whole numbers of a column, shape (rows,)."""
        values = self.numbers(name)
        self._refuse(values != np.rint(values), name, "is not a whole number")
        return values.astype(np.int64)

    def flags(self, name) -> np.ndarray:
        """Truth of a column written True/False or 1/0, all true without it, shape (rows,)."""
        if name not in self:
            return np.ones(len(self), dtype=bool)
        words = np.array([str(value).strip().lower() for value in self._column(name)], dtype=str)
        yes, no = np.isin(words, ("true", "1")), np.isin(words, ("false", "0"))
        self._refuse(~(yes | no), name, "is neither true nor false")
        return yes

    def keys(self, name) -> np.ndarray:
        """Whole numbers that order the rows as the values of a column do, shape (rows,)."""
        column = self._column(name)
        self._refuse(np.ma.getmaskarray(column), name, "is missing")
        return np.unique(np.asarray(column), return_inverse=True)[1]

    def is_numeric(self, name) -> bool:
        return self._column(name).dtype.kind in "iuf"

    def _column(self, name):
        if name not in self:
            raise self.error(f"{self.path} has no column {name}")
        return self.columns[name]

    def _refuse(self, bad, name, what):
        rows = np.flatnonzero(bad)
        if len(rows):
            values = [str(self.columns[name][row]) for row in rows[:_NAMED]]
            raise self.error(
                f"{self.path}: column {name} {what}: {self._named(rows)}: {', '.join(values)}"
            )

    def _named(self, rows):
        what = "robot" if self.has_ids else "row"
        more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
        return f"{what} {', '.join(str(self.ids[row]) for row in rows[:_NAMED])}{more}"


def _number(value) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return np.nan

"""Tables: focal planes, obstacles and targets from CSV, ECSV or FITS files.

The names of columns contain their units. A layout needs ``x_mm`` and ``y_mm``; every other
column is optional, and a preset supplies the values of missing columns:

=========================================  ==================================================
``id`` or ``location``                     robot id; by default the row number
``arm_theta_mm``, ``arm_phi_mm``           lengths of both arms
``theta_zero_deg``, ``phi_zero_deg``       zero of each joint
``theta_range_deg``                        range of theta, half of it on either side of its zero
``phi_range_deg``                          range of phi, upwards from its zero
``theta_min_deg``, ``theta_max_deg``, ...  instead: stops of a joint, theta from the x axis
``theta_speed_deg_s``, ``phi_speed_deg_s`` highest speeds
``radius_mm``                              radius of a capsule, in place of the preset's outline
``enabled`` or ``functional``              whether a robot may be moved
``petal``, ``bus``, ``address``            bus and address; each petal has its own bus numbers
=========================================  ==================================================
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fiber_core.array_types import Bools, Floats, Ids, Ints, Mask, Points, Rows
from fiber_core.errors import FiberError, LayoutError, TargetsError
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import PRESETS, PlaneColumns, Preset, figures_of, plane_from
from fiber_core.problem import FilePath, load_problem

if TYPE_CHECKING:
    from astropy.table import Column, Table

__all__ = ["read_layout", "read_obstacles", "read_targets"]

_FORMATS = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits", ".fit": "fits"}
_UNITS = {"_mm": "mm", "_deg": "deg", "_deg_s": "deg / s"}
_NAMED = 10  # most rows that a message names
_SAME_ARMS = 0.1  # largest relative difference of arm lengths at which a preset is recognized
_RECOGNIZED = ("desi", "pfs", "sdss_v", "moons", "lamost")  # presets of real instruments


def read_layout(
    path: FilePath, preset: str | None = None, obstacles: FilePath | None = None
) -> FocalPlane:
    """Read a focal plane from a table with one row per robot, in any order of ids.

    Args:
        path: a .csv, .ecsv or .fits file with the columns that this module lists.
        preset: name of the preset that supplies missing columns and the outlines; by default
            the instrument with the same arm lengths.
        obstacles: file of fixed discs, as for read_obstacles; by default there are none.

    Raises:
        LayoutError: the file cannot be read, or a value is missing or out of range;
            names the file, the column and the robot.
    """
    table = _Table(path, LayoutError)
    if len(table) == 0:
        raise LayoutError(f"{path} has no robots")
    table.sort_by_id()
    figures = _figures(table, preset)
    columns = PlaneColumns(
        limits=_limits(table, figures),
        speeds=np.deg2rad(
            _pair(table, "theta_speed_deg_s", "phi_speed_deg_s", figures.speeds_deg_s)
        ),
        enabled=table.flags("enabled") & table.flags("functional"),
        bus=_buses(table),
        address=table.whole("address") if "address" in table else None,
        obstacles=np.zeros((0, 3)) if obstacles is None else read_obstacles(obstacles),
        name=Path(path).stem,
    )
    if "radius_mm" in table:
        outline = figures.phi_outline if figures.phi_outline == "tip" else "capsule"
        figures = replace(figures, phi_outline=outline, theta_outline=())
        columns["phi_radius"] = table.numbers("radius_mm")
    centers = np.stack([table.numbers("x_mm"), table.numbers("y_mm")], axis=1)
    arms = _pair(table, "arm_theta_mm", "arm_phi_mm", figures.arms_mm)
    try:
        return plane_from(figures, table.ids, centers, arms, **columns)
    except LayoutError as error:
        raise LayoutError(f"{path}: {error}") from None


def read_obstacles(path: FilePath) -> Floats:
    """Read fixed discs from a table with the columns x_mm, y_mm and radius_mm.

    Args:
        path: a .csv, .ecsv or .fits file.

    Returns:
        x, y and radius of each disc [mm], shape (k, 3).

    Raises:
        LayoutError: as read_layout.
    """
    table = _Table(path, LayoutError)
    return np.stack([table.numbers(name) for name in ("x_mm", "y_mm", "radius_mm")], axis=1)


def read_targets(path: FilePath) -> tuple[Ids, Points]:
    """Read targets from a table with the columns id, x_mm and y_mm, or from a problem file.

    Args:
        path: a .csv, .ecsv, .fits or .npz file.

    Returns:
        Robot ids, shape (k,), in the order of the file, and their targets [mm], shape (k, 2).

    Raises:
        TargetsError: the file cannot be read or a value is missing; names file, column
            and robot.
    """
    if Path(path).suffix == ".npz":
        try:
            problem = load_problem(path)
        except LayoutError as error:
            raise TargetsError(str(error)) from None
        return problem.plane.ids[problem.asked], problem.targets[problem.asked]
    table = _Table(path, TargetsError)
    if not table.has_ids:
        raise TargetsError(f"{path} has no column id")
    return table.ids, np.stack([table.numbers("x_mm"), table.numbers("y_mm")], axis=1)


def _figures(table: "_Table", preset: str | None) -> Preset:
    # the preset of this name, or the instrument with the same arm lengths
    if preset is not None:
        return figures_of(preset)
    lacks = [name for name in ("arm_theta_mm", "arm_phi_mm") if name not in table]
    if lacks:
        raise LayoutError(f"{table.path} has no column {' nor '.join(lacks)}: name a preset")
    arms = _pair(table, "arm_theta_mm", "arm_phi_mm", (np.nan, np.nan))
    usual = np.median(arms, axis=0)
    for name in _RECOGNIZED:
        if np.allclose(usual, PRESETS[name].arms_mm, rtol=_SAME_ARMS, atol=0.0):
            return PRESETS[name]
    raise LayoutError(
        f"{table.path}: no instrument is known by arms of {usual.tolist()} mm; name a preset"
    )


def _pair(table: "_Table", first: str, second: str, otherwise: tuple[float, float]) -> Floats:
    # two columns, shape (rows, 2), with the same value in all rows where one is missing
    values = [
        table.numbers(name) if name in table else np.full(len(table), value, dtype=np.float64)
        for name, value in zip((first, second), otherwise)
    ]
    return np.stack(values, axis=1)


def _limits(table: "_Table", figures: Preset) -> Floats:
    # joint ranges [rad], shape (rows, 2, 2)
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


def _buses(table: "_Table") -> Ints | None:
    # a number for each bus of each petal, shape (rows,)
    if "bus" not in table:
        return None
    if "petal" not in table and table.is_numeric("bus"):
        return table.whole("bus")
    ranks = [table.ranks(name) for name in ("petal", "bus") if name in table]
    _, number = np.unique(np.stack(ranks, axis=1), axis=0, return_inverse=True)
    return number.reshape(-1)


class _Table:
    """Columns of a file as checked arrays; errors name the file, the column and the robots.

    Args:
        path: a .csv, .ecsv or .fits file.
        error: exception to raise.
    """

    columns: "Table"
    ids: Ids  # robot ids, or row numbers in a table without ids

    def __init__(self, path: FilePath, error: type[FiberError]):
        self.path, self.error = path, error
        kind = _FORMATS.get(Path(path).suffix.lower())
        if kind is None:
            raise error(f"{path}: the name of a table must end in {', '.join(_FORMATS)}")
        from astropy.table import Table  # slow to import, and only files need it

        try:
            self.columns = Table.read(path, format=kind)
        except (OSError, ValueError, TypeError, KeyError, IndexError) as problem:
            raise error(f"{path} cannot be read: {problem}") from None
        self.has_ids, self.ids = False, np.arange(len(self))
        for name in ("id", "location"):
            if name in self and not self.has_ids:
                self.ids, self.has_ids = self.whole(name), True

    def __len__(self) -> int:
        return len(self.columns)

    def __contains__(self, name: str) -> bool:
        return name in self.columns.colnames

    def sort_by_id(self) -> None:
        order = np.argsort(self.ids, kind="stable")
        self.columns, self.ids = self.columns[order], self.ids[order]
        repeated = np.flatnonzero(np.diff(self.ids) == 0)
        if len(repeated):
            raise self.error(f"{self.path}: more than one row for {self._named(repeated)}")

    def numbers(self, name: str) -> Floats:
        """Return the finite values of a column in the unit of its name, shape (rows,)."""
        column = self._column(name)
        values = np.array(
            [
                np.nan if absent else _number(value)
                for value, absent in zip(column, self._missing(name))
            ],
            dtype=np.float64,
        )
        unit = next((_UNITS[end] for end in _UNITS if name.endswith(end)), None)
        if column.unit is not None and unit is not None:
            try:
                values = values * column.unit.to(unit)
            except (ValueError, TypeError) as problem:
                raise self.error(f"{self.path}: column {name}: {problem}") from None
        self._refuse(~np.isfinite(values), name, "is not a number")
        return values

    def whole(self, name: str) -> Ints:
        """Return the whole numbers of a column, shape (rows,)."""
        values = self.numbers(name)
        self._refuse(values != np.rint(values), name, "is not a whole number")
        return values.astype(np.int64)

    def flags(self, name: str) -> Mask:
        """Return a column of True/False or 1/0, all true if it is missing, shape (rows,)."""
        if name not in self:
            return np.ones(len(self), dtype=np.bool_)
        words = np.array([str(value).strip().lower() for value in self._column(name)], dtype=str)
        yes, no = np.isin(words, ("true", "1")), np.isin(words, ("false", "0"))
        self._refuse(~(yes | no), name, "is neither true nor false")
        return yes

    def ranks(self, name: str) -> Ints:
        """Return whole numbers in the order of the values of a column, shape (rows,)."""
        self._refuse(self._missing(name), name, "is missing")
        return np.unique(np.asarray(self._column(name)), return_inverse=True)[1]

    def is_numeric(self, name: str) -> bool:
        """Return whether a column holds numbers."""
        return self._column(name).dtype.kind in "iuf"

    def _missing(self, name: str) -> Bools:
        return np.ma.getmaskarray(self._column(name))

    def _column(self, name: str) -> "Column":
        if name not in self:
            raise self.error(f"{self.path} has no column {name}")
        return self.columns[name]

    def _refuse(self, bad: Bools, name: str, what: str) -> None:
        # raises if a row of a column is bad; names the first of them
        rows = np.flatnonzero(bad)
        if len(rows):
            values = [str(self.columns[name][row]) for row in rows[:_NAMED]]
            raise self.error(
                f"{self.path}: column {name} {what}: {self._named(rows)}: {', '.join(values)}"
            )

    def _named(self, rows: Rows) -> str:
        what = "robot" if self.has_ids else "row"
        more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
        return f"{what} {', '.join(str(self.ids[row]) for row in rows[:_NAMED])}{more}"


def _number(value: object) -> float:
    try:
        return float(value)  # pyright: ignore[reportArgumentType]  # TypeError is the answer
    except (TypeError, ValueError):
        return np.nan

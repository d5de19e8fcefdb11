# SPDX-License-Identifier: Apache-2.0
"""Our own columns, in CSV, ECSV or FITS; units are part of the names.

A layout needs `x_mm` and `y_mm`; `LAYOUT_COLUMNS` lists the others, which are optional. Targets
need `id`, `x_mm`, `y_mm`, and may name a `fibre`; starts need `id`, `theta_deg`, `phi_deg`. A
column that differs from a known name by a few letters is refused, an unknown one is named in a
notice. A second file beside a layout holds obstacles: `x_mm`, `y_mm`, `radius_mm`. Another one
holds walls, a row for each corner: `wall`, `x_mm`, `y_mm`.
"""

import numpy as np

from fiber_core.array_types import Floats
from fiber_formats.availability import DISABLED, ENABLED, enabled_of, refuse_doubtful_flags
from fiber_formats.columns import Columns, near
from fiber_formats.errors import FormatError
from fiber_formats.fibres import fibres_of
from fiber_formats.interface import Format
from fiber_formats.outlines import WALL_COLUMNS, outlines_of, walls_of
from fiber_formats.records import LayoutColumns, StartColumns, TargetColumns
from fiber_formats.source import DataFile, Source
from fiber_formats.table import folded

__all__ = ["FORMAT", "LAYOUT_COLUMNS", "obstacles_of"]

NUMBERS = {
    "arm_theta_mm": "mm",
    "arm_phi_mm": "mm",
    "theta_zero_deg": "deg",
    "phi_zero_deg": "deg",
    "theta_range_deg": "deg",
    "phi_range_deg": "deg",
    "theta_min_deg": "deg",
    "theta_max_deg": "deg",
    "phi_min_deg": "deg",
    "phi_max_deg": "deg",
    "theta_speed_deg_s": "deg / s",
    "phi_speed_deg_s": "deg / s",
    "radius_mm": "mm",
    "spacing_mm": "mm",
    "theta_uncertainty_deg": "deg",
    "phi_uncertainty_deg": "deg",
    "theta_lost_motion_deg": "deg",
    "phi_lost_motion_deg": "deg",
    "theta_scale_falling": "",
    "theta_scale_rising": "",
    "phi_scale_falling": "",
    "phi_scale_rising": "",
    "theta_acceleration_deg_s2": "deg / s2",
    "phi_acceleration_deg_s2": "deg / s2",
    "motors_on": "",
}
# of motors that gears couple to the joints: each group is there as a whole or not at all
GEARS = tuple(f"motor_{motor}_by_{joint}" for motor in (1, 2) for joint in ("theta", "phi"))
MOTOR_SPEEDS = tuple(f"motor_{motor}_speed_deg_s" for motor in (1, 2))
MOTOR_LIMITS = tuple(f"motor_{motor}_{end}_deg" for motor in (1, 2) for end in ("min", "max"))
_OF_MOTORS = (GEARS, MOTOR_SPEEDS, MOTOR_LIMITS)
NUMBERS |= {name: "" for name in GEARS}
NUMBERS |= {name: "deg / s" for name in MOTOR_SPEEDS} | {name: "deg" for name in MOTOR_LIMITS}
_IDS = ("id", "location")
_WIRED = ("petal", "bus", "address", "supply")
OUTLINES = ("theta_outline_mm", "phi_outline_mm")
LAYOUT_COLUMNS = (
    *("id", "x_mm", "y_mm", *NUMBERS, *OUTLINES, "fibre_places_mm"),
    *("enabled", *_WIRED, "drive", "preset"),
)
_STARTS = ("theta_deg", "phi_deg")
_LAYOUT_NAMES = (*LAYOUT_COLUMNS, *_IDS, *ENABLED, *DISABLED)
_ONLY_LAYOUT = (*NUMBERS, *OUTLINES, "fibre_places_mm", *ENABLED, *DISABLED)
_RESULT_NAMES = ("outcome", "reason", "reached_x_mm", "reached_y_mm", "error_um")


def layout(source: Source) -> LayoutColumns:
    """Read the robots of a table, one row each, in any order of ids."""
    file, *others = source.files
    table = file.likely_table("x_mm", "y_mm")
    columns = Columns(table)
    notices = file.other_tables(table)
    identity, why = _layout_ids(columns)
    found: dict[str, np.ndarray] = {"id": identity}
    found |= _numbers_of(columns)
    for name in OUTLINES:
        if name in columns:
            found[name] = outlines_of(columns, name)
    fibre_names: tuple[str, ...] = ()
    if "fibre_places_mm" in columns:
        found["fibre_places_mm"], fibre_names = fibres_of(columns, "fibre_places_mm")
    enabled = enabled_of(columns)
    if enabled is not None:
        found["enabled"] = enabled
    for name in ("petal", "bus"):
        if name in columns:
            is_number = columns.is_number(name)
            found[name] = columns.whole(name) if is_number else columns.words(name)
    for name in ("address", "supply"):
        if name in columns:
            found[name] = columns.whole(name)
    if "petal" in columns and "bus" not in columns:
        notices += ("petal is not used: no column bus tells where robots are wired",)
    found |= _drive(columns)
    preset = _one_word(columns, "preset")
    if enabled is None:
        refuse_doubtful_flags(columns)
    _refuse_near_names(columns, _LAYOUT_NAMES)
    columns.check()
    notices += why + columns.unused_notice()
    discs, walls, more = _fixed_bodies(others)
    return LayoutColumns(found, discs, preset, notices + more, walls, fibre_names)


def starts(source: Source) -> StartColumns:
    """Read present angles from columns id, theta_deg, phi_deg, in the focal plane frame."""
    columns = Columns(source.only.likely_table(*_STARTS))
    ids = columns.ids(_id_name(columns))
    angles = [columns.numbers(name, "deg", missing=True) for name in _STARTS]
    half = np.isnan(angles[0]) != np.isnan(angles[1])
    columns.refuse_rows(half, "theta_deg", "and phi_deg must both be given or both be missing")
    _refuse_near_names(columns, (*_IDS, *_STARTS))
    columns.check()
    notices = source.only.other_tables(columns.table) + columns.unused_notice()
    return StartColumns(ids, np.stack(angles, axis=1), notices=notices)


def targets(source: Source) -> TargetColumns:
    """Read targets from columns id, x_mm, y_mm; a row without both is a robot without target."""
    columns = Columns(source.only.likely_table("x_mm", "y_mm"))
    _refuse_layout(columns, "targets")
    ids = columns.ids(_id_name(columns))
    xy_mm = [columns.numbers(name, "mm", missing=True) for name in ("x_mm", "y_mm")]
    half = np.isnan(xy_mm[0]) != np.isnan(xy_mm[1])
    columns.refuse_rows(half, "x_mm", "and y_mm must both be given or both be missing")
    fibre = columns.words("fibre", missing=True) if "fibre" in columns else None
    _refuse_near_names(columns, (*_IDS, "x_mm", "y_mm", "fibre"))
    columns.check()
    notices = source.only.other_tables(columns.table) + columns.unused_notice()
    return TargetColumns(ids, np.stack(xy_mm, axis=1), notices, fibre)


def obstacles_of(file: DataFile) -> tuple[Floats, tuple[str, ...]]:
    """Return fixed discs x, y, radius [mm], shape (k, 3), and notices.

    Raises:
        FormatError: the table is refused.
    """
    names = ("x_mm", "y_mm", "radius_mm")
    columns = Columns(file.likely_table(*names))
    discs = np.stack([columns.numbers(name, "mm") for name in names], axis=1)
    columns.refuse_rows(discs[:, 2] < 0, "radius_mm", "is negative")
    _refuse_layout(columns, "obstacles", *names)
    columns.check()
    return discs, columns.unused_notice()


def _fixed_bodies(files: list[DataFile]) -> tuple[Floats, Floats, tuple[str, ...]]:
    # obstacles and walls of the files beside a layout, at most one of each
    discs, walls, notices = np.zeros((0, 3)), np.zeros((0, 1, 2)), ()
    kinds = [file.has_columns(*WALL_COLUMNS) for file in files]
    if sum(kinds) > 1 or len(kinds) - sum(kinds) > 1:
        names = ", ".join(file.name for file in files)
        raise FormatError(f"beside a layout, one file of obstacles and one of walls: {names}")
    for file, are_walls in zip(files, kinds):
        if are_walls:
            walls, more = walls_of(file)
        else:
            discs, more = obstacles_of(file)
        notices += more
    return discs, walls, notices


def _id_name(columns: Columns) -> str:
    return next((name for name in _IDS if name in columns), "id")


def _layout_ids(columns: Columns) -> tuple[np.ndarray, tuple[str, ...]]:
    if any(name in columns for name in _IDS):
        return columns.ids(_id_name(columns)), ()
    known = {*_LAYOUT_NAMES, *_STARTS, *_RESULT_NAMES}
    likely = [
        name
        for name in columns.table.names
        if folded(name) not in known
        and (folded(name).endswith(("id", "ids")) or columns.holds_other_ids(name))
    ]
    if likely:
        columns.note(f"no column id; is {' or '.join(likely)} meant? Rename it to id")
    return np.arange(len(columns)), ("no column id: robots have the numbers of their rows, from 0",)


def _numbers_of(columns: Columns) -> dict[str, Floats]:
    # all columns of numbers; zero and range of a joint with stops are left to be named as not used
    found = {name: columns.numbers(name, "mm") for name in ("x_mm", "y_mm")}
    by_stops = [joint for joint in ("theta", "phi") if f"{joint}_min_deg" in columns]
    instead = {f"{joint}_{what}_deg" for joint in by_stops for what in ("zero", "range")}
    for name, unit in NUMBERS.items():
        if name in columns and name not in instead:
            found[name] = columns.numbers(name, unit)
    _ask_whole_groups(columns)
    return found


def _ask_whole_groups(columns: Columns) -> None:
    # notes what lacks of a group of which a part is there, and gears that speeds or ranges need
    stops = [(f"{joint}_min_deg", f"{joint}_max_deg") for joint in ("theta", "phi")]
    of_motors = [group for group in _OF_MOTORS if any(name in columns for name in group)]
    groups = [group for group in stops if any(name in columns for name in group)]
    for group in (*groups, *dict.fromkeys((GEARS, *of_motors) if of_motors else ())):
        for name in group:
            if name not in columns:
                columns.numbers(name)


def _refuse_layout(columns: Columns, meant: str, *but: str) -> None:
    # robots that are taken for something else would not move, and neither would others near them
    names = [n for n in columns.table.names if folded(n) in _ONLY_LAYOUT and folded(n) not in but]
    if names:
        columns.note(f"it is a layout and no table of {meant}: it has {', '.join(names)}")


def _drive(columns: Columns) -> dict[str, np.ndarray]:
    name = _one_word(columns, "drive")
    return {} if name is None else {"drive": np.full(len(columns), name)}


def _one_word(columns: Columns, name: str) -> str | None:
    # the word that a column has in every row, None without one
    if name not in columns:
        return None
    words = np.unique(columns.words(name))
    if len(words) > 1:
        columns.note(f"column {name} names several: {', '.join(words.tolist())}")
    return str(words[0]) if len(words) else None


def _refuse_near_names(columns: Columns, known: tuple[str, ...]) -> None:
    everything = {*_LAYOUT_NAMES, *_STARTS, *_RESULT_NAMES}
    for name in columns.unused:
        if folded(name) in everything:
            continue  # of another kind of table, named in a notice
        meant = near(name, known)
        if meant is not None:
            columns.note(f"column {name} is not known; is {meant} meant?")


FORMAT = Format("own columns", lambda source: False, layout, starts, targets)

# SPDX-License-Identifier: Apache-2.0
"""SDSS-V: positionerTable and wokCoords, and optionally fiducialCoords and gfaCoords, together.

The place of a robot is that of its hole in wokCoords plus dx, dy. Alpha counts from alphaOffset
- 90 degrees in the wok frame, beta from betaOffset. The tip is the metrology fibre, which is on
the axis of the beta arm; the BOSS and APOGEE fibres stand beside it.
"""

from pathlib import Path

import numpy as np

from fiber_core.array_types import Floats
from fiber_core.presets.sdss_v import CAMERA_MM
from fiber_formats.availability import enabled_of, refuse_doubtful_flags
from fiber_formats.columns import Columns
from fiber_formats.errors import FormatError
from fiber_formats.interface import Format
from fiber_formats.records import LayoutColumns
from fiber_formats.source import DataFile, Source

__all__ = ["FORMAT"]

_POSITIONERS = ("positionerID", "holeID", "alphaArmLen", "metX", "alphaOffset", "betaOffset")
_HOLES = ("holeID", "holeType", "xWok", "yWok")
_FIDUCIALS = ("holeID", "id", "xWok", "yWok", "xyVar")
_CAMERAS = ("xWok", "yWok", "ix", "iy", "jx", "jy", "y_0", "y_1")
FIBRES = {"APOGEE": ("apX", "apY"), "BOSS": ("bossX", "bossY"), "METROLOGY": ("metX", "metY")}
_FIDUCIAL_RADIUS_MM = 2.5
_ZERO_DEG = -90.0  # alpha = 0 points to -y of the wok


def matches(source: Source) -> bool:
    """Return whether one of the files has the columns of a positionerTable."""
    return source.with_columns(*_POSITIONERS) is not None


def layout(source: Source) -> LayoutColumns:
    """Read robots, fiducials as obstacles, and cameras as walls."""
    files = _files(source)
    columns = Columns(files["positionerTable"].table_with(*_POSITIONERS))
    ids = columns.ids("positionerID")
    centers, beside = _centers(files["wokCoords"], columns)
    found = {
        "id": ids,
        "x_mm": centers[:, 0] + _optional(columns, "dx"),
        "y_mm": centers[:, 1] + _optional(columns, "dy"),
        "arm_theta_mm": columns.numbers("alphaArmLen", "mm"),
        "arm_phi_mm": columns.numbers("metX", "mm"),
        "theta_zero_deg": columns.numbers("alphaOffset", "deg") + _ZERO_DEG,
        "phi_zero_deg": columns.numbers("betaOffset", "deg"),
    }
    off_axis = _optional(columns, "metY") != 0
    columns.refuse_rows(off_axis, "metY", "is not 0: the metrology fibre must be on the arm's axis")
    names: tuple[str, ...] = ()
    if all(name in columns for places in FIBRES.values() for name in places):
        names = tuple(FIBRES)
        places = [[columns.numbers(k, "mm") for k in pair] for pair in FIBRES.values()]
        found["fibre_places_mm"] = np.moveaxis(np.array(places), -1, 0)
    enabled = enabled_of(columns)
    if enabled is not None:
        found["enabled"] = enabled
    else:
        refuse_doubtful_flags(columns)
    lacking = [name for name in ("dx", "dy", "metY") if name not in columns]
    some = [k for places in FIBRES.values() for k in places if k in columns and not names]
    columns.check()
    notices: tuple[str, ...] = ("the tip is the metrology fibre",)
    if lacking:
        notices += (f"no column {', '.join(lacking)}: taken as 0",)
    if not {*some} <= {"metX", "metY"}:
        notices += (f"the fibres need all of their columns, there are only {', '.join(some)}",)
    discs, walls = np.zeros((0, 3)), np.zeros((0, 1, 2))
    if "fiducialCoords" in files:
        discs, more = _fiducials(files["fiducialCoords"])
        beside += more
        notices += (f"fiducials are given a radius of {_FIDUCIAL_RADIUS_MM} mm",)
    if "gfaCoords" in files:
        walls, more = _cameras(files["gfaCoords"])
        notices += more
    notices += columns.unused_notice() + beside
    return LayoutColumns(found, discs, "sdss_v", notices, walls, names)


def _files(source: Source) -> dict[str, DataFile]:
    signs = {
        "positionerTable": _POSITIONERS,
        "wokCoords": _HOLES,
        "fiducialCoords": _FIDUCIALS,
        "gfaCoords": _CAMERAS,
    }
    found: dict[str, DataFile] = {}
    for file in source.files:
        kinds = [kind for kind, sign in signs.items() if file.has_columns(*sign)]
        if not kinds:
            absent = {kind: file.lacking(*sign) for kind, sign in signs.items()}
            nearest = min(signs, key=lambda kind: len(absent[kind]) / len(signs[kind]))
            raise FormatError(
                f"{file.name} is none of {', '.join(signs)} of SDSS-V; as a {nearest} it lacks "
                + ", ".join(absent[nearest])
            )
        if kinds[0] in found:
            raise FormatError(f"{found[kinds[0]].name} and {file.name} are both a {kinds[0]}")
        found[kinds[0]] = file
    if "wokCoords" not in found:
        raise FormatError(
            f"{source.name} has no places: name the file with wokCoords too, joined by a comma"
        )
    return found


def _centers(file: DataFile, positioners: Columns) -> tuple[Floats, tuple[str, ...]]:
    holes = Columns(file.table_with(*_HOLES))
    keys = _keys(holes)
    xy_mm = np.stack([holes.numbers(name, "mm") for name in ("xWok", "yWok")], axis=1)
    twice = np.array([keys.index(key) != k for k, key in enumerate(keys)], dtype=bool)
    holes.refuse_rows(twice, "holeID", "stands twice")
    holes.check()
    row = {key: k for k, key in enumerate(keys)}
    rows = np.array([row.get(key, -1) for key in _keys(positioners)], dtype=int)
    positioners.refuse_rows(rows < 0, "holeID", f"is not in {file.name}")
    places = xy_mm[rows] if len(xy_mm) else np.full((len(rows), 2), np.nan)
    return places, _unused(file, holes)


def _unused(file: DataFile, columns: Columns) -> tuple[str, ...]:
    return tuple(f"{Path(file.name).name}: {notice}" for notice in columns.unused_notice())


def _keys(columns: Columns) -> list[tuple[str, str]]:
    site = columns.words("site").tolist() if "site" in columns else [""] * len(columns)
    return list(zip(site, columns.words("holeID").tolist()))


def _fiducials(file: DataFile) -> tuple[Floats, tuple[str, ...]]:
    columns = Columns(file.table_with(*_FIDUCIALS))
    xy_mm = [columns.numbers(name, "mm") for name in ("xWok", "yWok")]
    columns.check()
    discs = np.stack([*xy_mm, np.full(len(columns), _FIDUCIAL_RADIUS_MM)], axis=1)
    return discs, _unused(file, columns)


def _cameras(file: DataFile) -> tuple[Floats, tuple[str, ...]]:
    # the body of each camera as a wall: i along its front, j away from the centre of the wok
    columns = Columns(file.table_with(*_CAMERAS))
    place, along, away = (
        np.stack([columns.numbers(name, "mm") for name in names], axis=1)
        for names in (("xWok", "yWok"), ("ix", "iy"), ("jx", "jy"))
    )
    columns.check()
    corners = np.array(CAMERA_MM)
    walls = place[:, None] + corners[:, :1] * along[:, None] + corners[:, 1:] * away[:, None]
    return walls, (
        f"GFAs are walls of {np.ptp(corners[:, 0]):.1f} mm, as SDSS-V's own planner has them",
        *_unused(file, columns),
    )


def _optional(columns: Columns, name: str) -> Floats:
    return columns.numbers(name, "mm") if name in columns else np.zeros(len(columns))


FORMAT = Format(
    "SDSS-V positionerTable and wokCoords", matches, layout=layout, signs=(_POSITIONERS, _HOLES)
)

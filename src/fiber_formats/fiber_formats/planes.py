# SPDX-License-Identifier: Apache-2.0
"""Focal planes from columns, with the figures of a preset for what the columns lack."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fiber_core.array_types import Floats, Ints
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import PRESETS, PlaneColumns, Preset, plane_from
from fiber_formats.drives import gears_of, same_for_all, with_motors
from fiber_formats.errors import FormatError
from fiber_formats.formats.own import GEARS, MOTOR_LIMITS, MOTOR_SPEEDS, OUTLINES
from fiber_formats.plausibility import MANY
from fiber_formats.records import LayoutColumns

__all__ = ["plane_of", "preset_of", "without_outlines"]

_ARMS_ALIKE = 0.1  # relative difference of arm lengths up to which an instrument is recognised
_KNOWN_BY_ARMS = ("desi", "pfs", "sdss_v", "moons", "lamost")
_SAME_PLACE_MM = 0.1  # no instrument has robots so near to each other
_NAMED = 10
_SPARSE = 50.0  # of a plane, neighbours by arms; in units of 1000 mm or 1/1000 mm it is more


def preset_of(name: str, found: LayoutColumns, preset: str | None) -> str:
    """Return the preset that supplies what a layout lacks.

    Args:
        name: path of the file, for messages.
        found: the layout.
        preset: the user's choice; without one the file's own, else the instrument with such arms.

    Raises:
        FormatError: there is no such preset, or none has such arms.
    """
    chosen = preset or found.preset
    if chosen is not None:
        if chosen not in PRESETS:
            raise FormatError(f"no preset is named {chosen!r}; there are {', '.join(PRESETS)}")
        return chosen
    lacking = [key for key in ("arm_theta_mm", "arm_phi_mm") if key not in found.columns]
    if lacking:
        raise FormatError(f"{name} has no column {' nor '.join(lacking)}: name a preset")
    arms = [float(np.median(found.columns[key])) for key in ("arm_theta_mm", "arm_phi_mm")]
    for known in _KNOWN_BY_ARMS:
        if np.allclose(arms, PRESETS[known].arms_mm, rtol=_ARMS_ALIKE, atol=0.0):
            return known
    raise FormatError(f"{name}: no instrument is known by arms of {arms} mm; name a preset")


def without_outlines(found: LayoutColumns, preset: str | None) -> LayoutColumns:
    """Return a layout without its outlines where the user names another preset than its format.

    Args:
        found: the layout.
        preset: the user's choice, or None.
    """
    names = [name for name in OUTLINES if name in found.columns]
    if not names or preset is None or found.preset is None or preset == found.preset:
        return found
    columns = {key: values for key, values in found.columns.items() if key not in names}
    notice = f"outlines of the file are not used: preset {preset} is named, which has others"
    return replace(found, columns=columns, notices=(*found.notices, notice))


def plane_of(
    name: str, stem: str, found: LayoutColumns, preset: str
) -> tuple[FocalPlane, tuple[str, ...]]:
    """Return the focal plane of a layout, and what the preset supplied.

    Args:
        name: path of the file, for messages.
        stem: name of the plane.
        found: the layout; its rows may be in any order.
        preset: name of the preset.

    Raises:
        FormatError: two robots stand on one place, or FocalPlane refuses a value.
    """
    order = np.argsort(found.columns["id"], kind="stable")
    columns = {key: np.asarray(values)[order] for key, values in found.columns.items()}
    ids = columns["id"].astype(np.int64)
    centers = np.stack([columns["x_mm"], columns["y_mm"]], axis=1)
    figures = PRESETS[preset]
    supplied: list[str] = []
    arms = _pair(columns, "arm_theta_mm", "arm_phi_mm", figures.arms_mm, supplied, "arms")
    _refuse_wrong_places(name, ids, centers, arms)
    limits = _limits(columns, figures, supplied)
    speed = ("theta_speed_deg_s", "phi_speed_deg_s")
    speeds = np.deg2rad(_pair(columns, *speed, figures.speeds_deg_s, supplied, "speeds"))
    fields = PlaneColumns(
        limits=limits,
        speeds=speeds,
        enabled=columns.get("enabled", np.ones(len(ids), dtype=bool)),
        bus=_buses(columns),
        address=columns.get("address"),
        obstacles=found.obstacles,
        walls=found.walls,
        name=stem,
    )
    if "fibre_places_mm" in columns:
        fields["fibres"], fields["fibre_names"] = columns["fibre_places_mm"], found.fibre_names
    _put_gears(columns, figures, fields, supplied)
    if "phi_outline_mm" in columns or "theta_outline_mm" in columns:
        _put_outlines(name, columns, fields, supplied)
    elif "radius_mm" in columns:
        outline = figures.phi_outline if figures.phi_outline == "tip" else "capsule"
        figures = replace(figures, phi_outline=outline, theta_outline=())
        fields["phi_radius"] = columns["radius_mm"]
    else:
        supplied.append("outlines")
    try:
        if "spacing_mm" in columns:
            fields["spacing_mm"] = same_for_all(columns, "spacing_mm")
        drive = gears_of(columns)
        if drive is not None:
            fields["drive"] = drive
        plane = plane_from(figures, ids, centers, arms, **fields)
        return with_motors(plane, columns), tuple(supplied)
    except LayoutError as error:
        raise FormatError(f"{name}: {error}") from None


def _put_gears(
    columns: Mapping[str, NDArray], figures: Preset, fields: PlaneColumns, supplied: list[str]
) -> None:
    # motors of a table with gears are its own; without them those of the preset
    if GEARS[0] not in columns:
        if figures.gears is not None:
            supplied.append("gears")
        return
    n = len(columns["id"])

    def of(names: tuple[str, ...], *shape: int) -> Floats:
        return np.stack([columns[name] for name in names], axis=1).reshape(n, *shape)

    speeds, limits = MOTOR_SPEEDS[0] in columns, MOTOR_LIMITS[0] in columns
    fields["coupling"] = of(GEARS, 2, 2)
    fields["motor_speeds"] = np.deg2rad(of(MOTOR_SPEEDS, 2)) if speeds else None
    fields["motor_limits"] = np.deg2rad(of(MOTOR_LIMITS, 2, 2)) if limits else None


def _put_outlines(
    name: str, columns: Mapping[str, NDArray], fields: PlaneColumns, supplied: list[str]
) -> None:
    # outlines of each robot; a link without a column has that of the preset
    if "radius_mm" in columns:
        raise FormatError(f"{name} has radius_mm and outlines of robots: one of them is meant")
    if "phi_outline_mm" in columns:
        fields["phi_vertices"] = columns["phi_outline_mm"]
        fields["phi_radius"] = np.zeros(len(columns["id"]))
    else:
        supplied.append("outline of phi arms")
    if "theta_outline_mm" in columns:
        fields["theta_vertices"] = columns["theta_outline_mm"]
    else:
        supplied.append("outline of theta bodies")


def _refuse_wrong_places(name: str, ids: NDArray, centers: Floats, arms: Floats) -> None:
    # places in um stand far apart for their arms, and no robot would be in the way of another
    if len(ids) < 2:
        return
    apart, nearest = cKDTree(centers).query(centers, k=2)
    pitch, reach = float(np.median(apart[:, 1])), float(np.median(arms.sum(axis=1)))
    if len(ids) >= MANY and pitch > 0.0 and not reach / _SPARSE < pitch < reach * _SPARSE:
        raise FormatError(
            f"{name}: neighbours stand {pitch:.3g} mm apart and arms reach {reach:.3g} mm: are "
            "places and arms in mm?"
        )
    same = np.flatnonzero(apart[:, 1] < _SAME_PLACE_MM)
    if len(same):  # of two robots on one place, either may be its own nearest
        pairs = {tuple(sorted({k, *nearest[k].tolist()})[:2]) for k in same.tolist()}
        named = [
            f"{ids[first]} and {ids[second]} at {centers[first].tolist()} mm"
            for first, second in sorted(pairs)[:_NAMED]
        ]
        raise FormatError(f"{name}: two robots stand on one place: {'; '.join(named)}")


def _pair(
    columns: Mapping[str, NDArray],
    first: str,
    second: str,
    otherwise: tuple[float, float],
    supplied: list[str],
    what: str,
) -> Floats:
    rows = len(columns["id"])
    lacking = [name for name in (first, second) if name not in columns]
    if lacking:
        supplied.append(what if len(lacking) == 2 else lacking[0])
    values = [
        columns[name] if name in columns else np.full(rows, value)
        for name, value in zip((first, second), otherwise)
    ]
    return np.stack(values, axis=1)


def _limits(columns: Mapping[str, NDArray], figures: Preset, supplied: list[str]) -> Floats:
    rows = len(columns["id"])
    limits = np.empty((rows, 2, 2))
    for j, (joint, usual) in enumerate((("theta", figures.theta_deg), ("phi", figures.phi_deg))):
        if f"{joint}_min_deg" in columns:
            ends = [columns[f"{joint}_{end}_deg"] for end in ("min", "max")]
            limits[:, j] = np.stack(ends, axis=1)
            continue
        zero = columns.get(f"{joint}_zero_deg", np.zeros(rows))
        if f"{joint}_range_deg" in columns:
            span = columns[f"{joint}_range_deg"]
            low = zero - span / 2 if joint == "theta" else zero
            limits[:, j] = np.stack([low, low + span], axis=1)
        else:
            supplied.append(f"range of {joint}")
            limits[:, j] = np.add.outer(zero, usual)
    return np.deg2rad(limits)


def _buses(columns: Mapping[str, NDArray]) -> Ints | None:
    if "bus" not in columns:
        return None
    if "petal" not in columns and columns["bus"].dtype.kind in "iu":
        return columns["bus"].astype(np.int64)
    keys = [np.unique(columns[k], return_inverse=True)[1] for k in ("petal", "bus") if k in columns]
    _, number = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)
    return number.reshape(-1).astype(np.int64)

# SPDX-License-Identifier: Apache-2.0
"""Find the format of files by their content, and read a layout, starts or targets from them."""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TypeAlias, TypeVar

import numpy as np

from fiber_core.array_types import Angles, Floats, Ids, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import distance_range
from fiber_formats.errors import FormatError
from fiber_formats.fibres import chosen_fibres
from fiber_formats.formats import FORMATS, OWN
from fiber_formats.formats.own import obstacles_of
from fiber_formats.interface import Format
from fiber_formats.planes import plane_of, preset_of, without_outlines
from fiber_formats.plausibility import AS_RADIANS, MANY, far_bodies, far_from_others, layout_doubts
from fiber_formats.records import Layout, Starts, Targets
from fiber_formats.source import Source
from fiber_formats.turns import Turned, on_a_turn_inside

__all__ = ["find_format", "read_layout", "read_obstacles", "read_starts", "read_targets"]

Paths: TypeAlias = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
_Columns = TypeVar("_Columns")
_NAMED = 10
_MOST_TURNS = 2  # from its joint range; a present angle farther away is none
_STOP_DEG = 1e-4  # a start this far beyond a stop is on the stop


def find_format(source: Source, formats: Sequence[Format] = FORMATS) -> Format:
    """Return the format of a source: the only one that matches, else our own columns.

    Raises:
        FormatError: several formats match.
    """
    matching = [item for item in formats if item.matches(source)]
    if len(matching) > 1:
        names = ", ".join(item.name for item in matching)
        raise FormatError(f"{source.name} fits several formats: {names}")
    return matching[0] if matching else OWN


def read_layout(
    path: Paths,
    preset: str | None = None,
    obstacles: str | os.PathLike[str] | None = None,
    formats: Sequence[Format] = FORMATS,
) -> Layout:
    """Read a focal plane from an instrument's own files or from a table of our columns.

    Args:
        path: a file, or several joined by commas where an instrument splits them.
        preset: instrument that supplies what the files lack; by default the one that the format
            or the arms point to.
        obstacles: table of fixed discs x_mm, y_mm, radius_mm, in addition to those of the files.
        formats: the formats that are tried, apart from our own columns.

    Raises:
        FormatError: a file is refused; names file, column, robot and value.
    """
    source = Source(path)
    found_format = find_format(source, formats)
    found = _read(found_format, found_format.layout, source, "layout", formats)
    if len(found.columns["id"]) == 0:
        raise FormatError(f"{source.name} has no robots")
    if obstacles is not None:
        discs, notices = obstacles_of(Source([obstacles]).only)
        found = replace(
            found,
            obstacles=np.concatenate([found.obstacles, discs]),
            notices=found.notices + tuple(f"{obstacles}: {notice}" for notice in notices),
        )
    chosen = preset_of(source.name, found, preset)
    found = without_outlines(found, preset)
    plane, supplied = plane_of(source.name, source.stem, found, chosen)
    disabled = np.count_nonzero(~plane.enabled)
    summary = f"{_short(source)}: {plane.n} robots, {disabled} disabled"
    if len(plane.obstacles):
        summary += f", {len(plane.obstacles)} obstacles"
    if len(plane.walls):
        summary += f", {len(plane.walls)} walls"
    if supplied:
        summary += f"; from preset {chosen}: {', '.join(supplied)}"
    notices = found.notices + layout_doubts(found.columns)
    far = far_from_others(plane.ids, plane.centers)
    if len(far):
        notices += (f"far from all others: {_robots(far)}: is their place known?",)
    notices += far_bodies(plane.centers, plane.obstacles, plane.walls)
    return Layout(plane, found, found_format.name, chosen, summary, notices)


def read_obstacles(path: str | os.PathLike[str]) -> Floats:
    """Read fixed discs from a table with columns x_mm, y_mm, radius_mm: [mm], shape (k, 3).

    Raises:
        FormatError: as read_layout.
    """
    return obstacles_of(Source([path]).only)[0]


def read_starts(path: Paths, plane: FocalPlane, formats: Sequence[Format] = FORMATS) -> Starts:
    """Read the present joint angles of all robots of a plane.

    Args:
        path: as for read_layout.
        plane: the focal plane.
        formats: as for read_layout.

    Raises:
        FormatError: a file is refused, or a robot of the plane has no angles.
    """
    source = Source(path)
    found_format = find_format(source, formats)
    found = _read(found_format, found_format.starts, source, "starts", formats)
    rows = plane.index_of(found.ids)
    notices = found.notices + _unit_notice(found.angles_deg)
    angles = np.full((plane.n, 2), np.nan)
    angles[rows[rows >= 0]] = np.deg2rad(found.angles_deg[rows >= 0])
    if found.from_lower_stop:
        angles += plane.limits[:, :, 0]
    lacking = plane.ids[np.asarray(np.isnan(angles).any(axis=1))]
    if len(lacking):
        raise FormatError(
            f"{source.name} has no present angles for {_robots(lacking)}, {len(lacking)} of "
            f"{plane.n}: the place of every robot must be known, also of disabled ones"
        )
    notices += _not_in_plane(found.ids[rows < 0])
    _refuse_far_angles(source.name, plane, angles)
    stop = np.deg2rad(_STOP_DEG)
    turned = on_a_turn_inside(angles, plane.limits, stop)
    angles = turned.angles
    notices += _turn_notices(plane.ids, turned)
    low, high = plane.limits[:, :, 0] - stop, plane.limits[:, :, 1] + stop
    outside = plane.ids[np.asarray(((angles < low) | (angles > high)).any(axis=1))]
    if len(outside):
        notices += (f"starts outside the joint ranges, so held: {_robots(outside)}",)
    summary = f"{_short(source)}: present angles of {plane.n} robots"
    return Starts(angles, found_format.name, summary, notices)


def _unit_notice(angles_deg: Floats) -> tuple[str, ...]:
    # angles of many robots that would suit radians better
    known = angles_deg[np.isfinite(angles_deg).all(axis=1)]
    most = float(np.abs(known).max(initial=0.0))
    if len(known) < MANY or most > AS_RADIANS or np.ptp(known[:, 0]) < 1.0:
        return ()
    return (f"all present angles are within {most:.2f} degrees: are they in radians?",)


def _refuse_far_angles(name: str, plane: FocalPlane, angles: Angles) -> None:
    # as -999, which stands for an angle that is not known
    low, high = plane.limits[:, :, 0], plane.limits[:, :, 1]
    beyond = np.maximum(low - angles, angles - high).max(axis=1) / (2 * np.pi)
    far = np.flatnonzero(beyond > _MOST_TURNS)
    if len(far):
        values = np.rad2deg(angles[far[:_NAMED]]).tolist()
        raise FormatError(
            f"{name}: present angles more than {_MOST_TURNS} turns from the joint ranges, so no "
            f"place is known: {_robots(plane.ids[far])}: {', '.join(map(str, values))} deg"
        )


def _turn_notices(ids: Ids, turned: Turned) -> tuple[str, ...]:
    notices: tuple[str, ...] = ()
    if turned.moved.any():
        moved = ids[turned.moved]
        notices += (
            f"starts moved by whole turns into the joint ranges, {len(moved)} robots: "
            f"{_robots(moved)}",
        )
        doubtful = ids[turned.doubtful & ~turned.moved]
        if len(doubtful):  # the file counts turns otherwise than the layout
            notices += (
                f"starts that fit on two turns, taken as they stand, {len(doubtful)} robots: "
                f"{_robots(doubtful)}",
            )
    if turned.unclear.any():
        unclear = ids[turned.unclear]
        notices += (f"starts that fit on several turns, none taken: {_robots(unclear)}",)
    return notices


def read_targets(
    path: Paths, plane: FocalPlane | None = None, formats: Sequence[Format] = FORMATS
) -> Targets:
    """Read where fibres should go.

    Args:
        path: as for read_layout.
        plane: the focal plane; with it robots that it does not have are named in a notice, and
            targets are those of its fibres where the file names fibres.
        formats: as for read_layout.

    Raises:
        FormatError: a file is refused.
    """
    source = Source(path)
    found_format = find_format(source, formats)
    found = _read(found_format, found_format.targets, source, "targets", formats)
    xy_mm, fibre, more = chosen_fibres(source.name, found, plane)
    asked = np.asarray(np.isfinite(xy_mm).all(axis=1))
    notices = found.notices + more
    if plane is not None:
        notices += _not_in_plane(found.ids[asked & (plane.index_of(found.ids) < 0)])
        notices += _out_of_reach(plane, found.ids[asked], xy_mm[asked])
    count = np.count_nonzero(asked)
    summary = f"{_short(source)}: {count} targets, {len(asked) - count} robots without target"
    return Targets(
        found.ids[asked],
        xy_mm[asked],
        found.ids[~asked],
        found_format.name,
        summary,
        notices,
        fibre[asked],
    )


def _read(
    found: Format,
    reader: Callable[[Source], _Columns] | None,
    source: Source,
    kind: str,
    formats: Sequence[Format],
) -> _Columns:
    if reader is None:
        raise FormatError(f"{source.name} is of format {found.name}, which holds no {kind}")
    try:
        return reader(source)
    except FormatError as error:
        hint = "" if found is not OWN else _nearly(source, formats)
        raise FormatError(f"{error}{hint}") from None


def _nearly(source: Source, formats: Sequence[Format]) -> str:
    # a format of which a file has most columns, and what it lacks of it
    lacking = [
        (len(absent) / len(sign), item.name, file.name, absent)
        for item in formats
        for sign in item.signs
        for file in source.files
        if len(absent := file.lacking(*sign)) < len(sign) / 2
    ]
    if not lacking:
        return ""
    _, name, file_name, absent = min(lacking)
    if not absent:
        return f"; {file_name} is of format {name}, which needs other files beside it, or none"
    return f"; as a file of format {name} it lacks {', '.join(absent)}"


def _short(source: Source) -> str:
    return ",".join(file.path.name for file in source.files)


def _robots(ids: Ids) -> str:
    more = f" and {len(ids) - _NAMED} more" if len(ids) > _NAMED else ""
    return f"robot {', '.join(str(i) for i in ids[:_NAMED])}{more}"


def _out_of_reach(plane: FocalPlane, ids: Ids, xy_mm: Points) -> tuple[str, ...]:
    rows = plane.index_of(ids)
    known = rows >= 0
    away = np.hypot(*(xy_mm[known] - plane.centers[rows[known]]).T)
    far = ids[known][away > distance_range(plane)[1][rows[known]]]
    if not len(far):
        return ()
    whose = ": is it a table of this plane, in mm?" if 2 * len(far) > len(away) else ""
    return (f"out of reach, so held: {_robots(far)}, {len(far)} of {len(away)} targets{whose}",)


def _not_in_plane(ids: Ids) -> tuple[str, ...]:
    return (f"not in the plane: {_robots(ids)}, {len(ids)} rows",) if len(ids) else ()

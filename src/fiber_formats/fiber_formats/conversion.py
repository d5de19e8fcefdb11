# SPDX-License-Identifier: Apache-2.0
"""Convert any format into our own columns."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiber_formats.errors import FormatError
from fiber_formats.fibres import fibre_texts
from fiber_formats.formats.own import LAYOUT_COLUMNS, OUTLINES
from fiber_formats.outlines import outline_texts, wall_rows
from fiber_formats.reading import Paths, find_format, read_layout, read_starts, read_targets
from fiber_formats.records import Layout, StartColumns
from fiber_formats.source import Source
from fiber_formats.writing import kind_of, write_table

__all__ = ["KINDS", "convert", "write_layout"]

KINDS = ("layout", "targets", "starts")


def convert(
    source: Paths,
    target: str | os.PathLike[str],
    preset: str | None = None,
    what: str | None = None,
    layout: Paths | None = None,
) -> tuple[str, ...]:
    """Write the layout, the targets or the starts of any format as a table of our own columns.

    Obstacles and walls of a layout go to further files, their names ending in _obstacles and
    _walls.

    Args:
        source: a file, or several joined by commas.
        target: the table; .csv, .ecsv or .fits, also with .gz.
        preset: for a layout, instrument that supplies what the files lack.
        what: one of `KINDS`; by default the first of them that the format holds. A table of our
            own columns is a layout if it has arms or a preset is named, else targets, else starts.
        layout: files of the layout, for starts that count from the stops of the joints.

    Returns:
        One line that sums up, and the notices.

    Raises:
        FormatError: the source is refused, holds nothing of that kind, or the target cannot be
            written.
    """
    if what is not None and what not in KINDS:
        raise FormatError(f"{what!r} is not one of {', '.join(KINDS)}")
    kind_of(target)
    files = Source(source)
    for file in files.files:
        if os.path.exists(target) and os.path.samefile(file.path, target):
            raise FormatError(f"{target} is read and cannot be written")
    kinds = _kinds(files, preset) if what is None else [what]
    notices: tuple[str, ...] = ()
    if len(kinds) > 1:
        notices = (f"{kinds[0]} is written; the format also holds {', '.join(kinds[1:])}",)
    if kinds[0] == "layout":
        found_layout = read_layout(source, preset)
        said = write_layout(target, found_layout)
        notices = (found_layout.summary, *said, *notices, *found_layout.notices)
    elif kinds[0] == "targets":
        found = read_targets(source)
        columns = {"id": found.ids, "x_mm": found.xy_mm[:, 0], "y_mm": found.xy_mm[:, 1]}
        idle = len(found.without_target)
        columns["id"] = np.append(columns["id"], found.without_target)
        for axis in ("x_mm", "y_mm"):
            columns[axis] = np.append(columns[axis], np.full(idle, np.nan))
        if (found.fibre != "").any():
            columns["fibre"] = np.append(found.fibre, np.full(idle, ""))
        write_table(target, columns)
        notices = (found.summary, *notices, *found.notices)
    else:
        notices = (*_write_starts(files, target, layout, preset), *notices)
    return notices


def _kinds(files: Source, preset: str | None) -> list[str]:
    found = find_format(files)
    kinds = [kind for kind in KINDS if getattr(found, kind) is not None]
    if len(kinds) < len(KINDS):
        return kinds
    file = files.files[0]
    if preset is not None or file.has_columns("arm_theta_mm") or file.has_columns("preset"):
        return ["layout"]
    return ["targets"] if file.has_columns("x_mm") else ["starts"]


def write_layout(
    target: str | os.PathLike[str], layout: Layout, changed: Mapping[str, NDArray] | None = None
) -> tuple[str, ...]:
    """Write a layout as a table of our own columns, obstacles and walls beside it.

    Args:
        target: the table; .csv, .ecsv or .fits, also with .gz.
        layout: the layout.
        changed: columns that take the place of those found, in the order of the plane.

    Returns:
        A line for each further file.

    Raises:
        FormatError: the target cannot be written.
    """
    found = layout.found.columns
    order = np.argsort(found["id"], kind="stable")
    columns: dict[str, NDArray] = {
        name: np.asarray(found[name])[order] for name in LAYOUT_COLUMNS if name in found
    }
    columns |= changed or {}
    for joint in ("theta", "phi"):
        if f"{joint}_min_deg" in columns:  # stops, in place of a zero with a range
            for name in ("zero", "range"):
                columns.pop(f"{joint}_{name}_deg", None)
    columns["preset"] = np.full(len(order), layout.preset)
    for name in OUTLINES:
        if name in columns:
            columns[name] = outline_texts(columns[name])
    if "fibre_places_mm" in columns:
        columns["fibre_places_mm"] = fibre_texts(
            columns["fibre_places_mm"], layout.found.fibre_names
        )
    write_table(target, columns)
    said: tuple[str, ...] = ()
    discs, walls = layout.plane.obstacles, layout.plane.walls
    if len(discs):
        beside = _beside(Path(target), "_obstacles")
        write_table(beside, {"x_mm": discs[:, 0], "y_mm": discs[:, 1], "radius_mm": discs[:, 2]})
        said += (f"{len(discs)} obstacles are in {beside}",)
    if len(walls):
        beside = _beside(Path(target), "_walls")
        write_table(beside, wall_rows(walls))
        said += (f"{len(walls)} walls are in {beside}",)
    return said


def _beside(path: Path, ending: str) -> Path:
    stem = path.name.split(".")[0] if path.suffix == ".gz" else path.stem
    return path.with_name(stem + ending + path.name[len(stem) :])


def _write_starts(
    files: Source, target: str | os.PathLike[str], layout: Paths | None, preset: str | None
) -> tuple[str, ...]:
    found = find_format(files)
    if found.starts is None:
        raise FormatError(f"{files.name} is of format {found.name}, which holds no starts")
    starts: StartColumns = found.starts(files)
    ids, angles_deg, notices = starts.ids, starts.angles_deg, starts.notices
    if starts.from_lower_stop:
        if layout is None:
            raise FormatError(
                f"{files.name}: angles count from the stops of a layout: name its files, with "
                "--layout"
            )
        plane = read_layout(layout, preset).plane
        on_plane = read_starts([file.path for file in files.files], plane)
        ids, angles_deg, notices = plane.ids, np.rad2deg(on_plane.angles), on_plane.notices
    columns = {"id": ids, "theta_deg": angles_deg[:, 0], "phi_deg": angles_deg[:, 1]}
    write_table(target, columns)
    return (f"{files.name}: present angles of {len(ids)} robots", *notices)

# SPDX-License-Identifier: Apache-2.0
"""Polygons in tables: an outline of each robot as a text, walls as rows of corners."""

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Floats
from fiber_core.convex_parts import convex_parts
from fiber_core.errors import LayoutError
from fiber_core.walls import is_convex, padded_walls
from fiber_formats.columns import Columns
from fiber_formats.errors import FormatError
from fiber_formats.source import DataFile

__all__ = ["WALL_COLUMNS", "outline_texts", "outlines_of", "wall_rows", "walls_of"]

WALL_COLUMNS = ("wall", "x_mm", "y_mm")


def outlines_of(columns: Columns, name: str) -> Floats:
    """Return a polygon of each robot from texts "x y x y ...": [mm], shape (rows, corners, 2).

    Shorter polygons repeat their last corner. What is wrong is noted in the columns.
    """
    texts = columns.words(name)
    polygons = [_corners(text) for text in texts.tolist()]
    bad = np.array([polygon is None for polygon in polygons], dtype=bool)
    columns.refuse_rows(bad, name, "is not a list of corners x y x y ...")
    return padded_walls([p if p is not None else np.zeros((1, 2)) for p in polygons])


def outline_texts(outlines: NDArray) -> NDArray:
    """Return polygons of shape (n, corners, 2) as the texts that `outlines_of` reads."""
    trimmed = [_without_repeated_end(polygon) for polygon in outlines]
    return np.array([" ".join(repr(float(v)) for v in p.ravel()) for p in trimmed], dtype=str)


def walls_of(file: DataFile) -> tuple[Floats, tuple[str, ...]]:
    """Return the walls of a table with one row for each corner: [mm], shape (w, c, 2), and notices.

    Corners of a wall are the rows with its number, in their order. A wall that is not convex
    becomes several.

    Raises:
        FormatError: the table is refused, or a wall crosses itself.
    """
    columns = Columns(file.table_with(*WALL_COLUMNS))
    number = columns.whole("wall")
    corners = np.stack([columns.numbers(name, "mm") for name in ("x_mm", "y_mm")], axis=1)
    columns.check()
    parts, split = [], 0
    for wall in np.unique(number).tolist():
        polygon = corners[number == wall]
        try:
            pieces = [polygon] if is_convex(polygon) else convex_parts(polygon)
        except LayoutError as error:
            raise FormatError(f"{file.name}: wall {wall}: {error}") from None
        split += len(pieces) > 1
        parts += pieces
    notices = columns.unused_notice()
    if split:
        notices += (f"{split} walls are not convex and become {len(parts)} walls in all",)
    return padded_walls(parts), notices


def wall_rows(walls: Floats) -> dict[str, NDArray]:
    """Return walls as the columns that `walls_of` reads, one row for each corner."""
    shapes = [_without_repeated_end(wall) for wall in walls]
    corners = np.concatenate([*shapes, np.zeros((0, 2))])
    number = np.repeat(np.arange(len(shapes)), [len(shape) for shape in shapes])
    return {"wall": number, "x_mm": corners[:, 0], "y_mm": corners[:, 1]}


def _corners(text: str) -> Floats | None:
    if "_" in text:
        return None
    try:
        values = np.array([float(word) for word in text.replace(";", " ").split()])
    except ValueError:
        return None
    good = len(values) >= 2 and len(values) % 2 == 0 and np.isfinite(values).all()
    return values.reshape(-1, 2) if good else None


def _without_repeated_end(polygon: Floats) -> Floats:
    differs = np.flatnonzero((polygon != polygon[-1]).any(axis=1))
    return polygon[: (differs[-1] if len(differs) else -1) + 2]

# SPDX-License-Identifier: Apache-2.0
"""DESI: outlines of robots, petal edges and cameras, from a file or from its published figures.

The header of a state has polygons: `theta` and `phi`, of which KEEPOUT_T and KEEPOUT_P number one
for each robot, and `ptl` and `gfa` for each petal. Those of petals are in pixels of the fibre view
camera; X_FVC, Y_FVC beside X_FP, Y_FP tell how these lie in the focal plane. The first eight
corners of a `ptl` go round the inside of the petal.
"""

import re
from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from fiber_core.array_types import Bools, Floats, Ints, Points
from fiber_core.convex_parts import convex_hull, convex_parts
from fiber_core.presets.desi import LINEAR_DEG, keepouts
from fiber_core.presets.desi_petals import petal_walls
from fiber_core.walls import padded_walls
from fiber_formats.columns import Columns
from fiber_formats.errors import FormatError

__all__ = ["Polygons", "expanded_outlines", "file_outlines", "file_walls", "polygons_of"]

Polygons: TypeAlias = Mapping[str, list[Points]]

_EXPANSIONS = tuple(
    f"KEEPOUT_EXPANSION_{link}_{way}" for link in ("THETA", "PHI") for way in ("RADIAL", "ANGULAR")
)
_INNER = 8  # corners of a petal's keep-out that go round its inside
_PETALS = 10
_MOST_MM = 700.0  # a corner beyond it is in pixels
_DEGREE = 5  # of the polynomial from pixels to mm; it fits to 0.1 um
_FIT_MM = 0.01


def polygons_of(text: str) -> Polygons:
    """Return the polygons in the header of a state, by their names; empty without any.

    Raises:
        FormatError: a polygon has not as many x as y.
    """
    header = "\n".join(line[1:] for line in text[: 1 << 20].splitlines() if line.startswith("#"))
    start = re.search(r"^( +)keepout:\n", header, re.MULTILINE)
    if start is None:
        return {}
    indent, rest = start.group(1), header[start.end() :]
    end = re.search(rf"^{indent}\w", rest, re.MULTILINE)
    section = rest[: end.start()] if end else rest
    found: dict[str, list[Points]] = {}
    parts = rf"^{indent}  (\w+):\n(.*?)(?=^{indent}  \w|\Z)"
    for name, body in re.findall(parts, section, re.MULTILINE | re.DOTALL):
        try:
            lists = [
                np.array([float(word) for word in numbers.split(",")])
                for numbers in re.findall(r"\[([^\[\]]*)\]", body)
            ]
            pairs = zip(lists[::2], lists[1::2], strict=True)
            found[name] = [np.stack(pair, axis=1) for pair in pairs]
        except ValueError:
            raise FormatError(f"the keep-outs {name} in the header are no polygons") from None
    return found


def file_outlines(columns: Columns, polygons: Polygons) -> dict[str, Floats]:
    """Return the outlines of robots by the names of own columns; empty where the file has none."""
    if not all([columns.optional(name) for name in ("KEEPOUT_T", "KEEPOUT_P")]):
        return {}
    if not polygons.get("theta") or not polygons.get("phi"):
        return {}
    found = {}
    for name, kind in (("KEEPOUT_T", "theta"), ("KEEPOUT_P", "phi")):
        hulls = padded_walls([convex_hull(polygon) for polygon in polygons[kind]])
        number = columns.whole(name)
        bad = (number < 0) | (number >= len(hulls))
        columns.refuse_rows(bad, name, f"is no number of a polygon, 0 to {len(hulls) - 1}")
        found[f"{kind}_outline_mm"] = hulls[np.where(bad, 0, number)]
    return found


def expanded_outlines(
    columns: Columns, arms: Floats, linear_phi: Bools
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Return the published outlines, expanded for each robot, and a notice that says so."""
    nothing = np.zeros(len(arms))
    values = [
        np.nan_to_num(columns.numbers(name, missing=True)) if columns.optional(name) else nothing
        for name in _EXPANSIONS
    ]
    values[3] = np.where(linear_phi, np.maximum(values[3], LINEAR_DEG), values[3])
    usable = np.where(np.isfinite(arms), arms, 3.0)  # what is wrong is refused with its column
    theta, phi = keepouts(usable, *values)
    count = np.count_nonzero(np.any(values, axis=0))
    notice = f"outlines are those published, longer with the arms; {count} robots have larger ones"
    return {"theta_outline_mm": theta, "phi_outline_mm": phi}, (notice,)


def file_walls(
    columns: Columns, polygons: Polygons, petal: Ints, centers: Points
) -> tuple[Floats, tuple[str, ...]]:
    """Return edges and cameras of the petals that hold robots, and notices.

    Args:
        columns: all rows of the state, for the scale of the camera.
        polygons: those of the header.
        petal: place of the petal of each robot, shape (n,).
        centers: places of the robots [mm], shape (n, 2).

    Raises:
        FormatError: the edges of a petal do not hold its robots.
    """
    used = np.unique(petal)
    edges, cameras = (polygons.get(name, []) for name in ("ptl", "gfa"))
    if len(edges) != _PETALS or len(cameras) != _PETALS:
        return petal_walls(used), ("petal edges and GFAs are those published: the file has none",)
    to_mm = _scale(columns) if max(np.abs(p).max() for p in edges) > _MOST_MM else np.asarray
    if to_mm is None:
        return petal_walls(used), (
            "petal edges and GFAs are those published: X_FVC, Y_FVC do not tell where those of the "
            "header lie",
        )
    shapes: list[Points] = []
    for place in used.tolist():
        edge = to_mm(edges[place])[:_INNER]
        outside = ~_inside(edge, centers[petal == place])
        if outside.any():
            raise FormatError(
                f"{columns.table.label}: {np.count_nonzero(outside)} robots of petal {place} stand "
                "outside of its edges"
            )
        shapes += list(np.stack([edge, np.roll(edge, -1, axis=0)], axis=1))
        shapes += convex_parts(to_mm(cameras[place]))
    return padded_walls(shapes), ()


def _scale(columns: Columns):
    # from pixels to the focal plane, None where the columns do not tell
    names = ("X_FVC", "Y_FVC", "X_FP", "Y_FP")
    if not all(name in columns for name in names):
        return None
    values = np.stack([columns.numbers(name, missing=True) for name in names], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 3 * (_DEGREE + 1) * (_DEGREE + 2) // 2:
        return None
    pixels, places = values[:, :2], values[:, 2:]
    middle, half = pixels.mean(axis=0), np.ptp(pixels, axis=0).max() / 2

    def terms(points: Points) -> Floats:
        x, y = ((points - middle) / half).T
        powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
        return np.stack([x**i * y**j for i, j in powers], axis=1)

    weights = np.linalg.lstsq(terms(pixels), places, rcond=None)[0]
    if np.abs(terms(pixels) @ weights - places).max() > _FIT_MM:
        return None
    return lambda points: terms(points) @ weights


def _inside(polygon: Points, points: Points) -> Bools:
    # even-odd rule along a ray to the right
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0)):
        across = (y0 > points[:, 1]) != (y1 > points[:, 1])
        slope = (x1 - x0) / (y1 - y0) if y1 != y0 else 0.0
        odd ^= across & (points[:, 0] < x0 + (points[:, 1] - y0) * slope)
    return odd

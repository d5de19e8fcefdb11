# SPDX-License-Identifier: Apache-2.0
"""Values of a layout that a file may hold by mistake: other units, robots without a known place."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Floats, Ids, Points

__all__ = ["AS_RADIANS", "MANY", "far_bodies", "far_from_others", "layout_doubts"]

MANY = 10  # robots from which on what is common to all of them tells something
AS_RADIANS = 7.0  # a turn, and what ranges have beyond it
_FAR = 2.0  # in a round plane the outermost robot is 1.05 times as far out as nine in ten
_BESIDE_MM = 100.0  # cameras and guides stand beside the robots
_RANGES = ("theta_range_deg", "phi_range_deg")
_ZERO = "theta_zero_deg"


def layout_doubts(columns: Mapping[str, NDArray]) -> tuple[str, ...]:
    """Return notices of columns that may be in radians.

    Args:
        columns: of own names, each of shape (n,).
    """
    if len(columns["id"]) < MANY:
        return ()
    most = {name: _most(columns[name]) for name in (*_RANGES, _ZERO) if name in columns}
    small = [name for name, value in most.items() if value <= AS_RADIANS]
    if _ZERO in small and np.ptp(columns[_ZERO]) < 1.0:
        small.remove(_ZERO)  # zeros that were aligned
    return tuple(
        f"{name} is within {most[name]:.2f} degrees in every row: is it in radians?"
        for name in small
    )


def far_from_others(ids: Ids, centers: Points) -> Ids:
    """Return the robots that stand far outside of the plane, as one with a place of -999 mm.

    Args:
        ids: robot ids, shape (n,).
        centers: their places [mm], shape (n, 2).
    """
    if len(ids) < MANY:
        return ids[:0]
    away = np.hypot(*(centers - np.median(centers, axis=0)).T)
    return ids[away > _FAR * np.quantile(away, 0.9)]


def far_bodies(centers: Points, obstacles: Floats, walls: Floats) -> tuple[str, ...]:
    """Return a notice where all obstacles or all walls are far outside: they keep no robot away.

    Args:
        centers: places of the robots [mm], shape (n, 2).
        obstacles: discs x, y, radius [mm], shape (k, 3).
        walls: polygons [mm], shape (w, c, 2).
    """
    if len(centers) < MANY:  # a few robots of an instrument with all its walls
        return ()
    middle = np.median(centers, axis=0)
    plane = np.hypot(*(centers - middle).T).max() + _BESIDE_MM
    to_discs = np.hypot(*(obstacles[:, :2] - middle).T) - obstacles[:, 2]
    to_walls = np.hypot(*np.moveaxis(walls - middle, 2, 0)).min(axis=1)
    return tuple(
        f"all {len(away)} {name} are far from all robots: are their places in mm?"
        for name, away in (("obstacles", to_discs), ("walls", to_walls))
        if len(away) and np.all(away > _FAR * plane)
    )


def _most(values: Floats) -> float:
    return float(np.abs(values).max())

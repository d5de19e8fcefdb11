# SPDX-License-Identifier: Apache-2.0
"""What readers return: columns as found in a file, and planes, starts and targets of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Angles, Bools, Floats, Ids, Ints, Points
from fiber_core.fibres import ANY_FIBRE
from fiber_core.focal_plane import FocalPlane

__all__ = ["Layout", "LayoutColumns", "StartColumns", "Starts", "TargetColumns", "Targets"]


def _no_obstacles() -> Floats:
    return np.zeros((0, 3))


def _no_walls() -> Floats:
    return np.zeros((0, 1, 2))


@dataclass(frozen=True, eq=False)
class LayoutColumns:
    """The robots of a file, translated into our own columns.

    Args:
        columns: arrays of equal length by the names of our own columns (`own.LAYOUT_COLUMNS`);
            `id`, `x_mm` and `y_mm` are always there. Outlines have shape (n, corners, 2) [mm].
        obstacles: fixed discs x, y, radius [mm], shape (k, 3).
        preset: instrument that supplies the figures which the file lacks, or None.
        walls: fixed convex polygons [mm], as those of FocalPlane, shape (w, c, 2).
        fibre_names: names of the fibres whose places are the column `fibre_places_mm`, shape
            (n, fibres, 2) [mm].
        notices: what was not used, assumed or approximated; one sentence each.
    """

    columns: Mapping[str, NDArray]
    obstacles: Floats = field(default_factory=_no_obstacles)
    preset: str | None = None
    notices: tuple[str, ...] = ()
    walls: Floats = field(default_factory=_no_walls)
    fibre_names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class StartColumns:
    """Present angles as a file gives them.

    Args:
        ids: robot ids, shape (k,).
        angles_deg: theta, phi [deg], shape (k, 2); nan where the file has none.
        from_lower_stop: whether the angles count from the lower end of each joint's range and
            not in the focal plane frame.
        notices: as for LayoutColumns.
    """

    ids: Ids
    angles_deg: Floats
    from_lower_stop: bool = False
    notices: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class TargetColumns:
    """Targets as a file gives them.

    Args:
        ids: robot ids, shape (k,).
        xy_mm: targets [mm], shape (k, 2); nan for a robot without target.
        notices: as for LayoutColumns.
        fibre: name of the fibre that each target is for, empty for any, shape (k,); None for any.
        tip_mm: where the tips of the robots are then [mm], shape (k, 2), for a plane that does not
            know the fibres; None where the file does not tell.
    """

    ids: Ids
    xy_mm: Points
    notices: tuple[str, ...] = ()
    fibre: NDArray[np.str_] | None = None
    tip_mm: Points | None = None


@dataclass(frozen=True, eq=False)
class Layout:
    """A focal plane from a file.

    Args:
        plane: the focal plane.
        found: what the file itself holds, in the order of its rows.
        format_name: the format that was recognised.
        preset: the preset that supplied missing figures.
        summary: one line: number of robots, of disabled ones, and what the preset supplied.
        notices: what was not used, assumed or approximated; one sentence each.
    """

    plane: FocalPlane
    found: LayoutColumns
    format_name: str
    preset: str
    summary: str
    notices: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Starts:
    """Present joint angles of all robots of a plane.

    Args:
        angles: theta, phi [rad], in the order of the plane, shape (n, 2).
        format_name: the format that was recognised.
        summary: one line.
        notices: as for Layout.
    """

    angles: Angles
    format_name: str
    summary: str
    notices: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Targets:
    """Where fibres should go.

    Args:
        ids: robots with a target, in the order of the file, shape (k,).
        xy_mm: their targets [mm], shape (k, 2).
        without_target: ids of the rows that ask nothing, shape (m,).
        format_name: the format that was recognised.
        summary: one line.
        notices: as for Layout.
        fibre: name of the fibre that each target is for, empty for any, shape (k,).
    """

    ids: Ids
    xy_mm: Points
    without_target: Ids
    format_name: str
    summary: str
    notices: tuple[str, ...]
    fibre: NDArray[np.str_]

    def fibre_numbers(self, plane: FocalPlane) -> Ints:
        """Return the number of the fibre on a plane for each target, -1 for any, shape (k,)."""
        numbers = {"": ANY_FIBRE} | {name: k for k, name in enumerate(plane.fibre_names)}
        return np.array([numbers[name] for name in self.fibre.tolist()], dtype=np.int64)

    def on(self, plane: FocalPlane) -> FocalPlane:
        """Return a plane with the fibres that these targets are for."""
        fibre, rows = np.full(plane.n, ANY_FIBRE), plane.index_of(self.ids)
        fibre[rows[rows >= 0]] = self.fibre_numbers(plane)[rows >= 0]
        return plane.with_fibre(fibre)

    def of(self, plane: FocalPlane) -> tuple[Points, Bools]:
        """Return targets in the order of a plane (nan without one), (n, 2), and which rows fit.

        The second array, shape (k,), tells for each row whether the plane has its robot.
        """
        xy_mm = np.full((plane.n, 2), np.nan)
        rows = plane.index_of(self.ids)
        xy_mm[rows[rows >= 0]] = self.xy_mm[rows >= 0]
        return xy_mm, rows >= 0

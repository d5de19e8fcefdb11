# SPDX-License-Identifier: Apache-2.0
"""Figures of an instrument, and the focal plane that is built from them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_core.convex_parts import convex_hull
from fiber_core.drive.drive import Drive
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.hexagonal_grid import hexagonal_centers

__all__ = [
    "PlaneColumns",
    "Polygon",
    "Preset",
    "checked_number",
    "on_a_grid",
    "plane_from",
    "repeated",
]

Polygon: TypeAlias = tuple[tuple[float, float], ...]  # corners x, y in the frame of a link [mm]


@dataclass(frozen=True)
class Preset:
    """Figures of one instrument in the units in which they are published: mm and degrees.

    Args:
        robots: number of robots of the instrument.
        pitch_mm: distance between neighbouring robots on the hexagonal grid [mm].
        arms_mm: lengths of the theta arm and the phi arm, l1 and l2 [mm].
        theta_deg: range of theta about the zero of the robot [deg].
        phi_deg: range of phi [deg].
        speeds_deg_s: highest speeds of theta and phi [deg/s].
        envelope_mm: D of the papers: random targets and the navigation function keep tips that
            far apart [mm]. The spacing of targets is off, unless the outline is only a tip.
        radius_mm: rounding of the phi outline, for a capsule or a disc its radius [mm].
        phi_outline: "capsule" from elbow to tip, "tip" for a disc there, or a polygon [mm].
        theta_outline: polygon of the body that turns with theta [mm], empty for none.
        hexagon: whether the grid is a hexagon; otherwise it is a disc.
        gears: angles of both motors by angles of both joints where gears couple them, else None.
        motor_speeds_deg_s: highest speeds of both motors with gears [deg/s].
        note: which of these figures are inferred, chosen or assumed.
        build: makes the plane from the figures, a number of robots (None: all) and a name; by
            default `on_a_grid`. A plane of its own has scatter, walls or a layout besides, and the
            figures are those of a typical robot.
    """

    robots: int
    pitch_mm: float
    arms_mm: tuple[float, float]
    theta_deg: tuple[float, float]
    phi_deg: tuple[float, float]
    speeds_deg_s: tuple[float, float]
    envelope_mm: float
    radius_mm: float
    phi_outline: Literal["capsule", "tip"] | Polygon = "capsule"
    theta_outline: Polygon = ()
    hexagon: bool = False
    gears: tuple[tuple[float, float], tuple[float, float]] | None = None
    motor_speeds_deg_s: tuple[float, float] | None = None
    note: str = ""
    build: "Callable[[Preset, int | None, str], FocalPlane] | None" = None

    @property
    def spacing_mm(self) -> float:
        """Least distance between two targets that are accepted [mm]: 0 where outlines are whole."""
        return self.envelope_mm if self.phi_outline == "tip" else 0.0


class PlaneColumns(TypedDict, total=False):
    """Fields of FocalPlane that replace those of a preset."""

    limits: ArrayLike
    speeds: ArrayLike
    phi_vertices: ArrayLike
    phi_radius: ArrayLike
    theta_vertices: ArrayLike
    theta_radius: ArrayLike
    enabled: ArrayLike
    obstacles: ArrayLike
    walls: ArrayLike | None
    fibres: ArrayLike | None
    fibre_names: tuple[str, ...] | None
    coupling: ArrayLike | None
    motor_speeds: ArrayLike | None
    motor_limits: ArrayLike | None
    bus: ArrayLike | None
    address: ArrayLike | None
    spacing_mm: float
    envelope_mm: float | None
    name: str
    drive: Drive


def on_a_grid(figures: Preset, robots: int | None, name: str) -> FocalPlane:
    """Return equal robots on a hexagonal grid.

    Args:
        figures: the preset.
        robots: number of robots; None for that of the instrument. Robot k stands on the same site
            for every number.
        name: name of the plane.

    Raises:
        LayoutError: the number is not a positive integer.
    """
    robots = figures.robots if robots is None else robots
    centers = hexagonal_centers(robots, figures.pitch_mm, figures.hexagon)
    return plane_from(figures, np.arange(len(centers)), centers, name=name)


def checked_number(figures: Preset, robots: int | None, name: str) -> int:
    """Return the number of robots of a plane that has no more sites than its instrument.

    Raises:
        LayoutError: the number is not a positive integer, or is more than there are sites.
    """
    robots = figures.robots if robots is None else robots
    if not (robots >= 1 and robots % 1 == 0):
        raise LayoutError(f"robots must be a positive integer, got {robots}")
    if robots > figures.robots:
        raise LayoutError(
            f"preset {name} has {figures.robots} sites, {robots} robots are asked for"
        )
    return int(robots)


def plane_from(
    figures: Preset,
    ids: ArrayLike,
    centers: ArrayLike,
    arms: ArrayLike | None = None,
    **columns: Unpack[PlaneColumns],
) -> FocalPlane:
    """Build a focal plane on given sites, with the figures of a preset for all other fields.

    Args:
        figures: the preset.
        ids: robot ids, strictly increasing, shape (n,).
        centers: theta axes [mm], shape (n, 2).
        arms: lengths of both arms [mm], shape (n, 2); capsules and tips have these lengths.
        columns: any other field of FocalPlane, in place of the figures of the preset.

    Raises:
        LayoutError: as FocalPlane.
    """
    n = np.size(ids)
    arms = repeated(figures.arms_mm, n) if arms is None else np.asarray(arms, dtype=float)
    values = PlaneColumns(
        limits=repeated(np.deg2rad([figures.theta_deg, figures.phi_deg]), n),
        speeds=repeated(np.deg2rad(figures.speeds_deg_s), n),
        phi_vertices=_phi_vertices(figures.phi_outline, arms),
        phi_radius=repeated(figures.radius_mm, n),
        theta_vertices=repeated(_hull(figures.theta_outline), n),
        theta_radius=np.zeros(n),
        enabled=np.ones(n, dtype=bool),
        spacing_mm=figures.spacing_mm,
        envelope_mm=figures.envelope_mm,
    )
    if figures.gears is not None:
        values["coupling"] = repeated(figures.gears, n)
    if figures.motor_speeds_deg_s is not None:
        values["motor_speeds"] = repeated(np.deg2rad(figures.motor_speeds_deg_s), n)
    values.update(columns)
    return FocalPlane(ids=ids, centers=centers, arms=arms, **values)


def repeated(value: ArrayLike, n: int) -> Floats:
    """Return the same value for n robots, shape (n, *value.shape)."""
    value = np.array(value, dtype=np.float64)
    return np.broadcast_to(value, (n, *value.shape))


def _phi_vertices(outline: Literal["capsule", "tip"] | Polygon, arms: Floats) -> Floats:
    if outline != "capsule" and outline != "tip":
        return repeated(_hull(outline), len(arms))
    vertices = np.zeros((len(arms), 2, 2))
    vertices[:, 1, 0] = arms[:, 1]
    return vertices if outline == "capsule" else vertices[:, 1:]


def _hull(polygon: Polygon) -> Floats:
    points = np.array(polygon, dtype=np.float64).reshape(-1, 2)
    return convex_hull(points) if len(points) else points

# SPDX-License-Identifier: Apache-2.0
"""Presets: focal planes of known instruments, built from a table of their figures."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from fiber_core.array_types import Floats
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.hexagonal_grid import hexagonal_centers

__all__ = ["PRESETS", "PlaneColumns", "Polygon", "Preset", "figures_of", "plane_from", "preset"]

Polygon: TypeAlias = tuple[tuple[float, float], ...]  # corners x, y in the frame of a link [mm]

# DESI-0899, in the frame of the link [mm].
_DESI_PHI_ARM: Polygon = (
    (3.967, 0.000), (3.918, 1.014), (3.269, 1.583), (-1.172, 1.037),
    (-1.172, -1.037), (3.269, -1.583), (3.918, -1.014),
)  # fmt: skip
_DESI_THETA_BODY: Polygon = (
    (0.814, -3.236), (2.083, -2.707), (2.613, -2.665), (4.154, -2.759), (4.695, -1.680),
    (5.094, -0.540), (5.094, 0.540), (4.831, 1.291), (4.235, 1.933), (3.432, 2.283),
    (2.280, 2.283), (-1.902, -0.935), (-2.007, -2.665), (-1.139, -3.137), (-0.170, -3.332),
)  # fmt: skip


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
        note: which of these figures are inferred, chosen or assumed.
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
    note: str = ""

    @property
    def spacing_mm(self) -> float:
        """Least distance between two targets that are accepted [mm]: 0 where outlines are whole."""
        return self.envelope_mm if self.phi_outline == "tip" else 0.0


_DESI = Preset(
    robots=5000,
    pitch_mm=10.4,
    arms_mm=(3.0, 3.0),
    theta_deg=(-194.0, 194.0),
    phi_deg=(0.0, 180.0),
    speeds_deg_s=(176.0, 176.0),
    envelope_mm=4.0,
    radius_mm=1.0,
    note="A capsule of 1 mm in place of the real outlines, and a plain hexagonal grid in "
    "place of ten petals. Joint ranges are the narrow end of the real ones.",
)

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "paper": Preset(
            robots=5167,
            pitch_mm=12.0,
            arms_mm=(3.0, 3.0),
            theta_deg=(-1440.0, 1440.0),
            phi_deg=(-1440.0, 1440.0),
            speeds_deg_s=(180.0, 120.0),
            envelope_mm=4.0,
            radius_mm=1.0,
            phi_outline="tip",
            hexagon=True,
            note="A&A 566 A84. Pitch inferred from its Fig. 7, arms from its text. It keeps only "
            "tips apart (discs of d = 2 mm) and has no joint stops: four turns either way "
            "stand for none.",
        ),
        "desi": _DESI,
        "desi_outlines": replace(
            _DESI,
            radius_mm=0.0,
            phi_outline=_DESI_PHI_ARM,
            theta_outline=_DESI_THETA_BODY,
            note="Outlines of DESI-0899; the theta body is replaced by its convex hull. Plain "
            "hexagonal grid, no petal edges.",
        ),
        "pfs": Preset(
            robots=2394,
            pitch_mm=8.0,
            arms_mm=(2.375, 2.375),
            theta_deg=(-192.5, 192.5),
            phi_deg=(0.0, 180.0),
            speeds_deg_s=(180.0, 180.0),
            envelope_mm=4.0,
            radius_mm=1.0,
            note="Speed assumed, none is published: half a turn a second, so that times read as "
            "half turns. Envelope as in the papers.",
        ),
        "sdss_v": Preset(
            robots=547,
            pitch_mm=22.4,
            arms_mm=(7.4, 15.0),
            theta_deg=(0.0, 360.0),
            phi_deg=(0.0, 180.0),
            speeds_deg_s=(12.0, 12.0),
            envelope_mm=8.0,
            radius_mm=2.0,
            hexagon=True,
            note="Speed as its own planner uses it. The full hexagon of 547 sites, of which the "
            "instrument fills 500. Envelope chosen: four radii.",
        ),
        "moons": Preset(
            robots=1006,
            pitch_mm=25.3,
            arms_mm=(8.0, 17.0),
            theta_deg=(-180.0, 180.0),
            phi_deg=(-180.0, 150.0),
            speeds_deg_s=(16.7, 22.5),
            envelope_mm=10.5,
            radius_mm=2.625,
            note="The highest speeds of the ranges quoted. A capsule as wide as the widest part of "
            "the beta arm (5.25 mm), without its 0.5 mm of safety. Envelope chosen: four radii.",
        ),
        "lamost": Preset(
            robots=4000,
            pitch_mm=25.6,
            arms_mm=(8.25, 8.25),
            theta_deg=(-180.0, 180.0),
            phi_deg=(0.0, 180.0),
            speeds_deg_s=(180.0, 180.0),
            envelope_mm=8.0,
            radius_mm=2.0,
            note="Arms inferred. Joint ranges, speeds and arm width are assumed, none is known: "
            "the least ranges that reach the whole disc, half a turn a second, the width of an "
            "SDSS-V arm. Envelope chosen: four radii.",
        ),
    }
)


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
    bus: ArrayLike | None
    address: ArrayLike | None
    spacing_mm: float
    envelope_mm: float | None
    name: str


def preset(name: str, robots: int | None = None) -> FocalPlane:
    """Return the focal plane of an instrument, on a hexagonal grid of any number of robots.

    Args:
        name: one of PRESETS; the note of each says which figures are assumed.
        robots: number of robots; by default that of the instrument. Robot k stands on the
            same site for every number.

    Raises:
        LayoutError: no preset has this name, or the number is not a positive integer.
    """
    figures = figures_of(name)
    robots = figures.robots if robots is None else robots
    centers = hexagonal_centers(robots, figures.pitch_mm, figures.hexagon)
    return plane_from(figures, np.arange(len(centers)), centers, name=name)


def figures_of(name: str) -> Preset:
    """Return the figures of an instrument.

    Raises:
        LayoutError: no preset has this name.
    """
    if name not in PRESETS:
        raise LayoutError(f"no preset is named {name!r}; there are {', '.join(PRESETS)}")
    return PRESETS[name]


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
    arms = _repeated(figures.arms_mm, n) if arms is None else np.asarray(arms, dtype=float)
    values = PlaneColumns(
        limits=_repeated(np.deg2rad([figures.theta_deg, figures.phi_deg]), n),
        speeds=_repeated(np.deg2rad(figures.speeds_deg_s), n),
        phi_vertices=_phi_vertices(figures.phi_outline, arms),
        phi_radius=_repeated(figures.radius_mm, n),
        theta_vertices=_repeated(_hull(figures.theta_outline), n),
        theta_radius=np.zeros(n),
        enabled=np.ones(n, dtype=bool),
        spacing_mm=figures.spacing_mm,
        envelope_mm=figures.envelope_mm,
    )
    values.update(columns)
    return FocalPlane(ids=ids, centers=centers, arms=arms, **values)


def _repeated(value: ArrayLike, n: int) -> Floats:
    # the same value for n robots
    value = np.array(value, dtype=np.float64)
    return np.broadcast_to(value, (n, *value.shape))


def _phi_vertices(outline: Literal["capsule", "tip"] | Polygon, arms: Floats) -> Floats:
    if outline != "capsule" and outline != "tip":
        return _repeated(_hull(outline), len(arms))
    vertices = np.zeros((len(arms), 2, 2))
    vertices[:, 1, 0] = arms[:, 1]
    return vertices if outline == "capsule" else vertices[:, 1:]


def _hull(polygon: Polygon) -> Floats:
    points = np.array(polygon, dtype=np.float64).reshape(-1, 2)
    return points[ConvexHull(points).vertices] if len(points) else points  # counter-clockwise

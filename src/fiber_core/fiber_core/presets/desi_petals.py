# SPDX-License-Identifier: Apache-2.0
"""DESI as it is built: ten petals with edges and cameras, and robots that differ.

Corners, pitch and numbers are published; the scatter follows statistics of a calibration of
2026, of which it holds no value. Robots are numbered petal by petal, from the centre outwards.
"""

from dataclasses import replace

import numpy as np

from fiber_core.array_types import Bools, Floats, Ints, Points
from fiber_core.convex_parts import convex_parts
from fiber_core.drive.drive import Drive
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets.desi import DESI_OUTLINES, keepouts
from fiber_core.presets.figures import Polygon, Preset, checked_number, plane_from
from fiber_core.walls import distances_to_walls, padded_walls

__all__ = ["DESI_PETALS", "petal_angle", "petal_walls"]

# Inner side of the keep-out of a petal, and that of its guide camera, in the frame of the petal
# [mm]: DESI-0899 in the projection of DESI-0742.
_EDGE: Polygon = (
    (20.260, 0.0), (410.189, 0.0), (418.0, 32.25), (406.3, 89.0),
    (399.0, 125.0), (384.0, 167.5), (325.837, 235.993), (20.260, 13.978),
)  # fmt: skip
_CAMERA: Polygon = (
    (295.569, 207.451), (301.644, 201.634), (303.538, 201.588), (305.444, 201.296),
    (307.547, 201.131), (309.204, 199.968), (320.770, 184.033), (353.527, 207.831),
)  # fmt: skip

_PETALS, _IN_PETAL = 10, 502
_FIRST_SITE_MM = (28.13, 5.2)  # nearest the centre; rows run along the lower edge
_FROM_SIDES_MM, _FROM_RIM_MM, _FROM_CAMERA_MM = 5.2, 7.1, 6.6  # least distances of the axes
_SEED = 2026

# Statistics of the calibration of 3 March 2026: shares of 5020 robots, and of the 4646 in use.
_DISABLED, _LINEAR_THETA, _LINEAR_PHI = 374 / 5020, 295 / 4646, 204 / 4646
_EXPANSION_DEG = 5.5  # of the keep-outs of linear motors
_THETA_SCALE, _PHI_SCALE, _PHI_SCATTER = 0.75, 0.75, 0.12  # turn by that of a linear motor
_SLOWEST, _DIRECTIONS = 0.44, 0.01  # least scale, and how it differs between directions
_PETAL_SHIFT_MM, _SITE_SCATTER_MM = 0.06, 0.033
_DEGREES = 3  # of freedom of a t distribution, which has the tails that the values have


def petal_angle(petal: Floats | Ints) -> Floats:
    """Return how far petals are turned in the focal plane [rad], given their places 0 to 9."""
    return np.deg2rad(36.0 * (petal - 3.0))


def petal_walls(petals: Floats | Ints) -> Floats:
    """Return the edges and cameras of petals as walls [mm], shape (w, c, 2).

    The eight edges of a petal are lines; its camera is made of convex parts.

    Args:
        petals: places of the petals, 0 to 9, shape (k,).
    """
    edge = np.array(_EDGE)
    shapes = [*np.stack([edge, np.roll(edge, -1, axis=0)], axis=1), *convex_parts(_CAMERA)]
    turned = [_turned(shape, angle) for angle in petal_angle(petals) for shape in shapes]
    return padded_walls(turned)


def _petal_sites() -> Points:
    # all sites that lie far enough from edges and camera, nearest the centre first
    pitch, (x0, y0) = DESI_PETALS.pitch_mm, _FIRST_SITE_MM
    row, column = np.mgrid[0:30, -20:45].reshape(2, -1)
    sites = np.stack(
        [x0 + pitch * (column + 0.5 * (row % 2)), y0 + pitch * np.sqrt(0.75) * row], axis=1
    )
    edge = np.array(_EDGE)
    sides = np.stack([edge, np.roll(edge, -1, axis=0)], axis=1)
    inside = distances_to_walls(sites, np.broadcast_to(edge, (len(sites), *edge.shape))) == 0.0
    sites = sites[inside]
    rim = (1, 2, 3, 4, 5)
    least = [_FROM_RIM_MM if k in rim else _FROM_SIDES_MM for k in range(len(sides))]
    shapes = [*zip(sides, least), *((part, _FROM_CAMERA_MM) for part in convex_parts(_CAMERA))]
    for shape, distance in shapes:
        far = distances_to_walls(sites, np.broadcast_to(shape, (len(sites), *shape.shape)))
        sites = sites[far >= distance]
    return sites[np.argsort(np.hypot(*sites.T), kind="stable")]


def _plane(figures: Preset, robots: int | None, name: str) -> FocalPlane:
    n = figures.robots
    rows = slice(0, checked_number(figures, robots, name))
    rng = np.random.default_rng(_SEED)
    petal = np.repeat(np.arange(_PETALS), _IN_PETAL)
    centers = _centers(rng, petal)
    enabled = rng.random(n) >= _DISABLED
    linear_theta = enabled & (rng.random(n) < _LINEAR_THETA)
    linear_phi = enabled & ~linear_theta & (rng.random(n) < _LINEAR_PHI)
    arms = np.stack(
        [
            np.clip(3.0 + 0.043 * rng.standard_t(_DEGREES, n), 2.2, 3.8),
            np.clip(rng.normal(3.065, 0.043, n), 2.85, 3.25),
        ],
        axis=1,
    )
    theta_zero = rng.uniform(-180.0, 180.0, n)
    theta_range = np.clip(rng.normal(392.24, 1.54, n), 380.0, 402.0)
    phi_zero = np.clip(0.3 + 1.8 * rng.standard_t(_DEGREES, n), -12.0, 12.0)
    phi_range = np.clip(190.3 + 2.2 * rng.standard_t(_DEGREES, n), 183.0, 230.0)
    theta = np.stack([theta_zero - theta_range / 2, theta_zero + theta_range / 2], axis=1)
    phi = np.stack([phi_zero, phi_zero + phi_range], axis=1)
    theta_vertices, phi_vertices = keepouts(
        arms,
        theta_deg=np.where(linear_theta, _EXPANSION_DEG, 0.0),
        phi_deg=np.where(linear_phi, _EXPANSION_DEG, 0.0),
    )
    limits = np.deg2rad(np.stack([theta, phi], axis=1))
    return plane_from(
        figures,
        np.arange(n)[rows],
        centers[rows],
        arms[rows],
        limits=limits[rows],
        theta_vertices=theta_vertices[rows],
        phi_vertices=phi_vertices[rows],
        enabled=enabled[rows],
        bus=petal[rows],
        walls=petal_walls(np.unique(petal[rows])),
        name=name,
        drive=Drive(n, scale=_scales(linear_theta, linear_phi)).of_robots(np.arange(n)[rows]),
    )


def _scales(linear_theta: Bools, linear_phi: Bools) -> Floats:
    # turn of each joint by that of its motor, shape (n, 2, 2): robot, joint, direction
    n, rng = len(linear_theta), np.random.default_rng([_SEED, 1])
    scale = np.ones((n, 2, 2))
    scale[linear_theta, 0] = _THETA_SCALE
    of_phi = _PHI_SCALE + _PHI_SCATTER * rng.standard_normal((n, 1))
    of_phi = np.clip(of_phi + _DIRECTIONS * rng.standard_normal((n, 2)), _SLOWEST, 1.0)
    scale[linear_phi, 1] = of_phi[linear_phi]
    return scale


def _centers(rng: np.random.Generator, petal: Ints) -> Points:
    sites = _petal_sites()
    # the sites of a petal that hold fiducials instead of robots, spread over it
    empty = rng.choice(len(sites), (len(sites) - _IN_PETAL), replace=False)
    sites = np.delete(sites, empty, axis=0)
    shift = rng.normal(0.0, _PETAL_SHIFT_MM, (_PETALS, 2))
    scatter = rng.normal(0.0, _SITE_SCATTER_MM, (len(petal), 2))
    placed = np.concatenate([_turned(sites, angle) for angle in petal_angle(np.arange(_PETALS))])
    return placed + shift[petal] + scatter


def _turned(points: Points, angle: float) -> Points:
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


DESI_PETALS = replace(
    DESI_OUTLINES,
    robots=_PETALS * _IN_PETAL,
    pitch_mm=10.42,
    arms_mm=(3.0, 3.065),
    theta_deg=(-196.0, 196.0),
    phi_deg=(0.0, 190.0),
    build=_plane,
    note="Published: ten petals of 502 robots, petal edges, cameras, outlines and how they "
    "expand, pitch, speeds. Inferred: which sites hold fiducials (those are left empty, and are "
    "no obstacles); a hexagonal grid in each petal in place of the projected one. Drawn with one "
    "seed from the statistics of a calibration of 2026: arms, zeros, ranges, shifts of petals "
    "and sites, 7.5 % of robots disabled, 6.3 % with a linear theta motor and 4.4 % with a "
    "linear phi motor. Of a linear motor only the wider keep-out counts, 5.5 degrees; its speed "
    "is as that of others.",
)

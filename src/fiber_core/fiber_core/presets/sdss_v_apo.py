# SPDX-License-Identifier: Apache-2.0
"""SDSS-V at APO: fiducials, guide cameras, and robots with three fibres that differ.

Sites, fiducials, cameras and arms are published; the scatter follows statistics of a calibration,
of which it holds no value. Robots are numbered from the centre outwards, ring by ring.
"""

from dataclasses import replace

import numpy as np

from fiber_core.array_types import Floats, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.hexagonal_grid import hexagonal_centers
from fiber_core.presets.figures import Preset, checked_number, plane_from
from fiber_core.presets.sdss_v import CAMERA_MM, SDSS_V

__all__ = ["SDSS_V_APO"]

_SITES = 547
_FIDUCIALS = (4, 36, 48, 79, 100, 108)  # squared distances from the centre [pitch^2]
_EMPTY = ((3.0, 3.0**0.5), (-3.0, 3.0**0.5), (3.0, -(3.0**0.5)), (-3.0, -(3.0**0.5)))  # [pitch]
_FIDUCIAL_RADIUS_MM = 2.5
_CAMERA_PLACE_MM = 328.0  # from the centre, at 30, 90, ... degrees
_TIP_MM = 15.0  # end of the capsule: the outermost fibre
_FIBRES_MM = {"APOGEE": (14.975, 0.374), "BOSS": (14.975, -0.370), "METROLOGY": (14.327, 0.0)}
_SEED = 2024


def _plane(figures: Preset, robots: int | None, name: str) -> FocalPlane:
    n = figures.robots
    rows = slice(0, checked_number(figures, robots, name))
    rng = np.random.default_rng(_SEED)
    sites, fiducials = _sites()
    centers = sites[:n] + rng.normal([0.156, -0.170], [0.07, 0.10], (n, 2))
    arms = rng.normal([7.389, 14.327], [0.031, 0.023], (n, 2))
    fibres = rng.normal(list(_FIBRES_MM.values()), [0.025, 0.018], (n, 3, 2))
    fibres[:, 2] = np.stack([arms[:, 1], np.zeros(n)], axis=1)  # the tip
    zeros = rng.normal([0.305 - 90.0, 0.275], [0.585, 0.542], (n, 2))  # alpha = 0 points to -y
    limits = np.deg2rad(zeros[:, :, None] + [figures.theta_deg, figures.phi_deg])
    outline = np.broadcast_to([[0.0, 0.0], [_TIP_MM, 0.0]], (n, 2, 2))
    discs = np.column_stack([fiducials, np.full(len(fiducials), _FIDUCIAL_RADIUS_MM)])
    return plane_from(
        figures,
        np.arange(n)[rows],
        centers[rows],
        arms[rows],
        limits=limits[rows],
        phi_vertices=outline[rows],
        fibres=fibres[rows],
        fibre_names=tuple(_FIBRES_MM),
        obstacles=discs,
        walls=_cameras(),
        name=name,
    )


def _sites() -> tuple[Points, Points]:
    # sites of robots and of fiducials on the hexagon [mm]
    pitch = SDSS_V.pitch_mm
    sites = hexagonal_centers(_SITES, pitch, hexagon=True)
    squared = np.rint((sites**2).sum(axis=1) / pitch**2)
    fiducial = np.isin(squared, _FIDUCIALS)
    from_empty = np.hypot(*np.moveaxis(sites[:, None] - pitch * np.array(_EMPTY), -1, 0))
    empty = from_empty.min(axis=1) < pitch / 2
    return sites[~fiducial & ~empty], sites[fiducial]


def _cameras() -> Floats:
    walls: list[Points] = []
    for angle in np.deg2rad(30.0 + 60.0 * np.arange(6)):
        away = np.array([np.cos(angle), np.sin(angle)])
        along = np.array([away[1], -away[0]])
        corners = np.array(CAMERA_MM)
        walls.append(corners[:, :1] * along + (corners[:, 1:] + _CAMERA_PLACE_MM) * away)
    return np.stack(walls)


SDSS_V_APO = replace(
    SDSS_V,
    robots=500,
    arms_mm=(7.389, 14.327),
    build=_plane,
    note="Published: pitch, the sites of 500 robots and 42 fiducials on the hexagon, six cameras, "
    "arms, places of the three fibres, joint ranges, speed as its own planner uses it. Drawn with "
    "one seed from the statistics of a calibration: arms, fibres, zeros, offsets of sites. "
    "Inferred: which of 501 holes is empty, that each robot has three fibres (two in five have no "
    "APOGEE fibre), fiducials of 2.5 mm, and a capsule of 2 mm up to the outermost fibre. "
    "Envelope chosen: four radii.",
)

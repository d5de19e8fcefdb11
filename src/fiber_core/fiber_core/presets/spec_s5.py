# SPDX-License-Identifier: Apache-2.0
"""Spec-S5 as it is designed: triangular rafts with walls, and robots with coupled joints.

Only published figures are used: the pitch, the arms, the number of rafts and of robots in one, the
side of a raft, the gap between rafts, the thickness of a wall, and the gears. Robots are numbered
raft by raft, from the centre outwards; a raft is a bus.
"""

import numpy as np

from fiber_core.array_types import Floats, Ints, Points
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets.figures import Preset, plane_from

__all__ = ["SPEC_S5"]

_RAFTS, _SIDE_ROBOTS = 204, 11  # a triangle with 11 robots a side, less those at its corners
_RAFT_SIDE_MM, _GAP_MM, _WALL_MM = 74.0, 2.0, 0.3
_ROOT3 = 3.0**0.5


def _robots_of_raft() -> Points:
    # places about the middle of a raft with one corner up [mm], shape (63, 2)
    last = _SIDE_ROBOTS - 1
    row = np.concatenate([np.full(_SIDE_ROBOTS - r, r) for r in range(_SIDE_ROBOTS)])
    column = np.concatenate([np.arange(_SIDE_ROBOTS - r) for r in range(_SIDE_ROBOTS)])
    corner = ((row == 0) & ((column == 0) | (column == last))) | (row == last)
    sites = np.stack([column + 0.5 * row - 0.5 * last, 0.5 * _ROOT3 * row - last / (2 * _ROOT3)])
    return SPEC_S5.pitch_mm * sites.T[~corner]


def _walls_of_raft() -> Floats:
    # the three sides and three cut corners as plates about the middle of the raft, (6, 4, 2)
    to_side = _RAFT_SIDE_MM / (2 * _ROOT3)
    sites = _robots_of_raft()
    down, up = np.array([0.0, -1.0]), np.array([0.0, 1.0])
    beside = to_side - (sites @ down).max()  # as far from the robots at a corner
    to_corner = (sites @ up).max() + beside
    cut = 2 * to_side - to_corner  # from the corner of the whole triangle
    half_cut, half_side = cut / _ROOT3, _RAFT_SIDE_MM / 2 - 2 * cut / _ROOT3
    plates: list[Points] = []
    for turn in range(3):
        for away, distance, half in ((down, to_side, half_side), (up, to_corner, half_cut)):
            along = np.array([-away[1], away[0]])
            corners = [
                (distance - depth) * away + end * along
                for depth, end in ((0, half), (0, -half), (_WALL_MM, -half), (_WALL_MM, half))
            ]
            plates.append(_turned(np.array(corners), turn * 2 * np.pi / 3))
    return np.stack(plates)


def _rafts() -> tuple[Points, Floats]:
    # middles [mm] and turns [rad] of all rafts, from the centre outwards
    side = _RAFT_SIDE_MM + _ROOT3 * _GAP_MM  # with half of the gap on each side
    sites: Ints = np.mgrid[-12:13, -12:13].reshape(2, -1)
    a, b = sites
    corner = side * np.stack([a + 0.5 * b, 0.5 * _ROOT3 * b], axis=1)
    up = corner + side * np.array([0.5, _ROOT3 / 6])
    down = corner + side * np.array([1.0, _ROOT3 / 3])
    middles = np.concatenate([up, down])
    turns = np.repeat([0.0, np.pi], len(corner))
    away: Floats = np.hypot(middles[:, 0], middles[:, 1])
    around: Floats = np.arctan2(middles[:, 1], middles[:, 0])
    order = np.lexsort((np.round(around, 6), np.round(away, 6)))[:_RAFTS]
    return middles[order], turns[order]


def _turned(points: Points, angle: float) -> Points:
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def _plane(figures: Preset, robots: int | None, name: str) -> FocalPlane:
    robots = figures.robots if robots is None else robots
    if not (robots >= 1 and robots % 1 == 0):
        raise LayoutError(f"robots must be a positive integer, got {robots}")
    if robots > figures.robots:
        raise LayoutError(
            f"preset {name} has {figures.robots} sites, {robots} robots are asked for"
        )
    middles, turns = _rafts()
    sites, plates = _robots_of_raft(), _walls_of_raft()
    used = -(-int(robots) // len(sites))
    centers = [middle + _turned(sites, turn) for middle, turn in zip(middles[:used], turns)]
    walls = [
        middle + _turned(plate, turn)
        for middle, turn in zip(middles[:used], turns)
        for plate in plates
    ]
    rows = int(robots)
    return plane_from(
        figures,
        np.arange(rows),
        np.concatenate(centers)[:rows],
        walls=np.stack(walls),
        bus=(np.arange(rows) // len(sites)),
        name=name,
    )


SPEC_S5 = Preset(
    robots=_RAFTS * 63,
    pitch_mm=6.2,
    arms_mm=(1.8, 1.8),
    theta_deg=(-180.0, 180.0),
    phi_deg=(0.0, 180.0),
    speeds_deg_s=(180.0, 300.0),
    envelope_mm=3.2,
    radius_mm=0.8,
    # the motor of phi also turns with theta: phi = theta + 2/3 motor
    gears=((1.0, 0.0), (-1.5, 1.5)),
    motor_speeds_deg_s=(180.0, 180.0),
    build=_plane,
    note="Published: 204 rafts of 63 robots, pitch, arms, no part beyond 4.4 mm, rafts of 74 mm, "
    "gaps of 2.0 mm, walls of 0.3 mm, joint ranges, gears. Inferred: where the corners of a raft "
    "are cut, which rafts there are, and that walls are as high as the arms. Flat: the tilt of a "
    "raft changes only the gap to the next. Speeds assumed, none is published: each motor half a "
    "turn a second; phi turns as fast as both motors let it. Envelope chosen: four radii.",
)

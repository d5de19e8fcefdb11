# SPDX-License-Identifier: Apache-2.0
"""MUST and a plane like WST: triangular rafts of 63 robots, in two directions.

Robots are numbered raft by raft, from the centre outwards; a raft is a bus.
"""

from dataclasses import replace

import numpy as np

from fiber_core.array_types import Floats, Ints, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets.figures import Preset, checked_number, plane_from

__all__ = ["MUST", "WST_MIXED"]

_ROW = 11  # sites along the side of a raft; its three corners are cut
_IN_RAFT = 63
_SIDE_MM = 76.52  # from raft to raft of one direction
_LONG_ARMS_MM = (3.6, 3.6)
_ROOT3 = 3.0**0.5


def _sites(pitch_mm: float) -> Points:
    # places about the middle of a raft with one corner up [mm], the middle ones first
    row, column = np.mgrid[0:_ROW, 0:_ROW].reshape(2, -1)
    third = _ROW - 1 - row - column
    kept = (third >= 0) & (np.max([row, column, third], axis=0) < _ROW - 1)
    row, column = row[kept], column[kept]
    middle = (_ROW - 1) / 3
    x, y = column - middle + 0.5 * (row - middle), _ROOT3 / 2 * (row - middle)
    order = np.lexsort([x, y, np.round(np.hypot(x, y), 6)])
    return pitch_mm * np.stack([x, y], axis=1)[order]


def _rafts(count: int) -> tuple[Points, Floats]:
    # middles [mm] and signs of the rafts nearest the centre; -1 is turned by half a turn
    reach = int(np.ceil(np.sqrt(count))) + 2
    sites: Ints = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    a, b = sites
    corner = _SIDE_MM * np.stack([a + 0.5 * b, _ROOT3 / 2 * b], axis=1)
    up, down = [0.5, _ROOT3 / 6], [1.0, _ROOT3 / 3]
    middles = np.concatenate([corner + _SIDE_MM * np.array(at) for at in (up, down)])
    signs = np.repeat([1.0, -1.0], len(corner))
    place = np.round(middles, 6)
    away = np.round(np.hypot(place[:, 0], place[:, 1]), 6)
    order = np.lexsort((place[:, 0], place[:, 1], away))[:count]
    return middles[order], signs[order]


def _plane(figures: Preset, robots: int | None, name: str) -> FocalPlane:
    count = checked_number(figures, robots, name)
    centers = _centers(figures, count)
    return plane_from(
        figures, np.arange(count), centers, bus=np.arange(count) // _IN_RAFT, name=name
    )


def _mixed(figures: Preset, robots: int | None, name: str) -> FocalPlane:
    count = checked_number(figures, robots, name)
    arms = np.tile(figures.arms_mm, (count, 1))
    sites = _sites(figures.pitch_mm)
    angle = np.arctan2(sites[:, 1], sites[:, 0])
    ring = np.abs(np.hypot(*sites.T) - 2.5 * figures.pitch_mm)
    long = [int(np.argmin(ring + np.abs(angle - at))) for at in np.deg2rad([-150.0, -30.0, 90.0])]
    arms[np.isin(np.arange(count) % _IN_RAFT, long)] = _LONG_ARMS_MM
    bus = np.arange(count) // _IN_RAFT
    return plane_from(figures, np.arange(count), _centers(figures, count), arms, bus=bus, name=name)


def _centers(figures: Preset, count: int) -> Points:
    sites = _sites(figures.pitch_mm)
    middles, signs = _rafts(-(-count // _IN_RAFT))
    return (middles[:, None] + signs[:, None, None] * sites).reshape(-1, 2)[:count]


MUST = Preset(
    robots=372 * _IN_RAFT,
    pitch_mm=6.2,
    arms_mm=(1.8, 1.8),
    theta_deg=(-180.0, 180.0),
    phi_deg=(0.0, 180.0),
    speeds_deg_s=(180.0, 180.0),
    envelope_mm=3.2,
    radius_mm=0.8,
    build=_plane,
    note="Published: rafts of 63 robots, pitch, arms, no part beyond 4.4 mm, about 23,400 robots. "
    "Inferred: 372 rafts nearest the centre, 76.5 mm from raft to raft of one direction, as far as "
    "published places of them are apart, and no walls. Flat: rafts are not tilted. Joints are not "
    "coupled. Joint ranges and speed assumed: half a turn a second. Envelope chosen: four radii.",
)

WST_MIXED = replace(
    MUST,
    robots=508 * _IN_RAFT,
    build=_mixed,
    note="As must with about 32,000 robots. Published: 3 of 63 robots of a raft have arms of "
    "3.6 mm, twice as long. Inferred: which of the 63 these are, one in each third of a raft. "
    "Joints are not coupled, rafts are not tilted and have no walls. Joint ranges and speed are "
    "assumed.",
)

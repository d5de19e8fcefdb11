# SPDX-License-Identifier: Apache-2.0
"""The two elbows of an arm whose fibre is at a place, which a small turn of phi tells apart.

With the fibre at p from the axis of theta, at a distance d, the elbow joint is at either of two
places e, mirrored at the line of p. A turn of phi by b moves the fibre by b across p - e: in two
directions that are 2 g apart, sin g = l1 sin(phi) / d. A stretched arm (g = 0) tells nothing, and
hardly needs it; a folded one moves in opposite directions.
"""

from typing import NamedTuple

import numpy as np

from fiber_core.array_types import Angles, Floats, Mask, Points, Rows
from fiber_core.focal_plane import FocalPlane

__all__ = ["BEYOND_STOP_RAD", "ElbowsOfPlaces", "elbows_of_places"]

BEYOND_STOP_RAD = 0.005  # an arm may stand this far beyond the stops of its counter
_TURN_RAD = 2.0 * np.pi


class ElbowsOfPlaces(NamedTuple):
    """Both elbows of k arms; the first has phi between 0 and half a turn, or a whole turn more.

    Args:
        angles: joint angles with each elbow [rad], shape (k, 2, 2): arm, elbow, joint.
        possible: whether phi is within its range then, shape (k, 2).
        arm: from the elbow joint to the fibre [mm], shape (k, 2, 2): arm, elbow, x and y.
    """

    angles: Floats
    possible: Mask
    arm: Floats


def elbows_of_places(plane: FocalPlane, rows: Rows, places: Points, near: Angles) -> ElbowsOfPlaces:
    """Return the two elbows with which fibres can be at places.

    Args:
        plane: the focal plane.
        rows: robots, shape (k,).
        places: places of their fibres [mm], shape (k, 2); one out of reach counts as at the rim.
        near: joint angles, to which turns are the nearest [rad], shape (k, 2).
    """
    first, second = plane.arms[rows].T
    offset = places - plane.centers[rows]
    square = (offset**2).sum(axis=1)
    cosine = (square - first**2 - second**2) / (2.0 * first * second)
    bend = np.arccos(np.clip(cosine, -1.0, 1.0))
    lead = np.arctan2(second * np.sin(bend), first + second * np.cos(bend))
    both = np.array([1.0, -1.0])
    theta = np.arctan2(offset[:, 1], offset[:, 0])[:, None] - both * lead[:, None]
    theta = theta + _TURN_RAD * np.rint((near[:, :1] - theta) / _TURN_RAD)
    low, high = plane.limits[rows, 1].T[:, :, None, None]
    phi = (both * bend[:, None])[:, :, None] + _TURN_RAD * np.arange(-2.0, 3.0)
    within = (phi >= low - BEYOND_STOP_RAD) & (phi <= high + BEYOND_STOP_RAD)
    off = np.where(within, np.abs(phi - near[:, 1, None, None]), np.inf)
    phi = np.take_along_axis(phi, off.argmin(axis=2)[:, :, None], axis=2)[:, :, 0]
    elbow = first[:, None, None] * np.stack([np.cos(theta), np.sin(theta)], axis=2)
    return ElbowsOfPlaces(
        np.stack([theta, phi], axis=2), within.any(axis=2), offset[:, None] - elbow
    )

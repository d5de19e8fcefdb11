# SPDX-License-Identifier: Apache-2.0
"""Point clouds for 3D viewers: points along all arms, the centres of the plane, the targets.

Tables of points in metres for the topics view/arms, view/plane and view/targets. They are sent
with `fiber_msgs_py.table.encode_table`.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Angles, Codes, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome

__all__ = [
    "POINTS",
    "ViewState",
    "arms_cloud",
    "plane_cloud",
    "points_cloud",
    "view_states",
]

POINTS = 6  # along each arm
_FIELDS = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("state", "<f4"), ("rgb", "<u4")]
_METRES = 1e-3


class ViewState(IntEnum):
    """State of a robot in a view; the value of the column `state` of its points."""

    RESTING = 0
    MOVING = 1
    REACHED = 2
    HELD = 3
    FAILED = 4
    DISABLED = 5


# by ViewState, in the colours of the player
_RGB = np.array([0xA3ABB3, 0x0072B2, 0x009E73, 0xE69F00, 0xD55E00, 0x6B737B], dtype="<u4")
_OF_OUTCOME = {
    Outcome.REACHED: ViewState.REACHED,
    Outcome.HELD: ViewState.HELD,
    Outcome.FAILED: ViewState.FAILED,
}


def view_states(plane: FocalPlane, moving: ArrayLike, outcome: ArrayLike | None = None) -> Codes:
    """Return the ViewState of each robot, shape (n,).

    A disabled robot is DISABLED, another that moves is MOVING; the others have the state of
    their outcome, RESTING without one.

    Args:
        plane: the focal plane.
        moving: whether each robot moves, shape (n,).
        outcome: Outcome of each robot in the latest plan, shape (n,); None without a plan.
    """
    states = np.full(plane.n, ViewState.RESTING)
    if outcome is not None:
        for code, state in _OF_OUTCOME.items():
            states[np.asarray(outcome) == code] = state
    states[np.asarray(moving)] = ViewState.MOVING
    states[~plane.enabled] = ViewState.DISABLED
    return states


def arms_cloud(plane: FocalPlane, angles: Angles, states: Codes) -> np.ndarray:
    """Return points along both arms of every robot, theta arms before phi arms, in metres.

    Args:
        plane: the focal plane.
        angles: joint angles [rad], shape (n, 2).
        states: ViewState of each robot, shape (n,).

    Returns:
        Structured array x, y, z, state, rgb, shape (n * 2 * POINTS,).
    """
    elbow, tip = kinematics.forward(plane, angles)
    along = np.linspace(0, 1, POINTS)[:, None]
    ends = np.stack([plane.centers, elbow]), np.stack([elbow, tip])
    xy = ends[0][:, :, None] + along * (ends[1] - ends[0])[:, :, None]
    return _cloud(xy.reshape(-1, 2), np.tile(np.repeat(states, POINTS), 2))


def plane_cloud(plane: FocalPlane) -> np.ndarray:
    """Return the centres of all robots, then those of obstacles and the corners of walls [m].

    Args:
        plane: the focal plane.

    Returns:
        Structured array x, y, z, state, rgb, shape (n + obstacles + corners,).
    """
    xy = np.concatenate([plane.centers, plane.obstacles[:, :2], *plane.walls])
    states = np.where(plane.enabled, ViewState.RESTING, ViewState.DISABLED)
    return _cloud(xy, np.append(states, np.full(len(xy) - plane.n, ViewState.DISABLED)))


def points_cloud(xy_mm: ArrayLike, state: ViewState) -> np.ndarray:
    """Return any points of one state, such as targets, in metres.

    Args:
        xy_mm: the points [mm], shape (k, 2).
        state: state of all points.

    Returns:
        Structured array x, y, z, state, rgb, shape (k,).
    """
    points = np.asarray(xy_mm, dtype=float)
    return _cloud(points, np.full(len(points), state))


def _cloud(xy_mm: Points, states: Codes) -> np.ndarray:
    rows = np.zeros(len(xy_mm), dtype=_FIELDS)
    rows["x"], rows["y"] = xy_mm.T * _METRES
    rows["state"], rows["rgb"] = states, _RGB[states]
    return rows

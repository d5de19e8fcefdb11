"""What a live view shows, as tables of points in metres: all arms, the plane, the targets."""

from enum import IntEnum

import numpy as np

from fiber_core import kinematics
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

POINTS = 6  # of a link
_FIELDS = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("state", "<f4"), ("rgb", "<u4")]
_METRES = 1e-3


class ViewState(IntEnum):
    """What a robot does; the number is the state of its points."""

    RESTING = 0
    MOVING = 1
    REACHED = 2
    HELD = 3
    FAILED = 4
    DISABLED = 5


# by ViewState, the colours of the player
_RGB = np.array([0xA3ABB3, 0x0072B2, 0x009E73, 0xE69F00, 0xD55E00, 0x6B737B], dtype="<u4")
_OF_OUTCOME = {
    Outcome.REACHED: ViewState.REACHED,
    Outcome.HELD: ViewState.HELD,
    Outcome.FAILED: ViewState.FAILED,
}


def view_states(plane: FocalPlane, moving, outcome=None) -> np.ndarray:
    """Return the ViewState of each robot, shape (n,).

    Args:
        plane: the focal plane.
        moving: robots that move, shape (n,).
        outcome: Outcome of each in the latest plan, shape (n,); None without one.
    """
    states = np.full(plane.n, ViewState.RESTING)
    if outcome is not None:
        for code, state in _OF_OUTCOME.items():
            states[np.asarray(outcome) == code] = state
    states[np.asarray(moving)] = ViewState.MOVING
    states[~plane.enabled] = ViewState.DISABLED
    return states


def arms_cloud(plane: FocalPlane, angles, states) -> np.ndarray:
    """Return points along both arms of every robot, first arms before second, in metres.

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
    """Return the centres of all robots, then those of fixed discs, in metres."""
    xy = np.concatenate([plane.centers, plane.obstacles[:, :2]])
    states = np.where(plane.enabled, ViewState.RESTING, ViewState.DISABLED)
    return _cloud(xy, np.append(states, np.full(len(plane.obstacles), ViewState.DISABLED)))


def points_cloud(xy_mm, state: ViewState) -> np.ndarray:
    """Return points [mm], shape (k, 2), in metres."""
    return _cloud(np.asarray(xy_mm, dtype=float), np.full(len(xy_mm), state))


def _cloud(xy_mm, states):
    rows = np.zeros(len(xy_mm), dtype=_FIELDS)
    rows["x"], rows["y"] = xy_mm.T * _METRES
    rows["state"], rows["rgb"] = states, _RGB[states]
    return rows

# SPDX-License-Identifier: Apache-2.0
"""Turns of one joint without an end that matters, as the motors of a plane can make them."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.home import turn_motion
from fiber_bus_bridge.listed_home import segments_of_joint
from fiber_bus_bridge.session import Session
from fiber_core.array_types import Ints, Mask
from fiber_core.drive.listed_units import listed_units
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireMotion

__all__ = ["check_can_turn", "turning_motion"]

_SLOW = 5  # a turn is so many times slower than its joint can
_JOINTS = ("theta", "phi")


def turning_motion(session: Session, turn: Ints, chosen: Mask, joint: ArrayLike = 0) -> WireMotion:
    """Return the motion that turns one joint of robots, slowly.

    Motors with listed speeds turn at the slowest one, for whole ticks.

    Args:
        session: the session with the robots.
        turn: turn of each joint; a little less of it is ordered, never more [quanta], shape (n,).
        chosen: robots to turn, shape (n,).
        joint: 0 for theta, 1 for phi, one number or shape (n,).
    """
    c, every = session.protocol, np.arange(len(turn))
    column: Ints = np.broadcast_to(np.asarray(joint, dtype=np.int64), turn.shape)
    if c.plane.drive.listed is None:
        slow = c.speed[every, column] // _SLOW
        return turn_motion(c.units, session.counts, turn, slow, chosen, column)
    table = listed_units(c.plane, c.units)
    rising = (turn > 0).astype(np.int64)
    velocity = table.velocity[every, -1, column, rising]
    ticks = np.where(chosen, np.abs(turn) // velocity, 0)
    ticks[ticks < table.least[every, -1, column, rising]] = 0
    legs, way = ticks[:, None], (np.sign(turn) * velocity)[:, None]
    return segments_of_joint(c.units, session.counts, legs, way, column)


def check_can_turn(plane: FocalPlane, joint: ArrayLike) -> None:
    """Refuse turns of motors of which each move ends with an approach, longer than a test turn.

    Args:
        plane: the focal plane.
        joint: the joint that turns, 0 for theta, 1 for phi, one number or shape (n,).

    Raises:
        SessionError: the motors cannot make such turns; names the approach.
    """
    listed = plane.drive.listed
    if listed is None:
        return
    for k in np.unique(joint).tolist():
        approach_deg = float(np.degrees(listed.approach_rad[k]))
        if approach_deg > 0.0:
            raise SessionError(
                f"these motors cannot make test turns: each move of {_JOINTS[k]} ends with an "
                f"approach of {approach_deg:.3g} deg, which moves an arm much farther than half of "
                "its gap"
            )

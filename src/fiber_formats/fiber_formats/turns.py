# SPDX-License-Identifier: Apache-2.0
"""Present angles that differ from the joint ranges of a layout by whole turns."""

from typing import NamedTuple

import numpy as np

from fiber_core.array_types import Angles, Bools, Floats

__all__ = ["Turned", "on_a_turn_inside"]

_TURN = 2 * np.pi


class Turned(NamedTuple):
    """Angles on the turns that fit, and what was done to them.

    Args:
        angles: theta, phi [rad], shape (n, 2).
        moved: robots of which an angle was moved by whole turns, shape (n,).
        unclear: robots with an angle outside its range that fits on several turns: left where
            it is, shape (n,).
        doubtful: robots with an angle inside its range that fits on another turn too, shape (n,).
    """

    angles: Angles
    moved: Bools
    unclear: Bools
    doubtful: Bools


def on_a_turn_inside(angles: Angles, limits: Floats, slack: float) -> Turned:
    """Move angles outside their ranges by whole turns where exactly one turn fits.

    Args:
        angles: present angles [rad], shape (n, 2).
        limits: joint ranges [rad], shape (n, 2, 2).
        slack: how far beyond a stop an angle is on the stop [rad].
    """
    low, high = limits[:, :, 0] - slack, limits[:, :, 1] + slack
    first = np.ceil((low - angles) / _TURN)
    fit = np.floor((high - angles) / _TURN) - first + 1
    outside = (angles < low) | (angles > high)
    moves = outside & (fit == 1)
    return Turned(
        np.where(moves, angles + _TURN * first, angles),
        np.any(moves, axis=1),
        np.any(outside & (fit > 1), axis=1),
        np.any(~outside & (fit > 1), axis=1),
    )

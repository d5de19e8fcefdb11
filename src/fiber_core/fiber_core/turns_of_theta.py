# SPDX-License-Identifier: Apache-2.0
"""Turns of theta: angles a whole turn apart at which an arm stands in the same place.

A place alone does not tell which of them is true where the range of theta is wider than a turn. A
robot that turns theta beyond the end of the overlap of its ranges can stand there with one turn
alone; with the other turn it is stopped before, by its hard stop.
"""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats

__all__ = ["BEYOND_RAD", "PAST_STOP_RAD", "turns_in_range"]

BEYOND_RAD = 0.05  # an arm may stand this far beyond the end of its range, its hard stop included
PAST_STOP_RAD = 2.0 * BEYOND_RAD  # so that the end of a turn is in the range of one turn alone
_TURN_RAD = 2.0 * np.pi


def turns_in_range(
    theta_range: ArrayLike, theta_rad: ArrayLike, beyond_rad: ArrayLike = BEYOND_RAD
) -> tuple[Floats, Floats]:
    """Return the lowest and the highest angle of theta at which an arm may stand where it does.

    Args:
        theta_range: ends of the range of theta [rad], shape (n, 2).
        theta_rad: one of these angles [rad], shape (n,), nan for an arm that was not seen.
        beyond_rad: how far the arm may stand beyond its range [rad], one number or shape (n,).

    Returns:
        The angles [rad], shape (n,) each: the same where the turn is known, nan of an arm that was
        not seen.
    """
    low, high = np.asarray(theta_range, dtype=float).T
    theta = np.asarray(theta_rad, dtype=float)
    down = np.floor((theta - low + beyond_rad) / _TURN_RAD)
    up = np.floor((high + beyond_rad - theta) / _TURN_RAD)
    return theta - _TURN_RAD * np.maximum(down, 0.0), theta + _TURN_RAD * np.maximum(up, 0.0)

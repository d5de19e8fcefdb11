# SPDX-License-Identifier: Apache-2.0
"""Coupled joints: gears between two motors and two joints, as a matrix for each robot."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Angles, Floats, Ints
from fiber_core.errors import LayoutError
from fiber_core.validation import frozen_array

__all__ = ["checked_coupling", "checked_motor_limits", "checked_motor_speeds"]

_MOST_RATIO = 1e4  # motor to joint
_LEAST_DETERMINANT = 1e-6  # below, the motors do not hold both joints


def checked_coupling(coupling: ArrayLike | None, ids: Ints) -> Floats:
    """Return the matrices between joints and motors as a read-only array, shape (n, k, 2).

    Args:
        coupling: angles of both motors by angles of both joints, shape (n, k, 2); k = 2, or k = 0
            where each joint has a motor of its own; None for k = 0.
        ids: robot ids, for messages, shape (n,).

    Raises:
        LayoutError: there are neither two motors nor none, a ratio is out of bounds, or the
            motors do not determine the joints; names the robot.
    """
    coupling = np.zeros((len(ids), 0, 2)) if coupling is None else coupling
    checked = frozen_array(coupling, np.float64, (len(ids), None, 2), "coupling", LayoutError)
    if checked.shape[1] not in (0, 2):
        raise LayoutError(f"coupling is of {checked.shape[1]} motors a robot, expected 2")
    if checked.shape[1]:
        inside = (np.abs(checked) <= _MOST_RATIO).all(axis=(1, 2))  # nan is not inside
        with np.errstate(invalid="ignore"):  # an infinite ratio
            determinant = checked[:, 0, 0] * checked[:, 1, 1] - checked[:, 0, 1] * checked[:, 1, 0]
        good = inside & (np.abs(determinant) >= _LEAST_DETERMINANT)
        _refuse(
            ~good, ids, "coupling", checked, f"must have an inverse and ratios to {_MOST_RATIO:g}"
        )
    return checked


def checked_motor_speeds(
    speeds: ArrayLike | None, coupling: Floats, joints: Floats, ids: Ints
) -> Floats:
    """Return the highest speeds of the coupled motors [rad/s], shape (n, k).

    Args:
        speeds: highest speeds [rad/s], shape (n, k); None for what the joints allow.
        coupling: matrices between joints and motors, shape (n, k, 2).
        joints: highest joint speeds [rad/s], shape (n, 2).
        ids: robot ids, for messages, shape (n,).

    Raises:
        LayoutError: a speed is out of bounds; names the robot.
    """
    given = None if speeds is None or np.size(speeds) == 0 else speeds
    most = (np.abs(coupling) * joints[:, None]).sum(axis=2) if given is None else given
    shape = (len(ids), coupling.shape[1])
    checked = frozen_array(most, np.float64, shape, "motor_speeds", LayoutError)
    low, high = bounds.MIN_SPEED_RAD_S, bounds.MAX_SPEED_RAD_S
    good = np.all((checked >= low) & (checked <= high), axis=1)
    _refuse(~good, ids, "motor_speeds", checked, f"must be {low:.6g} to {high:.6g} rad/s")
    return checked


def checked_motor_limits(
    limits: ArrayLike | None, coupling: Floats, joints: Angles, ids: Ints
) -> Floats:
    """Return the ranges of the coupled motors [rad], shape (n, k, 2).

    Args:
        limits: ranges [rad], shape (n, k, 2); None for what the joints allow.
        coupling: matrices between joints and motors, shape (n, k, 2).
        joints: joint ranges [rad], shape (n, 2, 2).
        ids: robot ids, for messages, shape (n,).

    Raises:
        LayoutError: a range is empty or not finite; names the robot.
    """
    if limits is None or np.size(limits) == 0:
        ends = coupling[..., None] * joints[:, None]  # (n, k, 2, 2): motor, joint, (low, high)
        limits = np.stack([ends.min(axis=3).sum(axis=2), ends.max(axis=3).sum(axis=2)], axis=2)
    shape = (len(ids), coupling.shape[1], 2)
    checked = frozen_array(limits, np.float64, shape, "motor_limits", LayoutError)
    valid = np.isfinite(checked).all(axis=2) & (checked[..., 0] <= checked[..., 1])
    good = np.all(valid, axis=1)
    _refuse(~good, ids, "motor_limits", checked, "must be finite and not empty")
    return checked


def _refuse(bad: np.ndarray, ids: Ints, name: str, values: Floats, rule: str) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        raise LayoutError(f"robot {ids[row]}: {name} {rule}, got {values[row].tolist()}")

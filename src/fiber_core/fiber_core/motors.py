# SPDX-License-Identifier: Apache-2.0
"""Motors of coupled joints: their angles, the time that a move takes, and which limits it breaks.

The angles m of the motors of a robot are C q, C its coupling and q its joint angles. While both
joints turn at constant speed, so do both motors: a motor changes its speed only where a joint does.
"""

from dataclasses import replace

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Bools, Floats, Mask, Offsets, Velocities
from fiber_core.drive.curves import CurveMotion
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

__all__ = [
    "alone_s",
    "in_motor_range",
    "longest_move_s",
    "motors_broken",
    "motors_of",
    "speeds_alone",
    "with_independent_speeds",
]

_SAME_RAD = 1e-6  # a joint angle this far beyond a stop is on the stop
_ROUNDING = 1e-9  # as for the limits of joints


def motors_of(plane: FocalPlane, angles: ArrayLike) -> Floats:
    """Return the angles of the coupled motors [rad], shape (n, ..., k); k = 0 without coupling.

    Args:
        plane: the focal plane.
        angles: joint angles [rad], shape (n, ..., 2).
    """
    return np.einsum("ikj,i...j->i...k", plane.coupling, np.asarray(angles, dtype=float))


def in_motor_range(plane: FocalPlane, angles: Floats) -> Bools:
    """Return at which joint angles all coupled motors are inside their ranges, shape (n, ...).

    Args:
        plane: the focal plane.
        angles: joint angles [rad], shape (n, ..., 2).
    """
    low, high = np.moveaxis(plane.motor_limits, -1, 0)
    slack = _SAME_RAD * np.abs(plane.coupling).sum(axis=2)
    several = (slice(None), *(None,) * (angles.ndim - 2))
    at = motors_of(plane, angles)
    return np.asarray(
        ((at >= (low - slack)[several]) & (at <= (high + slack)[several])).all(axis=-1)
    )


def alone_s(plane: FocalPlane, start: Angles, goals: ArrayLike) -> Floats:
    """Return the least time in which each robot goes from its start to its goals [s].

    It is that of the slowest joint or coupled motor, all others waiting for it.

    Args:
        plane: the focal plane.
        start: present joint angles [rad], shape (n, 2).
        goals: one or several configurations of each robot [rad], shape (n, ..., 2).

    Returns:
        Shape (n, ...).
    """
    several = (slice(None), *(None,) * (np.ndim(goals) - 2))
    change = np.asarray(goals, dtype=np.float64) - np.asarray(start)[several]
    time = (np.abs(change) / plane.speeds[several]).max(axis=-1)
    if plane.coupling.shape[1]:
        of_motors = (np.abs(motors_of(plane, change)) / plane.motor_speeds[several]).max(axis=-1)
        time = np.maximum(time, of_motors)
    return np.asarray(time)


def longest_move_s(plane: FocalPlane) -> Floats:
    """Return the time in which each robot can make any move, at full speed [s], shape (n,)."""
    of_joints = (np.ptp(plane.limits, axis=2) / plane.speeds).max(axis=1)
    of_motors = (np.ptp(plane.motor_limits, axis=2) / plane.motor_speeds).max(axis=1, initial=0.0)
    return np.maximum(of_joints, of_motors)


def speeds_alone(plane: FocalPlane) -> Velocities:
    """Return the highest speed of each joint while the other one rests [rad/s], shape (n, 2)."""
    if not plane.coupling.shape[1]:
        return plane.speeds
    ratio = np.abs(plane.coupling)
    by_motor = plane.motor_speeds[:, :, None] / np.where(ratio > 0.0, ratio, 1e-300)
    return np.minimum(plane.speeds, by_motor.min(axis=1))


def with_independent_speeds(plane: FocalPlane) -> FocalPlane:
    """Return the same plane with joint speeds so low that no motor is too fast at any of them.

    For planners that choose the speed of each joint without regard to the other.
    """
    if not plane.coupling.shape[1]:
        return plane
    fastest = (np.abs(plane.coupling) * plane.speeds[:, None]).sum(axis=2)
    share = np.minimum(1.0, (plane.motor_speeds / fastest).min(axis=1))
    return replace(plane, speeds=plane.speeds * share[:, None])


def motors_broken(
    plane: FocalPlane, motion: SegmentMotion | CurveMotion, rows: ArrayLike | None = None
) -> Mask:
    """Return the robots that turn a coupled motor outside its range or too fast, shape (m,).

    Args:
        plane: the focal plane.
        motion: joint profiles of m robots, as ordered or as carried out.
        rows: the rows of these robots, shape (m,); by default all robots.
    """
    of = slice(None) if rows is None else np.asarray(rows, dtype=np.int64)
    if not plane.coupling.shape[1]:
        return np.zeros(motion.n, dtype=np.bool_)
    return _broken(
        plane.coupling[of], plane.motor_limits[of], plane.motor_speeds[of], *motion.curve_arrays
    )


@nb.njit(cache=True)
def _broken(
    coupling: Floats,
    limits: Floats,
    speeds: Floats,
    start: Angles,
    offsets: Offsets,
    duration_s: Floats,
    velocity_rad_s: Floats,
    acceleration_rad_s2: Floats,
) -> Bools:
    # Both profiles of a robot are followed at once, from one piece of either joint to the next.
    # A motor is fastest at the end of such a step, and farthest there or where it turns back.
    n = len(start)
    broken = np.zeros(n, dtype=np.bool_)
    angle, speed, gain, left = np.empty(2), np.empty(2), np.zeros(2), np.empty(2)
    at = np.empty(2, dtype=np.int64)
    for i in range(n):
        for joint in range(2):
            angle[joint] = start[i, joint]
            at[joint] = offsets[2 * i + joint]
            left[joint] = 0.0
        while True:
            step, moves = np.inf, False
            for joint in range(2):
                if left[joint] <= 0.0 and at[joint] < offsets[2 * i + joint + 1]:
                    left[joint] = duration_s[at[joint]]
                    speed[joint] = velocity_rad_s[at[joint]]
                    if len(acceleration_rad_s2):
                        gain[joint] = acceleration_rad_s2[at[joint]]
                    at[joint] += 1
                if left[joint] > 0.0:
                    step, moves = min(step, left[joint]), True
                else:
                    speed[joint] = gain[joint] = 0.0
            if not moves:
                break
            if speed[0] != 0.0 or speed[1] != 0.0 or gain[0] != 0.0 or gain[1] != 0.0:
                for k in range(2):
                    c0, c1 = coupling[i, k]
                    first, rise = c0 * speed[0] + c1 * speed[1], c0 * gain[0] + c1 * gain[1]
                    last = first + step * rise
                    before = c0 * angle[0] + c1 * angle[1]
                    after = before + 0.5 * step * (first + last)
                    turn = before - 0.5 * first * first / rise if first * last < 0.0 else before
                    slack = _SAME_RAD * (abs(c0) + abs(c1))
                    broken[i] |= max(abs(first), abs(last)) > speeds[i, k] * (1.0 + _ROUNDING)
                    broken[i] |= min(before, turn, after) < limits[i, k, 0] - slack
                    broken[i] |= max(before, turn, after) > limits[i, k, 1] + slack
            for joint in range(2):
                if left[joint] > 0.0:
                    angle[joint] += step * (speed[joint] + 0.5 * step * gain[joint])
                    speed[joint] += step * gain[joint]
                    left[joint] -= step
                    if left[joint] < 1e-12:
                        left[joint] = 0.0
    return broken

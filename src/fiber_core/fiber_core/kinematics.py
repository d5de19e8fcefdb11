# SPDX-License-Identifier: Apache-2.0
"""Forward and inverse kinematics: joint angles to elbow and tip, and back."""

import math

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Bools, Floats, Ints, Points
from fiber_core.focal_plane import FocalPlane

__all__ = ["RIM_MM", "configurations", "forward", "inverse", "jacobian", "most_configurations"]

_TURN = 2 * math.pi
RIM_MM = 1e-9  # a point this far outside the annulus is on its rim
# A tip d + e away from a stretched arm bends it by sqrt(2 e d / (l1 l2)): the rounding of
# coordinates (1e-13 mm) costs up to 3e-7 rad there. A joint angle this far beyond a stop
# is on the stop; 1e-6 rad moves a 6 mm arm by 6 nm.
_STOP_RAD = 1e-6


def _unit(angle: Floats) -> Floats:
    # unit vectors in the direction of each angle
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def forward(plane: FocalPlane, angles: ArrayLike) -> tuple[Points, Points]:
    """Return the positions of elbows and tips for given joint angles.

    Args:
        plane: the focal plane.
        angles: joint angles theta, phi [rad], shape (n, 2).

    Returns:
        Elbows and tips [mm], both shape (n, 2).

    Source: equation 1 of Makarem et al. (2014a) and (2014b).
    """
    theta, phi = np.moveaxis(np.asarray(angles, dtype=float), -1, 0)
    elbow = plane.centers + plane.arms[:, :1] * _unit(theta)
    return elbow, elbow + plane.arms[:, 1:] * _unit(theta + phi)


def jacobian(plane: FocalPlane, angles: ArrayLike) -> Floats:
    """Return the derivative of each tip by its two joint angles.

    Args:
        plane: the focal plane.
        angles: joint angles theta, phi [rad], shape (n, 2).

    Returns:
        d tip / d (theta, phi) [mm/rad], shape (n, 2, 2): robot, x or y, joint.
    """
    theta, phi = np.moveaxis(np.asarray(angles, dtype=float), -1, 0)
    quarter = np.pi / 2
    by_phi = plane.arms[:, 1:] * _unit(theta + phi + quarter)
    by_theta = plane.arms[:, :1] * _unit(theta + quarter) + by_phi
    return np.stack([by_theta, by_phi], axis=-1)


def inverse(plane: FocalPlane, tips: ArrayLike) -> tuple[Floats, Bools]:
    """Return every configuration that puts a tip on a point: both elbows, all turns in range.

    Args:
        plane: the focal plane.
        tips: points in the focal plane [mm], shape (n, 2); nan gives no solution.

    Returns:
        Joint angles [rad], shape (n, s, 2), and which of them are solutions inside the
        joint limits, shape (n, s). The solutions come first in the row of a robot, phi
        turned counter-clockwise before clockwise; the other entries are nan. A point up to 1e-9 mm
        outside the annulus counts as on its rim, an angle up to 1e-6 rad beyond a stop
        counts as on the stop. At the centre of a robot with equal arms every theta is a
        solution; the middle of the range of theta represents them.
    """
    offsets = np.asarray(tips, dtype=float) - plane.centers
    angles = np.full((plane.n, most_configurations(plane), 2), np.nan)
    count = _inverse(plane.arms, offsets, plane.limits, angles)
    used = max(1, count.max(initial=0))
    return angles[:, :used].copy(), np.arange(used) < count[:, None]


def most_configurations(plane: FocalPlane) -> int:
    """Return the most rows that `configurations` needs for any robot of a plane."""
    span = np.diff(plane.limits, axis=2).reshape(-1, 2).max(axis=0, initial=0.0)
    theta_turns, phi_turns = (math.floor((most + 2 * _STOP_RAD) / _TURN) + 1 for most in span)
    return (
        2 * (theta_turns + 1) * (phi_turns + 1)
    )  # one spare turn a joint, for rounding at the ends


@nb.njit(cache=True)
def configurations(
    arm1: float, arm2: float, x: float, y: float, limits: Floats, out: Floats
) -> int:
    """Write the configurations of one robot that put its tip on a point; return their number.

    With d the distance of the point, the law of cosines in half angles reads
    tan(phi / 2)^2 = ((l1 + l2)^2 - d^2) / (d^2 - (l1 - l2)^2), which keeps its digits
    where the arm is nearly stretched or folded.

    Args:
        arm1: length of the theta arm [mm].
        arm2: length of the phi arm [mm].
        x, y: the point relative to the centre of the robot [mm].
        limits: joint ranges [rad], shape (2, 2).
        out: receives theta, phi [rad], shape (s, 2); s from most_configurations.
    """
    distance = math.hypot(x, y)
    longest, shortest = arm1 + arm2, abs(arm1 - arm2)
    if not shortest - RIM_MM <= distance <= longest + RIM_MM:  # nan ends here too
        return 0
    outer = max(0.0, (longest - distance) * (longest + distance))
    inner = max(0.0, (distance - shortest) * (distance + shortest))
    bend = 2.0 * math.atan2(math.sqrt(outer), math.sqrt(inner))
    elbows = 2 if outer > 0.0 and inner > 0.0 else 1  # stretched or folded: both are the same
    count = 0
    for elbow in range(elbows):
        phi = bend if elbow == 0 else -bend
        if distance <= RIM_MM:
            theta = 0.5 * (limits[0, 0] + limits[0, 1])
        else:
            lever = arm1 + arm2 * math.cos(phi)
            theta = math.atan2(y, x) - math.atan2(arm2 * math.sin(phi), lever)
        phi += _TURN * math.ceil((limits[1, 0] - _STOP_RAD - phi) / _TURN)
        first = theta + _TURN * math.ceil((limits[0, 0] - _STOP_RAD - theta) / _TURN)
        while phi <= limits[1, 1] + _STOP_RAD:
            theta = first
            while theta <= limits[0, 1] + _STOP_RAD:
                out[count, 0] = min(max(theta, limits[0, 0]), limits[0, 1])
                out[count, 1] = min(max(phi, limits[1, 0]), limits[1, 1])
                count += 1
                theta += _TURN
            phi += _TURN
    return count


@nb.njit(cache=True)
def _inverse(arms: Floats, offsets: Points, limits: Floats, angles: Floats) -> Ints:
    # Fills in the configurations of each robot; returns their number, shape (n,).
    count = np.zeros(len(arms), dtype=np.int64)
    for i in range(len(arms)):
        x, y = offsets[i]
        count[i] = configurations(arms[i, 0], arms[i, 1], x, y, limits[i], angles[i])
    return count

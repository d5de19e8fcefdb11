# SPDX-License-Identifier: Apache-2.0
"""Forward and inverse kinematics: joint angles to elbow, tip and fibres, and back."""

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Bools, Floats, Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.motors import in_motor_range
from fiber_core.threads import share_out

__all__ = [
    "RIM_MM",
    "OnTarget",
    "Solutions",
    "configurations",
    "distance_range",
    "fibre_places",
    "forward",
    "inverse",
    "jacobian",
    "most_configurations",
    "on_target",
    "solutions",
]

_TURN = 2 * math.pi
_LEAST_ROBOTS = 2000  # of a thread: fewer are done sooner than it begins
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


def fibre_places(plane: FocalPlane, angles: ArrayLike) -> Floats:
    """Return where all fibres are for given joint angles [mm], shape (n, f, 2), f >= 1.

    Args:
        plane: the focal plane.
        angles: joint angles theta, phi [rad], shape (n, 2).
    """
    if not plane.fibres.shape[1]:
        return forward(plane, angles)[1][:, None]
    elbow = forward(plane, angles)[0]
    along = _unit(np.asarray(angles, dtype=float).sum(axis=1))
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    x, y = np.moveaxis(plane.fibres, -1, 0)[..., None]
    return elbow[:, None] + x * along[:, None] + y * across[:, None]


class OnTarget(NamedTuple):
    """The fibre of each robot that counts for its target, and where it is.

    Args:
        fibre: number of the fibre that the target names, or of the one nearest to the target;
            0 for a robot without target that names none, shape (n,).
        place: where that fibre is [mm], shape (n, 2).
        error_mm: its distance from the target [mm], nan without target, shape (n,).
    """

    fibre: Ints
    place: Points
    error_mm: Floats


def on_target(plane: FocalPlane, angles: ArrayLike, targets: ArrayLike) -> OnTarget:
    """Return which fibre of each robot is on its target, or nearest to it.

    Args:
        plane: the focal plane, with the fibre that each target is for.
        angles: joint angles theta, phi [rad], shape (n, 2).
        targets: targets [mm], shape (n, 2), nan = no target.
    """
    places, targets = fibre_places(plane, angles), np.asarray(targets, dtype=float)
    away = np.linalg.norm(places - targets[:, None], axis=2)
    nearest = np.where(np.isnan(away), np.inf, away).argmin(axis=1)
    fibre = np.where(plane.fibre >= 0, plane.fibre, nearest)
    rows = np.arange(plane.n)
    return OnTarget(fibre, places[rows, fibre], away[rows, fibre])


def distance_range(plane: FocalPlane) -> tuple[Floats, Floats]:
    """Return how near to and how far from its centre each robot can bring its fibre [mm], (n,).

    Of a robot whose target may have any fibre, the nearest and the farthest of all its fibres.
    """
    lever: Floats = np.hypot(plane.fibre_offsets[..., 0], plane.fibre_offsets[..., 1])
    near, far = np.abs(plane.arms[:, :1] - lever), plane.arms[:, :1] + lever
    chosen = plane.fibre[:, None]
    each: Ints = np.arange(int(plane.fibre_offsets.shape[1]))
    excluded: Mask = np.logical_and(chosen >= 0, chosen != each)
    return (
        np.where(excluded, np.inf, near).min(axis=1),
        np.where(excluded, -np.inf, far).max(axis=1),
    )


class Solutions(NamedTuple):
    """Every configuration that puts a fibre on a point.

    Args:
        angles: joint angles [rad], shape (n, s, 2); nan where there is no solution.
        valid: which of them are solutions inside the limits of joints and motors, shape (n, s).
        fibre: number of the fibre that is on the point, shape (n, s).
        is_left: whether the elbow is the left one of that fibre, shape (n, s).
    """

    angles: Floats
    valid: Bools
    fibre: Ints
    is_left: Bools


def inverse(plane: FocalPlane, points: ArrayLike) -> tuple[Floats, Bools]:
    """Return every configuration that puts a fibre on a point, as `solutions` does.

    Args:
        plane: the focal plane, with the fibre that each target is for.
        points: points in the focal plane [mm], shape (n, 2); nan gives no solution.

    Returns:
        Joint angles [rad], shape (n, s, 2), and which of them are solutions, shape (n, s).
    """
    found = solutions(plane, points)
    return found.angles, found.valid


def solutions(plane: FocalPlane, points: ArrayLike) -> Solutions:
    """Return every configuration that puts a fibre on a point: both elbows, all turns in range.

    Solutions inside the joint ranges come first in the row of a robot, by fibre, phi
    turned counter-clockwise before clockwise; the other entries are nan. Those with a coupled
    motor outside its range are not valid. A point up to 1e-9 mm
    outside the annulus counts as on its rim, an angle up to 1e-6 rad beyond a stop
    counts as on the stop. At the centre of a robot with equal arms every theta is a
    solution; the middle of the range of theta represents them.

    A fibre beside the axis of the arm is at the end of a link of its own: its length is the
    distance of the fibre from the elbow, and its angle is phi plus a constant.

    Args:
        plane: the focal plane, with the fibre that each target is for.
        points: points in the focal plane [mm], shape (n, 2); nan gives no solution.
    """
    offsets = np.asarray(points, dtype=float) - plane.centers
    fibres = plane.fibre_offsets
    most = most_configurations(plane)
    angles = np.full((plane.n, most * fibres.shape[1], 2), np.nan)
    fibre = np.zeros(angles.shape[:2], dtype=np.int64)
    count = np.zeros(plane.n, dtype=np.int64)

    def invert(first: int, last: int) -> None:
        some = slice(first, last)
        _inverse(
            plane.arms[some], offsets[some], plane.limits[some], fibres[some], plane.fibre[some],
            angles[some], fibre[some], most, count[some],
        )  # fmt: skip

    share_out(invert, plane.n, _LEAST_ROBOTS)
    used = max(1, count.max(initial=0))
    angles, fibre = angles[:, :used].copy(), fibre[:, :used].copy()
    aside = np.arctan2(fibres[..., 1], fibres[..., 0])
    bend = angles[..., 1] + np.take_along_axis(aside, fibre, axis=1)
    valid = np.arange(used) < count[:, None]
    if plane.coupling.shape[1]:
        valid &= in_motor_range(plane, angles)
    return Solutions(angles, valid, fibre, np.sin(bend) >= 0)


def most_configurations(plane: FocalPlane) -> int:
    """Return the most rows that `configurations` needs for one fibre of any robot of a plane."""
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


@nb.njit(cache=True, nogil=True)
def _inverse(
    arms: Floats,
    offsets: Points,
    limits: Floats,
    fibres: Floats,
    named: Ints,
    angles: Floats,
    fibre: Ints,
    most: int,
    count: Ints,
) -> None:
    # fills in the configurations of each robot, their fibres and their number, at first 0
    shifted = np.empty((2, 2))
    for i in range(len(arms)):
        x, y = offsets[i]
        for k in range(fibres.shape[1]):
            if named[i] >= 0 and named[i] != k:
                continue
            lever = math.hypot(fibres[i, k, 0], fibres[i, k, 1])
            aside = math.atan2(fibres[i, k, 1], fibres[i, k, 0])
            shifted[0, 0], shifted[0, 1] = limits[i, 0, 0], limits[i, 0, 1]
            shifted[1, 0], shifted[1, 1] = limits[i, 1, 0] + aside, limits[i, 1, 1] + aside
            begin = count[i]
            out = angles[i, begin : begin + most]
            count[i] += configurations(arms[i, 0], lever, x, y, shifted, out)
            for s in range(begin, count[i]):
                phi = angles[i, s, 1] - aside
                angles[i, s, 1] = min(max(phi, limits[i, 1, 0]), limits[i, 1, 1])
                fibre[i, s] = k

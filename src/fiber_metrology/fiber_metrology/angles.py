# SPDX-License-Identifier: Apache-2.0
"""Measured joint angles: the place of a fibre, with elbow and turn of the counters."""

import math

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Floats, Ints, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import configurations, most_configurations
from fiber_core.turns_of_theta import BEYOND_RAD

__all__ = ["angles_of_places", "likeliest_angles"]

_STEPS = 20  # of Gauss and Newton, which converge slowly where the arm is straight
_LEAST_RAD = 1e-9  # of the error of a joint that its drive keeps


def angles_of_places(
    plane: FocalPlane,
    places: ArrayLike,
    near: ArrayLike,
    error_mm: ArrayLike,
    beyond_rad: ArrayLike = BEYOND_RAD,
) -> tuple[Angles, Angles, Floats]:
    """Return the joint angles that put fibres on measured places, next to expected angles.

    Of all elbows and turns the one nearest to the expected angles is taken. A place outside the
    annulus of its robot is moved to the rim; how far tells whether it is an error of the camera.

    Args:
        plane: the focal plane.
        places: measured places [mm], shape (n, 2), nan for none.
        near: expected angles [rad], shape (n, 2).
        error_mm: bound of the error of a place [mm], one number or shape (n,).
        beyond_rad: an arm may stand this far beyond the stops of its counter [rad], one number or
            shape (n,).

    Returns:
        The angles [rad], shape (n, 2), nan without a place; half the width of the interval of each
        that the error leaves [rad], shape (n, 2); and how far each place is outside
        the annulus [mm], shape (n,). The interval holds both elbows where the error does not tell
        them apart.
    """
    offsets = np.asarray(places, dtype=float) - plane.centers
    near = np.ascontiguousarray(near, dtype=float)
    out = np.full((plane.n, 2), np.nan)
    wide = np.full((plane.n, 2), np.nan)
    outside = np.full(plane.n, np.nan)
    beyond = np.broadcast_to(np.asarray(beyond_rad, dtype=float), (plane.n,))[:, None, None]
    limits = plane.limits + beyond * np.array([-1.0, 1.0])
    error = np.ascontiguousarray(np.broadcast_to(np.asarray(error_mm, dtype=float), (plane.n,)))
    rows = most_configurations(plane) + 8  # of limits that are a little wider
    _angles(plane.arms, offsets, limits, plane.limits, near, error, rows, out, wide, outside)
    return out, wide, outside


def likeliest_angles(
    plane: FocalPlane,
    rows: Ints,
    places: Points,
    sigma_mm: Floats,
    expected: Angles,
    sigma_rad: Angles,
) -> Angles:
    """Return the joint angles that measured places and expected angles together make likeliest.

    They are the least of |tip(q) - place|^2 / sigma_mm^2 + sum_j ((q_j - expected_j) / sigma_j)^2.
    The tip is nearly on the place: expected angles tell how theta and phi share what it leaves
    open, which is much where the arm is stretched or folded.

    Args:
        plane: the focal plane.
        rows: the robots, shape (k,).
        places: their measured places [mm], shape (k, 2).
        sigma_mm: error of one coordinate of each place, 1 sigma [mm], shape (k,).
        expected: angles by the drive [rad], shape (k, 2).
        sigma_rad: their errors, 1 sigma [rad], shape (k, 2).

    Returns:
        The angles, within the limits of their joints [rad], shape (k, 2).
    """
    out = np.array(expected)
    _likeliest(
        plane.arms[rows], places - plane.centers[rows], plane.limits[rows], sigma_mm,
        expected, np.maximum(sigma_rad, _LEAST_RAD), out,
    )  # fmt: skip
    return out


@nb.njit(cache=True)
def _within(step, angle, limits):
    """The step of an angle that ends within its limits."""
    return min(max(angle + step, limits[0]), limits[1]) - angle


@nb.njit(cache=True)
def _likeliest(arms: Floats, offsets: Points, limits, sigma_mm, expected, sigma_rad, out):
    for i in range(len(arms)):
        arm1, arm2 = arms[i]
        trust = 1.0 / sigma_mm[i] ** 2
        weight = 1.0 / sigma_rad[i] ** 2
        for _ in range(_STEPS):
            x2 = arm2 * math.cos(out[i, 0] + out[i, 1])
            y2 = arm2 * math.sin(out[i, 0] + out[i, 1])
            x, y = arm1 * math.cos(out[i, 0]) + x2, arm1 * math.sin(out[i, 0]) + y2
            off_x, off_y = offsets[i, 0] - x, offsets[i, 1] - y
            # the tip moves by (-y, x) with theta and by (-y2, x2) with phi
            a = trust * (x * x + y * y) + weight[0]
            b = trust * (y * y2 + x * x2)
            c = trust * (x2 * x2 + y2 * y2) + weight[1]
            theta = trust * (x * off_y - y * off_x) + weight[0] * (expected[i, 0] - out[i, 0])
            phi = trust * (x2 * off_y - y2 * off_x) + weight[1] * (expected[i, 1] - out[i, 1])
            # a joint at its limit stays there, and the other one makes the best of it
            turn = _within((a * phi - b * theta) / (a * c - b * b), out[i, 1], limits[i, 1])
            free = (theta - b * turn) / a
            swing = _within(free, out[i, 0], limits[i, 0])
            if swing != free:
                turn = _within((phi - b * swing) / c, out[i, 1], limits[i, 1])
            out[i, 0] += swing
            out[i, 1] += turn


@nb.njit(cache=True)
def _lead(arm1, arm2, phi):
    """The angle of the tip as seen from the theta arm."""
    return math.atan2(arm2 * math.sin(phi), arm1 + arm2 * math.cos(phi))


@nb.njit(cache=True)
def _bend(arm1, arm2, distance):
    """The angle of phi, 0 to pi, and of the tip as seen from the theta arm."""
    longest, shortest = arm1 + arm2, abs(arm1 - arm2)
    distance = min(max(distance, shortest), longest)
    outer = max(0.0, (longest - distance) * (longest + distance))
    inner = max(0.0, (distance - shortest) * (distance + shortest))
    phi = 2.0 * math.atan2(math.sqrt(outer), math.sqrt(inner))
    return phi, _lead(arm1, arm2, phi)


@nb.njit(cache=True)
def _angles(
    arms: Floats, offsets: Points, limits, inside, near, error_mm, rows, out, wide, outside
):
    options = np.empty((rows, 2))
    for i in range(len(arms)):
        x, y = offsets[i]
        d = math.hypot(x, y)
        if not d >= 0.0:
            continue  # no place
        arm1, arm2 = arms[i]
        longest, shortest = arm1 + arm2, abs(arm1 - arm2)
        rim = min(max(d, shortest), longest)
        outside[i] = abs(d - rim)
        scale = rim / d if d > 0.0 else 1.0
        count = configurations(arm1, arm2, x * scale, y * scale, limits[i], options)
        best = np.inf
        for k in range(count):
            off = abs(options[k, 0] - near[i, 0]) + abs(options[k, 1] - near[i, 1])
            if off < best:
                best = off
                out[i] = options[k]
        if count == 0:
            out[i] = near[i]
            wide[i] = math.pi
            continue
        phi, lead = _bend(arm1, arm2, rim)
        error = error_mm[i] + outside[i]
        phi_low, lead_low = _bend(arm1, arm2, rim + error)
        phi_high, lead_high = _bend(arm1, arm2, rim - error)
        wide[i, 1] = max(phi - phi_low, phi_high - phi)
        swing = math.asin(error / rim) if rim > error else math.pi
        wide[i, 0] = swing + max(abs(lead - lead_low), abs(lead_high - lead))
        # the other elbow is as good where the arm is stretched or folded within the error
        if rim + error >= longest:
            wide[i, 1] = max(wide[i, 1], 2.0 * phi)
            wide[i, 0] = max(wide[i, 0], swing + 2.0 * lead)
        if rim - error <= shortest:
            wide[i, 1] = max(wide[i, 1], 2.0 * (math.pi - phi))
            wide[i, 0] = math.pi
        # an arm that is set to its stop keeps the direction of its fibre
        at_stop = min(max(out[i, 1], inside[i, 1, 0]), inside[i, 1, 1])
        turn = _lead(arm1, arm2, out[i, 1]) - _lead(arm1, arm2, at_stop)
        out[i, 0] += turn
        wide[i, 0] += abs(turn)
        for joint in range(2):
            angle = min(max(out[i, joint], inside[i, joint, 0]), inside[i, joint, 1])
            wide[i, joint] += abs(angle - out[i, joint])
            out[i, joint] = angle

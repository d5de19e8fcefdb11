# SPDX-License-Identifier: Apache-2.0
"""Measured joint angles: the place of a fibre, with elbow and turn of the counters."""

import math

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Floats, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import configurations, most_configurations

__all__ = ["BEYOND_RAD", "angles_of_places"]

BEYOND_RAD = 0.05  # an arm may stand this far beyond a stop of its counter


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

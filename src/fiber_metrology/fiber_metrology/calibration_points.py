# SPDX-License-Identifier: Apache-2.0
"""Points for a calibration: few, and chosen so that the zeros come out well.

The errors of the fitted numbers follow from the points alone (the bound of Cramer and Rao). Points
are exchanged one by one as long as the sum of the variances of both zeros falls (an optimal design
by exchange). In the frame of its ranges every robot goes to the same points.
"""

import numpy as np

from fiber_core.array_types import Angles, Floats
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.calibration import number_errors
from fiber_metrology.errors import MetrologyError

__all__ = ["calibration_points"]

_BACKLASH_RAD = 0.005  # that the points are chosen for
_TRIALS, _BEGINS = 2500, 2
_ENDS = 0.02  # of the ranges are left out at either end
_ZEROS = [4, 8]


def calibration_points(
    plane: FocalPlane,
    points: int,
    rng: np.random.Generator,
    error_um: float = 2.5,
    least_deg: float = 2.0,
) -> Angles:
    """Choose points to which robots go for a calibration.

    Args:
        plane: the focal plane; the points are chosen for its first robot.
        points: number of places to be measured, 8 or more.
        rng: source of trials.
        error_um: error of one coordinate of a place [um].
        least_deg: least turn of each joint between two points [deg], above its backlash.

    Returns:
        Joint angles at the start and at every point [rad], shape (points + 1, n, 2).

    Raises:
        MetrologyError: there are too few points.
    """
    if points < 8:
        raise MetrologyError(f"{points} points: a calibration needs 8 or more")
    low, span = plane.limits[:, :, 0], np.diff(plane.limits, axis=2)[:, :, 0]
    least = np.deg2rad(least_deg) / span[0]

    def loss(shares: Floats) -> float:
        if (np.abs(np.diff(shares, axis=0)) < least).any():
            return np.inf
        angles = low[0] + span[0] * shares
        errors = number_errors(plane.arms[0], angles, 1e-3 * error_um, _BACKLASH_RAD)
        return float((errors[_ZEROS] ** 2).sum())

    best, chosen = np.inf, np.zeros((points + 1, 2))
    for _ in range(_BEGINS):
        shares = rng.uniform(_ENDS, 1.0 - _ENDS, (points + 1, 2))
        now, step = loss(shares), 0.5
        for trial in range(_TRIALS):
            other = shares.copy()
            k = int(rng.integers(points + 1))
            moved = other[k] + rng.normal(0.0, step, 2) * (rng.random(2) < 0.7)
            other[k] = np.clip(moved, _ENDS, 1.0 - _ENDS)
            found = loss(other)
            if found < now or not np.isfinite(now):
                shares, now = other, found
            if 4 * (trial + 1) % _TRIALS == 0:
                step /= 2.0
        if now < best:
            best, chosen = now, shares
    return np.asarray(low + span * chosen[:, None])

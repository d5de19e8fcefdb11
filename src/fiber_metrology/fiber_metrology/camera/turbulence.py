# SPDX-License-Identifier: Apache-2.0
"""Air turbulence: displacements that are alike at places close to each other."""

import math

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Points

__all__ = ["turbulence"]

_WAVES = 256


def turbulence(
    places: ArrayLike, rms_mm: float, correlation_mm: float, rng: np.random.Generator
) -> Points:
    """Return the displacements of one exposure, a Gaussian random field.

    The covariance of each coordinate at a distance r is proportional to exp(-r^2 / (2 L^2)): a sum
    of cosines with wave vectors from the spectrum of that covariance (Rahimi and Recht 2007).

    Args:
        places: points in the focal plane [mm], shape (k, 2).
        rms_mm: rms distance by which a place is displaced [mm].
        correlation_mm: L [mm].
        rng: source of randomness.

    Returns:
        Displacements [mm], shape (k, 2).
    """
    wave = rng.normal(size=(2, _WAVES, 2)) / correlation_mm
    phase = rng.uniform(0.0, 2 * math.pi, (2, _WAVES))
    unit = _sum(np.ascontiguousarray(places, dtype=np.float64), wave, phase)
    return unit * rms_mm / math.sqrt(2.0)


@nb.njit(cache=True)
def _sum(places: Points, wave: Floats, phase: Floats) -> Points:
    # coordinates of unit variance
    out = np.zeros(places.shape)
    scale = math.sqrt(2.0 / wave.shape[1])
    for i in range(len(places)):
        for axis in range(2):
            total = 0.0
            for k in range(wave.shape[1]):
                turn = wave[axis, k, 0] * places[i, 0] + wave[axis, k, 1] * places[i, 1]
                total += math.cos(turn + phase[axis, k])
            out[i, axis] = scale * total
    return out

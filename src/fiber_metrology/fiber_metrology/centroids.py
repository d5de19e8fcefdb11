# SPDX-License-Identifier: Apache-2.0
"""Centroids: the spots in the pixels of an image.

A spot is a local maximum of the light above the background. Its place is the mean of the light
around it under a Gaussian window that follows it (the windowed centroid of SExtractor, Bertin and
Arnouts 1996), which is nearly as good as a fit of the profile and does not need one.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_metrology.errors import ImageError, MetrologyError
from fiber_metrology.spots import Spots, checked_spots

__all__ = ["CentroidConfig", "find_spots"]

_SAMPLE = 16  # every sixteenth row and column tells the background
_TO_SIGMA = 1.4826  # median distance from the median of a normal distribution, to its sigma
_ROUNDS, _SETTLED_PX = 12, 1e-4
_FLAT = 0.25  # an image of which more is lit than this shows no spots
_WIDEST = 2.0  # of a spot over the window


@dataclass(frozen=True)
class CentroidConfig:
    """What counts as a spot.

    Args:
        above: least height of a peak above the background, in its noise.
        window_px: sigma of the window, about that of a spot [px].
        saturated: counts from which on a pixel tells no light; a spot with such a pixel is left
            out.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "above": bounds.Range(1.0, 1e3),
        "window_px": bounds.Range(0.3, 50.0),
        "saturated": bounds.Range(1.0, 1e12),
    }

    above: float = 8.0
    window_px: float = 1.5
    saturated: float = 65000.0

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)


def find_spots(image: ArrayLike, config: CentroidConfig | None = None) -> Spots:
    """Return the spots in an image.

    Args:
        image: counts of the pixels, shape (rows, columns); a place is (column, row), and the
            centre of the first pixel is (0, 0).
        config: what counts as a spot.

    Raises:
        MetrologyError: the image is no table of numbers, or smaller than a spot.
        ImageError: it shows no spots: no light, or light everywhere.
    """
    config = config or CentroidConfig()
    pixels = np.asarray(image)
    margin = math.ceil(4.0 * config.window_px) + 2
    if pixels.ndim != 2 or pixels.dtype.kind not in "uif":
        raise MetrologyError(f"an image is a table of numbers, got {pixels.dtype} {pixels.shape}")
    if min(pixels.shape) <= 2 * margin:
        raise MetrologyError(f"an image of {pixels.shape} pixels is smaller than a spot")
    sample = pixels[::_SAMPLE, ::_SAMPLE].astype(np.float64)
    level = float(np.median(sample))
    # a camera whose background is one number has the noise of its last digit
    noise = max(_TO_SIGMA * float(np.median(np.abs(sample - level))), 0.3)
    if not (math.isfinite(level) and math.isfinite(noise)):
        raise ImageError("the image holds values that are not finite")
    lit = pixels > level + config.above * noise
    lit[:margin] = lit[-margin:] = False
    lit[:, :margin] = lit[:, -margin:] = False
    at = np.flatnonzero(lit)
    if len(at) == 0:
        raise ImageError("the image has no spots: no light, or the shutter was closed")
    if len(at) > _FLAT * pixels.size:
        raise ImageError(f"{len(at)} of {pixels.size} pixels are lit: the image shows no spots")
    row, column = np.divmod(at, pixels.shape[1])
    peak = _peaks(pixels, row, column, config.saturated)
    place, flux, width = _centroids(
        pixels, row[peak], column[peak], config.window_px, _SETTLED_PX, _ROUNDS
    )
    good = (flux > 0.0) & (width > 0.0) & (width < _WIDEST * config.window_px)
    return checked_spots(place[good], flux[good], width[good])


@nb.njit(cache=True)
def _smooth(pixels, r, c):
    total = 0.0
    for i in range(-1, 2):
        for k in range(-1, 2):
            total += pixels[r + i, c + k]
    return total


@nb.njit(cache=True)
def _peaks(pixels, row, column, saturated):
    """Whether each lit pixel is the brightest of those next to it, sums of nine compared."""
    peak = np.zeros(len(row), dtype=np.bool_)
    for p in range(len(row)):
        r, c = row[p], column[p]
        here = _smooth(pixels, r, c)
        best = pixels[r, c] < saturated
        for i in range(-2, 3):
            for k in range(-2, 3):
                if best and (i != 0 or k != 0):
                    there = _smooth(pixels, r + i, c + k)
                    # of two alike the later one is the peak
                    best = there < here or (there == here and (i < 0 or (i == 0 and k < 0)))
        peak[p] = best
    return peak


@nb.njit(cache=True)
def _background(pixels, r, c, half):
    """Median of the pixels at the rim of a window."""
    rim = np.empty(8 * half)
    n = 0
    for i in range(-half, half + 1):
        step = 1 if abs(i) == half else 2 * half
        for k in range(-half, half + 1, step):
            rim[n] = pixels[r + i, c + k]
            n += 1
    return np.median(rim[:n])


@nb.njit(cache=True)
def _centroids(pixels, row, column, window, settled, rounds):
    place, n = np.empty((len(row), 2)), len(row)
    flux, width = np.zeros(n), np.zeros(n)
    half = int(math.ceil(4.0 * window))
    for p in range(n):
        r, c = row[p], column[p]
        level = _background(pixels, r, c, half)
        x = y = 0.0
        light = spread = 0.0
        for _ in range(rounds):
            light = dx = dy = spread = 0.0
            for i in range(-half, half + 1):
                for k in range(-half, half + 1):
                    away = (k - x) ** 2 + (i - y) ** 2
                    share = math.exp(-away / (2.0 * window**2)) * (pixels[r + i, c + k] - level)
                    light += share
                    dx += share * (k - x)
                    dy += share * (i - y)
                    spread += share * away
            if light <= 0.0:
                break
            # the window takes half of the way of a spot as wide as it
            x, y = x + 2.0 * dx / light, y + 2.0 * dy / light
            if abs(x) > 2.0 or abs(y) > 2.0:
                light = 0.0  # it runs to another spot, which has a peak of its own
                break
            if abs(dx) + abs(dy) < settled * light:
                break
        place[p, 0], place[p, 1] = c + x, r + y
        if light > 0.0:
            # the light under the window is that of a narrower spot: 1/seen = 1/spot + 1/window
            seen = spread / (2.0 * light)
            if seen < window**2:
                spot = seen * window**2 / (window**2 - seen)
                width[p] = math.sqrt(spot)
                flux[p] = light * (spot + window**2) / window**2
    return place, flux, width

# SPDX-License-Identifier: Apache-2.0
"""The plate solution: from pixels of one image to the focal plane, by its fiducials."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiber_core import bounds
from fiber_core.array_types import Floats, Ints, Points
from fiber_metrology.errors import ImageError, MetrologyError
from fiber_metrology.polynomials import PolynomialMap, fit_map
from fiber_metrology.spots import Spots

__all__ = ["Plate", "PlateConfig", "solve_plate"]

_BIN_MM = 0.5  # of the vote for the shift
_NEAR_MM = 0.5  # of a fiducial after the shift, before turn and scale
_CLIP = 5.0  # residuals over the usual one, above which a fiducial is left out
_ROUNDS = 4


@dataclass(frozen=True)
class PlateConfig:
    """What an image must have to be believed.

    Args:
        shift_mm: largest shift from where the camera was calibrated [mm].
        search_mm: how far a shift is looked for, so that a shifted image can be named [mm].
        degree: degree of the correction of the calibrated map.
        found: least share of the fiducials that must be found.
        residual_um: largest rms distance of the fiducials from the fit [um].

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "shift_mm": bounds.Range(0.0, 1e3),
        "search_mm": bounds.Range(0.0, 1e3),
        "degree": bounds.Range(1, 9, whole=True),
        "found": bounds.Range(0.0, 1.0),
        "residual_um": bounds.Range(0.0, 1e4),
    }

    shift_mm: float = 1.0
    search_mm: float = 8.0
    degree: int = 2
    found: float = 0.7
    residual_um: float = 20.0

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)


@dataclass(frozen=True, eq=False)
class Plate:
    """The solution of one image.

    Args:
        places: every spot in the focal plane [mm], shape (s, 2).
        fiducial: the fiducial that each spot is of, -1 for none, shape (s,).
        shift_mm: shift of the image from its calibration [mm], shape (2,).
        residual_um: rms distance of the fiducials from the fit [um].
        correction: map from the calibrated to the solved plane.
    """

    places: Points
    fiducial: Ints
    shift_mm: Floats
    residual_um: float
    correction: PolynomialMap


def solve_plate(
    spots: Spots,
    fiducials: ArrayLike,
    calibrated: Callable[[ArrayLike], Floats],
    config: PlateConfig | None = None,
) -> Plate:
    """Find the fiducials among the spots of an image, and correct the calibrated map by them.

    The shift of the image is the one for which most pairs of a spot and a fiducial vote. Then
    each fiducial takes the nearest spot, in circles that shrink as the fit improves; fiducials that
    do not fit are left out.

    Args:
        spots: the spots of the image.
        fiducials: places of the fiducials [mm], shape (k, 2).
        calibrated: map from pixels to mm, of an earlier image or the laboratory.
        config: what the image must have.

    Raises:
        ImageError: there is no light, the image is shifted, or its fiducials are not those of
            this plane.
    """
    config = config or PlateConfig()
    fiducials = np.asarray(fiducials, dtype=float)
    needed = max(math.ceil(config.found * len(fiducials)), 3)
    if len(spots.place_px) == 0:
        raise ImageError("the image has no spots: no light, or the shutter was closed")
    if len(spots.place_px) < needed:
        raise ImageError(
            f"the image has {len(spots.place_px)} spots, and {needed} of {len(fiducials)} "
            "fiducials are needed"
        )
    seen = calibrated(spots.place_px)
    shift, votes = _shift(seen, fiducials, config.search_mm)
    size = math.hypot(*shift)
    if votes < needed:
        raise ImageError(
            f"only {votes} of {len(fiducials)} fiducials agree on a shift, {needed} are needed: "
            "the image is of another plane, turned, or shifted by more than "
            f"{config.search_mm:g} mm"
        )
    if size > config.shift_mm:
        raise ImageError(
            f"the image is shifted by {shift[0]:.2f}, {shift[1]:.2f} mm, more than "
            f"{config.shift_mm:g} mm"
        )
    near_mm, correction = _NEAR_MM, fit_map(seen, seen + shift, 1)
    spot, which = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    off = np.zeros(0)
    for turn in range(_ROUNDS):
        places = correction(seen)
        apart, nearest = cKDTree(places).query(fiducials)
        which = np.flatnonzero(apart <= near_mm)
        # a spot near two fiducials is of neither
        which = which[np.bincount(nearest[which], minlength=len(places))[nearest[which]] == 1]
        spot = nearest[which]
        if len(spot) < needed:
            raise ImageError(f"{len(spot)} of {len(fiducials)} fiducials found, needed {needed}")
        degree = config.degree if turn else 1
        correction = fit_map(seen[spot], fiducials[which], degree)
        off = np.hypot(*(correction(seen[spot]) - fiducials[which]).T)
        usual = max(float(np.median(off)), 1e-4)
        near_mm = min(near_mm, _CLIP * usual)
    residual_um = 1e3 * float(np.sqrt(np.mean(off**2)))
    if residual_um > config.residual_um:
        raise ImageError(
            f"the fiducials are {residual_um:.1f} um rms from their places, more than "
            f"{config.residual_um:g} um"
        )
    fiducial = np.full(len(seen), -1)
    fiducial[spot] = which
    return Plate(correction(seen), fiducial, shift, residual_um, correction)


def _shift(seen: Points, fiducials: Points, search_mm: float) -> tuple[Floats, int]:
    """The shift from spots to fiducials for which most pairs vote, and how many fiducials do."""
    pairs = cKDTree(fiducials).query_ball_point(seen, search_mm)
    spot = np.repeat(np.arange(len(seen)), [len(p) for p in pairs])
    which = np.array([k for p in pairs for k in p], dtype=np.int64)
    if len(which) == 0:
        return np.zeros(2), 0
    apart = fiducials[which] - seen[spot]
    cells = np.floor(apart / _BIN_MM).astype(np.int64)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    best = apart[cell.ravel() == np.argmax(count)].mean(axis=0)
    for _ in range(3):  # a cluster over two cells
        near = np.hypot(*(apart - best).T) <= _BIN_MM
        best = np.median(apart[near], axis=0) if near.any() else best
    near = np.hypot(*(apart - best).T) <= _BIN_MM
    return best, len(np.unique(which[near]))

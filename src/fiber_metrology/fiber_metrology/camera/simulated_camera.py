# SPDX-License-Identifier: Apache-2.0
"""A simulated fibre-view camera: true places of fibres and fiducials to spots of an exposure."""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from fiber_core import bounds
from fiber_core.array_types import Floats, Ints, Points
from fiber_metrology.camera.turbulence import turbulence
from fiber_metrology.errors import MetrologyError
from fiber_metrology.polynomials import PolynomialMap, fit_map
from fiber_metrology.spots import Spots

__all__ = ["CameraConfig", "Exposure", "Photograph", "SimulatedCamera"]

FIDUCIAL, STRAY = -1, -2  # owners of spots that are of no robot
_FIBRE_FLUX, _FIDUCIAL_FLUX = 1.0e4, 3.0e4
_FLUX_SPREAD = 0.1  # of the logarithm, from fibre to fibre
_WIDTH_PX, _WIDTH_SPREAD = 1.5, 0.03
_ELECTRONS = 2.0  # of a count
_LEVEL, _READ_NOISE, _FULL = 100.0, 5.0, 65535.0  # background, its noise, and the top [counts]
_HALF_PX = 9  # of the part of an image that one spot lights
_RADIAL, _OTHER = 0.01, 0.0005  # distortion at the rim over the radius: barrel; each other term
_DEGREE = 5  # of the distortion
_CALIBRATED_DEGREE = 9  # of the map from pixels to mm that the laboratory measures


@dataclass(frozen=True)
class CameraConfig:
    """The camera and the air before it.

    Args:
        mm_per_px: scale [mm/px].
        noise_um: rms distance by which noise of pixels and photons moves a centroid, for a spot of
            usual light [um of the focal plane].
        turbulence_um: rms distance by which air moves a spot in one exposure [um].
        correlation_mm: length over which the air moves spots alike [mm].
        missing: share of the spots that an exposure lacks.
        merged: share of the spots that are one with a stray light beside them.
        stray: number of stray spots over that of the fibres.
        shift_mm: largest shift of the camera between exposures, either axis [mm].
        turn_rad: largest turn of the camera between exposures [rad].
        stretch: largest relative change of the scale between exposures.
        merge_px: spots closer than this are one [px].

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "mm_per_px": bounds.Range(1e-4, 10.0),
        "noise_um": bounds.Range(0.0, 1e3),
        "turbulence_um": bounds.Range(0.0, 1e3),
        "correlation_mm": bounds.Range(1e-3, 1e5),
        "missing": bounds.Range(0.0, 1.0),
        "merged": bounds.Range(0.0, 1.0),
        "stray": bounds.Range(0.0, 10.0),
        "shift_mm": bounds.Range(0.0, 1e3),
        "turn_rad": bounds.Range(0.0, 0.1),
        "stretch": bounds.Range(0.0, 0.1),
        "merge_px": bounds.Range(0.0, 100.0),
    }

    mm_per_px: float = 0.14
    noise_um: float = 3.0
    turbulence_um: float = 5.0
    correlation_mm: float = 50.0
    missing: float = 0.05
    merged: float = 0.01
    stray: float = 0.005
    shift_mm: float = 0.2
    turn_rad: float = 1e-4
    stretch: float = 1e-4
    merge_px: float = 3.0

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)


class Exposure(NamedTuple):
    """The spots of one exposure, and what a judge knows about them.

    Args:
        spots: the spots, in random order; the metrology sees nothing else.
        owner: row of the robot that each spot is of, FIDUCIAL or STRAY, shape (s,).
    """

    spots: Spots
    owner: Ints


class Photograph(NamedTuple):
    """The pixels of one exposure, and what a judge knows about them.

    Args:
        pixels: counts, shape (h, w), uint16; (column, row) is a place.
        place_px: where each light is in it [px], shape (s, 2).
        owner: row of the robot that each light is of, FIDUCIAL or STRAY, shape (s,).
    """

    pixels: NDArray[np.uint16]
    place_px: Floats
    owner: Ints


class SimulatedCamera:
    """A camera that looks at a focal plane of a given radius.

    A spot stands where the fibre is, displaced by the air, through a polynomial distortion of
    degree 5 (barrel of 1 % and random terms of 0.05 % at the rim), seen by a camera that has
    shifted, turned and stretched a little since the last exposure.

    Not modelled: shapes of spots other than round, brightness over the plane, bad pixels.

    Args:
        radius_mm: radius of the plane [mm].
        config: the camera and the air.
        rng: source of the distortion, which stays the same.
    """

    FIDUCIAL, STRAY = FIDUCIAL, STRAY

    def __init__(self, radius_mm: float, config: CameraConfig, rng: np.random.Generator):
        bounds.check_number(radius_mm, "radius_mm", 1e-3, 1e6, MetrologyError)
        self.config, self.radius_mm = config, radius_mm
        terms = (_DEGREE + 1) * (_DEGREE + 2) // 2
        self._warp = PolynomialMap(
            np.zeros(2), radius_mm, _DEGREE, _OTHER * radius_mm * rng.normal(size=(terms, 2)) / 3
        )
        self._turn = rng.uniform(-0.1, 0.1)
        # the middle of a square image that holds the plane and its shifts
        reach_mm = 1.02 * radius_mm + config.shift_mm + 5.0
        self._middle = math.ceil(reach_mm / config.mm_per_px) + 4 * _HALF_PX
        lights_mm, seen_px = self.calibration_lights()
        self.calibrated = fit_map(seen_px, lights_mm, _CALIBRATED_DEGREE)

    def calibration_lights(self) -> tuple[Points, Floats]:
        """Return a laboratory's grid of lights [mm], and where it saw them without air [px]."""
        line = np.linspace(-1.02, 1.02, 25) * self.radius_mm
        grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= 1.02 * self.radius_mm]
        return grid, self._optics(grid)

    def expose(
        self,
        fibres: ArrayLike,
        fiducials: ArrayLike,
        lit: ArrayLike,
        rng: np.random.Generator,
    ) -> Exposure:
        """Return one exposure.

        Args:
            fibres: true places of the fibres [mm], shape (n, 2).
            fiducials: places of the fiducials [mm], shape (k, 2).
            lit: whether light comes out of each fibre, shape (n,).
            rng: source of air, noise and everything that goes wrong.
        """
        c = self.config
        places, flux, owner = self._lights(fibres, fiducials, lit, rng)
        noise = c.noise_um * 1e-3 / math.sqrt(2.0) * np.sqrt(_FIBRE_FLUX / flux)
        places += noise[:, None] * rng.normal(size=places.shape)
        px = self._moved(places, rng)
        width = _WIDTH_PX * (1.0 + _WIDTH_SPREAD * rng.normal(size=len(owner)))
        px, flux, width, owner = _with_strays_beside(px, flux, width, owner, c, rng)
        px, flux, width, owner = _merged(px, flux, width, owner, c.merge_px)
        order = rng.permutation(len(owner))
        return Exposure(Spots(px[order], flux[order], width[order]), owner[order])

    def photograph(
        self,
        fibres: ArrayLike,
        fiducials: ArrayLike,
        lit: ArrayLike,
        rng: np.random.Generator,
    ) -> Photograph:
        """Return the pixels of one exposure, with the noise of photons and reading.

        The arguments are those of `expose`. `noise_um` and `merge_px` take no part: both come
        from the pixels.
        """
        places, flux, owner = self._lights(fibres, fiducials, lit, rng)
        px = self._moved(places, rng)
        width = _WIDTH_PX * (1.0 + _WIDTH_SPREAD * rng.normal(size=len(owner)))
        px, flux, width, owner = _with_strays_beside(px, flux, width, owner, self.config, rng)
        side = 2 * self._middle + 1
        pixels = rng.standard_normal((side, side), dtype=np.float32)
        pixels *= _READ_NOISE
        pixels += _LEVEL
        near = np.arange(-_HALF_PX, _HALF_PX + 1)
        for (x, y), light, sigma in zip(px, flux, width):
            c, r = round(x), round(y)
            if not (_HALF_PX <= min(c, r) and max(c, r) < side - _HALF_PX):
                continue  # beyond the image
            across = np.exp(-((near + c - x) ** 2) / (2.0 * sigma**2))
            along = np.exp(-((near + r - y) ** 2) / (2.0 * sigma**2))
            mean = light / (2.0 * math.pi * sigma**2) * np.outer(along, across)
            part = pixels[r - _HALF_PX : r + _HALF_PX + 1, c - _HALF_PX : c + _HALF_PX + 1]
            part += rng.poisson(_ELECTRONS * mean) / _ELECTRONS
        return Photograph(np.clip(pixels, 0.0, _FULL).astype(np.uint16), px, owner)

    def _lights(
        self, fibres: ArrayLike, fiducials: ArrayLike, lit: ArrayLike, rng: np.random.Generator
    ) -> tuple[Points, Floats, Ints]:
        """The lights of an exposure: places that the air has moved, light, and owners."""
        c = self.config
        fibres, fiducials = np.asarray(fibres, dtype=float), np.asarray(fiducials, dtype=float)
        rows = np.flatnonzero(lit)
        rows = rows[rng.random(len(rows)) >= c.missing]
        strays = rng.poisson(c.stray * max(len(rows), 1))
        away = self.radius_mm * np.sqrt(rng.random(strays))
        at = rng.uniform(0.0, 2 * math.pi, strays)
        places = np.concatenate(
            [fibres[rows], fiducials, np.stack([away * np.cos(at), away * np.sin(at)], axis=1)]
        )
        owner = np.concatenate([rows, np.full(len(fiducials), FIDUCIAL), np.full(strays, STRAY)])
        flux = np.exp(_FLUX_SPREAD * rng.normal(size=len(owner)))
        flux *= np.where(owner == FIDUCIAL, _FIDUCIAL_FLUX, _FIBRE_FLUX)
        flux[owner == STRAY] *= np.exp(rng.normal(size=strays))
        return (
            places + turbulence(places, c.turbulence_um * 1e-3, c.correlation_mm, rng),
            flux,
            owner,
        )

    def _optics(self, places: Points) -> Floats:
        r2 = (places**2).sum(axis=1, keepdims=True) / self.radius_mm**2
        seen = places * (1.0 - _RADIAL * r2) + self._warp(places)
        turn = np.array(
            [
                [math.cos(self._turn), math.sin(self._turn)],
                [-math.sin(self._turn), math.cos(self._turn)],
            ]
        )
        return seen @ turn / self.config.mm_per_px + self._middle

    def _moved(self, places: Points, rng: np.random.Generator) -> Floats:
        c = self.config
        shift = rng.uniform(-c.shift_mm, c.shift_mm, 2)
        turn, stretch = rng.uniform(-c.turn_rad, c.turn_rad), rng.uniform(-c.stretch, c.stretch)
        small = (1.0 + stretch) * np.array(
            [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
        )
        return self._optics(places @ small + shift)


def _with_strays_beside(px, flux, width, owner, c: CameraConfig, rng: np.random.Generator):
    """Put a stray light beside a share of the spots of robots, so close that they merge."""
    fibre = np.flatnonzero(owner >= 0)
    chosen = fibre[rng.random(len(fibre)) < c.merged]
    k = len(chosen)
    away, at = rng.uniform(0.1, 1.0, k) * c.merge_px, rng.uniform(0.0, 2 * math.pi, k)
    beside = px[chosen] + np.stack([away * np.cos(at), away * np.sin(at)], axis=1)
    return (
        np.concatenate([px, beside]),
        np.concatenate([flux, flux[chosen] * rng.uniform(0.5, 1.5, k)]),
        np.concatenate([width, width[chosen]]),
        np.concatenate([owner, np.full(k, STRAY)]),
    )


def _merged(px, flux, width, owner, merge_px: float):
    """Make one of spots that are too close: centroid, sum, and width of both."""
    gone = np.zeros(len(owner), dtype=bool)
    if len(owner) == 0 or merge_px == 0.0:
        return px, flux, width, owner
    for one, other in cKDTree(px).query_pairs(merge_px, output_type="ndarray"):
        if gone[one] or gone[other]:
            continue
        whole, share = flux[one] + flux[other], flux[other] / (flux[one] + flux[other])
        apart = np.hypot(*(px[other] - px[one]))
        spread = share * (1.0 - share) * apart**2 / 2.0
        width[one] = math.sqrt((1 - share) * width[one] ** 2 + share * width[other] ** 2 + spread)
        px[one] += share * (px[other] - px[one])
        flux[one] = whole
        # a merged spot of a fiducial and a fibre is of neither
        owner[one] = max(owner[one], owner[other]) if STRAY in (owner[one], owner[other]) else STRAY
        gone[other] = True
    return px[~gone], flux[~gone], width[~gone], owner[~gone]

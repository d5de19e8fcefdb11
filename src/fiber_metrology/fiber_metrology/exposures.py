# SPDX-License-Identifier: Apache-2.0
"""Several exposures of the same fibres: which of their spots are one light."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiber_core.array_types import Bools, Floats, Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.errors import ImageError
from fiber_metrology.plate import Plate, PlateConfig, solve_plate
from fiber_metrology.spots import Spots

__all__ = ["Lights", "beside_free_lights", "combine"]

_SAME_MM = 0.06  # between spots of one fibre in two exposures; ten times the error of one
# A spot counts as two if its light, its width, or both together are so many sigma above the usual.
_ONE_SIGMAS, _BOTH_SIGMAS = 3.0, 3.5
_BESIDE_MM = 0.5  # between a merged spot and a clean one of the same fibre


class Lights(NamedTuple):
    """Points of light in the focal plane, fiducials left out.

    Args:
        places: mean over the exposures that saw each [mm], shape (s, 2).
        seen: number of exposures that saw each, shape (s,).
        merged: whether a light may be two that merged, shape (s,).
        exposures: number of exposures.
        plates: the plate solution of each exposure.
        first: index of one spot of each light in its exposure, and that exposure, shape (s, 2).
    """

    places: Points
    seen: Ints
    merged: Bools
    exposures: int
    plates: list[Plate]
    first: Ints


def combine(
    exposures: Sequence[Spots],
    fiducials: ArrayLike,
    calibrated: Callable[[ArrayLike], Floats],
    config: PlateConfig | None = None,
) -> Lights:
    """Return the lights of some exposures between which nothing moved.

    Spots within 60 um of each other are one light at their mean. A spot that is brighter or wider
    than fibres are may be two that merged: it tells that a light is there, and not where. It is a
    light only if no exposure has a clean one near it.

    Args:
        exposures: spots of each exposure, one or more.
        fiducials, calibrated, config: as for solve_plate.

    Raises:
        ImageError: there is no exposure, or one cannot be used.
    """
    if not exposures:
        raise ImageError("there is no exposure: the camera gave no image")
    plates = [solve_plate(spots, fiducials, calibrated, config) for spots in exposures]
    places, merged, source = [], [], []
    for k, (spots, plate) in enumerate(zip(exposures, plates)):
        fibre = np.flatnonzero(plate.fiducial < 0)
        places.append(plate.places[fibre])
        bright, wide = _sigmas(spots.flux[fibre]), _sigmas(spots.width_px[fibre])
        merged.append((np.maximum(bright, wide) > _ONE_SIGMAS) | (bright + wide > _BOTH_SIGMAS))
        source.append(np.stack([fibre, np.full(len(fibre), k)], axis=1))
    flat, doubtful, which = map(np.concatenate, (places, merged, source))
    if len(flat) == 0:
        return Lights(flat, np.zeros(0, int), doubtful, len(exposures), plates, which)
    if doubtful.any() and not doubtful.all():
        apart = cKDTree(flat[~doubtful]).query(flat, distance_upper_bound=_BESIDE_MM)[0]
        kept = ~doubtful | ~np.isfinite(apart)
        flat, doubtful, which = flat[kept], doubtful[kept], which[kept]
    group = _groups(flat, which[:, 1])
    seen = np.bincount(group)
    mean = np.stack([np.bincount(group, flat[:, axis]) / seen for axis in range(2)], axis=1)
    first = np.unique(group, return_index=True)[1]
    return Lights(mean, seen, doubtful[first], len(exposures), plates, which[first])


def beside_free_lights(plane: FocalPlane, lights: Lights, owned: Ints) -> Mask:
    """Return the robots with a light in reach that is of no robot and that most exposures saw.

    Args:
        plane: the focal plane.
        lights: the lights of the exposures.
        owned: rows of the lights that are of some robot, shape (k,).

    Returns:
        These robots, shape (n,).
    """
    free = 2 * lights.seen >= lights.exposures
    free[owned] = False
    if not free.any():
        return np.zeros(plane.n, dtype=bool)
    apart = cKDTree(lights.places[free]).query(plane.centers)[0]
    return np.asarray(apart <= plane.arms.sum(axis=1))


def _sigmas(values: Floats) -> Floats:
    """How far the logarithm of each value is above the usual one, in its usual spread."""
    logs = np.log(np.maximum(values, 1e-12))
    # the spread of the fainter half: merged spots are all in the other one
    low, usual = np.percentile(logs, [15.87, 50.0]) if len(logs) else (0.0, 1.0)
    spread = usual - low
    return (logs - usual) / max(float(spread), 1e-3)


def _groups(places: Points, exposure: Ints) -> Ints:
    """The light that each spot belongs to: the first exposure's spots, then what they lack."""
    group = np.full(len(places), -1)
    count = 0
    for k in range(int(exposure.max(initial=0)) + 1):
        new = np.flatnonzero(exposure == k)
        old = np.flatnonzero(group >= 0)
        if len(old) and len(new):
            apart, at = cKDTree(places[old]).query(places[new], distance_upper_bound=_SAME_MM)
            near = np.flatnonzero(np.isfinite(apart))
            # of two new spots near one light, the nearer one is of it
            near = near[np.argsort(apart[near], kind="stable")]
            _, one = np.unique(group[old[at[near]]], return_index=True)
            group[new[near[one]]] = group[old[at[near[one]]]]
        rest = new[group[new] < 0]
        group[rest] = count + np.arange(len(rest))
        count += len(rest)
    return group

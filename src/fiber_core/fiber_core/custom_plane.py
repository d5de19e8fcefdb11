# SPDX-License-Identifier: Apache-2.0
"""Focal planes of instruments that no preset describes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Mask
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.hexagonal_grid import hexagonal_centers
from fiber_core.presets import PlaneColumns, Preset, plane_from
from fiber_core.validation import frozen_array

__all__ = ["hexagonal"]

_RADIUS_SHARE = 1 / 3  # capsule radius over the shorter arm: 1 mm with the 3 mm arms of DESI
_RADII_APART = 4  # distance of two random targets over the capsule radius, as in the presets


def hexagonal(
    robots: int,
    pitch_mm: float,
    arms_mm: tuple[float, float],
    *,
    radius_mm: float | None = None,
    limits_deg: ArrayLike = ((-180.0, 180.0), (0.0, 180.0)),
    speeds_deg_s: tuple[float, float] = (180.0, 180.0),
    spacing_mm: float | None = None,
    disabled: float | Sequence[int] = (),
    seed: int = 0,
    obstacles: ArrayLike | None = None,
    name: str = "hexagonal",
) -> FocalPlane:
    """Return the focal plane of a made-up instrument: equal robots on a hexagonal grid.

    Robots are numbered from 0, from the centre outwards, ring by ring; robot k stands on the
    same site for every number of robots. The phi arm is a capsule from elbow to tip, and the
    theta arm passes below all phi arms. Folded robots are clear of their neighbours if
    ``max(l1, |l2 - l1|) + radius_mm`` is less than half the pitch.

    Args:
        robots: number of robots; 1, 7, 19, 37, ... 3 k (k + 1) + 1 fill k rings.
        pitch_mm: distance between neighbouring robots [mm].
        arms_mm: lengths of the theta arm and the phi arm, l1 and l2 [mm].
        radius_mm: radius of the capsule [mm]; by default a third of the shorter arm.
        limits_deg: joint ranges [deg], shape (2, 2): joint (theta, phi), (low, high); by
            default the least ranges with which the tip reaches the whole patrol region.
        speeds_deg_s: highest speeds of theta and phi [deg/s].
        spacing_mm: least distance between two targets [mm]; by default any distance is accepted,
            and random targets are four radii apart.
        disabled: ids of robots that may not be moved, shape (k,), or the share of the robots
            that are drawn as disabled, 0 to 1.
        seed: seed with which the disabled robots are drawn; the same seed draws the same ones.
        obstacles: fixed discs x, y, radius [mm], shape (k, 3); by default none.
        name: name of the instrument.

    Raises:
        LayoutError: a value is out of range; names the argument and the value.
    """
    _check(pitch_mm > 0, "pitch_mm", "positive", pitch_mm)
    bounds.check_number(seed, "seed", 0, 2**64, LayoutError, whole=True)
    arms, speeds = _pair(arms_mm, "arms_mm"), _pair(speeds_deg_s, "speeds_deg_s")
    radius_mm = _RADIUS_SHARE * min(arms) if radius_mm is None else radius_mm
    _check(radius_mm >= 0, "radius_mm", "0 or more", radius_mm)
    envelope_mm = _RADII_APART * radius_mm if spacing_mm is None else spacing_mm
    _check(envelope_mm >= 0, "spacing_mm", "0 or more", envelope_mm)
    theta_deg, phi_deg = _ranges(limits_deg)
    centers = hexagonal_centers(robots, pitch_mm)
    figures = Preset(
        robots=len(centers),
        pitch_mm=pitch_mm,
        arms_mm=arms,
        theta_deg=theta_deg,
        phi_deg=phi_deg,
        speeds_deg_s=speeds,
        envelope_mm=envelope_mm,
        radius_mm=radius_mm,
    )
    enabled = ~_disabled(disabled, len(centers), np.random.default_rng(seed))
    columns = PlaneColumns(enabled=enabled, name=name, spacing_mm=spacing_mm or 0.0)
    if obstacles is not None:
        columns["obstacles"] = obstacles
    return plane_from(figures, np.arange(len(centers)), centers, **columns)


def _check(holds: bool, name: str, rule: str, value: float) -> None:
    # nan breaks every rule, as no comparison with it holds
    if not (holds and np.isfinite(value)):
        raise LayoutError(f"{name} must be {rule}, got {value}")


def _pair(value: ArrayLike, name: str) -> tuple[float, float]:
    theta, phi = frozen_array(value, np.float64, (2,), name, LayoutError).tolist()
    for number in (theta, phi):
        _check(number > 0, name, "two positive numbers", number)
    return theta, phi


def _ranges(limits_deg: ArrayLike) -> tuple[tuple[float, float], tuple[float, float]]:
    limits = frozen_array(limits_deg, np.float64, (2, 2), "limits_deg", LayoutError)
    for joint, (low, high) in zip(("theta", "phi"), limits.tolist()):
        if not (np.isfinite([low, high]).all() and low <= high):
            raise LayoutError(f"limits_deg of {joint} must be low, high, got {low}, {high}")
    (theta_low, theta_high), (phi_low, phi_high) = limits.tolist()
    return (theta_low, theta_high), (phi_low, phi_high)


def _disabled(disabled: float | Sequence[int], n: int, rng: np.random.Generator) -> Mask:
    # which of n robots are disabled, from their ids or from their share
    mask = np.zeros(n, dtype=np.bool_)
    if isinstance(disabled, int | float):
        _check(0 <= disabled <= 1, "disabled", "ids or a share from 0 to 1", float(disabled))
        mask[rng.choice(n, round(disabled * n), replace=False)] = True
        return mask
    ids = frozen_array(disabled, np.int64, (None,), "disabled", LayoutError)
    unknown = ids[(ids < 0) | (ids >= n)]
    if len(unknown):
        raise LayoutError(f"disabled names robot {unknown[0]}, but the ids are 0 to {n - 1}")
    mask[ids] = True
    return mask

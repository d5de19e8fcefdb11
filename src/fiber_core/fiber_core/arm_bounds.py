# SPDX-License-Identifier: Apache-2.0
"""Arms that are known within an interval only: outlines that hold them wherever they are."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Floats, Ints, Mask
from fiber_core.clearance import levers_of
from fiber_core.focal_plane import FocalPlane

__all__ = [
    "arms_within",
    "both_elbows",
    "grown",
    "interval_of_tips",
    "joints_of_test_turns",
    "turn_within",
]

_BEYOND_RAD = 1e-6  # of a range of phi that ends where the arm is stretched or folded


def interval_of_tips(plane: FocalPlane, error_mm: ArrayLike) -> Angles:
    """Return half the width of the interval of each joint of fibres known within an error.

    Args:
        plane: the focal plane.
        error_mm: bound of the error of one coordinate of each fibre [mm], shape (n,) or one number.
            Half of its square is of theta, half of phi.

    Returns:
        Half the width of each interval [rad], shape (n, 2).
    """
    error = np.broadcast_to(np.asarray(error_mm, dtype=float), (plane.n,))
    return error[:, None] / plane.arms / np.sqrt(2.0)


def arms_within(
    plane: FocalPlane, interval_rad: ArrayLike, tip_mm: ArrayLike = np.nan
) -> tuple[Floats, Floats]:
    """Return how far points of both outlines may be from where the angles put them.

    With errors a and b of theta and phi the elbow is off by l1 |a|, and the tip by the vector sum
    of l1 a and l2 (a + b), whatever phi is. If the tip is known within e at one phi, then
    l2 |a + b| <= e + l1 |a|, and at every other phi it is off by at most e + 2 l1 |a|: less than
    the intervals alone say, because the errors of a measured tip belong together. Points of an
    outline beyond the ends of its arm are off by more, as their lever is longer.

    Args:
        plane: the focal plane.
        interval_rad: half the width of the interval of each joint [rad], shape (n, 2).
        tip_mm: bound of the error of each tip [mm], shape (n,) or one number, nan where it was not
            measured.

    Returns:
        Bounds for the theta outline and the phi outline [mm], shape (n,) each.
    """
    a, b = np.minimum(np.asarray(interval_rad, dtype=float), np.pi).T
    first, second = plane.arms.T
    elbow = first * a
    swing = np.minimum(second * (a + b), np.where(np.isnan(tip_mm), np.inf, tip_mm + elbow))
    beyond = np.maximum(levers_of(plane)[:, 1] / second, 1.0)
    theta_lever = _theta_lever(plane)
    return theta_lever * a, elbow + swing * beyond


def _theta_lever(plane: FocalPlane) -> Floats:
    if plane.theta_vertices.shape[1] == 0:
        return np.zeros(plane.n)
    return np.hypot(*np.moveaxis(plane.theta_vertices, -1, 0)).max(axis=1) + plane.theta_radius


def both_elbows(plane: FocalPlane) -> Mask:
    """Return the robots whose fibre can be at one place with either elbow in range, shape (n,)."""
    low, high = plane.limits[:, 1].T
    return (low < -_BEYOND_RAD) | (high > np.pi + _BEYOND_RAD)


def joints_of_test_turns(plane: FocalPlane) -> Ints:
    """Return the joint that a robot at an unknown place turns, 0 for theta, 1 for phi, shape (n,).

    A turn of theta moves a fibre alike with either elbow, so that robots with both in range turn
    phi.
    """
    return both_elbows(plane).astype(np.int64)


def turn_within(plane: FocalPlane, gap_mm: ArrayLike, joint: ArrayLike = 0) -> Floats:
    """Return how far one joint of all robots may turn at once so that none uses up half of its gap.

    It holds wherever the arms are: no point is farther from the axis than the lever.

    Args:
        plane: the focal plane.
        gap_mm: gap that the outlines keep before the turn [mm], shape (n,) or one number.
        joint: the joint that turns, 0 for theta, 1 for phi, one number or shape (n,).

    Returns:
        The turn of each robot [rad], shape (n,).
    """
    column: Ints = np.broadcast_to(np.asarray(joint, dtype=np.int64), (plane.n,))
    levers: Floats = levers_of(plane)[np.arange(plane.n), column]
    return 0.5 * np.asarray(gap_mm, dtype=float) / levers


def grown(plane: FocalPlane, interval_rad: Angles, tip_mm: ArrayLike = np.nan) -> FocalPlane:
    """Return the plane with outlines that hold the true arms, as `arms_within` bounds them.

    Args:
        plane: the focal plane.
        interval_rad: half the width of the interval of each joint [rad], shape (n, 2).
        tip_mm: as for arms_within.
    """
    theta_mm, phi_mm = arms_within(plane, interval_rad, tip_mm)
    return replace(
        plane, phi_radius=plane.phi_radius + phi_mm, theta_radius=plane.theta_radius + theta_mm
    )

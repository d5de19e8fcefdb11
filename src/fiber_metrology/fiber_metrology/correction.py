# SPDX-License-Identifier: Apache-2.0
"""The correction: from measured angles to the problem of the next move.

The orders of a robot are relative: they say how far its joints turn, and its counters take part in
nothing else. A correction therefore begins at the measured angles, wherever the counters are.

Where a robot is known within an interval only, its outlines are grown by how far any of their
points may be from where the angles put it, so that the usual margin holds between the true arms.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Floats, Mask
from fiber_core.clearance import levers_of
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_core.validation import frozen_array
from fiber_metrology.errors import MetrologyError
from fiber_metrology.measure import Measurement

__all__ = ["arms_within", "correction_problem", "follows", "grown"]


def follows(measurement: Measurement) -> Mask:
    """Return the robots whose place is known and whose joints turned when told to, shape (n,)."""
    return measurement.certain & ~measurement.not_moved


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


def correction_problem(
    measurement: Measurement, targets: ArrayLike, tolerance_um: float = 0.0
) -> Problem:
    """Return the problem that brings the fibres of an image to their targets.

    Robots that do not follow, and robots whose light was not found, are disabled: they
    stay, and are obstacles within their intervals.

    Args:
        measurement: where the robots are.
        targets: targets of the fibres [mm], shape (n, 2), nan without a target.
        tolerance_um: a fibre that is so close to its target is left there [um].

    Raises:
        MetrologyError: the targets have another shape.
    """
    plane = measurement.plane
    asked = frozen_array(targets, np.float64, (plane.n, 2), "targets", MetrologyError)
    moves = follows(measurement) & plane.enabled
    off_mm = np.hypot(*(measurement.places - asked).T)
    moved = moves & (off_mm > tolerance_um * 1e-3)
    wider = grown(plane, measurement.interval_rad, measurement.error_mm)
    problem_plane = replace(wider, enabled=moves)
    return Problem(problem_plane, measurement.angles, np.where(moved[:, None], asked, np.nan))

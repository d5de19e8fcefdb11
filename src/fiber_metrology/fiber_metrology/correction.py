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

from fiber_core.array_types import Mask
from fiber_core.problem import Problem
from fiber_core.validation import frozen_array
from fiber_metrology.errors import MetrologyError
from fiber_metrology.measure import Measurement

__all__ = ["correction_problem", "follows"]


def follows(measurement: Measurement) -> Mask:
    """Return the robots whose place is known and whose joints turned when told to, shape (n,)."""
    return measurement.certain & ~measurement.not_moved


def correction_problem(
    measurement: Measurement,
    targets: ArrayLike,
    outlines_off_mm: ArrayLike,
    tolerance_um: float = 0.0,
) -> Problem:
    """Return the problem that brings the fibres of an image to their targets.

    Robots that do not follow, and robots whose light was not found, are disabled: they
    stay, and are obstacles within their intervals.

    Args:
        measurement: where the robots are.
        targets: targets of the fibres [mm], shape (n, 2), nan without a target.
        outlines_off_mm: how far points of the theta and the phi outline may be from where the
            angles put them [mm], shape (n, 2), as `Knowledge.outlines_off_mm` tells.
        tolerance_um: a fibre that is so close to its target is left there [um].

    Raises:
        MetrologyError: an argument has another shape.
    """
    plane = measurement.plane
    asked = frozen_array(targets, np.float64, (plane.n, 2), "targets", MetrologyError)
    moves = follows(measurement) & plane.enabled
    off_mm = np.hypot(*(measurement.places - asked).T)
    moved = moves & (off_mm > tolerance_um * 1e-3)
    theta_mm, phi_mm = frozen_array(
        outlines_off_mm, np.float64, (plane.n, 2), "outlines_off_mm", MetrologyError
    ).T
    problem_plane = replace(
        plane,
        theta_radius=plane.theta_radius + theta_mm,
        phi_radius=plane.phi_radius + phi_mm,
        enabled=moves,
    )
    return Problem(problem_plane, measurement.angles, np.where(moved[:, None], asked, np.nan))

# SPDX-License-Identifier: Apache-2.0
"""Random fields of corrections: targets a fraction of a millimetre from where the tips stand."""

import numpy as np

from fiber_core import kinematics
from fiber_core.clearance import Safety, gaps, neighbour_pairs
from fiber_core.fields import random_problem
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_planner.approach import inside_approaches

__all__ = ["correction_field"]

_LEAST_MM, _MOST_MM = 0.05, 0.5
_TURN_RAD = 0.5  # most that a joint turns, see StraightPlanner
_SPARE_RAD = np.deg2rad(0.05)
_LONG_S, _ALLOWANCE_MM = 30.0, 0.02
_ROUNDS = 200


def correction_field(plane: FocalPlane, rng: np.random.Generator) -> Problem:
    """Draw a field in which every tip is 50 to 500 um from its target, in any direction.

    A target is drawn again until its robot can approach it with the elbow that it has, and until
    all outlines are as far apart at the end as at the start of a random field.

    Args:
        plane: the focal plane, with listed speeds.
        rng: source of randomness; the same state gives the same field.

    Raises:
        RuntimeError: some targets were not found; tells how many.
    """
    drawn = random_problem(plane, rng)
    narrow = inside_approaches(drawn, _SPARE_RAD).plane
    gap_mm = Safety().at_full_speed_mm(plane, _LONG_S) + _ALLOWANCE_MM
    pairs, rows = neighbour_pairs(plane, gap_mm), np.arange(plane.n)
    tips, ends = kinematics.forward(plane, drawn.start)[1], drawn.start.copy()
    targets, missing = np.full((plane.n, 2), np.nan), drawn.asked.copy()
    for _ in range(_ROUNDS):
        far, way = rng.uniform(_LEAST_MM, _MOST_MM, plane.n), rng.uniform(0, 2 * np.pi, plane.n)
        places = tips + far[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
        angles, valid = kinematics.inverse(narrow, places)
        turn = np.where(valid, np.abs(angles - drawn.start[:, None]).max(axis=2), np.inf)
        found = missing & (turn.min(axis=1) < _TURN_RAD)
        ends[found] = angles[rows, turn.argmin(axis=1)][found]
        targets[found] = places[found]
        bodies = pairs[gaps(plane, pairs, ends) < gap_mm].ravel()
        close = np.isin(rows, bodies) & drawn.asked
        ends[close], targets[close] = drawn.start[close], np.nan
        missing = drawn.asked & np.isnan(targets).any(axis=1)
        if not missing.any():
            return Problem(plane, drawn.start, targets)
    raise RuntimeError(f"{missing.sum()} robots found no target for a correction")

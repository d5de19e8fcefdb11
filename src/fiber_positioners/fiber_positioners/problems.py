"""Problems to solve: random ones, and targets from a table."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import fields
from fiber_core.assignment import assign
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_core.tables import read_targets

__all__ = ["random_problem", "with_targets"]


def random_problem(
    plane: FocalPlane,
    seed: int | np.random.Generator = 0,
    *,
    gap_mm: float | None = None,
    asked: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> Problem:
    """Draw a problem: random joint angles, and targets that can all be reached at once.

    Args:
        plane: the focal plane.
        seed: a seed, or a generator that the random numbers are taken from.
        gap_mm: clearance at the start and at the targets [mm]; by default the margin of
            `Safety` and 0.1 mm more.
        asked: the robots that get a target, shape (n,); by default all that are enabled.
        start: joint angles now [rad], shape (n, 2), where they are given and not drawn.

    Raises:
        FieldError: some robots found no place; names them.
    """
    return fields.random_problem(plane, np.random.default_rng(seed), gap_mm, asked, start)


def with_targets(problem: Problem, path: str | Path) -> Problem:
    """Return the same problem with the targets of a table instead of its own.

    Args:
        problem: the plane and the present joint angles.
        path: table with the columns id, x_mm, y_mm, or a problem.npz.

    Raises:
        TargetsError: the file cannot be read, or a robot is unknown; names it.
    """
    plane, (ids, xy_mm) = problem.plane, read_targets(path)
    return Problem(plane, problem.start, assign(plane, problem.start, ids, xy_mm).asked_mm)

"""Problems to solve: random ones, and targets from a table."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import fields
from fiber_core.assignment import assign
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_formats import read_targets

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
        path: file with targets, of any format that `fiber_formats` knows.

    Raises:
        FormatError: the file is refused.
        TargetsError: a robot is unknown; names it.
    """
    plane, found = problem.plane, read_targets(path)
    assigned = assign(plane, problem.start, found.ids, found.xy_mm)
    return Problem(plane, problem.start, assigned.asked_mm)

# SPDX-License-Identifier: Apache-2.0
"""Planes from files, and problems to solve: random ones, and targets from a table."""

import logging
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import fields
from fiber_core.assignment import assign
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_formats import read_layout as read_layout_file
from fiber_formats import read_targets

__all__ = ["random_problem", "read_layout", "with_targets"]

_LOG = logging.getLogger("fiber_positioners")


def read_layout(
    path: str | Path, preset: str | None = None, obstacles: str | Path | None = None
) -> FocalPlane:
    """Read a focal plane from a table or from an instrument's own files.

    A line of the log (warnings of the logger "fiber_positioners") tells the figures that a preset
    supplied; further lines name what the files hold and what is not used.
    `fiber_formats.read_layout` returns the same lines with the plane instead.

    Args:
        path: a file, or several joined by commas where an instrument splits them.
        preset: instrument that supplies what the files lack; by default the one that the format
            or the arms point to.
        obstacles: table of fixed discs x_mm, y_mm, radius_mm.

    Raises:
        FormatError: a file is refused; names file, column, robot and value.
    """
    layout = read_layout_file(str(path), preset, obstacles)
    for line in (layout.summary, *layout.notices):
        _LOG.warning("%s", line)
    return layout.plane


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
    found = read_targets(path, problem.plane)
    plane = found.on(problem.plane)
    assigned = assign(plane, problem.start, found.ids, found.xy_mm)
    return Problem(plane, problem.start, assigned.asked_mm)

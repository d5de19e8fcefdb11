# SPDX-License-Identifier: Apache-2.0
"""Our own problem.npz: present angles and targets of a whole problem."""

import numpy as np

from fiber_core.errors import FiberError
from fiber_core.problem import Problem, load_problem
from fiber_formats.errors import FormatError
from fiber_formats.interface import Format
from fiber_formats.records import StartColumns, TargetColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]


def matches(source: Source) -> bool:
    """Return whether the one file is a zip archive, as every .npz is."""
    return len(source.files) == 1 and source.files[0].is_zip


def starts(source: Source) -> StartColumns:
    """Read the present angles of a problem."""
    problem = _problem(source)
    return StartColumns(problem.plane.ids, np.rad2deg(problem.start))


def targets(source: Source) -> TargetColumns:
    """Read the targets of a problem."""
    problem = _problem(source)
    return TargetColumns(problem.plane.ids, problem.targets)


def _problem(source: Source) -> Problem:
    try:
        return load_problem(source.only.path)
    except FiberError as error:
        raise FormatError(str(error)) from None


FORMAT = Format("problem.npz", matches, starts=starts, targets=targets)

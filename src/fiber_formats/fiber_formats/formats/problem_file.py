# SPDX-License-Identifier: Apache-2.0
"""Our own problem.npz: present angles and targets of a whole problem."""

import io
import zipfile

import numpy as np

from fiber_core.errors import FiberError
from fiber_core.problem import Problem, load_problem
from fiber_formats.errors import FormatError
from fiber_formats.interface import Format
from fiber_formats.records import StartColumns, TargetColumns
from fiber_formats.source import Source

__all__ = ["FORMAT"]


def matches(source: Source) -> bool:
    """Return whether the one file is a zip archive of arrays, as every .npz is."""
    first, *others = source.files
    if others or not first.is_zip:
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(first.data)) as archive:
            return all(name.endswith(".npy") for name in archive.namelist())
    except zipfile.BadZipFile:
        return True  # damaged: refused as such


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
        return load_problem(source.only.path, source.only.data)
    except FiberError as error:
        raise FormatError(str(error)) from None


FORMAT = Format("problem.npz", matches, starts=starts, targets=targets)

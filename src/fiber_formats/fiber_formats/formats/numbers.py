# SPDX-License-Identifier: Apache-2.0
"""Rows of numbers in a text without header."""

import re

import numpy as np

from fiber_core.array_types import Floats
from fiber_formats.source import DataFile

__all__ = ["numbers_of"]

_SEPARATOR = re.compile(r"\s*,\s*|\s+")


def numbers_of(file: DataFile, width: int) -> Floats | None:
    """Return the numbers of a text, shape (rows, width), or None where it is anything else."""
    lines = file.data_lines
    if not lines or "_" in lines[0] or len(_SEPARATOR.split(lines[0])) != width:
        return None
    rows = [_SEPARATOR.split(line) for line in lines]
    if any(len(row) != width or "_" in line for row, line in zip(rows, lines)):
        return None
    try:
        values = np.array(rows, dtype=str).astype(float)
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None

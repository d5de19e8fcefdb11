# SPDX-License-Identifier: Apache-2.0
"""Errors of the focal plane core."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Ids

__all__ = ["FiberError", "FieldError", "LayoutError", "MotionError", "TargetsError"]


class FiberError(Exception):
    """Base of every error this project raises for bad input."""


class LayoutError(FiberError):
    """A focal plane cannot be built from the values given."""


class MotionError(FiberError):
    """A motion is malformed: wrong shape, times out of order, values not finite."""


class TargetsError(FiberError):
    """A table of targets is malformed, so all of its targets are refused.

    Args:
        message: the error, with robot ids and values.
        ids: ids of the robots concerned, shape (k,).
        reasons: Reason of each, shape (k,).
    """

    def __init__(self, message: str, ids: ArrayLike = (), reasons: ArrayLike = ()):
        super().__init__(message)
        self.ids: Ids = np.array(ids, dtype=np.int64)
        self.reasons: Codes = np.array(reasons, dtype=np.int64)


class FieldError(FiberError):
    """No random field could be drawn: some robots cannot be placed apart from the others.

    Args:
        message: which robots could not be placed, and with which gap.
        ids: ids of the robots that could not be placed, shape (k,).
    """

    def __init__(self, message: str, ids: ArrayLike = ()):
        super().__init__(message)
        self.ids: Ids = np.array(ids, dtype=np.int64)

"""Errors of the focal plane core."""

import numpy as np

__all__ = ["FiberError", "FieldError", "LayoutError", "MotionError", "TargetsError"]


class FiberError(Exception):
    """Base of every error this project raises for bad input."""


class LayoutError(FiberError):
    """A focal plane cannot be built from the values given."""


class MotionError(FiberError):
    """A motion is malformed: wrong shape, times out of order, values not finite."""


class TargetsError(FiberError):
    """A table of targets is malformed, so none of it is taken.

    Args:
        message: what is wrong, with robot ids and values.
        ids: the robots concerned, shape (k,).
        reasons: Reason of each, shape (k,).
    """

    def __init__(self, message: str, ids=(), reasons=()):
        super().__init__(message)
        self.ids = np.array(ids, dtype=np.int64)
        self.reasons = np.array(reasons, dtype=np.int64)


class FieldError(FiberError):
    """No random field could be drawn: the robots cannot be placed apart from each other.

    Args:
        message: what could not be placed.
        ids: the robots left without a place, shape (k,).
    """

    def __init__(self, message: str, ids=()):
        super().__init__(message)
        self.ids = np.array(ids, dtype=np.int64)

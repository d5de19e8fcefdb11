"""Errors of this package."""

from fiber_core.errors import FiberError

__all__ = ["RecordingError"]


class RecordingError(FiberError):
    """A recording is malformed, or of a version this software does not know."""

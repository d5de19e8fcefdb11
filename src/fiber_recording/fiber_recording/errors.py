"""The error of this package."""

from fiber_core.errors import FiberError

__all__ = ["RecordingError"]


class RecordingError(FiberError):
    """A recording is malformed, or its version is newer than this software."""

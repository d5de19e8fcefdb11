# SPDX-License-Identifier: Apache-2.0
"""Errors of this package."""

from fiber_core.errors import FiberError

__all__ = ["BagError", "RecordingError"]


class RecordingError(FiberError):
    """A recording is malformed, or its version is newer than this software."""


class BagError(FiberError):
    """A bag cannot be written."""

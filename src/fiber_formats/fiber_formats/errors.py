# SPDX-License-Identifier: Apache-2.0
"""The one error that every reader and writer of this package raises."""

from fiber_core.errors import FiberError

__all__ = ["FormatError"]


class FormatError(FiberError):
    """A file is refused: the message names the file, column, robot or row, and the value."""

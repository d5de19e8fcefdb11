# SPDX-License-Identifier: Apache-2.0
"""Errors of this package."""

from fiber_core.errors import FiberError

__all__ = ["ProcessError"]


class ProcessError(FiberError):
    """A process of the graph could not be started, or has ended by itself."""

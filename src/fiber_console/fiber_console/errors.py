# SPDX-License-Identifier: Apache-2.0
"""The base of the errors of this package."""

from fiber_core.errors import FiberError

__all__ = ["ConsoleError"]


class ConsoleError(FiberError):
    """The console cannot be served, or an order cannot be passed on."""

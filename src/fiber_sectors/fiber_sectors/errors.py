# SPDX-License-Identifier: Apache-2.0
"""Errors of sectors."""

from fiber_core.errors import FiberError

__all__ = ["SectorError"]


class SectorError(FiberError):
    """Base of every error that sectors raise for bad input."""

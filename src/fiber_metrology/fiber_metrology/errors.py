# SPDX-License-Identifier: Apache-2.0
"""Errors of the metrology."""

from fiber_core.errors import FiberError

__all__ = ["ImageError", "MetrologyError"]


class MetrologyError(FiberError):
    """A value given to the metrology is malformed; the message names it."""


class ImageError(MetrologyError):
    """An image cannot be used: no light, too few fiducials, shifted, or of another plane.

    Nothing is learned from such an image.
    """

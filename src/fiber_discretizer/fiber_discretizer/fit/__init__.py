# SPDX-License-Identifier: Apache-2.0
"""Line fitting: a sampled profile as few straight pieces inside its corridor."""

from fiber_discretizer.fit.linearize import LINEARIZERS, Polylines, linearize

__all__ = ["LINEARIZERS", "Polylines", "linearize"]

# SPDX-License-Identifier: Apache-2.0
"""Shows recordings of a focal plane: the player in a browser, figures, and a live view."""

from fiber_viewer.figures import before_and_after
from fiber_viewer.figures.residuals import residuals
from fiber_viewer.page import write_player

__all__ = ["before_and_after", "residuals", "write_player"]

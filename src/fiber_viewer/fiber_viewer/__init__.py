# SPDX-License-Identifier: Apache-2.0
"""Shows recordings of a focal plane: the player in a browser, figures, and a live view."""

import importlib
from typing import TYPE_CHECKING, Any

from fiber_viewer.page import write_player

if TYPE_CHECKING:
    from fiber_viewer.figures import before_and_after
    from fiber_viewer.figures.residuals import residuals

__all__ = ["before_and_after", "residuals", "write_player"]

_FIGURES = {
    "before_and_after": "fiber_viewer.figures",
    "residuals": "fiber_viewer.figures.residuals",
}


def __getattr__(name: str) -> Any:
    # the library of figures takes a second to load, and the node needs none
    if name in _FIGURES:
        return getattr(importlib.import_module(_FIGURES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

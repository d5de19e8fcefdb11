"""Pictures of the focal plane, from the exchange files."""

from fiber_viewer.figures import before_and_after

__all__ = ["before_and_after"]

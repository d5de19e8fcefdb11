"""Errors of whoever talks to the graph from outside."""

from fiber_core.errors import FiberError

__all__ = ["PlaneError", "PlaneRefusal"]


class PlaneError(FiberError):
    """The focal plane did not do what it was asked to do."""


class PlaneRefusal(PlaneError):
    """A node refused what it was sent.

    Args:
        stage: who refused.
        text: its reason, with robot and value.
    """

    def __init__(self, stage: str, text: str):
        super().__init__(f"{stage}: {text}")
        self.stage, self.text = stage, text

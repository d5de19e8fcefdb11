"""Errors of the clients of the graph."""

from fiber_core.errors import FiberError

__all__ = ["PlaneError", "PlaneRefusal"]


class PlaneError(FiberError):
    """The focal plane did not do what a client asked for."""


class PlaneRefusal(PlaneError):
    """A node refused a request.

    Args:
        stage: name of the node.
        text: its reason, with robot and value.
    """

    def __init__(self, stage: str, text: str):
        super().__init__(f"{stage}: {text}")
        self.stage, self.text = stage, text

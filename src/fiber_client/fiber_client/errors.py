# SPDX-License-Identifier: Apache-2.0
"""Errors of the clients of the graph."""

from fiber_core.errors import FiberError

__all__ = ["NodeLost", "PlaneError", "PlaneRefusal"]


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


class NodeLost(PlaneError):
    """A node that a plan needs has left the graph: it was ended, or its machine was.

    Args:
        stage: name of the node.
        what: what cannot come any more.
    """

    def __init__(self, stage: str, what: str):
        super().__init__(f"{stage}: the node has left the graph, no {what} will come")
        self.stage, self.what = stage, what

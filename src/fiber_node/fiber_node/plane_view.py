"""What a node knows of the focal plane: its layout and where its robots are."""

import numpy as np
from rclpy.node import Node

from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import joint_states, layout, topics
from fiber_msgs_py.errors import MessageError
from fiber_node.reporter import Reporter

__all__ = ["PlaneView"]


class PlaneView:
    """Follows layout and joint states for a node; malformed messages change nothing.

    Args:
        node: the node that listens.
        report: told of messages refused, and how many robots are known.
    """

    def __init__(self, node: Node, report: Reporter):
        self._report = report
        self._plane = self._units = self._states = None
        topics.LAYOUT.subscription(node, self._on_layout)
        topics.JOINT_STATES.subscription(node, self._on_joint_states)

    def _on_layout(self, message):
        try:
            self._plane, self._units = layout.decode(message)
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}")
        self._tell()

    def _on_joint_states(self, message):
        try:
            self._states = joint_states.decode(message)
        except FiberError as error:
            self._report.refuse(f"joint states refused: {error}")
        self._tell()

    def _tell(self):
        # so that whoever sends targets can know that this node will not refuse them for this
        robots = self._plane.n if self.complete else 0
        if self._report.counters.get("robots") != robots:
            self._report.counters["robots"] = robots
            self._report.publish()

    @property
    def complete(self) -> bool:
        """Whether layout and joint states of the same robots have been heard."""
        if self._plane is None or self._states is None:
            return False
        return np.array_equal(self._states[0], self._plane.ids)

    def _known(self, value):
        if not self.complete:
            missing = "layout" if self._plane is None else "joint states of this layout"
            raise MessageError(missing, "not heard yet")
        return value

    @property
    def plane(self) -> FocalPlane:
        """The focal plane.

        Raises:
            MessageError: not complete yet; so for all properties.
        """
        return self._known(self._plane)

    @property
    def units(self) -> WireUnits:
        """Tick, quantum and field widths of the plane's hardware."""
        return self._known(self._units)

    @property
    def angles(self) -> np.ndarray:
        """Joint angles by the robots' encoders [rad], shape (n, 2)."""
        return self._known(self._states)[1]

    @property
    def moving(self) -> bool:
        """Whether any robot moves."""
        return bool(np.any(self._known(self._states)[2]))

"""What a node knows of the focal plane: its layout and where its robots are."""

from collections.abc import Callable

import numpy as np
from rclpy.node import Node

from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import Attempt, PlanStamp, joint_states, layout, topics
from fiber_msgs_py.errors import MessageError
from fiber_node.reporter import Reporter

__all__ = ["PlaneCache"]


class PlaneCache:
    """Keeps the newest layout and joint states for a node; malformed messages change nothing.

    Topics overtake each other. A later attempt of a plan is about what has changed, and says since
    when: work on it waits until layout and joint states are that new.

    Args:
        node: the node that receives the messages.
        report: publishes refused messages, and how many robots are known.
    """

    def __init__(self, node: Node, report: Reporter):
        self._report = report
        self._plane = self._units = self._states = None
        self._layout_ns = self._states_ns = -1
        self._waiting: tuple[int, Callable[[], None]] | None = None
        topics.LAYOUT.subscription(node, self._on_layout)
        topics.JOINT_STATES.subscription(node, self._on_joint_states)

    def when_current(self, attempt: Attempt, work: Callable[[], None]) -> None:
        """Do work on an attempt as soon as layout and joint states are as new as it needs them.

        The first attempt of a plan needs nothing. One piece of work waits at most: newer work
        takes its place. It waits until something newer is received.

        Args:
            attempt: the attempt.
            work: called once.
        """
        self._waiting = (-1 if attempt.since_ns is None else attempt.since_ns, work)
        self._start_if_current()

    def _start_if_current(self):
        if self._waiting is None or min(self._layout_ns, self._states_ns) < self._waiting[0]:
            return
        (_, work), self._waiting = self._waiting, None
        work()

    def _on_layout(self, message):
        try:
            self._plane, self._units = layout.decode(message)
            self._layout_ns = PlanStamp.of(message).ns
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}")
        self._publish_count()
        self._start_if_current()

    def _on_joint_states(self, message):
        try:
            self._states = joint_states.decode(message)
            self._states_ns = self._states[3]
        except FiberError as error:
            self._report.refuse(f"joint states refused: {error}")
        self._publish_count()
        self._start_if_current()

    def _publish_count(self):
        # a client waits for this count, so that its targets are not refused for want of a plane
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

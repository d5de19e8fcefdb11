"""What a node knows of the focal plane: its layout and where its robots are."""

from collections.abc import Callable

import numpy as np
from rclpy.node import Node

from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import PlanStamp, joint_states, layout, targets, topics
from fiber_msgs_py.errors import MessageError
from fiber_node.reporter import Reporter

__all__ = ["PlaneCache"]


class PlaneCache:
    """Follows layout and joint states for a node; malformed messages change nothing.

    Topics overtake each other. A plan that is tried again is about what has changed, and its
    targets say since when: work on it waits until layout and joint states are that new.

    Args:
        node: the node that listens.
        report: told of messages refused, and how many robots are known.
    """

    def __init__(self, node: Node, report: Reporter):
        self._report = report
        self._plane = self._units = self._states = None
        self._layout_ns = self._states_ns = -1
        self._since: tuple[PlanStamp, int] | None = None  # of the latest plan that tells
        self._waiting: tuple[PlanStamp, Callable[[], None]] | None = None
        topics.LAYOUT.subscription(node, self._on_layout)
        topics.JOINT_STATES.subscription(node, self._on_joint_states)
        topics.TARGETS.subscription(node, self._on_targets)

    def when_new_enough(self, stamp: PlanStamp, work: Callable[[], None]) -> None:
        """Do work on a plan as soon as layout and joint states are as new as it needs them.

        The first attempt of a plan needs nothing. One piece of work waits at most: newer takes
        its place. It waits for as long as nothing newer is heard.
        """
        self._waiting = (stamp, work)
        self._look()

    def _look(self):
        if self._waiting is None or not self._new_enough(self._waiting[0]):
            return
        (_, work), self._waiting = self._waiting, None
        work()

    def _new_enough(self, stamp):
        if stamp.attempt == 1:
            return True
        if self._since is None or self._since[0] < stamp:
            return False  # its targets are on their way
        return min(self._layout_ns, self._states_ns) >= self._since[1]

    def _on_targets(self, message):
        try:
            stamp, since_ns = PlanStamp.of(message), targets.since(message)
        except FiberError:
            return  # the planner says so
        if since_ns is not None and (self._since is None or stamp > self._since[0]):
            self._since = stamp, since_ns
            self._look()

    def _on_layout(self, message):
        try:
            self._plane, self._units = layout.decode(message)
            self._layout_ns = PlanStamp.of(message).ns
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}")
        self._tell()
        self._look()

    def _on_joint_states(self, message):
        try:
            self._states = joint_states.decode(message)
            self._states_ns = self._states[3]
        except FiberError as error:
            self._report.refuse(f"joint states refused: {error}")
        self._tell()
        self._look()

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

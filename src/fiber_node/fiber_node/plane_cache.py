# SPDX-License-Identifier: Apache-2.0
"""The newest layout and joint states of the focal plane, for the nodes that plan with them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import JointState, PointCloud2

from fiber_core.array_types import Angles, Ids, Velocities
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import Attempt, PlanStamp, joint_states, layout, session_of, topics
from fiber_msgs_py.errors import MessageError
from fiber_node.reporter import Reporter
from fiber_node.session_gate import SessionGate

__all__ = ["PlaneCache", "PlaneState"]


class PlaneState(NamedTuple):
    """The focal plane and where its robots are.

    Args:
        plane: the focal plane.
        units: tick, quantum and field widths of its hardware.
        angles: joint angles by the robots' encoders [rad], shape (n, 2).
        moving: whether any robot moves.
        border_skews_s: skews of start and stop that robots of two sectors need [s].
    """

    plane: FocalPlane
    units: WireUnits
    angles: Angles
    moving: bool
    border_skews_s: tuple[float, float]


class PlaneCache:
    """Keeps the newest layout and joint states for a node; malformed messages change nothing.

    Topics overtake each other. The bridge says of each attempt that it accepts how new layout and
    joint states must be: work on it waits until they are. With the layout of a new session all of
    the session before is forgotten.

    Args:
        gate: the gate for messages of open sessions.
        report: publishes refused messages, and how many robots are known.
    """

    def __init__(self, gate: SessionGate, report: Reporter):
        self._report = report
        self._layout: tuple[FocalPlane, WireUnits, tuple[float, float]] | None = None
        self._states: tuple[Ids, Angles, Velocities] | None = None
        self._layout_ns = self._states_ns = -1
        self._states_session: str | None = None
        self._waiting: tuple[Attempt, str, Callable[[], None]] | None = None
        self.session: str | None = None  # of the layout
        gate.subscription(topics.LAYOUT, self._on_layout)
        gate.subscription(topics.JOINT_STATES, self._on_joint_states)

    def when_current(self, attempt: Attempt, session: str, work: Callable[[], None]) -> None:
        """Do work on an attempt as soon as layout and joint states are as new as it needs them.

        One piece of work waits at most: newer work takes its place.

        Args:
            attempt: the attempt.
            session: the session whose layout and joint states it needs.
            work: called once.
        """
        if self._waiting is not None:
            self._report.debug(f"plan {self._waiting[0]} gives way to plan {attempt}")
        self._waiting = attempt, session, work
        self._start_if_current()
        if self._waiting is not None:
            self._report.debug(f"plan {attempt} waits for a newer layout or newer joint states")

    @property
    def complete(self) -> bool:
        """Whether layout and joint states of the same robots have been received."""
        return self._pair() is not None

    @property
    def state(self) -> PlaneState:
        """The newest layout and joint states, as they are at one instant.

        Raises:
            MessageError: layout, or joint states of its robots, have not been received yet.
        """
        pair = self._pair()
        if pair is None:
            missing = "layout" if self._layout is None else "joint states of this layout"
            raise MessageError(missing, "not received yet")
        (plane, units, border_skews_s), (_, angles, velocities) = pair
        return PlaneState(plane, units, angles, bool(np.any(velocities)), border_skews_s)

    def _pair(self):
        layout, states = self._layout, self._states  # a worker reads while callbacks replace
        if layout is None or states is None or self._states_session != self.session:
            return None
        return (layout, states) if np.array_equal(states[0], layout[0].ids) else None

    def _start_if_current(self) -> None:
        if self._waiting is None or self._pair() is None:
            return
        attempt, session, work = self._waiting
        since_ns = -1 if attempt.since_ns is None else attempt.since_ns
        layout_ns = since_ns if attempt.layout_ns is None else attempt.layout_ns
        if self.session != session or self._layout_ns < layout_ns or self._states_ns < since_ns:
            return
        self._waiting = None
        work()

    def _on_layout(self, message: PointCloud2) -> None:
        try:
            found = *layout.decode(message), layout.decode_border_skews(message)
            self._layout, ns = found, PlanStamp.of(message).ns
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}", "layout")
        else:
            self._layout_ns, self.session = ns, session_of(message)
            self._report.session = self.session
        self._publish_count()
        self._start_if_current()

    def _on_joint_states(self, message: JointState) -> None:
        try:
            ids, angles, velocities, self._states_ns = joint_states.decode(message)
        except FiberError as error:
            self._report.refuse(f"joint states refused: {error}", "joint_states")
        else:
            self._states, self._states_session = (ids, angles, velocities), session_of(message)
        self._publish_count()
        self._start_if_current()

    def _publish_count(self) -> None:
        # clients wait for this count: before it, the node would refuse their targets
        pair = self._pair()
        counters = {"robots": 0 if pair is None else pair[0][0].n, "session": self.session or ""}
        if counters.items() - self._report.counters.items():
            if pair is not None:
                self._report.info(f"the plane has come: {pair[0][0].n} robots, of {self.session}")
            self._report.counters |= counters
            self._report.publish()

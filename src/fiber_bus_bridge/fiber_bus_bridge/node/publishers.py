# SPDX-License-Identifier: Apache-2.0
"""The topics that the bridge publishes: layout, encoders, frames, outcomes; and its diagnostics."""

from collections.abc import Iterator

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.frame_log import frame_log
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_core.array_types import Ints, Mask
from fiber_core.outcomes import Reason
from fiber_msgs_py import (
    Level,
    PlanStamp,
    Status,
    frames,
    joint_states,
    layout,
    outcome,
    topics,
)

__all__ = ["Publishers"]

_NAMED = 20  # failed robots, and robots at unknown places, with a line each in the diagnostics
_UNKNOWN = "place unknown"


class Publishers:
    """Publishes the state of a session and the availability of its robots.

    Args:
        node: the node that publishes.
        session: the session with the robots.
        availability: the robots that can be commanded.
        session_id: id of the session, which layout, encoders and outcomes carry.
    """

    def __init__(self, node: Node, session: Session, availability: Availability, session_id: str):
        self._node, self._session, self._availability = node, session, availability
        self._session_id = session_id
        self.layout_ns = 0  # time of the last layout [ns]
        self._layout = topics.LAYOUT.publisher(node)
        self._joint_states = topics.JOINT_STATES.publisher(node)
        self._frames = topics.FRAMES.publisher(node)
        self._outcome = topics.OUTCOME.publisher(node)
        self._last_layout: PointCloud2 | None = None
        # columns `enabled` and `unplaced` of the last layout
        self._published: tuple[Mask, Ints] | None = None

    def now_ns(self) -> int:
        """Return the time of messages [ns]."""
        return self._node.get_clock().now().nanoseconds

    def publish_layout(self, always: bool = False, now_ns: int | None = None) -> None:
        """Publish the layout, then the encoders, if the set of commandable robots has changed.

        Args:
            always: publish even without a change.
            now_ns: time of the messages [ns]; None for the present.
        """
        enabled = self._availability.commandable(self._session.usable)
        robots, published = self._session.robots, self._published
        code = np.select([robots["seen"], robots["recalled"]], [layout.SEEN, layout.RECALLED], 1)
        unplaced = np.where(robots["unplaced"], code, 0)
        if not always and published is not None and np.array_equal((enabled, unplaced), published):
            return
        self._published = enabled, unplaced
        now_ns = self.now_ns() if now_ns is None else now_ns
        plane = self._session.plane.with_enabled(enabled)
        message = layout.encode(
            plane,
            self._session.units,
            PlanStamp(now_ns),
            self._session_id,
            unplaced,
            self._session.border_skews_s,
        )
        self._layout.publish(message)
        self._last_layout = message
        self.layout_ns = now_ns
        self.publish_encoders(now_ns)

    def repeat(self) -> None:
        """Publish the last layout, unchanged, and the encoders again.

        Subscribers with the default quality of service get no message from before they came.
        """
        if self._last_layout is not None:
            self._layout.publish(self._last_layout)
            self.publish_encoders()

    def publish_encoders(self, now_ns: int | None = None) -> None:
        """Publish the readings of the encoders at a time [ns], None for the present."""
        session = self._session
        now_ns = self.now_ns() if now_ns is None else now_ns
        self._joint_states.publish(
            joint_states.encode(
                session.plane.ids, session.angles, session.velocities, now_ns, self._session_id
            )
        )

    def publish_frames(self, stamp: PlanStamp | None) -> None:
        """Publish the bus traffic since the last call, if it is of a plan and has a subscriber."""
        traffic = self._session.transactions.take_traffic()
        if traffic and stamp is not None and self._frames.get_subscription_count() > 0:
            self._frames.publish(frames.encode(frame_log(traffic), stamp))

    def publish_outcome(self, result: PlanResult, stamp: PlanStamp) -> None:
        """Publish the result of each robot of a plan."""
        columns = result.outcome, result.reason, result.error_mm
        ids = self._session.plane.ids
        self._outcome.publish(outcome.encode(ids, *columns, stamp, self._session_id))
        self.publish_encoders()  # tells nodes that have heard the outcome where the robots rest

    def statuses(self) -> Iterator[Status]:
        """Yield the diagnostics of every bus, and of the robots left out of plans."""
        transactions, plane = self._session.transactions, self._session.plane
        for bus, figures in transactions.counters.table().items():
            on_bus = np.flatnonzero(transactions.addresses.bus == bus)
            worst = on_bus[np.argmax(transactions.failures[on_bus])]
            if transactions.failures[worst]:
                named = {"robot": plane.ids[worst], "failures": transactions.failures[worst]}
                figures |= {f"worst_{name}": int(value) for name, value in named.items()}
            figures |= {"given_up": int(transactions.given_up[transactions.places(bus)])}
            bad = sum(figures[n] for n in ("no_address", "refused", "line_errors", "bad_replies"))
            level, text = (Level.WARN, f"{bad} frames failed") if bad else (Level.OK, "good")
            yield Status(f"bridge: bus {bus}", level, text, figures, f"i2c-{bus}")
        yield self._left_out()

    def _left_out(self) -> Status:
        availability, ids = self._availability, self._session.plane.ids
        reasons = {f"robot {robot}": why for robot, why in sorted(availability.disabled.items())}
        unknown, failed = ~self._session.known, availability.failed != Reason.OK
        lost = self._session.robots["lost"]
        text = (
            f"{len(reasons)} disabled by operators, {unknown.sum()} not found, "
            f"{failed.sum()} failed, {lost.sum()} at unknown places"
        )
        rows, further = np.split(np.flatnonzero(failed), [_NAMED])
        for row in rows:
            reasons[f"robot {ids[row]}"] = Reason(availability.failed[row]).name.lower()
        for reason in np.unique(availability.failed[further]):
            these = ids[further[availability.failed[further] == reason]]
            reasons[f"further {Reason(reason).name.lower()}"] = " ".join(map(str, these))
        if self._session.state is not SessionState.MOVING:
            rows, further = np.split(np.flatnonzero(lost), [_NAMED])
            for row in rows:
                before = reasons.get(f"robot {ids[row]}")
                why = f" ({before})" if before else ""
                reasons[f"robot {ids[row]}"] = f"{_UNKNOWN}{why}: its neighbours rest"
            if len(further):
                reasons[f"further {_UNKNOWN}"] = " ".join(map(str, ids[further]))
        level = Level.WARN if unknown.any() or failed.any() else Level.OK
        return Status("bridge: left out", level, text, reasons)

"""What the bridge tells of its plane: layout, encoders, frames, outcomes, state of its buses."""

import numpy as np
from rclpy.node import Node

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.frame_log import frame_log
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.session import Session
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

_NAMED = 20  # robots that failed, in the diagnostics


class Publishers:
    """Publishes what a session and a roster know.

    Args:
        node: the node that publishes.
        session: the session with the robots.
        roster: who can be commanded.
    """

    def __init__(self, node: Node, session: Session, roster: Availability):
        self._node, self._session, self._roster = node, session, roster
        self._layout = topics.LAYOUT.publisher(node)
        self._joint_states = topics.JOINT_STATES.publisher(node)
        self._frames = topics.FRAMES.publisher(node)
        self._outcome = topics.OUTCOME.publisher(node)
        self._told: np.ndarray | None = None  # enabled, as the last layout said

    def now_ns(self) -> int:
        """The time of messages [ns]."""
        return self._node.get_clock().now().nanoseconds

    def plane(self, always: bool = False, now_ns: int | None = None) -> None:
        """Publish the layout, and where everybody is, if it has changed who can be commanded."""
        enabled = self._roster.commandable(self._session.known)
        if not always and np.array_equal(enabled, self._told):
            return
        self._told = enabled
        now_ns = self.now_ns() if now_ns is None else now_ns
        plane = self._session.plane.with_enabled(enabled)
        self._layout.publish(layout.encode(plane, self._session.units, PlanStamp(now_ns)))
        self.state(now_ns)

    def state(self, now_ns: int | None = None) -> None:
        """Publish the encoders' readings."""
        session = self._session
        now_ns = self.now_ns() if now_ns is None else now_ns
        self._joint_states.publish(
            joint_states.encode(session.plane.ids, session.angles, session.velocities, now_ns)
        )

    def frames(self, stamp: PlanStamp | None) -> None:
        """Publish what went over the buses, if it is of a plan and anybody listens."""
        traffic = self._session.link.take_traffic()
        if traffic and stamp is not None and self._frames.get_subscription_count() > 0:
            self._frames.publish(frames.encode(frame_log(traffic), stamp))

    def outcome(self, result: PlanResult, stamp: PlanStamp) -> None:
        """Publish what became of the robots of a plan."""
        columns = result.outcome, result.reason, result.error_mm
        self._outcome.publish(outcome.encode(self._session.plane.ids, *columns, stamp))

    def statuses(self):
        """Yield the diagnostics of every bus, and of the robots that are left out of plans."""
        link, plane = self._session.link, self._session.plane
        for bus, figures in link.counters.table().items():
            here = np.flatnonzero(plane.bus == bus)
            worst = here[np.argmax(link.failures[here])]
            if link.failures[worst]:
                named = {"robot": plane.ids[worst], "failures": link.failures[worst]}
                figures |= {f"worst_{name}": int(value) for name, value in named.items()}
            figures |= {"given_up": int(link.given_up[link.at(bus)])}
            bad = sum(figures[n] for n in ("no_address", "refused", "line_errors", "bad_replies"))
            level, text = (Level.WARN, f"{bad} frames failed") if bad else (Level.OK, "good")
            yield Status(f"bridge: bus {bus}", level, text, figures, f"i2c-{bus}")
        yield self._left_out()

    def _left_out(self):
        roster, ids = self._roster, self._session.plane.ids
        why = {f"robot {robot}": text for robot, text in sorted(roster.disabled.items())}
        unknown, failed = ~self._session.known, roster.failed != Reason.OK
        text = f"{len(why)} disabled by operators, {unknown.sum()} not found, {failed.sum()} failed"
        for row in np.flatnonzero(failed)[:_NAMED]:
            why[f"robot {ids[row]}"] = Reason(roster.failed[row]).name.lower()
        level = Level.WARN if unknown.any() or failed.any() else Level.OK
        return Status("bridge: left out", level, text, why)

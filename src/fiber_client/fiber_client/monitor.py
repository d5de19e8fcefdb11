# SPDX-License-Identifier: Apache-2.0
"""What a client receives from the graph: the plane, its motion, and the plans under way."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState, PointCloud2

from fiber_client.errors import PlaneError, PlaneRefusal
from fiber_core.array_types import Angles, Codes, Counts, Ids
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.outcomes import PlanOutcome
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    AttemptTable,
    MessageError,
    PlanStamp,
    Progress,
    RateLimit,
    diagnostics,
    frames,
    held,
    joint_states,
    layout,
    measured,
    outcome,
    progress,
    session_of,
    targets,
    topics,
)
from fiber_node import SessionGate

__all__ = ["STAGES", "PlaneMonitor"]

STAGES = ("planner", "discretizer", "bridge")  # a plan ends when one of these nodes refuses it

_STAMPS_KEPT = 8  # attempts of one plan count as plans of their own

_FRESH_S = 2.5  # for which diagnostics tell that their node is there

_Entry = TypeVar("_Entry")


class PlaneMonitor:
    """Receives the topics of the graph and keeps the newest state; it sends nothing.

    Of all messages that belong to a session, only those of the bridge that is in the graph count.
    The last eight entries of these tables are kept, by stamp:

    - `outcomes`: the outcome of each plan.
    - `times`: when each stage was done with a plan, by name of the stage [s of the clock];
      "sent" and "ended" are the times of its targets and its outcome.
    - `frames`: the frames on the buses of each attempt of a plan, as they were received.
    - `counts_before`: the encoders before the first frame of each attempt [quanta], shape (n, 2).
    - `held`: the robots that the stages hold, of each attempt: ids, Reason and Stage.

    - `unplaced`: robots whose counters do not tell their places, codes of the layout.
    - `measured`: where the robots are after a plan, by its last image.
    - `refusals`: the refusals of each plan and attempt, by any node.

    `moving` tells whether any robot moves, `session` is the session of the layout, `node` is
    the ROS node that receives.

    Args:
        node: the ROS node that receives.
        on_progress: called with the progress of every stage.
        on_status: called with every diagnostic status, and with the status of the same name that
            was received before, or None.
        clock: returns seconds, for `times`.
    """

    def __init__(
        self,
        node: Node,
        on_progress: Callable[[Progress], None],
        on_status: Callable[[diagnostics.Status, diagnostics.Status | None], None],
        clock: Callable[[], float],
    ):
        self.node = node
        self._on_progress, self._on_status, self._clock = on_progress, on_status, clock
        self.outcomes: dict[PlanStamp, PlanOutcome] = {}
        self.times: dict[PlanStamp, dict[str, float]] = {}
        self.frames: dict[PlanStamp, list[FrameLog]] = {}
        self.counts_before: dict[PlanStamp, Counts] = {}
        self.held: dict[PlanStamp, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
        self.unplaced: Codes = np.zeros(0, dtype=np.int64)
        self.measured: dict[PlanStamp, measured.Measured] = {}
        self.moving = False
        self._layout: tuple[FocalPlane, WireUnits] | None = None
        self._states: tuple[Ids, Angles] | None = None
        self._states_session: str | None = None
        self._angles_at_rest: Angles | None = None  # when last no robot moved
        self._attempts = AttemptTable()
        self._statuses: dict[str, diagnostics.Status] = {}
        self._heard_s: dict[str, float] = {}
        self.refusals: dict[PlanStamp, list[PlaneRefusal]] = {}
        self.session: str | None = None
        self._limit = RateLimit()
        gate = SessionGate(node, lambda topic, text, _: self._warn(topic, text))
        for topic, callback in (
            (topics.LAYOUT, self._on_layout),
            (topics.JOINT_STATES, self._on_joint_states),
            (topics.OUTCOME, self._on_outcome),
            (topics.MEASURED, self._on_measured),
        ):
            gate.subscription(topic, self._refusing(topic.name, callback))
        for topic, callback in (
            (topics.TARGETS, self._on_targets),
            (topics.HELD_BY_PLANNER, self._on_held),
            (topics.HELD_BY_DISCRETIZER, self._on_held),
            (topics.FRAMES, self._on_frames),
            (topics.PROGRESS, self._on_progress_message),
            # last: when diagnostics of a node come in, its other topics are connected too
            (topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            topic.subscription(self.node, self._refusing(topic.name, callback))

    def _refusing(self, topic: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback that logs why a message was refused; the state stays as it was."""

        def receive(message: Any) -> None:
            try:
                callback(message)
            except FiberError as error:
                self._warn(topic, f"{topic}: message refused: {error}")

        return receive

    def _warn(self, topic: str, text: str) -> None:
        line = self._limit.line(topic, text)
        if line is not None:
            self.node.get_logger().warning(line)

    @property
    def plane(self) -> FocalPlane:
        """The focal plane; its `enabled` tells which robots can be commanded.

        Raises:
            PlaneError: no layout received yet; wait for the graph first.
        """
        return self._received_layout()[0]

    @property
    def units(self) -> WireUnits:
        """Tick and quantum of the hardware.

        Raises:
            PlaneError: no layout received yet; wait for the graph first.
        """
        return self._received_layout()[1]

    @property
    def angles(self) -> Angles:
        """Joint angles by the robots' encoders [rad], shape (n, 2).

        Raises:
            PlaneError: none received yet, or they are of other robots than the layout.
        """
        states = self.states_of_layout()
        if states is None:
            raise PlaneError("no joint states of this layout received yet: wait for the graph")
        return states

    @property
    def statuses(self) -> dict[str, diagnostics.Status]:
        """The newest diagnostics by name, of the nodes that are in the graph.

        A node that was paused for longer than its lease is in the graph without its name, and is
        known by its diagnostics, which come each second.
        """
        found = self.node.get_node_names_and_namespaces()
        present = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found}
        # the status of a role tells the name of its node
        roles = {
            name for name, each in self._statuses.items() if each.values.get("node") in present
        }
        return {
            name: status
            for name, status in self._statuses.items()
            if name.partition(":")[0] in roles or self._heard_s[name] > self._clock() - _FRESH_S
        }

    def attempts(self, stamp: PlanStamp) -> list[PlanStamp]:
        """Return the stamps of all attempts of a plan in their order; the first is the plan's."""
        return [attempt.stamp for attempt in self._attempts.of_plan(stamp)]

    def last_attempt(self, stamp: PlanStamp) -> PlanStamp:
        """Return the stamp of the last attempt of a plan with frames, else that of the plan."""
        return max(set(self.attempts(stamp)) & set(self.frames), default=stamp)

    def _times_of(self, plan: PlanStamp) -> dict[str, float]:
        return _entry(self.times, plan, dict)

    def now_ns(self) -> int:
        """Return the time of the node's clock [ns]; 0 while it waits for a simulated one."""
        return self.node.get_clock().now().nanoseconds

    def _received_layout(self) -> tuple[FocalPlane, WireUnits]:
        if self._layout is None:
            raise PlaneError("no layout received yet: wait for the graph")
        return self._layout

    @property
    def has_layout(self) -> bool:
        """Whether a layout has been received."""
        return self._layout is not None

    def states_of_layout(self) -> Angles | None:
        """Return the joint angles of the robots of the layout, None before both have come."""
        if self._layout is None or self._states is None:
            return None
        ids, angles = self._states
        if self._states_session != self.session:
            return None
        return angles if np.array_equal(ids, self._layout[0].ids) else None

    def _has_unannounced_frames(self, plan: PlanStamp) -> bool:
        # frames can overtake the targets and the progress that tell which plan they belong to
        return any(each > plan and self._attempts.find(each) is None for each in self.frames)

    def _on_layout(self, message: PointCloud2) -> None:
        self._layout, self.unplaced = layout.decode(message), layout.decode_unplaced(message)
        self.session = session_of(message)

    def _on_targets(self, message: PointCloud2) -> None:
        try:
            self._attempts.add(targets.decode_attempt(message))
        except MessageError:
            pass  # the planner refuses them

    def _on_joint_states(self, message: JointState) -> None:
        ids, angles, velocities, _ = joint_states.decode(message)
        self._states, self.moving = (ids, angles), bool(np.any(velocities))
        self._states_session = session_of(message)
        if not self.moving:
            self._angles_at_rest = angles

    def _on_held(self, message: PointCloud2) -> None:
        robots = held.decode(message)
        _entry(self.held, PlanStamp.of(message), list).append(robots)

    def _on_frames(self, message: PointCloud2) -> None:
        log = frames.decode(message)
        stamp, at_rest = PlanStamp.of(message), self._angles_at_rest
        if stamp not in self.counts_before and at_rest is not None and self._layout is not None:
            _entry(self.counts_before, stamp, lambda: self.units.to_counts(at_rest))
        _entry(self.frames, stamp, list).append(log)

    def _on_outcome(self, message: PointCloud2) -> None:
        stamp = PlanStamp.of(message)
        _entry(self.outcomes, stamp, lambda: PlanOutcome(stamp.ns, *outcome.decode(message)))
        _entry(self.times, stamp, dict).setdefault("ended", self._clock())

    def _on_measured(self, message: PointCloud2) -> None:
        stamp, table = PlanStamp.of(message), measured.decode(message)
        _entry(self.measured, stamp, lambda: table)
        self.measured[stamp] = table

    def _on_progress_message(self, message: DiagnosticStatus) -> None:
        received = progress.decode(message)
        self._attempts.add(received.attempt)
        plan = received.attempt.plan
        if received.refused:
            refusal = PlaneRefusal(received.stage, received.text)
            for stamp in {received.attempt.stamp, plan}:
                _entry(self.refusals, stamp, list).append(refusal)
        elif received.fraction == 1.0 or (received.stage == "bridge" and received.fraction > 0):
            times = _entry(self.times, plan, dict)
            times.setdefault(received.stage, self._clock())
        self._on_progress(received)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for received in diagnostics.decode(message):
            status = received.of_namespace(self.node.get_namespace())
            if status is None:
                continue  # of another plane
            before = self._statuses.get(status.name)
            self._statuses[status.name] = status
            self._heard_s[status.name] = self._clock()
            self._on_status(status, before)


def _entry(table: dict[PlanStamp, _Entry], stamp: PlanStamp, make: Callable[[], _Entry]) -> _Entry:
    """Return the entry of a stamp, made when there is none; the oldest entries are forgotten."""
    if stamp not in table:
        table[stamp] = make()
        for old in list(table)[:-_STAMPS_KEPT]:
            del table[old]
    return table[stamp]

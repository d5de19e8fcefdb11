"""A client of the focal-plane graph: it sends targets, follows the plan, and reads the outcome."""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import ArrayLike
from rclpy.node import Node
from sensor_msgs.msg import JointState, PointCloud2

from fiber_client.errors import PlaneError, PlaneRefusal
from fiber_core.array_types import Angles, Counts, Ids
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.outcomes import PlanOutcome
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    AttemptTable,
    MessageError,
    PlanStamp,
    Progress,
    Service,
    Topic,
    diagnostics,
    frames,
    held,
    joint_states,
    layout,
    outcome,
    progress,
    targets,
    topics,
)
from fiber_node import RosClient

__all__ = ["PlaneClient"]

_STAGES = ("planner", "discretizer", "bridge")
_TARGET_RECEIVERS = ("planner", "discretizer", "bridge")
_STAMPS_KEPT = 8  # attempts of one plan count as plans of their own

_Entry = TypeVar("_Entry")


class PlaneClient:
    """Talks to the graph through its topics and services only, as an observatory would.

    One plan takes four calls: `send_targets`, `wait_until_ready`, `start`, `wait_for_outcome`.
    The client receives messages while it waits, and only then. Every wait ends: with what it
    waits for, with a PlaneRefusal when a node refuses the plan, or with a WaitError after its
    time-out.

    The newest eight entries of these tables are kept, by stamp:

    - `outcomes`: the outcome of each plan.
    - `times`: when each stage was done with a plan, by name of the stage [s of the clock];
      "sent" and "ended" are the times of its targets and its outcome.
    - `frames`: the frames on the buses of each attempt of a plan, as they were received.
    - `counts_before`: the encoders before the first frame of each attempt [quanta], shape (n, 2).
    - `held`: the robots that the stages hold, of each attempt: ids, Reason and Stage.

    Args:
        domain: ROS domain of the graph; by default the domain of the environment.
        on_progress: called with the progress of every stage.
        on_status: called with every diagnostic status, and with the status of the same name that
            was received before, or None.
        guard: called again and again while the client waits; it ends the wait by raising.
        clock: returns seconds, for time-outs and for `times`.
    """

    def __init__(
        self,
        domain: int | None = None,
        on_progress: Callable[[Progress], None] = lambda _: None,
        on_status: Callable[[diagnostics.Status, diagnostics.Status | None], None] = (
            lambda _, before: None
        ),
        guard: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._on_progress, self._on_status, self._clock = on_progress, on_status, clock
        self._ros = RosClient("plane_client", domain, guard, clock)
        self.outcomes: dict[PlanStamp, PlanOutcome] = {}
        self.times: dict[PlanStamp, dict[str, float]] = {}
        self.frames: dict[PlanStamp, list[FrameLog]] = {}
        self.counts_before: dict[PlanStamp, Counts] = {}
        self.held: dict[PlanStamp, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
        self.moving = False
        self._layout: tuple[FocalPlane, WireUnits] | None = None
        self._states: tuple[Ids, Angles] | None = None
        self._angles_at_rest: Angles | None = None  # when last no robot moved
        self._attempts = AttemptTable()
        self._statuses: dict[str, diagnostics.Status] = {}
        self._refusals: list[PlaneRefusal] = []  # since targets were last sent
        self._sent: PlanStamp | None = None  # the time of that

        self._targets = topics.TARGETS.publisher(self.node)
        self._services = {
            service: service.client(self.node)
            for service in (
                topics.START, topics.STOP, topics.HOME, topics.CLEAR, topics.CONFIGURE
            )
        }  # fmt: skip
        for topic, callback in (
            (topics.LAYOUT, self._on_layout),
            (topics.TARGETS, self._on_targets),
            (topics.JOINT_STATES, self._on_joint_states),
            (topics.HELD_BY_PLANNER, self._on_held),
            (topics.HELD_BY_DISCRETIZER, self._on_held),
            (topics.FRAMES, self._on_frames),
            (topics.OUTCOME, self._on_outcome),
            (topics.PROGRESS, self._on_progress_message),
            # last: when diagnostics of a node come in, its other topics are connected too
            (topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            topic.subscription(self.node, callback)

    def __enter__(self) -> "PlaneClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._ros.close()

    # --- one plan ------------------------------------------------------------

    def wait_for_graph(self, timeout_s: float, also: Sequence[str] = ()) -> None:
        """Wait until planner, discretizer and bridge know the plane and can be reached.

        Args:
            timeout_s: time-out for all of it [s].
            also: names of other nodes that must be there and receive targets, such as "recorder".

        Raises:
            WaitError: names what was missing.
        """
        missing = partial(self._missing, also)
        self.wait_for(lambda: not missing(), timeout_s, lambda: ", ".join(missing()))

    def send_targets(self, ids: ArrayLike, xy_mm: ArrayLike) -> PlanStamp:
        """Send targets for the fibres of some robots; planning begins at once.

        Args:
            ids: robot ids, shape (k,).
            xy_mm: targets in the focal plane [mm], shape (k, 2).

        Returns:
            The stamp that names the plan.

        Raises:
            MessageError: the table is malformed and was not sent; names robot and value.
        """
        now = PlanStamp(self.node.get_clock().now().nanoseconds)
        return self.send_message(targets.encode(ids, xy_mm, now))

    def send_message(self, message: PointCloud2) -> PlanStamp:
        """Send a targets message as it is; return its stamp, which names the plan."""
        stamp = PlanStamp.of(message)
        self._refusals.clear()
        self._sent = PlanStamp(self.node.get_clock().now().nanoseconds)
        _entry(self.times, stamp, dict)["sent"] = self._clock()
        self._targets.publish(message)
        return stamp

    def wait_until_ready(self, stamp: PlanStamp, timeout_s: float) -> None:
        """Wait until the bridge has the orders of a plan, so that it can be started.

        Args:
            stamp: names the plan.
            timeout_s: time-out [s].

        Raises:
            PlaneRefusal: a node refused the plan; gives its reason.
            WaitError: no orders came.
        """
        times = _entry(self.times, stamp, dict)

        def ready() -> bool:
            if self._refusals:
                raise self._refusals[0]
            return "bridge" in times

        self.wait_for(ready, timeout_s, f"orders of plan {stamp}")

    def start(self, timeout_s: float) -> str:
        """Start the plan that is ready: load, verify, go. Return the answer of the bridge.

        Raises:
            PlaneRefusal: the bridge refused; gives its reason.
            WaitError: no answer.
        """
        return self.call_service(topics.START, timeout_s)

    def wait_for_outcome(self, stamp: PlanStamp, timeout_s: float) -> PlanOutcome:
        """Wait until a plan has ended, with all its attempts.

        Args:
            stamp: names the plan.
            timeout_s: time-out [s].

        Returns:
            The outcome of every robot.

        Raises:
            WaitError: the plan did not end.
        """
        self.wait_for(
            lambda: stamp in self.outcomes and not self._has_unannounced_frames(stamp),
            timeout_s,
            f"outcome of plan {stamp}",
        )
        return self.outcomes[stamp]

    def reconfigure(self, ids: ArrayLike, xy_mm: ArrayLike, timeout_s: float) -> PlanOutcome:
        """Carry out one plan: send targets, wait for the orders, start, wait for the outcome.

        Args:
            ids: robot ids, shape (k,).
            xy_mm: targets in the focal plane [mm], shape (k, 2).
            timeout_s: time-out of each of the four steps [s].

        Returns:
            The outcome of every robot.

        Raises:
            MessageError, PlaneRefusal, WaitError: as in the four steps.
        """
        stamp = self.send_targets(ids, xy_mm)
        self.wait_until_ready(stamp, timeout_s)
        self.start(timeout_s)
        return self.wait_for_outcome(stamp, timeout_s)

    def wait_for_recording(self, stamp: PlanStamp, timeout_s: float) -> None:
        """Wait until a recorder in the graph has written the recording of a plan.

        Args:
            stamp: names the plan.
            timeout_s: time-out [s].

        Raises:
            PlaneRefusal: the recorder could not write it; gives its reason.
            WaitError: no recording was written.
        """
        times = _entry(self.times, stamp, dict)

        def written() -> bool:
            status = self._statuses.get("recorder")
            if status is not None and status.level is diagnostics.Level.ERROR:
                raise PlaneRefusal("recorder", status.text)
            return "recorder" in times

        self.wait_for(written, timeout_s, f"recording of plan {stamp}")

    def attempts(self, stamp: PlanStamp) -> list[PlanStamp]:
        """Return the stamps of all attempts of a plan in their order; the first is the plan's."""
        return [attempt.stamp for attempt in self._attempts.of_plan(stamp)]

    def last_attempt(self, stamp: PlanStamp) -> PlanStamp:
        """Return the stamp of the last attempt of a plan with frames, else that of the plan."""
        return max(set(self.attempts(stamp)) & set(self.frames), default=stamp)

    # --- services ------------------------------------------------------------

    def home(self, timeout_s: float) -> PlanOutcome:
        """Fold all robots that can be folded; return the outcome of every robot.

        Raises:
            PlaneRefusal: the bridge refused; gives its reason.
            WaitError: no answer, or the motion did not end.
        """
        before = set(self.outcomes)
        self.call_service(topics.HOME, timeout_s)
        self.wait_for(lambda: set(self.outcomes) - before, timeout_s, "outcome of home")
        return self.outcomes[max(set(self.outcomes) - before)]

    def call_service(self, service: Service, timeout_s: float) -> str:
        """Call a service of the bridge, such as `fiber_msgs_py.topics.STOP`; return its answer.

        Raises:
            PlaneRefusal: the bridge refused; gives its reason.
            WaitError: no answer.
        """
        client = self._services[service]
        self.wait_for(client.service_is_ready, timeout_s, f"service {service.name}")
        future = client.call_async(service.type.Request())
        self.wait_for(future.done, timeout_s, f"answer of {service.name}")
        answer = future.result()
        if answer is None:
            raise PlaneError(f"service {service.name} gave no answer")
        if not answer.success:
            raise PlaneRefusal("bridge", answer.message)
        return answer.message

    # --- the plane as it is --------------------------------------------------

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
        states = self._states_of_layout()
        if states is None:
            raise PlaneError("no joint states of this layout received yet: wait for the graph")
        return states

    @property
    def statuses(self) -> dict[str, diagnostics.Status]:
        """The newest diagnostics by name."""
        return dict(self._statuses)

    # --- for anything else ---------------------------------------------------

    @property
    def node(self) -> Node:
        """The ROS node of the client, for further topics and services."""
        return self._ros.node

    def collect(self, topic: Topic) -> list[Any]:
        """Subscribe to a topic; return a list that grows by every message received."""
        return self._ros.collect(topic)

    def wait_for(
        self,
        condition: Callable[[], object],
        timeout_s: float,
        what: str | Callable[[], str] = "what was waited for",
    ) -> None:
        """Receive messages until a condition holds.

        Args:
            condition: evaluated after every message.
            timeout_s: time-out [s].
            what: names what is waited for, in the error.

        Raises:
            WaitError: the condition did not hold in time.
        """
        self._ros.wait_for(condition, timeout_s, what)

    # --- messages ------------------------------------------------------------

    def _received_layout(self) -> tuple[FocalPlane, WireUnits]:
        if self._layout is None:
            raise PlaneError("no layout received yet: wait for the graph")
        return self._layout

    def _states_of_layout(self) -> Angles | None:
        if self._layout is None or self._states is None:
            return None
        ids, angles = self._states
        return angles if np.array_equal(ids, self._layout[0].ids) else None

    def _missing(self, also: Sequence[str]) -> list[str]:
        return list(self._iterate_missing(also))

    def _iterate_missing(self, also: Sequence[str]) -> Iterator[str]:
        for service, client in self._services.items():
            if not client.service_is_ready():
                yield service.name
        if self._states_of_layout() is None:
            yield "layout" if self._layout is None else "joint_states"
            return
        for stage in _STAGES:
            status = self._statuses.get(stage)
            if status is None:
                yield f"diagnostics of {stage}"
            elif stage != "bridge" and status.values.get("robots") != str(self.plane.n):
                yield f"{stage} to know the plane"
        for name in also:
            if name not in self._statuses:
                yield f"diagnostics of {name}"
        # other nodes may subscribe too, so a count alone would not tell that these do
        found = self.node.get_subscriptions_info_by_topic(self._targets.topic_name)
        if self._targets.get_subscription_count() < len(found):
            yield "a connection to every subscription of targets"
            return
        names = {info.node_name for info in found}
        for name in (*_TARGET_RECEIVERS, *also):
            if name not in names:
                yield f"{name} to subscribe to targets"

    def _has_unannounced_frames(self, plan: PlanStamp) -> bool:
        # frames can overtake the targets and the progress that tell which plan they belong to
        return any(each > plan and self._attempts.find(each) is None for each in self.frames)

    def _on_layout(self, message: PointCloud2) -> None:
        self._layout = layout.decode(message)

    def _on_targets(self, message: PointCloud2) -> None:
        try:
            self._attempts.add(targets.decode_attempt(message))
        except MessageError:
            pass  # the planner refuses them

    def _on_joint_states(self, message: JointState) -> None:
        ids, angles, velocities, _ = joint_states.decode(message)
        self._states, self.moving = (ids, angles), bool(np.any(velocities))
        if not self.moving:
            self._angles_at_rest = angles

    def _on_held(self, message: PointCloud2) -> None:
        _entry(self.held, PlanStamp.of(message), list).append(held.decode(message))

    def _on_frames(self, message: PointCloud2) -> None:
        stamp, at_rest = PlanStamp.of(message), self._angles_at_rest
        if stamp not in self.counts_before and at_rest is not None and self._layout is not None:
            _entry(self.counts_before, stamp, lambda: self.units.to_counts(at_rest))
        _entry(self.frames, stamp, list).append(frames.decode(message))

    def _on_outcome(self, message: PointCloud2) -> None:
        stamp = PlanStamp.of(message)
        _entry(self.outcomes, stamp, lambda: PlanOutcome(stamp.ns, *outcome.decode(message)))
        _entry(self.times, stamp, dict).setdefault("ended", self._clock())

    def _on_progress_message(self, message: DiagnosticStatus) -> None:
        received = progress.decode(message)
        self._attempts.add(received.attempt)
        if received.fraction == 1.0 or received.stage == "bridge":
            times = _entry(self.times, received.attempt.plan, dict)
            times.setdefault(received.stage, self._clock())
        self._on_progress(received)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        # the report of an earlier refusal may come late, after new targets were sent
        recent = self._sent is not None and PlanStamp.of(message) >= self._sent
        for status in diagnostics.decode(message):
            before = self._statuses.get(status.name)
            if recent and before is not None and _refused(status) > _refused(before):
                self._refusals.append(PlaneRefusal(status.name, status.text))
            self._statuses[status.name] = status
            self._on_status(status, before)


def _entry(table: dict[PlanStamp, _Entry], stamp: PlanStamp, make: Callable[[], _Entry]) -> _Entry:
    """Return the entry of a stamp, made when there is none; the oldest stamps are forgotten."""
    if stamp not in table:
        table[stamp] = make()
        for old in sorted(table)[:-_STAMPS_KEPT]:
            del table[old]
    return table[stamp] if stamp in table else make()


def _refused(status: diagnostics.Status) -> int:
    return sum(int(str(status.values.get(name, 0))) for name in ("refused", "dropped"))

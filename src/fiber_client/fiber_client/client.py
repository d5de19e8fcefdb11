"""A focal plane seen from outside: send targets, follow, start, learn what became of them."""

import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from fiber_client.errors import PlaneError, PlaneRefusal
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
_LISTENERS = ("planner", "bridge")
_PLANS_KEPT = 8  # attempts of one count as plans of their own


class PlaneClient:
    """Talks to a graph as an observatory would: through its topics and services only.

    It listens while it waits, and only then. Every wait ends: with what was waited for,
    with the refusal of a node, or after its time-out with a WaitError. `frames`, `held` and
    `before`, the encoders before the first frame [quanta], are kept of each attempt of a plan;
    `ends` and `times` of the plan.

    Args:
        domain: ROS domain of the graph; by default that of the environment.
        on_progress: told of all progress heard.
        on_status: told of every status heard, with the one of that name before it, or None.
        guard: called over and over while waiting; ends the wait by raising.
        clock: seconds, for time-outs and for `times`.
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
        self._peer = RosClient("plane_client", domain, guard, clock)
        self.plane: FocalPlane | None = None
        self.units: WireUnits | None = None
        self.moving = False
        self.frames: dict[PlanStamp, list[FrameLog]] = {}
        self.before: dict[PlanStamp, np.ndarray] = {}
        self.held: dict[PlanStamp, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
        self.ends: dict[PlanStamp, PlanOutcome] = {}
        self.times: dict[PlanStamp, dict[str, float]] = {}
        self._attempts = AttemptTable()
        self._states: tuple[np.ndarray, np.ndarray] | None = None
        self._rest: np.ndarray | None = None  # angles when last nothing moved
        self._statuses: dict[str, diagnostics.Status] = {}
        self._refusals: list[PlaneRefusal] = []  # since targets were last sent
        self._asked: PlanStamp | None = None  # when that was

        self._targets = topics.TARGETS.publisher(self.node)
        self._services = {
            service: service.client(self.node)
            for service in (
                topics.START, topics.STOP, topics.HOME, topics.CLEAR, topics.CONFIGURE
            )
        }  # fmt: skip
        for topic, heard in (
            (topics.LAYOUT, self._on_layout),
            (topics.TARGETS, self._on_targets),
            (topics.JOINT_STATES, self._on_joint_states),
            (topics.HELD_BY_PLANNER, self._on_held),
            (topics.HELD_BY_DISCRETIZER, self._on_held),
            (topics.FRAMES, self._on_frames),
            (topics.OUTCOME, self._on_outcome),
            (topics.PROGRESS, self._on_progress_message),
            # last: a node that is heard here has heard of all the others
            (topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            topic.subscription(self.node, heard)

    def __enter__(self) -> "PlaneClient":
        return self

    def __exit__(self, *_):
        self.close()

    @property
    def node(self) -> Node:
        """The node it speaks through, for whatever else is to be heard or said."""
        return self._peer.node

    def close(self) -> None:
        """Leave the graph."""
        self._peer.close()

    # --- what is asked -------------------------------------------------------

    def wait_for_graph(self, timeout_s: float, also: Sequence[str] = ()) -> None:
        """Wait until all three stages know the plane and can be reached.

        Args:
            timeout_s: for all of it [s].
            also: other nodes that must be there and listen to targets, as "recorder".

        Raises:
            WaitError: names what was missing.
        """
        missing = partial(self._missing, also)
        self.until(lambda: not missing(), timeout_s, lambda: ", ".join(missing()))

    def send(self, ids, xy_mm) -> PlanStamp:
        """Ask robots to bring their fibres somewhere; return the name of the plan.

        Args:
            ids: robot ids, shape (k,).
            xy_mm: targets in the focal plane [mm], shape (k, 2).

        Raises:
            MessageError: the table is malformed, so it was not sent.
        """
        now = PlanStamp(self.node.get_clock().now().nanoseconds)
        return self.publish(targets.encode(ids, xy_mm, now))

    def publish(self, message: PointCloud2) -> PlanStamp:
        """Send a targets message as it is; return its stamp."""
        stamp = PlanStamp.of(message)
        self._refusals.clear()
        self._asked = PlanStamp(self.node.get_clock().now().nanoseconds)
        self._of(self.times, stamp, dict)["sent"] = self._clock()
        self._targets.publish(message)
        return stamp

    def wait_ready(self, stamp: PlanStamp, timeout_s: float) -> None:
        """Wait until the bridge has the orders of a plan and could start it.

        Raises:
            PlaneRefusal: a node refused the plan.
            WaitError: no orders came.
        """
        known = self._of(self.times, stamp, dict)

        def ready():
            if self._refusals:
                raise self._refusals[0]
            return "bridge" in known

        self.until(ready, timeout_s, f"orders of plan {stamp}")

    def call(self, service: Service, timeout_s: float) -> str:
        """Call a service of the bridge; return what it answered.

        Raises:
            PlaneRefusal: the bridge refused, with its reason.
            WaitError: no answer.
        """
        client = self._services[service]
        self.until(client.service_is_ready, timeout_s, f"service {service.name}")
        future = client.call_async(service.type.Request())
        self.until(future.done, timeout_s, f"answer of {service.name}")
        answer = future.result()
        if not answer.success:
            raise PlaneRefusal("bridge", answer.message)
        return answer.message

    def start(self, timeout_s: float) -> str:
        """Start the orders that wait; return what the bridge answered."""
        return self.call(topics.START, timeout_s)

    def wait_end(self, stamp: PlanStamp, timeout_s: float) -> PlanOutcome:
        """Wait until a plan has ended; return what became of its robots.

        Raises:
            WaitError: it did not end.
        """
        self.until(
            lambda: stamp in self.ends and not self._unannounced(stamp),
            timeout_s,
            f"outcome of plan {stamp}",
        )
        return self.ends[stamp]

    def attempts(self, stamp: PlanStamp) -> list[PlanStamp]:
        """Return the stamps of all attempts of a plan, in their order; the first is the plan's."""
        return [attempt.stamp for attempt in self._attempts.of_plan(stamp)]

    def last_attempt(self, stamp: PlanStamp) -> PlanStamp:
        """Return the last attempt of a plan of which frames were received, else the first."""
        return max(set(self.attempts(stamp)) & set(self.frames), default=stamp)

    def _unannounced(self, plan):
        # frames can overtake the targets and the progress that tell which plan they belong to
        return any(each > plan and self._attempts.find(each) is None for each in self.frames)

    def wait_recording(self, stamp: PlanStamp, timeout_s: float) -> None:
        """Wait until a recorder of the graph has written the recording of a plan.

        Raises:
            PlaneRefusal: it could not.
            WaitError: it did not.
        """
        known = self._of(self.times, stamp, dict)

        def written():
            status = self._statuses.get("recorder")
            if status is not None and status.level is diagnostics.Level.ERROR:
                raise PlaneRefusal("recorder", status.text)
            return "recorder" in known

        self.until(written, timeout_s, f"recording of plan {stamp}")

    def home(self, timeout_s: float) -> PlanOutcome:
        """Fold the robots that can be; return what became of all.

        Raises:
            PlaneRefusal: the bridge refused.
            WaitError: no answer, or it did not end.
        """
        known = set(self.ends)
        self.call(topics.HOME, timeout_s)
        self.until(lambda: set(self.ends) - known, timeout_s, "outcome of home")
        return self.ends[max(set(self.ends) - known)]

    def reconfigure(self, ids, xy_mm, timeout_s: float) -> PlanOutcome:
        """Send targets, wait for the orders, start them, wait for the end.

        Args:
            ids: robot ids, shape (k,).
            xy_mm: targets in the focal plane [mm], shape (k, 2).
            timeout_s: of each of these [s].

        Raises:
            MessageError, PlaneRefusal, WaitError: as the four calls do.
        """
        stamp = self.send(ids, xy_mm)
        self.wait_ready(stamp, timeout_s)
        self.start(timeout_s)
        return self.wait_end(stamp, timeout_s)

    def hear(self, topic: Topic) -> list:
        """Return a list to which every message of a topic is added from now on."""
        return self._peer.hear(topic)

    def until(self, condition: Callable[[], object], timeout_s: float, what="it") -> None:
        """Listen until a condition holds; see fiber_node.RosClient.until."""
        self._peer.until(condition, timeout_s, what)

    # --- what is heard -------------------------------------------------------

    @property
    def angles(self) -> np.ndarray:
        """Joint angles by the robots' encoders [rad], shape (n, 2).

        Raises:
            PlaneError: none heard yet, or of other robots than the layout's.
        """
        if not self._complete():
            raise PlaneError("no joint states of this layout heard yet")
        return self._states[1]

    @property
    def statuses(self) -> dict[str, diagnostics.Status]:
        """Latest diagnostics by name."""
        return dict(self._statuses)

    def _complete(self):
        known = self.plane is not None and self._states is not None
        return known and np.array_equal(self._states[0], self.plane.ids)

    def _missing(self, also):
        missing = [s.name for s, c in self._services.items() if not c.service_is_ready()]
        if not self._complete():
            return missing + ["layout" if self.plane is None else "joint_states"]
        for stage in _STAGES:
            status = self._statuses.get(stage)
            if status is None:
                missing.append(f"diagnostics of {stage}")
            elif stage != "bridge" and status.values.get("robots") != str(self.plane.n):
                missing.append(f"{stage} to know the plane")
        missing += [f"diagnostics of {name}" for name in also if name not in self._statuses]
        return missing + [f"{name} to listen to targets" for name in self._deaf(also)]

    def _deaf(self, also):
        # others may listen too, so counting alone would not tell that these two do
        found = self.node.get_subscriptions_info_by_topic(self._targets.topic_name)
        names = {info.node_name for info in found}
        if self._targets.get_subscription_count() < len(found):
            return ["everybody known"]
        return [name for name in (*_LISTENERS, *also) if name not in names]

    def _on_layout(self, message):
        self.plane, self.units = layout.decode(message)

    def _on_targets(self, message):
        try:
            self._attempts.add(targets.decode_attempt(message))
        except MessageError:
            pass  # the planner refuses them

    def _on_joint_states(self, message):
        ids, angles, velocities, _ = joint_states.decode(message)
        self._states, self.moving = (ids, angles), bool(np.any(velocities))
        if not self.moving:
            self._rest = angles

    def _on_held(self, message):
        self._of(self.held, PlanStamp.of(message), list).append(held.decode(message))

    def _on_frames(self, message):
        stamp = PlanStamp.of(message)
        if stamp not in self.before and self._rest is not None and self.units is not None:
            self._of(self.before, stamp, lambda: self.units.to_counts(self._rest))
        self._of(self.frames, stamp, list).append(frames.decode(message))

    def _on_outcome(self, message):
        stamp = PlanStamp.of(message)
        self._of(self.ends, stamp, lambda: PlanOutcome(stamp.ns, *outcome.decode(message)))
        self._of(self.times, stamp, dict).setdefault("ended", self._clock())

    def _on_progress_message(self, message):
        heard = progress.decode(message)
        self._attempts.add(heard.attempt)
        if heard.fraction == 1.0 or heard.stage == "bridge":
            self._of(self.times, heard.attempt.plan, dict).setdefault(heard.stage, self._clock())
        self._on_progress(heard)

    def _on_diagnostics(self, message):
        # word of an earlier refusal may come late, after new targets were sent
        recent = self._asked is not None and PlanStamp.of(message) >= self._asked
        for status in diagnostics.decode(message):
            before = self._statuses.get(status.name)
            if recent and before is not None and _refused(status) > _refused(before):
                self._refusals.append(PlaneRefusal(status.name, status.text))
            self._statuses[status.name] = status
            self._on_status(status, before)

    @staticmethod
    def _of(table, stamp, make):
        # the entry of a plan, made when there is none; the oldest plans are forgotten
        if stamp not in table:
            table[stamp] = make()
            for old in sorted(table)[:-_PLANS_KEPT]:
                del table[old]
        return table[stamp] if stamp in table else make()


def _refused(status) -> int:
    return sum(int(status.values.get(name, 0)) for name in ("refused", "dropped"))

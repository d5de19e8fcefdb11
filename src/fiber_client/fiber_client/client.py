# SPDX-License-Identifier: Apache-2.0
"""A client of the focal-plane graph: it sends targets, starts the plan, and reads the outcome."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from numpy.typing import ArrayLike
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import PointCloud2

from fiber_client.errors import NodeLost, PlaneError, PlaneRefusal
from fiber_client.interrupts import sigterm_interrupts
from fiber_client.missing import missing_parts
from fiber_client.monitor import STAGES, PlaneMonitor
from fiber_core.outcomes import PlanOutcome
from fiber_msgs_py import PlanStamp, Progress, Service, Topic, diagnostics, targets, topics
from fiber_node import BRIDGE, RepeatedRequest, RosClient, claims

__all__ = ["PlaneClient"]

_PLANS_KEPT = 8
_GRAPH_PERIOD_S = 0.1  # time between two looks at the graph while a client waits for it
_PRESENT_PERIOD_S = 0.2  # time between two looks at the nodes of the graph


class PlaneClient(PlaneMonitor):
    """Talks to the graph through its topics and services only, as an observatory would.

    One plan takes four calls: `send_targets`, `wait_until_ready`, `start`, `wait_for_outcome`.
    The client receives messages while it waits, and only then. Every wait ends: with what it
    waits for, with a PlaneRefusal when a node refuses the plan, with a NodeLost when a node that
    the plan needs leaves the graph, or with a WaitError after its time-out.

    What it receives is there as attributes, such as `plane`, `angles` and `outcomes`: see
    PlaneMonitor.

    Args:
        domain: ROS domain of the graph; by default the domain of the environment.
        on_progress: called with the progress of every stage.
        on_status: called with every diagnostic status, and with the status of the same name that
            was received before, or None.
        guard: called again and again while the client waits; it ends the wait by raising.
        clock: returns seconds, for time-outs and for `times`.
        args: command line for ROS; None for that of the process, so that a script takes
            ``--ros-args -r __ns:=/north -p use_sim_time:=true``.
        namespace: namespace of the plane, as "/north"; by default that of the environment
            variable ROS_NAMESPACE.
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
        args: Sequence[str] | None = None,
        namespace: str | None = None,
    ):
        self._ros = RosClient("plane_client", domain, guard, clock, args, namespace)
        super().__init__(self._ros.node, on_progress, on_status, clock)
        self._targets = topics.TARGETS.publisher(self.node)
        self._last_ns = -1  # stamp of the plan sent last
        self._stages: dict[PlanStamp, dict[str, str]] = {}  # claims when targets were sent
        self._looked_s = -1.0
        self._ready: PlanStamp | None = None
        self._parameters: AsyncParameterClient | None = None
        self._services = {
            service: service.client(self.node)
            for service in (
                topics.START, topics.STOP, topics.HOME, topics.TURN, topics.CLEAR, topics.CONFIGURE
            )
        }  # fmt: skip

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
        missing = partial(missing_parts, self, self._services, self._targets, also)
        due_s = 0.0

        def complete() -> bool:
            # a look at the graph takes longer than a message: messages go first
            nonlocal due_s
            if self._clock() < due_s:
                return False
            found = not missing()
            due_s = self._clock() + _GRAPH_PERIOD_S
            return found

        self.wait_for(complete, timeout_s, lambda: ", ".join(missing()))

    def send_targets(
        self,
        ids: ArrayLike,
        xy_mm: ArrayLike,
        fibre: ArrayLike | None = None,
        straight: bool = False,
    ) -> PlanStamp:
        """Send targets for the fibres of some robots; planning begins at once.

        Args:
            ids: robot ids, shape (k,).
            xy_mm: targets in the focal plane [mm], shape (k, 2).
            fibre: number of the fibre that each target is for, -1 for any, shape (k,); by default
                any.
            straight: whether this is a correction: every robot goes straight to the elbow and turn
                next to it, or is held.

        Returns:
            The stamp that names the plan.

        Raises:
            MessageError: the table is malformed and was not sent; names robot and value.
        """
        # a simulated clock may rest: two plans still need two stamps
        self._last_ns = max(self.now_ns(), self._last_ns + 1)
        now = PlanStamp(self._last_ns)
        return self.send_message(targets.encode(ids, xy_mm, now, self.session, fibre, straight))

    def send_message(self, message: PointCloud2) -> PlanStamp:
        """Send a targets message as it is; return its stamp, which names the plan.

        A message with the stamp 0 gets that of the present time.
        """
        if PlanStamp.of(message).ns == 0:
            message.header.stamp = self.node.get_clock().now().to_msg()
        stamp = PlanStamp.of(message)
        self._stages[stamp] = {
            role: found[0] for role in STAGES if (found := claims(self.node, role))
        }
        for old in list(self._stages)[:-_PLANS_KEPT]:
            del self._stages[old]
        self._times_of(stamp)["sent"] = self._clock()
        self._targets.publish(message)
        return stamp

    def wait_until_ready(self, stamp: PlanStamp, timeout_s: float) -> None:
        """Wait until the bridge has the orders of a plan, so that it can be started.

        Args:
            stamp: names the plan.
            timeout_s: time-out [s].

        Raises:
            PlaneRefusal: a node refused the plan, or it was ended; gives the reason.
            NodeLost: a node that works on the plan has left the graph.
            WaitError: no orders came.
        """
        times = self._times_of(stamp)

        def ready() -> bool:
            for refusal in self.refusals.get(stamp, []):
                if refusal.stage in STAGES:
                    raise refusal
            if "bridge" not in times:
                self._check_present(stamp, STAGES, f"orders of plan {stamp}")
            return "bridge" in times

        self.wait_for(ready, timeout_s, f"orders of plan {stamp}")
        self._ready = stamp

    def start(self, timeout_s: float, plan: PlanStamp | None = None) -> str:
        """Start a plan that is ready: load, verify, go. Return the answer of the bridge.

        Args:
            timeout_s: time-out of the answer [s].
            plan: the plan; by default the one that this client has waited for. When other orders
                have taken its place the bridge refuses.

        Raises:
            PlaneRefusal: the bridge refused; gives its reason.
            NodeLost: the bridge has left the graph.
            WaitError: no answer.
        """
        plan = self._ready if plan is None else plan
        if plan is not None:
            named = Parameter("start_plan", Parameter.Type.STRING, str(plan))
            future = self.bridge_parameters(timeout_s).set_parameters([named])
            self._wait_for_bridge(future.done, timeout_s, "answer to start_plan")
        return self.call_service(topics.START, timeout_s)

    def wait_for_outcome(self, stamp: PlanStamp, timeout_s: float) -> PlanOutcome:
        """Wait until a plan has ended, with all its attempts.

        Args:
            stamp: names the plan.
            timeout_s: time-out [s].

        Returns:
            The outcome of every robot.

        Raises:
            NodeLost: the bridge has left the graph.
            WaitError: the plan did not end.
        """

        def ended() -> bool:
            if stamp not in self.outcomes:
                self._check_present(stamp, (BRIDGE,), f"outcome of plan {stamp}")
            return stamp in self.outcomes and not self._has_unannounced_frames(stamp)

        self.wait_for(ended, timeout_s, f"outcome of plan {stamp}")
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
            MessageError, PlaneRefusal, NodeLost, WaitError: as in the four steps. Robots that may
            have started are stopped before.
        """
        stamp = self.send_targets(ids, xy_mm)
        self.wait_until_ready(stamp, timeout_s)
        with self.stops_on_error(timeout_s):
            self.start(timeout_s)
            return self.wait_for_outcome(stamp, timeout_s)

    @contextmanager
    def stops_on_error(self, timeout_s: float) -> Iterator[None]:
        """Stop the robots when an error, an interrupt or SIGTERM ends the block, then raise it.

        SIGTERM is raised as KeyboardInterrupt, if the process has no handler of its own for it.

        A PlaneRefusal stops no robot: the bridge refused to move them, and the robots that it
        moves are those of another client.

        Args:
            timeout_s: time-out of the service stop [s].
        """
        try:
            with sigterm_interrupts():
                yield
        except PlaneRefusal:
            raise
        except BaseException:
            try:
                self.call_service(topics.STOP, timeout_s)
                self.node.get_logger().warning("robots that may be under way were told to stop")
            except Exception as error:
                self.node.get_logger().error(f"robots under way were not told to stop: {error}")
            raise

    def wait_for_recording(self, stamp: PlanStamp, timeout_s: float) -> None:
        """Wait until a recorder in the graph has written the recording of a plan.

        Args:
            stamp: names the plan.
            timeout_s: time-out [s].

        Raises:
            PlaneRefusal: the recorder could not write it; gives its reason.
            WaitError: no recording was written.
        """
        times = self._times_of(stamp)

        def written() -> bool:
            for refusal in self.refusals.get(stamp, []):
                if refusal.stage == "recorder":
                    raise refusal
            return "recorder" in times

        self.wait_for(written, timeout_s, f"recording of plan {stamp}")

    # --- services ------------------------------------------------------------

    def home(self, timeout_s: float) -> PlanOutcome:
        """Fold all robots that can be folded; return the outcome of every robot.

        Raises:
            PlaneRefusal: the bridge refused; gives its reason.
            WaitError: no answer, or the motion did not end.
        """
        return self.end_of(self.call_service(topics.HOME, timeout_s), timeout_s)

    def end_of(self, answer: str, timeout_s: float) -> PlanOutcome:
        """Wait for the end of the motion that a service has started, by its answer."""
        plan = answer.removeprefix("plan ").partition(":")[0]
        self._wait_for_bridge(
            lambda: plan in map(str, self.outcomes), timeout_s, f"outcome of plan {plan}"
        )
        named = {str(stamp): each for stamp, each in self.outcomes.items()}
        return named[plan]

    def call_service(self, service: Service, timeout_s: float) -> str:
        """Call a service of the bridge, such as `fiber_msgs_py.topics.STOP`; return its answer.

        Raises:
            PlaneRefusal: the bridge refused; gives its reason.
            NodeLost: the bridge has left the graph.
            WaitError: no answer.
        """
        client = self._services[service]
        self._wait_for_bridge(client.service_is_ready, timeout_s, f"service {service.name}")
        living = partial(claims, self.node, BRIDGE)
        request = RepeatedRequest(self.node, client, service.type.Request(), living, self._clock)
        self._wait_for_bridge(request.done, timeout_s, f"answer of {service.name}")
        answer = request.result()
        if answer is None:
            raise PlaneError(f"service {service.name} gave no answer")
        if not answer.success:
            raise PlaneRefusal("bridge", answer.message)
        return answer.message

    def bridge_parameters(self, timeout_s: float) -> AsyncParameterClient:
        """Return a client of the bridge's parameters; its diagnostics tell its name.

        Raises:
            NodeLost: the bridge has left the graph.
            WaitError: there is no bridge, or it does not answer.
        """
        self._wait_for_bridge(lambda: BRIDGE in self._statuses, timeout_s, "parameters of bridge")
        name = str(self._statuses[BRIDGE].values.get("node", BRIDGE))
        if self._parameters is None or self._parameters.remote_node_name != name:
            self._parameters = AsyncParameterClient(self.node, name)
        ready = self._parameters.services_are_ready
        self._wait_for_bridge(ready, timeout_s, f"parameters of {name}")
        return self._parameters

    # --- for anything else ---------------------------------------------------

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

    def _wait_for_bridge(
        self, condition: Callable[[], object], timeout_s: float, what: str
    ) -> None:
        """Wait for an answer of the bridge, as long as the bridge that is known is there."""
        known = set(claims(self.node, BRIDGE)) or ({self.session} - {None})

        def held() -> bool:
            if condition():
                return True
            if known and self._clock() > self._looked_s + _PRESENT_PERIOD_S:
                self._looked_s = self._clock()
                if not known & set(claims(self.node, BRIDGE)):
                    raise NodeLost(BRIDGE, what)
            return False

        self.wait_for(held, timeout_s, what)

    def _check_present(self, stamp: PlanStamp, stages: Sequence[str], what: str) -> None:
        """Raise NodeLost if a node that was there when targets were sent has left the graph."""
        if self._clock() < self._looked_s + _PRESENT_PERIOD_S:
            return
        self._looked_s = self._clock()
        for role in stages:
            claim = self._stages.get(stamp, {}).get(role)
            if claim is not None and claim not in claims(self.node, role):
                raise NodeLost(role, what)

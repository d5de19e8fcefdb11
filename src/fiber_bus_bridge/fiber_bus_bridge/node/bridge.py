# SPDX-License-Identifier: Apache-2.0
"""The bus bridge as a node: segments in, frames on the buses, outcomes out."""

import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.accepted_plans import AcceptedPlans
from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.node.declared_parameters import declare_bridge
from fiber_bus_bridge.node.disabled_parameter import follow_disabled_parameter
from fiber_bus_bridge.node.hardware import Hardware, open_hardware
from fiber_bus_bridge.node.kept_plan import KeptPlan
from fiber_bus_bridge.node.locked_calls import LockedCalls
from fiber_bus_bridge.node.measured_robots import MeasuredRobots
from fiber_bus_bridge.node.motion import BusTime, Motion
from fiber_bus_bridge.node.operator_changes import OperatorChanges
from fiber_bus_bridge.node.outlines import Outlines
from fiber_bus_bridge.node.plan_inputs import PlanInputs
from fiber_bus_bridge.node.plane_claim import OtherBridges, claim_plane
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.node.remembered import Remembered, memory_path
from fiber_bus_bridge.node.stage_watch import StageWatch
from fiber_bus_bridge.node.unplanned_motions import UnplannedMotions
from fiber_bus_bridge.node.vouched_parameter import follow_vouched_parameter
from fiber_bus_bridge.protocol import Event, State
from fiber_bus_bridge.session_state import SessionState
from fiber_core.errors import FiberError
from fiber_core.outcomes import Reason
from fiber_msgs_py import PlanStamp, Status, guarded, topics
from fiber_node import BRIDGE, ManagedNode, run

__all__ = ["BridgeNode", "main"]

_CHECK_PERIOD_S = 0.25
_REPEAT_PERIOD_S = 1.0  # of layout and joint states at rest
_Response: TypeAlias = Trigger.Response


class BridgeNode(ManagedNode):
    """Executes plans on positioners and publishes the outcome of every robot.

    The time of simulated buses advances only while robots move, `time_scale` seconds a second.
    Configured, the bridge has claimed its plane and found the robots, and publishes where they are;
    active, it accepts targets and moves robots. Deactivated in motion it stops them first.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    open_hardware = staticmethod(open_hardware)
    own_parameters: ClassVar[dict[str, type]] = {}  # of a derived node: dataclasses by prefix

    def __init__(self, **options: Any):
        self._lock, self._stop_requested = threading.Lock(), threading.Event()
        self._calls = LockedCalls(self, self._lock)
        # transitions are served while a call is at work
        super().__init__("bridge", BRIDGE, MutuallyExclusiveCallbackGroup(), **options)
        self._parameters_given = declare_bridge(self, self.parameters, self.own_parameters)
        self._capture = self._parameters_given.execution.capture
        disabled = self._parameters_given.disabled
        follow_disabled_parameter(disabled, self._disable, self.reporter.refuse)
        follow_vouched_parameter(self, self._vouch, self.reporter.refuse)
        self.begin()

    def configure(self) -> None:
        """Open the buses, claim the plane, find the robots, and tell where they are.

        Raises:
            FiberError: the parameters describe no hardware, its plant or devices are not there, or
                another bridge has the plane.
        """
        declared = self._parameters_given.hardware
        hardware = self.open_hardware(declared, self.get_namespace(), self.pause)
        try:
            with self._lock:  # what hears and serves waits until all is there
                self._build(hardware)
                self._find_robots()
                self._calls.open = True
        except Exception:
            hardware.close()
            raise
        buses, found = len(self._session.transactions.buses), int(self._session.known.sum())
        known = f"{found} of {hardware.plane.n} robots found on {buses} buses"
        for line in (*hardware.lines, known):
            self.get_logger().info(line)

    def activate(self) -> None:
        """Accept targets."""
        self.get_logger().info(f"waits for targets, {self._session.state.name}, {self._claim.id}")

    def _build(self, hardware: Hardware) -> None:
        given, plane = self._parameters_given, hardware.plane
        self._hardware = hardware
        self._tap = Tap(hardware.buses, hardware.timing) if self._capture else None
        self._session = hardware.session(given.safety, given.session, self._tap)
        self._time = BusTime(self._session, hardware)
        memory = memory_path(given.memory, hardware)
        self._availability = given.disabled.availability(plane, memory)
        self._session.enable(self._availability.enabled)
        claim = self._claim = claim_plane(self, given.execution.discovery_s)
        self._others = OtherBridges(claim)
        self._outgoing = Publishers(self, self._session, self._availability, claim.id)
        self._outlines = Outlines(self._session, plane, given.errors, self._outgoing)
        self._kept_plan = KeptPlan(
            self._session, plane, memory, self._outgoing, self.reporter, self._time.now_s
        )
        self.reporter.session, self._work_group = claim.id, MutuallyExclusiveCallbackGroup()
        self._attempts, self._stopped = self._make_attempts(), topics.STOPPED.publisher(self)
        self._remembered = Remembered(
            self._session, self._availability, hardware, memory, self.reporter.refuse
        )
        self._operators = OperatorChanges(
            self, self._session, self._availability, self._attempts, self._outgoing,
            self._remembered.save_or_warn,
        )  # fmt: skip
        self._measured = MeasuredRobots(
            self._session, plane, self._availability, self._attempts, self._outlines,
            self._outgoing, self.reporter, self._time.now_s, self._remembered.save_or_warn,
        )  # fmt: skip
        self._motion = Motion(
            self, self._calls, self._session, hardware, self._time, self._attempts,
            self._outgoing, self._remembered, self._stop_requested, given.execution.time_scale,
            self._work_group,
        )  # fmt: skip
        self._unplanned = UnplannedMotions(
            self._session, self._attempts, self._time.now_s, self._check_role, self._may_go,
            self._report_started, self._outgoing, self.reporter,
        )  # fmt: skip
        self._subscribe()
        self._make_timers()

    def _make_timers(self) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for period_s, name, call, clock in (
            (_CHECK_PERIOD_S, "plans", self._check_plans, steady),
            (_REPEAT_PERIOD_S, "repeat", self._repeat, self.get_clock()),
        ):
            check = guarded(self, name, self._calls.locked(call))
            self.create_timer(period_s, check, callback_group=self._work_group, clock=clock)

    def deactivate(self) -> None:
        """Stop robots that move, and end all plans; orders that wait are forgotten.

        After a stop the service `clear` makes the next plan possible, as after any stop.
        """
        with self._stopping(), self._lock:
            if self._session.state is SessionState.MOVING:
                self._session.stop(self._time.now_s())
            elif self._session.state is SessionState.READY:
                self._session.clear(self._time.now_s())
            self._motion.publish_changes(last=True)
            self._attempts.end_all(Reason.STOPPED, "the bridge is deactivated")
        self.get_logger().info(f"deactivated: {self._session.state.value}")

    def cleanup(self) -> None:
        """End the session: robots stay where they are, and their memory is kept."""
        with self._lock:
            self._remembered.save_or_warn()
            self._calls.open = False
            self._hardware.close()
        self.set_parameters([Parameter("vouched", Parameter.Type.INTEGER_ARRAY, [])])

    def statuses(self) -> Iterable[Status]:
        """Return the diagnostics of every bus, and of the robots left out of plans."""
        return self._outgoing.statuses() if self._calls.open else ()

    def _make_attempts(self) -> Attempts:
        inputs, watch = PlanInputs(self._hardware.plane, self._claim.id), StageWatch(self)
        accepted = AcceptedPlans(
            watch, self._session, self._claim.id, inputs, self._outlines, self._outgoing,
            self._kept_plan, self.reporter, topics.TARGETS.publisher(self), self._check_role,
        )  # fmt: skip
        return Attempts(
            self, watch, self._session, self._claim.id, accepted, inputs, self._availability,
            self._outlines, self._outgoing, self._kept_plan, self.reporter,
            self._parameters_given.attempts,
            self._stop_requested, self._time.now_s, self._start_orders, self._save_traffic,
        )  # fmt: skip

    def _subscribe(self) -> None:
        # the work of the bridge leaves the default group to parameters and diagnostics
        work = self._work_group
        for topic, hear in (
            (topics.TARGETS, self._attempts.hear_targets),
            (topics.HELD_BY_PLANNER, self._attempts.hear_held),
            (topics.HELD_BY_DISCRETIZER, self._attempts.hear_held),
            (topics.PROGRESS, self._attempts.hear_progress),
            (topics.SEGMENTS, self._attempts.hear_segments),
            (topics.MEASURED, self._measured.hear),
            (topics.TURNS, self._unplanned.hear_turns),
        ):
            topic.subscription(self, self._calls.locked(hear), callback_group=work)
        for service, call in (
            (topics.START, self._start),
            (topics.HOME, self._unplanned.home),
            (topics.TURN, self._unplanned.turn),
            (topics.CLEAR, self._clear),
            (topics.CONFIGURE, lambda: self._find_robots(restore=True)),
        ):
            service.server(self, self._calls.serving(service.name, call), callback_group=work)
        # stop is served while another call is at work
        own_group = MutuallyExclusiveCallbackGroup()
        topics.STOP.server(self, self._on_stop, callback_group=own_group)

    def _repeat(self) -> None:
        if self._session.state is not SessionState.MOVING:
            self._outgoing.repeat()

    def _check_plans(self) -> None:
        self._kept_plan.tell()
        self._attempts.check()
        self._check_other_bridges()

    def _check_other_bridges(self) -> None:
        at_rest = self._session.state in (SessionState.IDLE, SessionState.READY)
        if self._others.stay() and at_rest:
            self._attempts.end_all(Reason.STOPPED, "another bridge is in the graph")
            self._session.clear(self._time.now_s())
            self._motion.publish_changes(last=True)
            self._session.protocol.state = State.UNCONFIGURED
            self.reporter.refuse("another bridge is in the graph: end one, then configure")

    def _save_traffic(self, plan: PlanStamp) -> None:
        if self._tap is not None:
            self._tap.write(Path(self._capture) / str(plan))

    # --- services ------------------------------------------------------------

    def _start(self) -> str:
        if plan := self._parameters_given.start.value.start_plan:
            self.set_parameters([Parameter("start_plan", value="")])
        return self.start(plan)

    def start(self, plan: str = "") -> str:
        """Start the orders of a plan; return how many robots were started.

        Args:
            plan: stamp of the plan, as text; empty for the plan that was ready.

        Raises:
            SessionError: its orders do not wait, or have been replaced since they were ready.
        """
        self._check_role()
        self._attempts.check_start(plan)
        return self._start_orders()

    def _check_role(self) -> None:
        """Refuse what moves robots, or leads to it, while this bridge may not.

        Raises:
            SessionError: the bridge is inactive, or an earlier one has the plane.
        """
        if not self.active:
            raise SessionError("the bridge is inactive: activate it first")
        if self._claim.earlier():
            raise SessionError("another bridge of this plane is in the graph")

    def _start_orders(self) -> str:
        self._session.start(self._time.now_s(), self._may_go)
        self._attempts.forget_replaced()
        return self._report_started()

    def _may_go(self) -> bool:
        if self._stop_requested.is_set():  # the file must not say that robots move
            return False
        try:
            self._check_role()  # it may have changed since the first attempt, or in motion
            self._kept_plan.begin(self._attempts.so_far())
            self._remembered.save(starting=True)
        except FiberError as error:
            self.reporter.refuse(f"no robot is started: {error}")
            return False
        return not self._stop_requested.is_set()

    def _report_started(self) -> str:
        loaded_plan, current = self._session.loaded_plan, self._attempts.current
        started = 0 if loaded_plan is None else int(loaded_plan.started.sum())
        self._motion.publish_changes()
        if self._session.state is SessionState.MOVING:
            self._motion.begin()
        return f"plan {current}: {started} robots started"

    @contextmanager
    def _stopping(self) -> Iterator[None]:
        """Let no start send its GO, and end planning and discretizing."""
        self._stop_requested.set()  # a start that is still checking will not send GO
        self._remembered.stop_note.begin()
        now, newest = PlanStamp(self._outgoing.now_ns()), self._attempts.newest
        self._stopped.publish((now if newest is None else max(now, newest)).to_time())
        try:
            yield
        finally:
            self._stop_requested.clear()
            self._remembered.stop_note.finish()

    def _on_stop(self, request: Any, response: _Response) -> _Response:
        with self._stopping():
            return self._calls.serving(topics.STOP.name, self._stop)(request, response)

    def _stop(self) -> str:
        self._unplanned.forget_turns()
        self._session.stop(self._time.now_s())
        self._motion.publish_changes(last=True)
        self._attempts.end_all(Reason.STOPPED, "stopped")
        return f"stopped: {SessionState.STOPPED.value}"

    def _clear(self) -> str:
        self._kept_plan.tell()  # cleared robots do not
        self._unplanned.forget_turns()
        self._session.clear(self._time.now_s())
        self._availability.restore()
        self._motion.publish_changes(last=True)
        self._attempts.end_all(Reason.NOT_PLANNED, "cleared")
        self._attempts.forget_stamps()
        self._outgoing.publish_layout()
        return self._session.state.value

    def _find_robots(self, restore: bool = False) -> str:
        self._unplanned.forget_turns()
        self._session.configure(self._time.now_s())
        if Event.FOUND_ALONE in [step.event for step in self._session.take_transitions()]:
            self.get_logger().warning("robots that had stopped by themselves are cleared")
        if restore:  # not at the start: robots that failed before a restart have failed
            self._availability.restore()
        self._attempts.end_all(Reason.NOT_PLANNED, "configured")
        self._outgoing.publish_layout(always=True)
        self._motion.publish_changes()
        self._kept_plan.tell()
        return f"{self._session.known.sum()} of {self._session.plane.n} robots configured"

    def _disable(self, ids: Sequence[int], reason: str) -> None:
        with self._calls.soon("disabled or enabled"):
            if self._calls.open:  # else the plane is not known yet
                self._operators.disable(ids, reason)
            self._parameters_given.disabled.keep(ids, reason)

    def _vouch(self, ids: Sequence[int]) -> None:
        with self._calls.soon("vouched for"):
            if self._calls.open:
                self._operators.vouch(ids)
            elif ids:
                raise SessionError("robots cannot be vouched for before the bridge is configured")


def main(args: list[str] | None = None) -> int:
    """Run the bridge until it is interrupted."""
    return run(BridgeNode, args)

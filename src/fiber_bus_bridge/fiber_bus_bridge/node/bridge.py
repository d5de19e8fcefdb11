# SPDX-License-Identifier: Apache-2.0
"""The bus bridge as a node: segments in, frames on the buses, outcomes out."""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.errors import BridgeError, SessionError
from fiber_bus_bridge.node.accepted_plans import AcceptedPlans
from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.node.disabled_parameter import (
    declare_availability,
    follow_disabled_parameter,
)
from fiber_bus_bridge.node.hardware import declare_hardware
from fiber_bus_bridge.node.plan_inputs import PlanInputs
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.node.remembered import MemoryConfig, Remembered, memory_path
from fiber_bus_bridge.node.settings import AttemptConfig, ExecutionConfig, StartConfig
from fiber_bus_bridge.node.stage_watch import StageWatch
from fiber_bus_bridge.node.vouched_parameter import declare_vouched, follow_vouched_parameter
from fiber_bus_bridge.protocol import Event, State
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.session_state import SessionState
from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.outcomes import Reason
from fiber_msgs_py import PlanStamp, guarded, topics
from fiber_node import BRIDGE, Claim, Declared, PlaneNode, Reporter, run

__all__ = ["BridgeNode", "main"]

_TICK_S = 0.1  # time of the buses between two publications while robots move
_SOON_S = 1e-3
_POLL_S = 0.02
_CHECK_PERIOD_S = 0.25
_REPEAT_PERIOD_S = 1.0  # of layout and joint states at rest
_LEASE_S = 4.0  # a bridge that was killed has left the graph by then
_STAYS_S = 2 * _LEASE_S  # a bridge that refuses to run has left the graph by then
_ANSWER_S = 0.25  # longest wait of a change of parameters for other work of the bridge
_Response: TypeAlias = Trigger.Response


class BridgeNode(PlaneNode):
    """Executes plans on positioners and publishes the outcome of every robot.

    The time of simulated buses advances only while robots move, `time_scale` seconds a second.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("bridge", **options)
        hardware = declare_hardware(self.parameters, self.get_namespace())
        safety = self.parameters.declare(Safety, "safety", read_only=True).value
        execution = self.parameters.declare(ExecutionConfig, read_only=True).value
        attempt_config = self.parameters.declare(AttemptConfig)
        self._to_start = self.parameters.declare(StartConfig)
        scale, self._capture = execution.time_scale, execution.capture
        self._hardware, plane = hardware, hardware.plane
        self._tap = Tap(hardware.buses, hardware.timing) if self._capture else None
        config = self.parameters.declare(SessionConfig, "session", read_only=True).value
        self._session = Session(
            plane, hardware.units, safety, self._tap or hardware.buses, hardware.start, config
        )
        self._lock, self._stop_requested = threading.Lock(), threading.Event()
        self._time_s = self._due_s = 0.0
        self._others_since_s: dict[str, float] = {}  # claims of other bridges
        memory = memory_path(self.parameters.declare(MemoryConfig, read_only=True).value, hardware)
        self._availability = declare_availability(self, self.parameters, plane, memory)
        declare_vouched(self, self.parameters)
        self.parameters.finish()
        self._session.enable(self._availability.enabled)
        self._claim = self._claimed(execution.discovery_s)
        self._outgoing = Publishers(self, self._session, self._availability, self._claim.id)
        self._reporter = Reporter(self, BRIDGE, self._outgoing.statuses)
        self._reporter.session = self._claim.id
        self._attempts = self._make_attempts(attempt_config)
        self._stopped = topics.STOPPED.publisher(self)
        self._work_group = MutuallyExclusiveCallbackGroup()
        self._remembered = Remembered(
            self._session, self._availability, hardware, memory, self._reporter.refuse
        )
        self._subscribe()
        pause_s = _SOON_S if hardware.in_real_time or not scale else _TICK_S / scale
        # simulated buses follow the clock of the node, as one of use_sim_time; real ones cannot
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(
            pause_s,
            guarded(self, "tick", self._on_tick),
            callback_group=self._work_group,
            clock=steady if hardware.in_real_time else self.get_clock(),
        )
        self._timer.cancel()
        self.create_timer(
            _CHECK_PERIOD_S,
            guarded(self, "plans", self._check_plans),
            callback_group=self._work_group,
            clock=steady,
        )
        self.create_timer(
            _REPEAT_PERIOD_S, guarded(self, "repeat", self._repeat), callback_group=self._work_group
        )
        self._find_robots()
        for line in hardware.lines:
            self.get_logger().info(line)
        self.get_logger().info(f"{plane.n} robots on {len(self._session.transactions.buses)} buses")

    def _claimed(self, discovery_s: float) -> Claim:
        """Claim the plane, before any robot is asked.

        Raises:
            BridgeError: an earlier bridge of the same plane is in the graph, and does not leave.
        """
        claim, begin_s = Claim(self, BRIDGE), time.monotonic()
        while (now_s := time.monotonic()) < begin_s + discovery_s or claim.earlier():
            if now_s > begin_s + discovery_s + _LEASE_S:
                earlier = claim.earlier()[0]
                self.destroy_node()
                raise BridgeError(
                    f"a bridge of this plane is in the graph already, of {earlier}: end it first, "
                    "or use another ROS_DOMAIN_ID or namespace"
                )
            time.sleep(_POLL_S)
        return claim

    def _make_attempts(self, config: Declared[AttemptConfig]) -> Attempts:
        inputs, watch = PlanInputs(self._hardware.plane, self._claim.id), StageWatch(self)
        accepted = AcceptedPlans(
            watch, self._session, self._claim, inputs, self._outgoing, self._reporter,
            topics.TARGETS.publisher(self),
        )  # fmt: skip
        return Attempts(
            self, watch, self._session, self._claim.id, accepted, inputs, self._availability,
            self._outgoing, self._reporter, config, self._stop_requested,
            self._now_s, self._start_orders, self._save_traffic,
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
        ):
            topic.subscription(self, self._locked(hear), callback_group=work)
        for service, call in (
            (topics.START, self._start),
            (topics.HOME, self._home),
            (topics.CLEAR, self._clear),
            (topics.CONFIGURE, self._configure),
        ):
            service.server(self, self._served(service.name, call), callback_group=work)
        # stop is served while another call is at work
        own_group = MutuallyExclusiveCallbackGroup()
        topics.STOP.server(self, self._on_stop, callback_group=own_group)
        follow_disabled_parameter(self, self._disable, self._reporter.refuse)
        follow_vouched_parameter(self, self._vouch, self._reporter.refuse)

    def _locked(self, hear: Callable[[Any], None]) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            with self._lock:
                hear(message)

        return receive

    def _repeat(self) -> None:
        with self._lock:
            if self._session.state is not SessionState.MOVING:
                self._outgoing.repeat()

    def _check_plans(self) -> None:
        with self._lock:
            self._attempts.check()
            self._check_other_bridges()

    def _check_other_bridges(self) -> None:
        # A later bridge refuses to run while this one is in the graph. One that stays has not seen
        # this one, which was paused perhaps, and may have moved robots.
        now_s, others = time.monotonic(), self._claim.others()
        self._others_since_s = {each: self._others_since_s.get(each, now_s) for each in others}
        stays = any(since_s < now_s - _STAYS_S for since_s in self._others_since_s.values())
        if stays and self._session.state in (SessionState.IDLE, SessionState.READY):
            self._attempts.end_all(Reason.STOPPED, "another bridge is in the graph")
            self._session.clear(self._now_s())
            self._publish_changes(last=True)
            self._session.protocol.state = State.UNCONFIGURED
            self._reporter.refuse("another bridge is in the graph: end one, then configure")

    def _save_traffic(self, plan: PlanStamp) -> None:
        if self._tap is not None:
            self._tap.write(Path(self._capture) / str(plan))

    # --- services ------------------------------------------------------------

    def _served(self, name: str, call: Callable[[], str]) -> Callable[[Any, _Response], _Response]:
        """Make a Trigger service of a call; a refusal of the core becomes the response."""
        name = name.rpartition("/")[2]

        def serve(_: Any, response: _Response) -> _Response:
            try:
                with self._lock:
                    response.message = call()
                response.success = True
                self.get_logger().info(f"service {name}: {response.message}")
            except FiberError as error:
                response.success, response.message = False, str(error)
                self._reporter.refuse(f"service {name} refused: {error}")
            return response

        return serve

    def _start(self) -> str:
        plan = self._to_start.value.start_plan
        if plan:
            self.set_parameters([Parameter("start_plan", value="")])
        return self.start(plan)

    def start(self, plan: str = "") -> str:
        """Start the orders of a plan; return how many robots were started.

        Args:
            plan: stamp of the plan, as text; empty for the plan that was ready.

        Raises:
            SessionError: its orders do not wait, or have been replaced since they were ready.
        """
        if self._claim.earlier():
            raise SessionError("another bridge of this plane is in the graph")
        self._attempts.check_start(plan)
        return self._start_orders()

    def _start_orders(self) -> str:
        self._session.start(self._now_s(), self._may_go)
        self._attempts.forget_replaced()
        return self._report_started()

    def _home(self) -> str:
        if self._claim.earlier():
            raise SessionError("another bridge of this plane is in the graph")
        self._attempts.end_all(Reason.NOT_PLANNED, "the robots go home")
        self._session.home(self._now_s(), self._may_go)
        self._attempts.begin_home()
        return self._report_started()

    def _may_go(self) -> bool:
        try:
            self._remembered.save(starting=True)
        except BridgeError as error:
            self._reporter.refuse(f"no robot is started: {error}")
            return False
        return not self._stop_requested.is_set()

    def _report_started(self) -> str:
        loaded_plan, current = self._session.loaded_plan, self._attempts.current
        started = 0 if loaded_plan is None else int(loaded_plan.started.sum())
        self._publish_changes()
        if self._session.state is SessionState.MOVING:
            self._due_s = self._time_s
            self._timer.reset()
        return f"plan {current}: {started} robots started"

    def _on_stop(self, request: Any, response: _Response) -> _Response:
        self._stop_requested.set()  # a start that is still checking will not send GO
        now, newest = PlanStamp(self._outgoing.now_ns()), self._attempts.newest
        self._stopped.publish((now if newest is None else max(now, newest)).to_time())
        try:
            return self._served(topics.STOP.name, self._stop)(request, response)
        finally:
            self._stop_requested.clear()

    def _stop(self) -> str:
        self._session.stop(self._now_s())
        self._publish_changes(last=True)
        self._attempts.end_all(Reason.STOPPED, "stopped")
        return f"stopped: {SessionState.STOPPED.value}"

    def _clear(self) -> str:
        self._session.clear(self._now_s())
        self._availability.restore()
        self._publish_changes(last=True)
        self._attempts.end_all(Reason.NOT_PLANNED, "cleared")
        self._attempts.forget_stamps()
        self._outgoing.publish_layout()
        return self._session.state.value

    def _configure(self) -> str:
        return self._find_robots(restore=True)

    def _find_robots(self, restore: bool = False) -> str:
        self._session.configure(self._now_s())
        if Event.FOUND_ALONE in [step.event for step in self._session.take_transitions()]:
            self.get_logger().warning("robots that had stopped by themselves are cleared")
        if restore:  # not at the start: robots that failed before a restart have failed
            self._availability.restore()
        self._attempts.end_all(Reason.NOT_PLANNED, "configured")
        self._outgoing.publish_layout(always=True)
        self._publish_changes()
        return f"{self._session.known.sum()} of {self._session.plane.n} robots configured"

    def _disable(self, ids: Sequence[int], reason: str) -> None:
        if not self._lock.acquire(timeout=_ANSWER_S):
            raise SessionError("robots cannot be disabled or enabled while a plan is under way")
        try:
            changed = sorted(set(ids) ^ set(self._availability.disabled))
            moving = self._session.state is SessionState.MOVING
            if changed and (moving or self._attempts.awaited is not None):
                verb = "disabled" if changed[0] in ids else "enabled"
                raise SessionError(f"robot {changed[0]} cannot be {verb} while a plan is under way")
            self._availability.disable(ids, reason)
            self._session.enable(self._availability.enabled)
            self._outgoing.publish_layout()
        finally:
            self._lock.release()
        self._reporter.publish()
        self.get_logger().info(f"disabled by operators: {sorted(ids) or 'no robot'}")

    def _vouch(self, ids: Sequence[int]) -> None:
        if not self._lock.acquire(timeout=_ANSWER_S):
            raise SessionError("robots cannot be vouched for while a plan is under way")
        try:
            self._session.vouch(ids)
            self._remembered.save_or_warn()
        finally:
            self._lock.release()
        self._reporter.publish()
        self.get_logger().info(f"vouched for by operators: {sorted(ids) or 'no robot'}")

    # --- motion --------------------------------------------------------------

    def _now_s(self) -> float:
        """The time of the buses [s]."""
        free_s = self._session.transactions.now_s
        self._time_s = max(self._time_s, free_s, self._hardware.clock())
        return self._time_s

    def _on_tick(self) -> None:
        with self._lock:
            if self._session.state is SessionState.MOVING:
                self._advance()
                self._publish_changes()
            else:
                # in this thread and never in the one that serves stop: a timer that is cancelled
                # when it is due fails in rclpy as it is taken, with its whole callback group
                self._timer.cancel()

    def _advance(self) -> None:
        # from tick to tick, independent of the time that the polls take on the buses
        clock, slice_s = self._hardware.clock, self._hardware.slice_s
        until_s = max(self._due_s, clock()) + _TICK_S
        while self._due_s < until_s and self._session.state is SessionState.MOVING:
            self._due_s = min(max(self._due_s, clock()) + slice_s, until_s)
            self._session.advance(self._due_s)
            if self._stop_requested.is_set():
                return

    def _publish_changes(self, last: bool = False) -> None:
        """Publish the changes of a call; after a last call a plan gets no further attempt."""
        self._publish_state(last)
        if self._session.state is not SessionState.MOVING:
            self._remembered.save_or_warn()

    def _publish_state(self, last: bool) -> None:
        self._now_s()
        current = self._attempts.current
        self._outgoing.publish_frames(None if current is None else current.stamp)
        self._outgoing.publish_encoders()
        if current is None:
            return
        loaded_plan = self._session.loaded_plan
        if self._session.state is SessionState.MOVING and loaded_plan is not None:
            makespan_s = max(loaded_plan.motion.decoded().makespan_s, _TICK_S)
            fraction = np.clip((self._time_s - loaded_plan.start_s) / makespan_s, 0.0, 1.0)
            self._reporter.progress(current, float(fraction), "robots are moving")
        elif (result := self._session.take_result()) is not None:
            self._attempts.finish(current, result, last)


def main(args: list[str] | None = None) -> int:
    """Run the bridge until it is interrupted."""
    return run(BridgeNode, args)

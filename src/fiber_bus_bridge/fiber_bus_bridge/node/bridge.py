"""The bus bridge as a node: segments in, frames on the buses, outcomes out."""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import Trigger

from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.disabled_parameter import (
    declare_availability,
    follow_disabled_parameter,
)
from fiber_bus_bridge.node.hardware import declare_hardware
from fiber_bus_bridge.node.plan_inputs import PlanInputs
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.node.settings import AttemptConfig, ExecutionConfig
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.replanning import Replanning
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.session_state import SessionState
from fiber_core.array_types import Mask
from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.outcomes import Outcome
from fiber_msgs_py import (
    Attempt,
    AttemptTable,
    PlanStamp,
    guarded,
    targets,
    topics,
)
from fiber_node import PlaneNode, Reporter, run

__all__ = ["BridgeNode", "main"]

_TICK_S = 0.1  # time of the buses between two publications while robots move
_SOON_S = 1e-3
_TIMEOUT_CHECK_S = 0.5
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
        scale = execution.time_scale
        self._attempts = self.parameters.declare(AttemptConfig)
        plane, self._hardware, self._units = hardware.plane, hardware, hardware.units
        self._capture = execution.capture
        self._tap = Tap(hardware.buses, hardware.timing) if self._capture else None
        config = self.parameters.declare(SessionConfig, "session", read_only=True).value
        self._session = Session(
            plane, self._units, safety, self._tap or hardware.buses, hardware.start, config
        )
        self._lock, self._stop_requested = threading.Lock(), threading.Event()
        self._time_s = self._due_s = 0.0
        self._current: Attempt | None = None  # the attempt with the orders of the session
        self._announced = AttemptTable()  # later attempts that this node has requested
        self._plan_inputs = PlanInputs(plane)
        self._replanning = Replanning(self._no_targets(), 1)
        self._ordered: Mask = np.zeros(plane.n, dtype=bool)  # robots with orders in this attempt
        self._awaited: Attempt | None = None  # next attempt, whose orders have not come yet
        self._awaited_until_s = 0.0
        self._availability = declare_availability(self, self.parameters, plane)
        self.parameters.finish()
        self._session.enable(self._availability.enabled)

        self._outgoing = Publishers(self, self._session, self._availability)
        self._reporter = Reporter(self, "bridge", self._outgoing.statuses)
        self._targets = topics.TARGETS.publisher(self)
        self._stopped = topics.STOPPED.publisher(self)
        self._work_group = MutuallyExclusiveCallbackGroup()
        self._subscribe()
        pause_s = _SOON_S if hardware.in_real_time or not scale else _TICK_S / scale
        self._timer = self.create_timer(
            pause_s, guarded(self, "tick", self._on_tick), callback_group=self._work_group
        )
        self._timer.cancel()
        self.create_timer(
            _TIMEOUT_CHECK_S,
            guarded(self, "time-out", self._check_timeout),
            callback_group=self._work_group,
        )
        self._configure()
        for line in hardware.lines:
            self.get_logger().info(line)
        self.get_logger().info(f"{plane.n} robots on {len(self._session.transactions.buses)} buses")

    def _subscribe(self) -> None:
        # the work of the bridge leaves the default group to parameters and diagnostics
        work = self._work_group
        topics.TARGETS.subscription(self, self._on_targets, callback_group=work)
        topics.HELD_BY_PLANNER.subscription(self, self._on_held, callback_group=work)
        topics.HELD_BY_DISCRETIZER.subscription(self, self._on_held, callback_group=work)
        topics.SEGMENTS.subscription(self, self._on_segments, callback_group=work)
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

    def _no_targets(self) -> np.ndarray:
        return np.full((self._hardware.plane.n, 2), np.nan)

    # --- plans ---------------------------------------------------------------

    def _on_targets(self, message: Any) -> None:
        try:
            self._plan_inputs.add_targets(message)
            with self._lock:
                if self._awaited is not None and PlanStamp.of(message) > self._awaited.stamp:
                    self._give_up_attempt("there are new targets")
        except FiberError:
            pass  # the planner reports the error

    def _on_held(self, message: Any) -> None:
        try:
            self._plan_inputs.add_held(message)
        except FiberError as error:
            self._reporter.refuse(f"held refused: {error}", "held")

    def _on_segments(self, message: Any) -> None:
        with self._lock:
            is_awaited = False
            try:
                stamp = PlanStamp.of(message)
                attempt = self._announced.find(stamp) or Attempt.first(stamp)
                is_awaited = attempt == self._awaited
                if attempt.number > 1 and not is_awaited:
                    self._reporter.drop(
                        f"segments {attempt} dropped: this attempt has ended", "segments"
                    )
                elif self._current is not None and stamp <= self._current.stamp:
                    self._reporter.drop(
                        f"segments {attempt} dropped: plan {self._current} is not older",
                        "segments",
                    )
                else:
                    self._accept_orders(attempt, message)
            except FiberError as error:
                self._reporter.refuse(f"segments refused: {error}", "segments")
                if is_awaited:
                    self._give_up_attempt("its orders were refused")

    def _accept_orders(self, attempt: Attempt, message: Any) -> None:
        motion = self._plan_inputs.motion(message, self._units, self._session.counts)
        asked, is_awaited = self._plan_inputs.targets(attempt.stamp), attempt == self._awaited
        if not is_awaited:
            self._give_up_attempt("there are new orders")
        replaced = self._session.submit(motion, asked)
        if replaced is not None and self._current is not None:
            self._finish_attempt(self._current, replaced, last=True)
        if not is_awaited:
            unknown = asked is None
            self._replanning = Replanning(
                self._no_targets() if unknown else asked,
                1 if unknown else self._attempts.value.attempts,
            )
        self._current, self._awaited = attempt, None
        self._ordered = motion.moves
        self._reporter.done(attempt, f"ready: orders for {self._ordered.sum()} robots")
        if is_awaited:  # start was requested for this plan
            self.get_logger().info(self._start())

    def _finish_attempt(self, attempt: Attempt, result: PlanResult, last: bool) -> None:
        """Add the result of an attempt; request the next attempt, or publish the outcome."""
        result = result.explained_by(self._plan_inputs.reasons(attempt.stamp))
        known = self._session.known
        self._availability.exclude_failed(result, known)
        xy_mm = self._plan_inputs.targets(attempt.stamp)
        asked = False if xy_mm is None else np.all(np.isfinite(xy_mm), axis=1)
        combined = self._replanning.add_attempt(self._availability.explain(result), asked)
        robots = self._replanning.next_robots(self._ordered, self._availability.commandable(known))
        stamp = self._plan_inputs.free_stamp_after(attempt.stamp)
        if last or self._stop_requested.is_set() or not robots.any() or stamp is None:
            self._outgoing.publish_layout()
            self._publish_outcome(attempt.plan, combined)
        else:
            self._replan(attempt, stamp, robots, combined)

    def _replan(
        self, last_attempt: Attempt, stamp: PlanStamp, robots: Mask, result: PlanResult
    ) -> None:
        """Request the next attempt of a plan for some robots; all others are obstacles."""
        # reads the positions of all robots, of failed robots too if they answer
        self._session.clear(self._now_s())
        now_ns = self._outgoing.now_ns()
        attempt = self._awaited = last_attempt.next(stamp, since_ns=now_ns)
        self._announced.add(attempt)
        self._awaited_until_s = time.monotonic() + self._attempts.value.attempt_timeout_s
        self._outgoing.publish_layout(always=True, now_ns=now_ns)
        ids, goals = self._session.plane.ids[robots], self._replanning.goals[robots]
        message = targets.encode_attempt(ids, goals, attempt)
        self._plan_inputs.add_targets(message)
        self._targets.publish(message)
        held = int((robots & (result.outcome == Outcome.HELD)).sum())
        text = f"replanning: {held} robots were held because of robots that cannot be commanded"
        self.get_logger().info(f"plan {attempt}: {text}")
        self._reporter.progress(attempt, 0.0, text)

    def _give_up_attempt(self, reason: str) -> None:
        """End a plan whose next attempt is awaited, with the result so far."""
        result = self._replanning.result
        if self._awaited is not None and result is not None:
            self.get_logger().warning(f"plan {self._awaited} given up: {reason}")
            plan, self._awaited = self._awaited.plan, None
            self._publish_outcome(plan, result)

    def _check_timeout(self) -> None:
        with self._lock:
            if self._awaited is not None and time.monotonic() > self._awaited_until_s:
                timeout_s = self._attempts.value.attempt_timeout_s
                self._reporter.drop(
                    f"plan {self._awaited}: no orders within {timeout_s:g} s, "
                    "the plan ends without this attempt"
                )
                self._give_up_attempt("no orders came")

    def _publish_outcome(self, plan: PlanStamp, result: PlanResult) -> None:
        attempts = self._replanning.attempts
        self._outgoing.publish_outcome(result, plan)
        counts = np.bincount(result.outcome, minlength=len(Outcome))
        summary = ", ".join(f"{counts[o]} {o.name.lower()}" for o in Outcome)
        self._reporter.counters |= {"plan": plan, "outcome": summary, "attempts": attempts}
        text = summary if attempts == 1 else f"{summary}, in {attempts} attempts"
        self._reporter.done(Attempt.first(plan), text)
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
        self._session.start(self._now_s(), self._may_go)
        return self._report_started()

    def _home(self) -> str:
        self._give_up_attempt("the robots go home")
        self._session.home(self._now_s(), self._may_go)
        self._current = Attempt.first(PlanStamp(self._outgoing.now_ns()))
        self._replanning = Replanning(self._no_targets(), 1)
        return self._report_started()

    def _may_go(self) -> bool:
        return not self._stop_requested.is_set()

    def _report_started(self) -> str:
        loaded_plan, current = self._session.loaded_plan, self._current
        started = 0 if loaded_plan is None else int(loaded_plan.started.sum())
        self._publish_changes()
        if self._session.state is SessionState.MOVING:
            self._due_s = self._time_s
            self._timer.reset()
        return f"plan {current}: {started} robots started"

    def _on_stop(self, request: Any, response: _Response) -> _Response:
        self._stop_requested.set()  # a start that is still checking will not send GO
        now, newest = PlanStamp(self._outgoing.now_ns()), self._plan_inputs.newest
        self._stopped.publish((now if newest is None else max(now, newest)).to_time())
        try:
            return self._served(topics.STOP.name, self._stop)(request, response)
        finally:
            self._stop_requested.clear()

    def _stop(self) -> str:
        self._session.stop(self._now_s())
        self._publish_changes(last=True)
        self._give_up_attempt("stopped")
        return f"stopped: {SessionState.STOPPED.value}"

    def _clear(self) -> str:
        self._session.clear(self._now_s())
        self._availability.restore()
        self._publish_changes(last=True)
        self._give_up_attempt("cleared")
        self._outgoing.publish_layout()
        return self._session.state.value

    def _configure(self) -> str:
        self._session.configure(self._now_s())
        self._availability.restore()
        self._give_up_attempt("configured")
        self._outgoing.publish_layout(always=True)
        self._publish_changes()
        return f"{self._session.known.sum()} of {self._session.plane.n} robots configured"

    def _disable(self, ids: Sequence[int], reason: str) -> None:
        if not self._lock.acquire(timeout=_ANSWER_S):
            raise SessionError("robots cannot be disabled or enabled while a plan is under way")
        try:
            changed = sorted(set(ids) ^ set(self._availability.disabled))
            moving = self._session.state is SessionState.MOVING
            if changed and (moving or self._awaited is not None):
                verb = "disabled" if changed[0] in ids else "enabled"
                raise SessionError(f"robot {changed[0]} cannot be {verb} while a plan is under way")
            self._availability.disable(ids, reason)
            self._session.enable(self._availability.enabled)
            self._outgoing.publish_layout()
        finally:
            self._lock.release()
        self._reporter.publish()
        self.get_logger().info(f"disabled by operators: {sorted(ids) or 'no robot'}")

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
        self._now_s()
        self._outgoing.publish_frames(None if self._current is None else self._current.stamp)
        self._outgoing.publish_encoders()
        if self._current is None:
            return
        loaded_plan = self._session.loaded_plan
        if self._session.state is SessionState.MOVING and loaded_plan is not None:
            makespan_s = max(loaded_plan.motion.decoded().makespan_s, _TICK_S)
            fraction = np.clip((self._time_s - loaded_plan.start_s) / makespan_s, 0.0, 1.0)
            self._reporter.progress(self._current, float(fraction), "robots are moving")
        elif (result := self._session.take_result()) is not None:
            self._finish_attempt(self._current, result, last)


def main(args: list[str] | None = None) -> int:
    """Run the bridge until it is interrupted."""
    return run(BridgeNode, args)

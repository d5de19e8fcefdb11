"""The bus bridge as a node: segments in, bytes on the buses, outcomes out."""

import threading
import time
from pathlib import Path

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_bus_bridge.bus import bus_timing
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.disabled_parameter import declare_availability, follow_operators
from fiber_bus_bridge.node.hardware import device_hardware, simulated_hardware
from fiber_bus_bridge.node.plan_inputs import PlanInputs
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.replanning import Replanning
from fiber_bus_bridge.session import Session, SessionState
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.simulation.config import SimulationConfig
from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.outcomes import Outcome
from fiber_msgs_py import Attempt, AttemptTable, MessageError, PlanStamp, targets, topics
from fiber_node import Reporter, declare_parameters, run

__all__ = ["BridgeNode", "main"]

_TICK_S = 0.1  # time of the buses between two looks at moving robots
_SOON_S = 1e-3
_LOOK_S = 0.5  # how often it is seen whether orders planned again have been waited for too long


class BridgeNode(Node):
    """Carries plans to positioners and says what became of every robot.

    The time of simulated buses goes on only while robots move, `time_scale` seconds a second.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options):
        super().__init__("bridge", **options)
        simulation = declare_parameters(self, SimulationConfig)
        safety = declare_parameters(self, Safety, "safety")
        scale = self._positive("time_scale", 1.0)
        self._most = self._positive("attempts", 2, "is less than one", least=1)
        self._patience_s = self._positive("attempt_timeout_s", 60.0)
        self.declare_parameter("devices", Parameter.Type.STRING_ARRAY)
        none = Parameter("devices", Parameter.Type.STRING_ARRAY, [])
        devices = self.get_parameter_or("devices", none).value
        if devices:
            hardware = device_hardware(simulation, devices)
        else:
            hardware = simulated_hardware(simulation)
        plane, buses = hardware.plane, hardware.buses
        self._units, self._bus_clock, self._slice_s = (
            hardware.units,
            hardware.clock,
            hardware.slice_s,
        )
        self._capture = self.declare_parameter("capture", "").value
        if self._capture:
            buses = Tap(buses, bus_timing(simulation.clock))
        self._buses = buses
        config = declare_parameters(self, SessionConfig, "session")
        self._session = Session(plane, self._units, safety, buses, hardware.start, config)
        self._lock, self._halt = threading.Lock(), threading.Event()
        self._time_s = self._due_s = 0.0
        self._current: Attempt | None = None  # the attempt whose orders the session has
        self._announced = AttemptTable()  # later attempts that this node has asked for
        self._notes = PlanInputs(plane)
        self._attempts = Replanning(np.full((plane.n, 2), np.nan), 1)
        self._ordered = np.zeros(plane.n, dtype=bool)  # robots with orders in this attempt
        self._again: Attempt | None = None  # the attempt whose orders are waited for
        self._again_until_s = 0.0
        self._roster = declare_availability(self, plane)
        self._session.enable(self._roster.enabled)

        self._tell = Publishers(self, self._session, self._roster)
        self._report = Reporter(self, "bridge", self._tell.statuses)
        self._targets = topics.TARGETS.publisher(self)
        topics.TARGETS.subscription(self, self._on_targets)
        topics.HELD_BY_PLANNER.subscription(self, self._on_held)
        topics.HELD_BY_DISCRETIZER.subscription(self, self._on_held)
        topics.SEGMENTS.subscription(self, self._on_segments)
        for service, call in (
            (topics.START, self._start),
            (topics.HOME, self._home),
            (topics.CLEAR, self._clear),
            (topics.CONFIGURE, self._configure),
        ):
            service.server(self, self._served(call))
        # stop is served while another call is at work
        alone = MutuallyExclusiveCallbackGroup()
        topics.STOP.server(self, self._on_stop, callback_group=alone)
        follow_operators(self, self._disable, self._report.refuse)
        pause_s = _TICK_S / scale if scale and not devices else _SOON_S
        self._timer = self.create_timer(pause_s, self._tick)
        self._timer.cancel()
        self.create_timer(_LOOK_S, self._look_at_clock)
        self._configure()
        self.get_logger().info(f"{plane.n} robots on {len(self._session.link.buses)} buses")

    def _positive(self, name, default, problem="is negative", least=0):
        value = self.declare_parameter(name, default).value
        if not value >= least:
            raise MessageError("parameters", problem, field=name, value=value)
        return value

    # --- plans ---------------------------------------------------------------

    def _on_targets(self, message):
        try:
            self._notes.hear_targets(message)
            with self._lock:
                if self._again is not None and PlanStamp.of(message) > self._again.stamp:
                    self._give_up_attempt("there are new targets")
        except FiberError:
            pass  # the planner says so

    def _on_held(self, message):
        try:
            self._notes.hear_held(message)
        except FiberError as error:
            self._report.refuse(f"held refused: {error}")

    def _on_segments(self, message):
        with self._lock:
            again = False
            try:
                stamp = PlanStamp.of(message)
                attempt = self._announced.find(stamp) or Attempt.first(stamp)
                again = attempt == self._again
                if attempt.number > 1 and not again:
                    self._report.drop(f"segments {attempt} dropped: this attempt has ended")
                elif self._current is not None and stamp <= self._current.stamp:
                    dropped = f"segments {attempt} dropped: plan {self._current} is not older"
                    self._report.drop(dropped)
                else:
                    self._take_orders(attempt, message)
            except FiberError as error:
                self._report.refuse(f"segments refused: {error}")
                if again:
                    self._give_up_attempt("its orders were refused")

    def _take_orders(self, attempt, message):
        motion = self._notes.motion(message, self._units, self._session.counts)
        asked, again = self._notes.asked(attempt.stamp), attempt == self._again
        if not again:
            self._give_up_attempt("there are new orders")
        replaced = self._session.submit(motion, asked)
        if replaced is not None:
            self._attempt_ends(replaced, last=True)
        if not again:
            unasked = np.full((self._session.plane.n, 2), np.nan)
            self._attempts = Replanning(*((unasked, 1) if asked is None else (asked, self._most)))
        self._current, self._again = attempt, None
        self._ordered = np.diff(motion.offsets).reshape(-1, 2).any(axis=1)
        self._report.done(attempt, f"ready: orders for {self._ordered.sum()} robots")
        if again:  # start was asked for this plan
            self.get_logger().info(self._start())

    def _attempt_ends(self, result, last):
        """Take what came of an attempt; ask for another, or tell the outcome of the plan."""
        result = result.explained_by(self._notes.reasons(self._current.stamp))
        self._roster.leave_out(result, self._session.known)
        asked = self._notes.asked(self._current.stamp)
        asked = False if asked is None else np.isfinite(asked).all(axis=1)
        self._attempts.add(self._roster.explain(result), asked)
        again = self._attempts.again(self._ordered, self._roster.commandable(self._session.known))
        stamp = self._notes.free_stamp_after(self._current.stamp)
        if last or self._halt.is_set() or not again.any() or stamp is None:
            self._tell.plane()
            self._publish_outcome()
        else:
            self._ask_again(again, stamp)

    def _ask_again(self, robots, stamp):
        """Have a plan planned again for some robots, with all others as obstacles."""
        self._session.clear(self._now_s())  # reads where all stand, the failed too if they answer
        now_ns = self._tell.now_ns()
        self._again = self._current.next(stamp, since_ns=now_ns)
        self._announced.add(self._again)
        self._again_until_s = time.monotonic() + self._patience_s
        self._tell.plane(always=True, now_ns=now_ns)
        ids, goals = self._session.plane.ids[robots], self._attempts.goals[robots]
        message = targets.encode_attempt(ids, goals, self._again)
        self._notes.hear_targets(message)
        self._targets.publish(message)
        held = int((robots & (self._attempts.result.outcome == Outcome.HELD)).sum())
        said = f"planned again: {held} robots were held for others that cannot be commanded"
        self.get_logger().info(f"plan {self._again}: {said}")
        self._report.progress(self._again, 0.0, said)

    def _give_up_attempt(self, why):
        """End a plan whose next attempt is waited for, with what there is."""
        if self._again is not None:
            self.get_logger().warning(f"plan {self._again} given up: {why}")
            self._again = None
            self._publish_outcome()

    def _look_at_clock(self):
        with self._lock:
            if self._again is not None and time.monotonic() > self._again_until_s:
                self._report.drop(
                    f"plan {self._again}: no orders within {self._patience_s:g} s, it ends without"
                )
                self._give_up_attempt("no orders came")

    def _publish_outcome(self):
        result, plan = self._attempts.result, Attempt.first(self._current.plan)
        self._tell.outcome(result, plan.stamp)
        counts = np.bincount(result.outcome, minlength=len(Outcome))
        said = ", ".join(f"{counts[o]} {o.name.lower()}" for o in Outcome)
        made = self._attempts.made
        self._report.counters |= {"plan": plan, "outcome": said, "attempts": made}
        self._report.done(plan, said if made == 1 else f"{said}, in {made} attempts")
        if self._capture:
            self._buses.write(Path(self._capture) / str(plan))

    # --- services ------------------------------------------------------------

    def _served(self, call):
        """A Trigger service: the core's refusal is the answer, and the node lives on."""

        def serve(_, response):
            try:
                with self._lock:
                    response.message = call()
                response.success = True
            except FiberError as error:
                response.success, response.message = False, str(error)
                self._report.refuse(str(error))
            return response

        return serve

    def _start(self):
        self._session.start(self._now_s(), self._may_go)
        return self._under_way()

    def _home(self):
        self._give_up_attempt("the robots go home")
        self._session.home(self._now_s(), self._may_go)
        self._current = Attempt.first(PlanStamp(self._tell.now_ns()))
        self._attempts = Replanning(np.full((self._session.plane.n, 2), np.nan), 1)
        return self._under_way()

    def _may_go(self):
        return not self._halt.is_set()

    def _under_way(self):
        started = int(self._session.upload.started.sum())
        current = self._current
        self._after()
        if self._session.state is SessionState.MOVING:
            self._due_s = self._time_s
            self._timer.reset()
        return f"plan {current}: {started} robots started"

    def _on_stop(self, request, response):
        self._halt.set()  # a start that is not through its checks yet will not go
        try:
            return self._served(self._stop)(request, response)
        finally:
            self._halt.clear()

    def _stop(self):
        self._session.stop(self._now_s())
        self._after(last=True)
        self._give_up_attempt("stopped")
        return f"stopped: {SessionState.STOPPED.value}"

    def _clear(self):
        self._session.clear(self._now_s())
        self._roster.take_back()
        self._after(last=True)
        self._give_up_attempt("cleared")
        self._tell.plane()
        return self._session.state.value

    def _configure(self):
        self._session.configure(self._now_s())
        self._roster.take_back()
        self._give_up_attempt("configured")
        self._tell.plane(always=True)
        self._after()
        return f"{self._session.known.sum()} of {self._session.plane.n} robots configured"

    def _disable(self, ids, why):
        with self._lock:
            changed = sorted(set(ids) ^ set(self._roster.disabled))
            under_way = self._session.state is SessionState.MOVING or self._again is not None
            if changed and under_way:
                what = f"{changed[0]}: cannot be {'dis' if changed[0] in ids else 'en'}abled"
                raise SessionError(f"robot {what} while a plan is under way")
            self._roster.disable(ids, why)
            self._session.enable(self._roster.enabled)
            self._tell.plane()
        self._report.publish()
        self.get_logger().info(f"disabled by operators: {sorted(ids) or 'nobody'}")

    # --- what the robots do --------------------------------------------------

    def _now_s(self):
        """The time of the buses [s]."""
        self._time_s = max(self._time_s, self._session.link.now_s, self._bus_clock())
        return self._time_s

    def _tick(self):
        with self._lock:
            if self._session.state is SessionState.MOVING:
                self._watch()
                self._after()
            else:
                # here, and never from the thread that serves stop: a timer cancelled when it is
                # due fails in rclpy as it is taken, and its whole callback group with it
                self._timer.cancel()

    def _watch(self):
        # from tick to tick, whatever time the polling takes on the buses
        until_s = max(self._due_s, self._bus_clock()) + _TICK_S
        while self._due_s < until_s and self._session.state is SessionState.MOVING:
            self._due_s = min(max(self._due_s, self._bus_clock()) + self._slice_s, until_s)
            self._session.advance(self._due_s)
            if self._halt.is_set():
                return

    def _after(self, last=False):
        """Tell everybody what a call has changed; after the last a plan is not tried again."""
        self._now_s()
        self._tell.frames(None if self._current is None else self._current.stamp)
        self._tell.state()
        if self._session.state is SessionState.MOVING:
            motion = self._session.upload
            lasts = max(motion.motion.decoded().makespan_s, _TICK_S)
            gone = np.clip((self._time_s - motion.start_s) / lasts, 0.0, 1.0)
            self._report.progress(self._current, gone, "robots are moving")
            return
        if self._session.result is not None and self._current is not None:
            self._attempt_ends(self._session.take_result(), last)


def main(args=None) -> int:
    """Run the bridge until it is interrupted."""
    return run(BridgeNode, args)

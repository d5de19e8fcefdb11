"""The bus bridge as a node: segments in, bytes on the buses, outcomes out."""

import threading
from pathlib import Path

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.node.frame_log import frame_log
from fiber_bus_bridge.node.notes import PlanNotes
from fiber_bus_bridge.session import Session, SessionConfig, SessionState
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses, simulated_plane
from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.outcomes import Outcome
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    Level,
    MessageError,
    PlanStamp,
    Status,
    frames,
    joint_states,
    layout,
    outcome,
    topics,
)
from fiber_node import Reporter, declare_settings, run

__all__ = ["BridgeNode", "main"]

_TICK_S = 0.1  # simulated time between two looks at moving robots


class BridgeNode(Node):
    """Carries plans to simulated positioners and says what became of every robot.

    Simulated time goes on only while robots move, `time_scale` seconds a second.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options):
        super().__init__("bridge", **options)
        simulation = declare_settings(self, SimulationConfig)
        safety = declare_settings(self, Safety, "safety")
        scale = self.declare_parameter("time_scale", 1.0).value
        if not scale >= 0:
            raise MessageError("parameters", "is negative", field="time_scale", value=scale)
        plane, start = simulated_plane(simulation)
        self._plane, self._units = plane, WireUnits.for_plane(plane)
        buses = simulated_buses(plane, self._units, start, simulation)
        self._capture = self.declare_parameter("capture", "").value
        if self._capture:
            buses = Tap(buses, buses.timing)
        self._buses = buses
        config = declare_settings(self, SessionConfig, "session")
        self._session = Session(plane, self._units, safety, buses, start, config)
        self._lock, self._halt = threading.Lock(), threading.Event()
        self._time_s = self._due_s = 0.0
        self._stamp: PlanStamp | None = None
        self._notes = PlanNotes(plane)

        self._report = Reporter(self, "bridge", self._bus_statuses)
        self._layout = topics.LAYOUT.publisher(self)
        self._joint_states = topics.JOINT_STATES.publisher(self)
        self._frames = topics.FRAMES.publisher(self)
        self._outcome = topics.OUTCOME.publisher(self)
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
        self._timer = self.create_timer(_TICK_S / scale if scale else 1e-3, self._tick)
        self._timer.cancel()
        self._configure()
        self._publish_state()
        self.get_logger().info(f"{plane.n} robots on {len(self._session.link.buses)} buses")

    # --- plans ---------------------------------------------------------------

    def _on_targets(self, message):
        try:
            self._notes.hear_targets(message)
        except FiberError:
            pass  # the planner says so

    def _on_held(self, message):
        try:
            self._notes.hear_held(message)
        except FiberError as error:
            self._report.refuse(f"held refused: {error}")

    def _on_segments(self, message):
        try:
            stamp = PlanStamp.of(message)
            if self._stamp is not None and stamp <= self._stamp:
                self._report.drop(f"segments {stamp} dropped: plan {self._stamp} is not older")
                return
            with self._lock:
                motion = self._notes.motion(message, self._units, self._session.counts)
                replaced = self._session.submit(motion, self._notes.asked(stamp))
                if replaced is not None:
                    self._publish_outcome(replaced)
                self._stamp = stamp
        except FiberError as error:
            self._report.refuse(f"segments refused: {error}")
            return
        moving = int(np.diff(motion.offsets).reshape(-1, 2).any(axis=1).sum())
        self._report.done(stamp, f"ready: orders for {moving} robots")

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
        self._session.start(self._time_s, self._may_go)
        return self._under_way()

    def _home(self):
        self._session.home(self._time_s, self._may_go)
        self._stamp = PlanStamp(self.get_clock().now().nanoseconds)
        return self._under_way()

    def _may_go(self):
        return not self._halt.is_set()

    def _under_way(self):
        started = int(self._session.upload.started.sum())
        self._after()
        if self._session.state is SessionState.MOVING:
            self._due_s = self._time_s
            self._timer.reset()
        return f"plan {self._stamp}: {started} robots started"

    def _on_stop(self, request, response):
        self._halt.set()  # a start that is not through its checks yet will not go
        try:
            return self._served(self._stop)(request, response)
        finally:
            self._halt.clear()

    def _stop(self):
        self._session.stop(self._time_s)
        self._after()
        return f"stopped: {SessionState.STOPPED.value}"

    def _clear(self):
        self._session.clear(self._time_s)
        self._after()
        return self._session.state.value

    def _configure(self):
        self._session.configure(self._time_s)
        stamp = PlanStamp(self.get_clock().now().nanoseconds)
        self._layout.publish(layout.encode(self._plane, self._units, stamp))
        self._after()
        return f"{self._session.known.sum()} of {self._plane.n} robots configured"

    # --- what the robots do --------------------------------------------------

    def _tick(self):
        with self._lock:
            if self._session.state is SessionState.MOVING:
                # from tick to tick, whatever time the polling takes on the buses
                self._due_s += _TICK_S
                self._session.advance(self._due_s)
                self._after()
            else:
                # here, and never from the thread that serves stop: a timer cancelled when it is
                # due fails in rclpy as it is taken, and its whole callback group with it
                self._timer.cancel()

    def _after(self):
        """Tell everybody what a call has changed."""
        self._time_s = max(self._time_s, self._session.link.now_s)
        self._publish_frames()
        self._publish_state()
        if self._session.state is SessionState.MOVING:
            motion = self._session.upload
            lasts = max(motion.motion.decoded().makespan_s, _TICK_S)
            gone = np.clip((self._time_s - motion.start_s) / lasts, 0.0, 1.0)
            self._report.progress(self._stamp, gone, "robots are moving")
            return
        if self._session.result is not None and self._stamp is not None:
            self._publish_outcome(self._session.take_result())

    def _publish_outcome(self, result):
        result = result.explained_by(self._notes.reasons(self._stamp))
        self._outcome.publish(
            outcome.encode(
                self._plane.ids, result.outcome, result.reason, result.error_mm, self._stamp
            )
        )
        counts = np.bincount(result.outcome, minlength=len(Outcome))
        said = ", ".join(f"{counts[o]} {o.name.lower()}" for o in Outcome)
        self._report.counters |= {"plan": self._stamp, "outcome": said}
        self._report.done(self._stamp, said)
        if self._capture:
            self._buses.write(Path(self._capture) / str(self._stamp))

    def _publish_state(self):
        speeds = self._session.velocities
        stamp_ns = self.get_clock().now().nanoseconds
        self._joint_states.publish(
            joint_states.encode(self._plane.ids, self._session.angles, speeds, stamp_ns)
        )

    def _publish_frames(self):
        traffic = self._session.link.take_traffic()
        if traffic and self._stamp is not None and self._frames.get_subscription_count() > 0:
            self._frames.publish(frames.encode(frame_log(traffic), self._stamp))

    def _bus_statuses(self):
        link = self._session.link
        for bus, figures in link.counters.table().items():
            here = np.flatnonzero(self._plane.bus == bus)
            worst = here[np.argmax(link.failures[here])]
            if link.failures[worst]:
                named = {"robot": self._plane.ids[worst], "failures": link.failures[worst]}
                figures |= {f"worst_{name}": int(value) for name, value in named.items()}
            figures |= {"given_up": int(link.given_up[link.at(bus)])}
            bad = sum(figures[n] for n in ("no_address", "refused", "line_errors", "bad_replies"))
            level, text = (Level.WARN, f"{bad} frames failed") if bad else (Level.OK, "good")
            yield Status(f"bridge: bus {bus}", level, text, figures, f"i2c-{bus}")


def main(args=None) -> int:
    """Run the bridge until it is interrupted."""
    return run(BridgeNode, args)

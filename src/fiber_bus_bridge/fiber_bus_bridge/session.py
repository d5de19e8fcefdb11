"""A controller's session with a focal plane: configure, take orders, start, watch, stop."""

from collections.abc import Callable
from dataclasses import replace
from enum import Enum

import numpy as np

from fiber_bus_bridge.bus import BusBackend, addresses_of
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.home import home_motion
from fiber_bus_bridge.loader import LoadedPlan, Loader
from fiber_bus_bridge.plan_result import Plan, PlanResult, judge
from fiber_bus_bridge.remaining_motion import remaining_motion
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.start_stop import StartStop
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import Alert, Configuration, Opcode, RobotState, encode_config
from fiber_core.clearance import Safety, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["Session", "SessionState"]


_CONFIGS = 2  # times a robot is configured that then reports a fault


class SessionState(Enum):
    """What a session may be asked next; the value is the advice given with a refusal."""

    UNCONFIGURED = "configure first"
    IDLE = "send orders, or home"
    READY = "start, or clear to drop the orders"
    MOVING = "wait for the end, or stop"
    STOPPED = "clear first"


class Session:
    """Everything a bridge does, without a clock: each call is told the simulated time.

    Calls that use the bus return when the bus is free again [s]; a later call at an
    earlier time waits for that. Each robot of each plan gets exactly one outcome, in
    `result` from the moment the plan ends until the next one begins.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of the wire format.
        safety: clearance asked of everything that is started.
        backend: the buses.
        believed: where robots that never answered are held to be [rad], shape (n, 2).
        config: settings.

    Raises:
        TopologyError: the plane's addresses are impossible.
        SessionError: `believed` does not fit the plane.
    """

    def __init__(
        self,
        plane: FocalPlane,
        units: WireUnits,
        safety: Safety,
        backend: BusBackend,
        believed,
        config: SessionConfig | None = None,
    ):
        believed = np.asarray(believed, dtype=float)
        if believed.shape != (plane.n, 2) or not np.isfinite(believed).all():
            raise SessionError(f"believed angles {believed.shape} do not fit {plane.n} robots")
        self.plane, self.units, self.config = plane, units, config or SessionConfig()
        self.link = Transactions(backend, addresses_of(plane))
        self.state = SessionState.UNCONFIGURED
        self.counts = units.encoder_counts(plane, believed)
        self.known = np.zeros(plane.n, dtype=bool)
        self.robot_state = np.zeros(plane.n, dtype=np.int64)
        self.robot_fault = np.zeros(plane.n, dtype=np.int64)
        self.alerts = np.zeros(plane.n, dtype=np.int64)
        self.result: PlanResult | None = None
        self.upload: LoadedPlan | None = None
        self.uploads: list[LoadedPlan] = []  # all of the last plan
        self._may_go: Callable[[], bool] = lambda: True
        self._boot = np.full(plane.n, -1)
        self._lost = np.zeros(plane.n, dtype=bool)  # last heard, or started, while it moved
        self._arrived = np.zeros(plane.n, dtype=bool)
        self._failed = np.zeros(plane.n, dtype=bool)
        self._velocities = np.zeros((plane.n, 2))
        self._read_s = np.full(plane.n, -np.inf)
        self._plan: Plan | None = None
        silence_s = 1e-3 * self.config.silence_ms
        self._starter = StartStop(
            self.link, silence_s, self.config.watch_s, self.config.stretch_s,
            0.25 * safety.start_skew_s, self._hear,
        )  # fmt: skip
        self._uploader = Loader(
            plane, units, safety, self.link, neighbour_pairs(plane), self._starter
        )
        # inside the limits, so that what a robot accepts is inside them too
        self._limits = units.range_counts(plane)
        speed = np.floor(plane.speeds / units.velocity_rad_s).astype(np.int64)
        self._speed = np.minimum(speed, units.max_velocity)

    @property
    def angles(self) -> np.ndarray:
        """Joint angles by the robots' own encoders, last read or believed [rad], shape (n, 2)."""
        return self.units.to_angles(self.counts)

    @property
    def velocities(self) -> np.ndarray:
        """Mean joint speeds between the last two readings, 0 at rest [rad/s], shape (n, 2)."""
        if self.state is not SessionState.MOVING:
            return np.zeros(self.counts.shape)
        return self._velocities

    def take_result(self) -> PlanResult | None:
        """Return the result of the plan that has ended since the last call, if there is one."""
        taken, self.result = self.result, None
        return taken

    def enable(self, enabled) -> None:
        """Say who may move from now on, shape (n,); the others are obstacles where they are.

        Raises:
            SessionError: robots are moving.
        """
        self._require("change who may move", *set(SessionState) - {SessionState.MOVING})
        self.plane = self._uploader.plane = self.plane.with_enabled(enabled)

    def configure(self, t: float) -> float:
        """Find out who is there, check identities, and send units, limits and speeds.

        Robots that do not answer, or answer with another serial number, stay unknown and
        are obstacles where they are believed to be; a later call tries them again.

        Raises:
            SessionError: robots are moving, or stopped and not cleared, or orders wait.
        """
        self._require("configure", SessionState.UNCONFIGURED, SessionState.IDLE)
        everybody = np.arange(self.plane.n)
        self.link.revive(power=True, t=t)
        identity = self.link.identities(everybody, t)
        rows = np.flatnonzero(identity.ok & (identity.serial == self.plane.ids))
        self.known = np.zeros(self.plane.n, dtype=bool)
        for _ in range(_CONFIGS):
            todo = rows[~self.known[rows]]
            config = Configuration(
                self.units,
                self._limits[todo],
                self._speed[todo],
                self.config.watchdog_ms,
                self.config.silence_ms,
            )
            self.link.send(todo, encode_config(config, self.link.addresses[todo]), t)
            status = self._sweep(todo, t)
            # a fault may be of a frame that was not meant for it; then the next try tells
            self.known[todo] = (
                status.ok & (status.state != RobotState.UNCONFIGURED) & (status.fault == 0)
            )
            self._boot[todo] = status.boot
        halted = np.isin(self.robot_state, (RobotState.STOPPED, RobotState.FAULT)) & self.known
        self.state = SessionState.STOPPED if halted.any() else SessionState.IDLE
        return self.link.now_s

    def submit(self, motion: WireMotion, targets=None) -> PlanResult | None:
        """Take the orders of the next plan; nothing goes to the robots yet.

        Args:
            motion: orders of every robot, from where its encoders are.
            targets: where each fibre should go [mm], shape (n, 2), nan = nothing asked; by
                default the end of the motion, for those that move.

        Returns:
            The result of the plan that waited and is replaced, if there was one.

        Raises:
            SessionError: in this state orders are not taken, or they do not fit the plane,
                the units, or where a robot stands; names the robot.
        """
        self._require("submit", SessionState.IDLE, SessionState.READY)
        if motion.units != self.units:
            raise SessionError(f"orders in {motion.units}, robots configured for {self.units}")
        if motion.start.shape != self.counts.shape:
            raise SessionError(f"orders for {len(motion.start)} robots, not {self.plane.n}")
        plan = Plan.of(self.plane, motion, self.counts, targets)
        off = np.abs(motion.start - self.counts).max(axis=1, initial=0) * self.units.quantum_rad
        wrong = plan.moves & self.known & (off > self.config.start_tolerance_rad)
        if wrong.any():
            at = int(np.argmax(wrong))
            raise SessionError(
                f"robot {self.plane.ids[at]}: orders begin at {motion.start[at].tolist()} quanta, "
                f"its encoders are at {self.counts[at].tolist()}"
            )
        replaced = self._end() if self._plan else None
        self._plan, self.upload, self.result = plan, None, None
        self._arrived[:] = self._failed[:] = False
        self.state = SessionState.READY
        return replaced

    def start(self, t: float, may_go: Callable[[], bool] = lambda: True) -> float:
        """Load, verify, certify and, if nobody objects by then, go.

        Robots that cannot be verified or certified stay where they are and say why. When
        nobody is started the plan ends at once.

        Raises:
            SessionError: there are no orders to start, or the robots are moving or stopped.
        """
        self._require("start", SessionState.READY)
        plan = self._plan
        self.link.revive()
        self._may_go, self.uploads = may_go, []
        wanted = plan.moves & self.plane.enabled & ~plan.crowded & self.known
        self._begin(wanted, t)
        return self._watch()

    def advance(self, t: float) -> float:
        """MotionMonitor the robots until time t; end the plan when all have arrived or time is up.

        A robot that stops by itself, or falls silent, stops everybody. In other states
        nothing is done.
        """
        if self.state is not SessionState.MOVING:
            return self.link.now_s
        watch = self.upload.watch
        while watch.now_s < t and watch.freeze_s is None and watch.running.any():
            watch.step()
        return self._watch()

    def stop(self, t: float) -> float:
        """Stop every robot, from any state: a general call, then one by one who has not."""
        self.link.revive()
        rows = np.flatnonzero(self.known) if self.known.any() else np.arange(self.plane.n)
        status = self._starter.stop(rows, t)
        self.robot_state[rows] = status.state
        if self._plan:
            self._end()
        self.state = SessionState.STOPPED
        return self.link.now_s

    def clear(self, t: float) -> float:
        """Forget orders, faults and a stop; robots stay where they are.

        Raises:
            SessionError: robots are moving, or nobody is configured.
        """
        self._require("clear", SessionState.IDLE, SessionState.READY, SessionState.STOPPED)
        if self._plan:
            self._end()
        self.link.revive()
        rows = np.flatnonzero(self.known) if self.known.any() else np.arange(self.plane.n)
        self.link.command(Opcode.CLEAR, rows, t)
        self._sweep(rows, t)
        self.state = SessionState.IDLE if self.known.any() else SessionState.UNCONFIGURED
        return self.link.now_s

    def home(self, t: float, may_go: Callable[[], bool] = lambda: True) -> float:
        """Fold every robot that safely can: phi to its upper limit, theta still.

        Goes the way of all orders. Robots held the first time may fold the next.

        Raises:
            SessionError: in this state the robots cannot be moved.
        """
        self._require("home", SessionState.IDLE)
        chosen = self.plane.enabled & self.known
        motion = home_motion(
            self.units, self.counts, self._limits[:, 1, 1], self._speed[:, 1], chosen
        )
        self.submit(motion)
        return self.start(t, may_go)

    def _require(self, call, *states):
        if self.state not in states:
            raise SessionError(f"cannot {call} while {self.state.name}: {self.state.value}")

    def _sweep(self, rows, t):
        """Read robots; a silent one has state 0 and keeps its last position."""
        status = self.link.statuses(rows, t)
        self.robot_state[rows] = status.state
        self._hear(rows[status.ok], status.only(status.ok), self.link.now_s)
        return status

    def _hear(self, rows, status, t):
        """Take note of valid statuses read at time t."""
        way = (status.position - self.counts[rows]) * self.units.quantum_rad
        passed = np.maximum(t - self._read_s[rows], 1e-9)[:, None]
        moves = (status.state == RobotState.MOVING)[:, None]
        self._velocities[rows] = np.where(moves, way / passed, 0.0)
        self._read_s[rows] = t
        self.counts[rows] = status.position
        self.robot_state[rows] = status.state
        self.robot_fault[rows] = status.fault
        self.alerts[rows] = status.alerts
        self._lost[rows] = status.state == RobotState.MOVING

    def _watch(self):
        """End the plan when all have arrived; stop all when time is up or one must be stopped."""
        watch = self.upload.watch
        if watch is None:
            self._end()
            return self.link.now_s
        self._arrived = self.upload.started & watch.arrived
        running = self.upload.started & ~self._arrived
        motion, safety = self.upload.motion.decoded(), self._uploader.safety
        late = safety.clock_ppm * 1e-6 * motion.makespan_s + safety.start_skew_s
        if watch.freeze_s is not None:
            return self._freeze(watch)
        if not running.any():
            self._end()
        elif watch.now_s > self.upload.start_s + motion.makespan_s + late + self.config.grace_s:
            self._failed |= running
            return self.stop(watch.now_s)
        return max(watch.now_s, self.link.now_s)

    def _begin(self, wanted, t):
        """LoadedPlan the plan for the wanted robots and start them."""
        self.upload = self._uploader.run(
            self._plan.motion, wanted, self.known, self._boot, self._lost, t, self._may_go
        )
        self.uploads.append(self.upload)
        self._lost |= self.upload.started
        self.state = SessionState.MOVING

    def _freeze(self, watch):
        """Stop everybody together, and let those go on who can."""
        before, t = self.upload, watch.freeze_s
        self.link.revive()
        running = before.started & ~self._arrived
        rows = np.flatnonzero(self.known)
        status = self._starter.stop(rows, t)
        self.robot_state[rows] = status.state
        # faults may be of garbled frames meanwhile; alerts stay
        silent = (self.robot_state == RobotState.FAULT) & (self.alerts & Alert.SILENT != 0)
        fit = (self.robot_state == RobotState.STOPPED) | silent
        fit &= (self.alerts & (Alert.STALLED | Alert.REBOOTED) == 0) & ~self._lost
        fit[rows] &= status.ok & (status.boot == self._boot[rows])
        # who heard no HEARTBEAT though its bus did will not hear the next either
        bus = self.link.at(self.plane.bus)
        heard = np.unique(bus[running & (self.robot_state == RobotState.STOPPED)])
        fit &= ~(silent & np.isin(bus, heard))
        self._failed |= running & ~fit
        if len(self.uploads) > self.config.resumes or not self._may_go():
            return self.stop(self.link.now_s)
        self.link.command(Opcode.CLEAR, rows[fit[rows]], self.link.now_s)
        elapsed_s, goes_on, crowded = t - before.start_s, running & fit, self._plan.crowded
        left = remaining_motion(before.motion, self.counts, elapsed_s, self._speed, goes_on)
        self._plan = Plan(left, self._plan.goals)
        self._begin(goes_on & self._plan.moves & ~self._plan.crowded, self.link.now_s)
        stays = running & ~self.upload.started & (self.upload.reason == Reason.OK)
        # who was left behind before keeps its reason
        reason = np.where(self.upload.reason == Reason.OK, before.reason, self.upload.reason)
        reason[crowded] = Reason.TOO_MANY_SEGMENTS
        reason[stays] = Reason.STOPPED
        self.upload = self.uploads[-1] = replace(self.upload, reason=reason)
        return self._watch()

    def _end(self):
        """Judge the plan and forget it; silent robots of a plan cut short have failed."""
        if self.upload:
            self._failed |= self.upload.started & ~self._arrived & (self.robot_state == 0)
        self.result = judge(
            self.plane,
            self._plan,
            self.upload,
            self.counts,
            self.known,
            self._arrived,
            self._failed,
            self.config.tolerance_mm,
        )
        self._plan = None
        self.state = SessionState.IDLE
        return self.result

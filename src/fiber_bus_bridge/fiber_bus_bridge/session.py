"""A controller's session with a focal plane: configure, submit orders, start, advance, stop."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import BusBackend, addresses_of
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.home import home_motion
from fiber_bus_bridge.loader import LoadedPlan, Loader
from fiber_bus_bridge.plan_result import Plan, PlanResult, evaluate
from fiber_bus_bridge.remaining_motion import remaining_motion
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.session_state import SessionState
from fiber_bus_bridge.start_stop import StartStop
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import (
    Alert,
    Configuration,
    Opcode,
    RobotState,
    Statuses,
    encode_config,
    roll_call_slots,
)
from fiber_core.array_types import Angles, Counts, Mask, Rows, Velocities
from fiber_core.clearance import Safety, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["Session"]

_CONFIGS = 2  # attempts to configure a robot that reports a fault afterwards


class Session:
    """The controller of a focal plane, without a clock: each call is given the simulated time.

    Calls that use the buses return the time at which the buses are free [s]; a later call at an
    earlier time waits until then. Each robot of each plan gets exactly one outcome, in `result`
    from the end of the plan until the next plan begins.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of the wire format.
        safety: clearance required of every started motion.
        backend: the buses.
        assumed: angles of robots that have never answered [rad], shape (n, 2).
        config: settings.

    Raises:
        TopologyError: the plane's addresses are impossible.
        SessionError: `assumed` does not fit the plane.
    """

    def __init__(
        self,
        plane: FocalPlane,
        units: WireUnits,
        safety: Safety,
        backend: BusBackend,
        assumed: ArrayLike,
        config: SessionConfig | None = None,
    ):
        assumed = np.asarray(assumed, dtype=float)
        if assumed.shape != (plane.n, 2) or not np.isfinite(assumed).all():
            raise SessionError(
                f"assumed angles have shape {assumed.shape}, expected {(plane.n, 2)} finite values"
            )
        self.plane, self.units, self.config = plane, units, config or SessionConfig()
        self.transactions = Transactions(backend, addresses_of(plane))
        self.state = SessionState.UNCONFIGURED
        self.counts: Counts = units.encoder_counts(plane, assumed)
        self.known: Mask = np.zeros(plane.n, dtype=bool)
        self.robot_state = np.zeros(plane.n, dtype=np.int64)
        self.robot_fault = np.zeros(plane.n, dtype=np.int64)
        self.alerts = np.zeros(plane.n, dtype=np.int64)
        self.result: PlanResult | None = None
        self.loaded_plan: LoadedPlan | None = None
        self.loaded_plans: list[LoadedPlan] = []  # one for each phase of the last plan
        self._may_go: Callable[[], bool] = lambda: True
        self._boot = np.full(plane.n, -1)
        self._lost = np.zeros(plane.n, dtype=bool)  # moving at the last status, or since
        self._arrived, self._failed = np.zeros((2, plane.n), dtype=bool)
        self._velocities = np.zeros((plane.n, 2))
        self._read_s = np.full(plane.n, -np.inf)
        self._plan: Plan | None = None
        self._start_stop = StartStop(
            self.transactions, 1e-3 * self.config.silence_ms, self.config.heartbeat_period_s,
            self.config.stretch_s, 0.25 * safety.start_skew_s, self._handle_statuses,
        )  # fmt: skip
        pairs = neighbour_pairs(plane)
        self._loader = Loader(plane, units, safety, self.transactions, pairs, self._start_stop)
        # rounded inwards, so that every order that a robot accepts keeps the limits and speeds
        self._limits = units.range_counts(plane)
        speed = np.floor(plane.speeds / units.velocity_rad_s).astype(np.int64)
        self._speed = np.minimum(speed, units.max_velocity)

    @property
    def angles(self) -> Angles:
        """Joint angles by the robots' own encoders, last read or assumed [rad], shape (n, 2)."""
        return self.units.to_angles(self.counts)

    @property
    def velocities(self) -> Velocities:
        """Mean joint speeds between the last two readings, 0 at rest [rad/s], shape (n, 2)."""
        if self.state is not SessionState.MOVING:
            return np.zeros(self.counts.shape)
        return self._velocities

    def take_result(self) -> PlanResult | None:
        """Return the result of the plan that has ended since the last call, None without one."""
        taken, self.result = self.result, None
        return taken

    def enable(self, enabled: Mask) -> None:
        """Set the robots that may move from now on; the others are obstacles where they are.

        Args:
            enabled: robots that may move, shape (n,).

        Raises:
            SessionError: robots are moving.
        """
        self._require("enable or disable robots", *set(SessionState) - {SessionState.MOVING})
        self.plane = self._loader.plane = self.plane.with_enabled(enabled)

    def configure(self, t: float) -> float:
        """Identify the robots, and send units, limits and speeds to them.

        Robots that do not answer, or answer with another serial number, remain unknown and
        are obstacles at their assumed angles; a later call tries them again.

        Raises:
            SessionError: robots are moving, or stopped and not cleared, or orders wait.
        """
        self._require("configure", SessionState.UNCONFIGURED, SessionState.IDLE)
        all_rows = np.arange(self.plane.n)
        self.transactions.revive(power=True, t=t)
        identity = self.transactions.identities(all_rows, t)
        rows = np.flatnonzero(identity.ok & (identity.serial == self.plane.ids))
        self.known = np.zeros(self.plane.n, dtype=bool)
        for _ in range(_CONFIGS):
            todo = rows[~self.known[rows]]
            config = Configuration(
                self.units, self._limits[todo], self._speed[todo], self.config.watchdog_ms,
                self.config.silence_ms, roll_call_slots(self.transactions.addresses)[todo],
            )  # fmt: skip
            frames = encode_config(config, self.transactions.addresses[todo])
            self.transactions.send(todo, frames, t)
            status = self._read_statuses(todo, t)
            # the fault may be of a frame for another robot, so the robot is configured once more
            configured = (status.state != RobotState.UNCONFIGURED) & (status.fault == 0)
            self.known[todo] = status.ok & configured
            self._boot[todo] = status.boot
        halted = np.isin(self.robot_state, (RobotState.STOPPED, RobotState.FAULT)) & self.known
        self.state = SessionState.STOPPED if halted.any() else SessionState.IDLE
        return self.transactions.now_s

    def submit(self, motion: WireMotion, targets: ArrayLike | None = None) -> PlanResult | None:
        """Accept the orders of the next plan; no frame is sent yet.

        Args:
            motion: orders of every robot, from the positions of the encoders.
            targets: target of each fibre [mm], shape (n, 2), nan = no target; by default the end
                of the motion, for robots that move.

        Returns:
            The result of the waiting plan that is replaced, None without one.

        Raises:
            SessionError: orders are not accepted in this state, or they do not fit the plane,
                the units, or the encoders of a robot; names the robot.
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
        replaced = self._end_plan(self._plan) if self._plan else None
        self._plan, self.loaded_plan, self.result = plan, None, None
        self._arrived[:] = self._failed[:] = False
        self.state = SessionState.READY
        return replaced

    def start(self, t: float, may_go: Callable[[], bool] = lambda: True) -> float:
        """Load, verify and certify the orders, and start them unless `may_go` refuses.

        Robots that cannot be verified or certified stay where they are; their reasons are in the
        result. When no robot is started the plan ends at once.

        Args:
            t: earliest time [s].
            may_go: asked when the orders are certified; False drops all orders.

        Raises:
            SessionError: there are no orders to start, or the robots are moving or stopped.
        """
        plan = self._plan
        if plan is None or self.state is not SessionState.READY:
            raise self._refusal("start")
        self.transactions.revive()
        self._may_go, self.loaded_plans = may_go, []
        wanted = plan.moves & self.plane.enabled & ~plan.oversized & self.known
        return self._evaluate_motion(plan, self._start_phase(plan, wanted, t))

    def advance(self, t: float) -> float:
        """Supervise the robots until time t [s]; end the plan when all have arrived or on timeout.

        A robot that stops by itself, or is lost, makes all robots stop. In other states nothing
        is done.
        """
        plan, loaded_plan = self._plan, self.loaded_plan
        if self.state is not SessionState.MOVING or plan is None or loaded_plan is None:
            return self.transactions.now_s
        monitor = loaded_plan.monitor
        if monitor is not None:
            while monitor.now_s < t and monitor.stop_all_at_s is None and monitor.running.any():
                monitor.step()
        return self._evaluate_motion(plan, loaded_plan)

    def stop(self, t: float) -> float:
        """Stop every robot, in any state: by general call, then singly where needed."""
        self.transactions.revive()
        rows = self._known_or_all()
        status = self._start_stop.stop(rows, t)
        self.robot_state[rows] = status.state
        if self._plan:
            self._end_plan(self._plan)
        self.state = SessionState.STOPPED
        return self.transactions.now_s

    def clear(self, t: float) -> float:
        """Delete orders and faults, and leave the state STOPPED; robots stay where they are.

        Raises:
            SessionError: robots are moving, or no robot is configured.
        """
        self._require("clear", SessionState.IDLE, SessionState.READY, SessionState.STOPPED)
        if self._plan:
            self._end_plan(self._plan)
        self.transactions.revive()
        rows = self._known_or_all()
        self.transactions.command(Opcode.CLEAR, rows, t)
        self._read_statuses(rows, t)
        self.state = SessionState.IDLE if self.known.any() else SessionState.UNCONFIGURED
        return self.transactions.now_s

    def home(self, t: float, may_go: Callable[[], bool] = lambda: True) -> float:
        """Fold every robot that safely can: phi to its upper limit, theta still.

        The orders are loaded, verified and certified as those of every plan. Robots that are held
        in the first call may fold in the next.

        Args:
            t: earliest time [s].
            may_go: as in `start`.

        Raises:
            SessionError: the robots cannot be moved in this state.
        """
        self._require("home", SessionState.IDLE)
        chosen = self.plane.enabled & self.known
        motion = home_motion(
            self.units, self.counts, self._limits[:, 1, 1], self._speed[:, 1], chosen
        )
        self.submit(motion)
        return self.start(t, may_go)

    def _require(self, call: str, *states: SessionState) -> None:
        if self.state not in states:
            raise self._refusal(call)

    def _refusal(self, call: str) -> SessionError:
        return SessionError(f"cannot {call} while {self.state.name}: {self.state.value}")

    def _known_or_all(self) -> Rows:
        return np.flatnonzero(self.known) if self.known.any() else np.arange(self.plane.n)

    def _read_statuses(self, rows: Rows, t: float) -> Statuses:
        """Read robots; a robot without a reply has state 0 and keeps its last position."""
        status = self.transactions.statuses(rows, t)
        self.robot_state[rows] = status.state
        valid = status.select(status.ok)
        self._handle_statuses(rows[status.ok], valid, self.transactions.now_s)
        return status

    def _handle_statuses(self, rows: Rows, status: Statuses, t: float) -> None:
        """Take over valid statuses read at time t [s]."""
        distance = (status.position - self.counts[rows]) * self.units.quantum_rad
        elapsed_s = np.maximum(t - self._read_s[rows], 1e-9)[:, None]
        moves = (status.state == RobotState.MOVING)[:, None]
        self._velocities[rows] = np.where(moves, distance / elapsed_s, 0.0)
        self._read_s[rows] = t
        self.counts[rows] = status.position
        self.robot_state[rows] = status.state
        self.robot_fault[rows] = status.fault
        self.alerts[rows] = status.alerts
        self._lost[rows] = status.state == RobotState.MOVING

    def _start_phase(self, plan: Plan, wanted: Mask, t: float) -> LoadedPlan:
        """Load a plan for the wanted robots and start them."""
        loaded_plan = self._loader.run(
            plan.motion, wanted, self.known, self._boot, self._lost, t, self._may_go
        )
        self.loaded_plan = loaded_plan
        self.loaded_plans.append(loaded_plan)
        self._lost |= loaded_plan.started
        self.state = SessionState.MOVING
        return loaded_plan

    def _evaluate_motion(self, plan: Plan, loaded_plan: LoadedPlan) -> float:
        """End the plan when all have arrived; stop all on timeout or when the monitor says so."""
        monitor = loaded_plan.monitor
        if monitor is None:
            self._end_plan(plan)
            return self.transactions.now_s
        self._arrived = loaded_plan.started & monitor.arrived
        running = loaded_plan.started & ~self._arrived
        safety, makespan_s = self._loader.safety, loaded_plan.motion.decoded().makespan_s
        late_s = safety.clock_ppm * 1e-6 * makespan_s + safety.start_skew_s
        end_s = loaded_plan.start_s + makespan_s + late_s + self.config.grace_s
        if monitor.stop_all_at_s is not None:
            return self._stop_and_resume(plan, loaded_plan, monitor.stop_all_at_s)
        if not running.any():
            self._end_plan(plan)
        elif monitor.now_s > end_s:
            self._failed |= running
            return self.stop(monitor.now_s)
        return max(monitor.now_s, self.transactions.now_s)

    def _stop_and_resume(self, plan: Plan, before: LoadedPlan, t: float) -> float:
        """Stop all robots together, and start the remaining motion of those that can resume."""
        self.transactions.revive()
        running = before.started & ~self._arrived
        rows = np.flatnonzero(self.known)
        status = self._start_stop.stop(rows, t)
        self.robot_state[rows] = status.state
        able = self._able_to_resume(running)
        able[rows] &= status.ok & (status.boot == self._boot[rows])
        self._failed |= running & ~able
        if len(self.loaded_plans) > self.config.resumes or not self._may_go():
            return self.stop(self.transactions.now_s)
        self.transactions.command(Opcode.CLEAR, rows[able[rows]], self.transactions.now_s)
        resuming, oversized = running & able, plan.oversized
        left = remaining_motion(
            before.motion, self.counts, t - before.start_s, self._speed, resuming
        )
        plan = self._plan = Plan(left, plan.goals)
        wanted = resuming & plan.moves & ~plan.oversized
        loaded_plan = self._start_phase(plan, wanted, self.transactions.now_s)
        stays = running & ~loaded_plan.started & (loaded_plan.reason == Reason.OK)
        # a robot that was not started in an earlier phase keeps its reason
        reason = np.where(loaded_plan.reason == Reason.OK, before.reason, loaded_plan.reason)
        reason[oversized] = Reason.TOO_MANY_SEGMENTS
        reason[stays] = Reason.STOPPED
        self.loaded_plan = self.loaded_plans[-1] = replace(loaded_plan, reason=reason)
        return self._evaluate_motion(plan, self.loaded_plan)

    def _able_to_resume(self, running: Mask) -> Mask:
        """Robots that have stopped in order, by state and alerts, shape (n,)."""
        # faults may be of frames garbled in the meantime; alerts stay
        silent = (self.robot_state == RobotState.FAULT) & (self.alerts & Alert.SILENT != 0)
        able = (self.robot_state == RobotState.STOPPED) | silent
        able &= (self.alerts & (Alert.STALLED | Alert.REBOOTED) == 0) & ~self._lost
        # a robot without heartbeats on a bus with heartbeats would miss the next ones too
        bus = self.transactions.places(self.transactions.addresses.bus)
        with_heartbeats = np.unique(bus[running & (self.robot_state == RobotState.STOPPED)])
        return able & ~(silent & np.isin(bus, with_heartbeats))

    def _end_plan(self, plan: Plan) -> PlanResult:
        """Evaluate a plan and forget it; lost robots of a plan cut short have failed."""
        loaded_plan = self.loaded_plan
        if loaded_plan is not None:
            self._failed |= loaded_plan.started & ~self._arrived & (self.robot_state == 0)
        self.result = evaluate(
            self.plane,
            plan,
            loaded_plan,
            self.counts,
            self.known,
            self._arrived,
            self._failed,
            self.config.tolerance_mm,
        )
        self._plan = None
        self.state = SessionState.IDLE
        return self.result

# SPDX-License-Identifier: Apache-2.0
"""A controller's session with a focal plane: configure, submit orders, start, advance, stop."""

from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import BusBackend, addresses_of
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.listed_home import folding_motion
from fiber_bus_bridge.plan_result import LoadedPlan, Plan, PlanResult
from fiber_bus_bridge.protocol import (
    Buses,
    Certifier,
    Context,
    Event,
    Robots,
    State,
    Transition,
    allows,
    handle,
    run,
)
from fiber_bus_bridge.protocol.ending import end_plan, look, so_far
from fiber_bus_bridge.protocol.loading import begin_plan
from fiber_bus_bridge.protocol.turn_limits import full_turn, learn_gaps
from fiber_bus_bridge.robot_memory import RobotMemory
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.session_memory import recall, remember
from fiber_bus_bridge.session_state import SessionState, session_state
from fiber_bus_bridge.transactions import Transactions
from fiber_core.array_types import Angles, Codes, Counts, Mask, Velocities
from fiber_core.clearance import Safety, hold_until_safe
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["Session"]


class Session:
    """The controller of a focal plane, without a clock: each call is given the simulated time.

    Calls that use the buses return the time at which the buses are free [s]; a later call at an
    earlier time waits until then. Each robot of each plan gets exactly one outcome, in `result`
    from the end of the plan until the next plan begins. `fiber_bus_bridge.protocol` has the states
    and the steps; an exception in a step interrupts the plan, and the next call of `advance` or
    `stop` stops all robots.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of the wire format.
        safety: clearance required of every started motion.
        backend: the buses.
        assumed: angles of robots that have never answered [rad], shape (n, 2).
        config: settings.
        certify: as hold_until_safe: the motion with unsafe robots held, these robots, and the
            certificate.

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
        certify: Certifier = hold_until_safe,
    ):
        assumed = np.asarray(assumed, dtype=float)
        if assumed.shape != (plane.n, 2) or not np.isfinite(assumed).all():
            raise SessionError(
                f"assumed angles have shape {assumed.shape}, expected {(plane.n, 2)} finite values"
            )
        self.units, self.config = units, config or SessionConfig()
        self.transactions = Transactions(backend, addresses_of(plane))
        self.protocol = Context.new(
            plane, units, safety, self.config, self.transactions, certify,
            units.encoder_counts(plane, assumed),
        )  # fmt: skip
        self.robots["turn_limit"] = full_turn(self.protocol)[:, None]

    has_buses: ClassVar[bool] = True  # of its own; else others drive the robots for it
    border_skews_s: tuple[float, float] | None = None  # that robots of two sectors need [s]

    @property
    def plane(self) -> FocalPlane:
        """The focal plane, with the robots that may move enabled."""
        return self.protocol.plane

    @property
    def state(self) -> SessionState:
        """State of the session."""
        return session_state(self.protocol.state)

    @property
    def robots(self) -> Robots:
        """The table of the robots, records of `protocol.ROBOT`, n rows."""
        return self.protocol.robots

    @property
    def buses(self) -> Buses:
        """The table of the buses, records of `protocol.BUS`, b rows."""
        return self.protocol.buses

    @property
    def known(self) -> Mask:
        """Robots that were found and configured, shape (n,)."""
        return self.robots["known"]

    @property
    def usable(self) -> Mask:
        """Robots that were found and configured, and whose counters tell their places, (n,)."""
        return self.robots["known"] & ~self.robots["unplaced"]

    @property
    def counts(self) -> Counts:
        """Encoders, last read or assumed [quanta], shape (n, 2)."""
        return self.robots["counts"]

    @property
    def angles(self) -> Angles:
        """Joint angles by the robots' own encoders, last read or assumed [rad], shape (n, 2)."""
        return self.units.to_angles(self.counts)

    @property
    def velocities(self) -> Velocities:
        """Mean joint speeds between the last two readings, 0 at rest [rad/s], shape (n, 2)."""
        if self.state is not SessionState.MOVING:
            return np.zeros(self.counts.shape)
        return self.robots["velocity"]

    @property
    def result(self) -> PlanResult | None:
        """The result of the plan that has ended, until it is taken or the next plan begins."""
        return self.protocol.result

    @property
    def loaded_plan(self) -> LoadedPlan | None:
        """The phase of the plan that was loaded last."""
        return self.protocol.loaded_plan

    @property
    def loaded_plans(self) -> list[LoadedPlan]:
        """The phases of the last plan."""
        return self.protocol.loaded_plans

    def take_result(self) -> PlanResult | None:
        """Return the result of the plan that has ended since the last call, None without one."""
        taken, self.protocol.result = self.protocol.result, None
        return taken

    def take_transitions(self) -> list[Transition]:
        """Return the transitions of the protocol since the last call, oldest first.

        Repeated polls and steps are left out, and of many transitions the oldest.
        """
        taken, self.protocol.log = self.protocol.log, []
        return taken

    def enable(self, enabled: Mask) -> None:
        """Set the robots that may move from now on; the others are obstacles where they are.

        Args:
            enabled: robots that may move, shape (n,).

        Raises:
            SessionError: robots are moving.
        """
        self._require(Event.ENABLE, "enable or disable robots")
        self.protocol.plane = self.plane.with_enabled(enabled)

    def memory(self, failed: Codes, starting: bool = False) -> RobotMemory:
        """Return what must be remembered of the robots over a restart.

        Args:
            failed: Reason for which each robot is left out of plans, else OK, shape (n,).
            starting: whether the verified robots are about to be sent a GO, or the robots that were
                stopped after a failure are about to resume.
        """
        return remember(self.protocol, failed, starting)

    def so_far(self) -> PlanResult:
        """Return the result of the plan if its controller dies after the GO that is about to go.

        Of the robots that are verified, and so are started, it tells nothing.
        """
        return so_far(self.protocol)

    def look_back(self, note_ends: Callable[[Mask], None] | None) -> None:
        """Let `configure` find out why each robot rests, for a plan that an earlier session left.

        The Reasons are in the column `rest_cause`, OK for a robot that carried out its orders. A
        robot that does not tell remains unknown: it is not configured, so that it forgets nothing.

        Args:
            note_ends: called with the robots that were read at rest, shape (n,), before the first
                message that lets a robot forget why it rests; None for no such plan.
        """
        self.protocol.note_ends = note_ends

    def look(self, t: float) -> Mask:
        """Read the robots that moved when they were read last; return those that move still, (n,).

        Raises:
            SessionError: a plan is under way.
        """
        self._require(Event.ENABLE, "look for moving robots")
        self.protocol.t = t
        return look(self.protocol)

    def recall(self, memory: RobotMemory) -> None:
        """Take over what was remembered before a restart, before the robots are configured.

        Robots that answer are believed more than any memory.

        Raises:
            SessionError: the robots were configured already.
        """
        if self.protocol.state is not State.UNCONFIGURED:
            raise self._refusal("recall a memory")
        recall(self.protocol, memory)

    def forget_turns(self) -> None:
        """Let robots at unknown places not turn: earlier turns are not known."""
        self.robots["turn_limit"] = 0

    def vouch(self, ids: ArrayLike) -> None:
        """Believe that robots rest where they were read last, or assumed.

        Args:
            ids: ids of the robots, shape (k,).

        Raises:
            SessionError: a robot does not exist, its place is known, the bridge has set its
                counters without knowing its place, or robots are moving.
        """
        self._require(Event.ENABLE, "vouch for robots")
        ids = np.asarray(ids, dtype=np.int64)
        rows = self.plane.index_of(ids)
        if (rows < 0).any():
            raise SessionError(
                f"robot {ids[rows < 0][0]} cannot be vouched for: the plane has no such robot"
            )
        known = ~(self.robots["lost"] | self.robots["unplaced"])[rows]
        if known.any():
            raise SessionError(f"robot {ids[known][0]} cannot be vouched for: its place is known")
        guessed = (self.robots["guessed"] & ~self.robots["seen"])[rows]
        if guessed.any():
            raise SessionError(
                f"robot {ids[guessed][0]} cannot be vouched for: the bridge has set its counters, "
                "and nothing tells where it rests; a camera tells (ros2 run fiber_client recover)"
            )
        self.robots["placed"][rows], self.robots["lost"][rows] = True, False
        for column in ("unplaced", "recalled", "seen", "guessed"):
            self.robots[column][rows] = False
        learn_gaps(self.protocol)

    def configure(self, t: float) -> float:
        """Identify the robots, and send units, limits and speeds to them.

        Robots that do not answer, or answer with another serial number, remain unknown and
        are obstacles where they were read last; a later call tries them again. Robots that stopped
        by themselves are cleared, if all rest and none was stopped by a STOP. Of a robot that was
        never read, and that no memory and no operator vouches for, the place is not known: its
        neighbours do not move.

        Raises:
            SessionError: robots are moving, or stopped and not cleared, or orders wait.
        """
        return self._call(Event.CONFIGURE, t)

    def submit(
        self,
        motion: WireMotion,
        targets: ArrayLike | None = None,
        fibre: ArrayLike | None = None,
    ) -> PlanResult | None:
        """Accept the orders of the next plan; no frame is sent yet.

        Args:
            motion: orders of every robot, from the positions of the encoders.
            targets: target of each fibre [mm], shape (n, 2), nan = no target; by default the end
                of the motion, for robots that move.
            fibre: number of the fibre that each target is for, -1 for any, shape (n,); by default
                that of the plane.

        Returns:
            The result of the waiting plan that is replaced, None without one.

        Raises:
            SessionError: orders are not accepted in this state, or they do not fit the plane,
                the units, or the encoders of a robot; names the robot.
        """
        self._require(Event.SUBMIT)
        if motion.units != self.units:
            raise SessionError(f"orders in {motion.units}, robots configured for {self.units}")
        if motion.start.shape != self.counts.shape:
            raise SessionError(f"orders for {len(motion.start)} robots, not {self.plane.n}")
        plan = Plan.of(self.plane, motion, self.counts, targets, fibre)
        off = np.abs(motion.start - self.counts).max(axis=1, initial=0) * self.units.quantum_rad
        wrong = plan.moves & self.known & (off > self.config.start_tolerance_rad)
        if wrong.any():
            at = int(np.argmax(wrong))
            raise SessionError(
                f"robot {self.plane.ids[at]}: orders begin at {motion.start[at].tolist()} quanta, "
                f"its encoders are at {self.counts[at].tolist()}"
            )
        c = self.protocol
        replaced = end_plan(c)
        c.plan, c.loaded_plan, c.result = plan, None, None
        c.robots["arrived"], c.robots["cause"] = False, Reason.OK
        handle(c, Event.SUBMIT)
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
        self._require(Event.START)
        begin_plan(self.protocol, t, may_go)
        return self._call(Event.START, t)

    def advance(self, t: float) -> float:
        """Supervise the robots until time t [s]; end the plan when all have arrived or on timeout.

        A robot that stops by itself, or is lost, makes all robots stop. When the others resume,
        the call returns as they begin to move. In other states nothing is done.
        """
        if not allows(self.protocol.state, Event.ADVANCE):
            return self.transactions.now_s
        return self._call(Event.ADVANCE, t)

    def stop(self, t: float) -> float:
        """Stop every robot, in any state: by general call, then singly where needed."""
        return self._call(Event.STOP, t)

    def clear(self, t: float) -> float:
        """Delete orders and faults, and leave the state STOPPED; robots stay where they are.

        Raises:
            SessionError: robots are moving, or no robot is configured.
        """
        return self._call(Event.CLEAR, t)

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
        c = self.protocol
        if c.state is not State.IDLE:
            raise self._refusal("home")
        chosen = self.plane.enabled & self.usable
        high, speed = c.limits[:, 1, 1], c.speed[:, 1]
        self.submit(folding_motion(self.plane, self.units, self.counts, high, speed, chosen))
        c.blind_mm = c.of_move_mm  # no image tells yet where the arms will end
        return self.start(t, may_go)

    def _call(self, event: Event, t: float) -> float:
        """Let an event happen at time t [s], and run the protocol until it awaits a call."""
        c = self.protocol
        self._require(event)
        c.t, before = t, c.watch if event is Event.ADVANCE else None
        handle(c, event)
        run(c, t)
        watch = c.watch or before
        return max(self.transactions.now_s, -np.inf if watch is None else watch.now_s)

    def _require(self, event: Event, call: str = "") -> None:
        if not allows(self.protocol.state, event):
            raise self._refusal(call or event.name.lower())

    def _refusal(self, call: str) -> SessionError:
        return SessionError(f"cannot {call} while {self.state.name}: {self.state.value}")

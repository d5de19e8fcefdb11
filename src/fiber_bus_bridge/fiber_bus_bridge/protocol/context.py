# SPDX-License-Identifier: Apache-2.0
"""What the steps of the protocol share: the tables, the plan, and the phase under way."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from fiber_bus_bridge.plan_result import LoadedPlan, Plan, PlanResult
from fiber_bus_bridge.poll_scheduler import PollScheduler
from fiber_bus_bridge.protocol.decisions import neighbours_of
from fiber_bus_bridge.protocol.states import Event, State
from fiber_bus_bridge.protocol.tables import Buses, Robots, new_buses, new_robots, observe
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import (
    Alert,
    Frames,
    Gears,
    Opcode,
    Ramps,
    Speeds,
    Statuses,
    encode_command,
    general_call,
    roll_call_bytes,
    roll_call_slots,
)
from fiber_core.array_types import Bools, Counts, Floats, Ints, Mask, Rows
from fiber_core.clearance import Certificate, Safety, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["Certifier", "Context", "Phase", "Transition", "Watch"]

Certifier: TypeAlias = Callable[
    [FocalPlane, SegmentMotion, Safety], tuple[SegmentMotion, Mask, Certificate]
]
_LOG = 1000  # transitions kept until they are taken


class Transition(NamedTuple):
    """One transition of the protocol, at a time of the buses [s]."""

    t: float
    state: State
    event: Event
    next_state: State


@dataclass(eq=False)
class Phase:
    """The part of a plan between a start and the next stop, while it is prepared and carried out.

    Args:
        motion: orders of the robots that shall move.
        t: earliest time of the first message [s].
        rounds: sequence numbers tried.
        verify_s: longest time to VERIFY all robots once [s].
        frames: LOAD frames of all robots, n rows.
        loaded: the motion decoded from the frames of the verified robots.
        certificate: the certificate of `loaded`.
        go_s: time at which the GO was complete [s].
        go_took_s: duration of a GO on a bus [s].
        start_s: time at which the robots begin to move [s].
        late: robots on buses on which this GO was late, shape (n,).
        responding: robots that do not cause the cancelling of this start, shape (n,).
        stopped_at_s: time at which all robots were to stop [s].
        resumed: robots that this phase shall resume, shape (n,); None in a first phase.
        oversized: robots of the phase before with more segments than an order carries, shape (n,).
        before: the phase before; None in a first phase.
        turn_limit: limits of test turns wherever this phase ends, shape (n, 2); None before its GO.
    """

    motion: WireMotion
    t: float
    rounds: int = 0
    verify_s: float = 0.0
    frames: Frames | None = None
    loaded: WireMotion | None = None
    certificate: Certificate | None = None
    go_s: float = 0.0
    go_took_s: float = 0.0
    start_s: float = 0.0
    late: Mask | None = None
    responding: Mask | None = None
    stopped_at_s: float = 0.0
    resumed: Mask | None = None
    oversized: Mask | None = None
    before: LoadedPlan | None = None
    turn_limit: Ints | None = None


@dataclass(eq=False)
class Watch:
    """Supervision of the robots from their GO on, beside the tables.

    Args:
        now_s: time of the next step [s].
        schedulers: of polls, by the number of bytes that are read.
        low_lines: buses whose alert line was low at the GO: no news.
        ends_s: expected end of the motion [s]: a loss of power after this time is harmless.
        stop_all_at_s: time at which all robots must stop [s], None while all is well.
    """

    now_s: float
    schedulers: dict[int, PollScheduler]
    low_lines: Ints
    ends_s: float = np.inf
    stop_all_at_s: float | None = None


@dataclass(eq=False)
class Context:
    """The state of a controller, on which all steps work.

    Args:
        plane: the focal plane, with the robots that may move enabled.
        units: tick, quantum and widths.
        safety: clearance required of every started motion.
        config: settings.
        transactions: the transactions with the robots.
        certify: returns the motion with unsafe robots held, the held robots and the certificate.
        robots: a row for each robot; the encoders are assumed until they are read.
        buses: a row for each bus.
        steps: the function of each state, where it is another than that of `machine.STEPS`.
        start_at_s: instant at which the robots begin to move [s], as agreed with other
            controllers by the time `may_go` returns; None for as early as possible.
    """

    plane: FocalPlane
    units: WireUnits
    safety: Safety
    config: SessionConfig
    transactions: Transactions
    certify: Certifier
    robots: Robots
    buses: Buses
    steps: Mapping[State, Callable[["Context"], Event]] = field(default_factory=dict)
    start_at_s: float | None = None
    state: State = State.UNCONFIGURED
    was_stopped: bool = False  # an earlier session left the robots stopped; nothing cleared them
    was_moving: bool = False  # an earlier session moved robots; a STOP since then was its own
    # called with the robots that were read at rest, before they forget how an earlier plan ended
    note_ends: Callable[[Mask], None] | None = None
    # called before messages that let robots forget that a joint did not follow, where counters
    # do not outlive that; an error lets none of them be sent
    save: Callable[[], None] = lambda: None
    log: list[Transition] = field(default_factory=list)
    t: float = -np.inf  # earliest time of the next message [s]
    now_s: float = -np.inf  # time of the last transition [s]
    may_go: Callable[[], bool] = lambda: True
    plan: Plan | None = None
    phase: Phase | None = None
    watch: Watch | None = None
    loaded_plan: LoadedPlan | None = None
    loaded_plans: list[LoadedPlan] = field(default_factory=list)  # one for each phase
    result: PlanResult | None = None
    words: object = None  # where robots rested before they turned by code words (`word_turns`)
    stop_reason: Reason = Reason.STOPPED  # of robots that the end of this plan finds on the way

    @classmethod
    def new(
        cls,
        plane: FocalPlane,
        units: WireUnits,
        safety: Safety,
        config: SessionConfig,
        transactions: Transactions,
        certify: Certifier,
        counts: Counts,
    ) -> "Context":
        """Make the state of a controller whose robots have never answered, at assumed counts."""
        return cls(
            plane, units, safety, config, transactions, certify,
            new_robots(counts), new_buses(len(transactions.buses)),
        )  # fmt: skip

    def __post_init__(self) -> None:
        addresses = self.transactions.addresses
        self.bus: Ints = self.transactions.places(addresses.bus)  # place of each robot's bus
        self.slot: Ints = roll_call_slots(addresses)
        self.roll_call_bytes: Ints = roll_call_bytes(np.bincount(self.bus))
        self.pairs = neighbour_pairs(self.plane)
        self.exact_mm: Floats = np.stack([self.plane.theta_radius, self.plane.phi_radius], axis=1)
        # how far points of both outlines may be from where the counters put them, by the last image
        self.known_mm: Floats = np.zeros((self.plane.n, 2))
        self.blind_mm: Floats = np.zeros((self.plane.n, 2))  # and by moves since that image
        self.of_move_mm: Floats = np.zeros((self.plane.n, 2))  # and by any move after an image
        # rounded inwards, so that every order that a robot accepts keeps the limits and speeds
        self.limits: Ints = self.units.range_counts(self.plane)
        speed = np.floor(self.plane.speeds / self.units.velocity_rad_s).astype(np.int64)
        self.speed: Ints = np.minimum(speed, self.units.max_velocity)
        self.gears = Gears.of(self.plane, self.units)
        self.listed = Speeds.of(self.plane, self.units)
        self.ramps = Ramps.of(self.plane)
        self._heartbeats: tuple[bytes, Frames] | None = None

    @property
    def silence_s(self) -> float:
        """Time without a heartbeat after which robots stop by themselves [s]."""
        return 1e-3 * self.config.silence_ms

    @property
    def known_or_all(self) -> Rows:
        """Robots that can be commanded, or all when there is none, shape (k,)."""
        known = self.robots["known"]
        return np.flatnonzero(known) if known.any() else np.arange(len(known))

    @property
    def cut_off(self) -> Mask:
        """Robots on buses that were given up, shape (n,)."""
        return self.transactions.given_up[self.bus]

    def buses_of(self, robots: Rows | Mask) -> Bools:
        """Return whether a bus carries some of these robots, shape (b,)."""
        return np.bincount(self.bus[robots], minlength=len(self.buses)) > 0

    def heartbeats(self, buses: Ints) -> Frames:
        """Return heartbeats on some buses; the frames of the last call are used again."""
        key = buses.tobytes()
        if self._heartbeats is None or self._heartbeats[0] != key:
            calls = general_call(self.transactions.buses[buses])
            self._heartbeats = key, encode_command(Opcode.HEARTBEAT, calls)
        return self._heartbeats[1]

    def observe(self, rows: Rows, status: Statuses, t: float) -> None:
        """Take over the valid ones of some statuses, read at time t [s]."""
        ok = status.ok
        if not ok.all():
            rows, status = rows[ok], status.select(ok)
        kept, before = self.config.counters_kept, self.robots["unplaced"][rows]
        observe(self.robots, rows, status, t, self.units.quantum_rad, kept)
        if kept:
            return
        # a joint that did not follow was under no certificate: nothing is known of gaps beside it
        stalled = rows[~before & (status.alerts & Alert.STALLED != 0)]
        if len(stalled):
            beside = np.isin(np.arange(len(self.robots)), stalled)
            beside |= neighbours_of(beside, self.pairs)
            self.robots["turn_limit"][beside] = 0

    def read(self, rows: Rows, t: float) -> Statuses:
        """Read robots; a robot without a reply has state 0 and keeps its last position."""
        status = self.transactions.statuses(rows, t)
        self.robots["state"][rows] = status.state
        self.observe(rows, status, self.transactions.now_s)
        return status

    def record(self, event: Event, after: State) -> None:
        """Add a transition to the log, and enter the state that follows."""
        watched_s = -np.inf if self.watch is None else self.watch.now_s
        self.now_s = max(self.now_s, self.transactions.now_s, watched_s)
        if event not in (Event.STEPPED, Event.POLLED):
            self.log.append(Transition(self.now_s, self.state, event, after))
            del self.log[:-_LOG]
        self.state = after

# SPDX-License-Identifier: Apache-2.0
"""A controller with a few robots as one state of a search: copied, compared, and judged."""

import copy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from fiber_bus_bridge.bus import addresses_of
from fiber_bus_bridge.protocol import Context, Event, State, handle, run_one
from fiber_bus_bridge.protocol.loading import begin_plan
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.simulation.memory import new_memory
from fiber_bus_bridge.simulation.model_check.choices import BusError, Choices, ChosenBuses
from fiber_bus_bridge.simulation.model_check.key import state_parts
from fiber_bus_bridge.simulation.model_check.truth import Truth
from fiber_bus_bridge.wire import encode_load
from fiber_core.array_types import Bools, Counts
from fiber_core.clearance import Safety
from fiber_core.presets import preset
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["Scenario", "System"]

_TICKS, _VELOCITY, _STALE_VELOCITY = 3, 6000, 4000
_REST_S = 1.0  # time after the end of a plan in which no robot may move
_AT_REST = (State.IDLE, State.STOPPED, State.UNCONFIGURED)


@dataclass(frozen=True)
class Scenario:
    """Where a search begins: robots configured, orders submitted, start called.

    Args:
        buses: number of buses.
        robots: robots on each bus.
        stuck: buses may stick.
        resumes: resumes allowed, as in SessionConfig.
        silence_ms: as in SessionConfig; 0 takes the robots' own protection away.
        stale: the robots hold another order, under the sequence number that comes next.
    """

    buses: int = 2
    robots: int = 1
    stuck: bool = True
    resumes: int = 1
    silence_ms: int = 5
    stale: bool = True


class System:
    """A controller, its buses and robots, and the truth about them."""

    c: Context
    buses: ChosenBuses
    truth: Truth

    @classmethod
    def begin(cls, scenario: Scenario) -> "System":
        """Return the system at the beginning of a scenario."""
        self = object.__new__(cls)
        n = scenario.buses * scenario.robots
        rows = np.arange(n)
        plane = replace(
            preset("desi", n), bus=rows // scenario.robots, address=8 + rows % scenario.robots
        )
        units = WireUnits.for_plane(plane)
        start = units.to_counts(np.tile([0.0, 2.6], (n, 1)))
        memory = new_memory(
            addresses_of(plane), plane.ids, units.quantum_prad, start, np.zeros(n), np.zeros(n)
        )
        self.buses = ChosenBuses(memory, plane.bus, self._on_started, scenario.stuck)
        config = SessionConfig(
            tolerance_mm=1e-6, watchdog_ms=0, grace_s=0.05,
            silence_ms=scenario.silence_ms, resumes=scenario.resumes,
        )  # fmt: skip
        session = Session(
            plane, units, Safety(), self.buses, units.to_angles(start), config, self._certify
        )
        session.configure(0.0)
        self.c = session.protocol
        orders = _one_segment(units, start, _VELOCITY)
        self.truth = Truth(np.full(n, -1), start.copy(), orders.end)
        if scenario.stale:
            motion = _one_segment(units, start, _STALE_VELOCITY)
            to = session.transactions.addresses
            session.transactions.send(rows, encode_load(to, 1, motion), 0.0)
        session.submit(orders)
        begin_plan(self.c, 0.0, self._may_go)
        handle(self.c, Event.START)
        return self

    def clone(self) -> "System":
        """Return a copy that shares nothing that changes."""
        other, c = object.__new__(System), copy.copy(self.c)
        other.buses = self.buses.clone(other._on_started)
        other.truth = copy.copy(self.truth)
        for name in ("accepted", "rest", "wrong"):
            setattr(other.truth, name, copy.copy(getattr(self.truth, name)))
        c.robots, c.buses = c.robots.copy(), c.buses.copy()
        c.log, c.loaded_plans = [], list(c.loaded_plans)
        c.phase = copy.copy(c.phase)
        c.transactions = copy.copy(c.transactions)
        c.transactions.backend = other.buses
        for name in ("free_s", "given_up", "failures"):
            setattr(c.transactions, name, getattr(c.transactions, name).copy())
        c.transactions.take_traffic()
        if c.watch is not None:
            schedulers = {width: s.copy() for width, s in c.watch.schedulers.items()}
            c.watch = replace(c.watch, schedulers=schedulers)
        c.certify, c.may_go = other._certify, other._may_go
        other.c = c
        return other

    @property
    def ended(self) -> bool:
        """Whether the plan has ended."""
        return self.c.state in _AT_REST

    def step(self, choices: Choices) -> None:
        """Run one step of the protocol, or let a caller stop the robots; then judge."""
        self.buses.choices, c = choices, self.c
        before = c.state
        moved = c.robots["started"] & ~c.robots["arrived"]
        if before is State.INTERRUPTED:
            handle(c, Event.ADVANCE)
        elif before is State.MOVING and choices.choose([("a caller stops",)]) is not None:
            c.t = c.now_s
            handle(c, Event.STOP)
        else:
            try:
                run_one(c)
            except BusError:
                pass
        self._judge(before, moved)
        if self.ended:
            self._judge_end()

    def key(self) -> int:
        """Return a number that is equal for states with the same future but for the time."""
        return hash(b"".join(state_parts(self.c, self.buses, self.truth)))

    # --- what the controller asks for ----------------------------------------

    def _may_go(self) -> bool:
        return self.buses.choices.choose([("a caller refuses the start",)]) is None

    def _certify(self, plane: Any, motion: Any, safety: Any) -> tuple[Any, Any, Any]:
        """The certificate as a predicate: all is safe, or else one moving robot is not."""
        n = plane.n
        none, held = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        moving = np.flatnonzero((motion.counts > 0).any(axis=1)).tolist()
        chosen = self.buses.choices.choose([("robot", row, "is unsafe") for row in moving])
        if chosen is not None:
            held[chosen[1]] = True
        phase = self.c.phase
        if phase is not None and phase.loaded is not None:
            orders = phase.loaded
            self.truth.certified = {row: _bytes_of(orders, row) for row in moving if not held[row]}
        certificate = SimpleNamespace(
            ok=True, unsafe_robots=none, limits_broken=none, moved_disabled=none
        )
        return motion, held, certificate

    def _on_started(self, row: int) -> None:
        """Judge a robot that has accepted a GO."""
        r = self.buses.memory[row]
        order = b"".join(
            r[column][joint, : r["counts"][joint]].tobytes()
            for joint in range(2)
            for column in ("ticks", "velocity")
        )
        self.truth.start(row, order, bool(self.c.robots["verified"][row]))

    # --- rules -----------------------------------------------------------------

    def _judge(self, before: State, moved: Bools) -> None:
        """Judge what has happened in a step."""
        c, truth, at = self.c, self.truth, self.buses.positions()
        if c.state is State.CERTIFIED:
            truth.attempt += 1
        if before is State.COUNTDOWN and c.state is State.MOVING:
            started_s = self.buses.memory["started_s"]
            truth.commit(c.robots["started"], started_s, c.safety.start_skew_s)
        truth.judge_places(at)
        if before is State.STOPPING and c.state is not State.INTERRUPTED:
            halted_s = self.buses.memory["halted_s"][moved]
            truth.apart_s = float(np.ptp(halted_s)) if moved.any() else 0.0
            truth.stop(at)

    def _judge_end(self) -> None:
        """Judge the outcomes, and let time pass."""
        c, truth, buses = self.c, self.truth, self.buses
        buses.advance(float(buses.free_s.max()) + c.silence_s)
        at = buses.positions()
        truth.judge_places(at)
        truth.judge_outcomes(c.result, at)
        buses.advance(float(buses.free_s.max()) + _REST_S)
        truth.judge_rest(at, buses.positions())


def _one_segment(units: WireUnits, start: Counts, velocity: int) -> WireMotion:
    """Every robot turns theta."""
    n = len(start)
    offsets = Parts.from_counts(np.tile([1, 0], n)).offsets
    return WireMotion(units, start, offsets, np.full(n, _TICKS), np.full(n, velocity))


def _bytes_of(motion: WireMotion, row: int) -> bytes:
    parts = [slice(*motion.offsets[j : j + 2]) for j in (2 * row, 2 * row + 1)]
    return b"".join(motion.ticks[p].tobytes() + motion.velocity[p].tobytes() for p in parts)

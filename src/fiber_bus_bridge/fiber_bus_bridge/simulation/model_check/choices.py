# SPDX-License-Identifier: Apache-2.0
"""Buses on which the fate of every message, and every mishap of a robot or a bus, is a choice."""

from collections.abc import Callable
from enum import Enum
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import Ack, Recovery, Replies
from fiber_bus_bridge.simulation.drive import advance_robot, encoder
from fiber_bus_bridge.simulation.events import set_power
from fiber_bus_bridge.simulation.firmware import receive, reply, reply_to_roll_call
from fiber_bus_bridge.simulation.memory import Memory
from fiber_bus_bridge.wire import ROLL_CALL_ADDRESS, Frames, RobotState
from fiber_core.array_types import Counts, Floats, Ints
from fiber_core.ragged import Parts

__all__ = ["BusError", "Choices", "ChosenBuses", "Fate", "Mishap"]

Option: TypeAlias = tuple[Any, ...]  # words that say what goes wrong
_MESSAGE_S = 50e-6  # duration of every message
_LATE_S = 2e-3  # a late message takes longer by this time
_CLOCKS_S, _RESET_S = 20e-6, 10e-3
_MOVING = int(RobotState.MOVING)


class BusError(Exception):
    """A backend that raises an exception."""


class Fate(Enum):
    """What becomes of a message."""

    LOST = "lost"
    MISSED = "missed by one robot, acknowledged by another"
    REPLY_LOST = "delivered, reply lost"
    DOUBLED = "doubled"
    LATE = "late"
    ASTRAY = "lost, and acknowledged"


class Mishap(Enum):
    """What happens before the first message of a batch."""

    RESET = "resets"
    POWER_LOST = "loses power"
    JAMMED = "is jammed"
    STUCK = "sticks for good"
    FREED = "sticks until it is freed"
    RAISES = "backend raises an exception"


class Choices:
    """The choices of a run: 0 is what happens without a fault, others are given by their number.

    Args:
        forced: option of some choices, by the number of the choice.
    """

    def __init__(self, forced: dict[int, int] | None = None):
        self.forced = forced or {}
        self.options: list[int] = []  # of each choice so far
        self.words: list[str] = []  # what was chosen and is a fault

    def choose(self, options: list[Option]) -> Option | None:
        """Return one of some options, None when nothing goes wrong."""
        number = self.forced.get(len(self.options), 0)
        self.options.append(len(options) + 1)
        if number == 0:
            return None
        chosen = options[number - 1]
        self.words.append(" ".join(x.value if isinstance(x, Enum) else str(x) for x in chosen))
        return chosen


class ChosenBuses:
    """A backend with the firmware of the simulated robots, and choices in place of wires.

    Every message takes the same time. A message that is lost is not acknowledged, or acknowledged
    by another target; a general call may also be missed by one robot alone. A late message ends
    later for robots and controller, as on a bus whose clock is held low.

    Args:
        memory: memory of the robots.
        bus: place of the bus of each robot, shape (n,); also the bus numbers.
        on_started: called with a row when a robot has accepted a GO.
        may_stick: whether buses may stick.
    """

    def __init__(
        self, memory: Memory, bus: Ints, on_started: Callable[[int], None], may_stick: bool = True
    ):
        self.memory, self.bus, self.on_started = memory, bus, on_started
        self.may_stick = may_stick
        buses = int(bus.max()) + 1
        self.free_s: Floats = np.zeros(buses)
        self.stuck: list[Mishap | None] = [None] * buses
        self.choices = Choices()
        self.rows = [np.flatnonzero(bus == b) for b in range(buses)]

    def clone(self, on_started: Callable[[int], None]) -> "ChosenBuses":
        """Return a copy with memory of its own."""
        other = object.__new__(ChosenBuses)
        vars(other).update(vars(self))
        other.memory, other.on_started = self.memory.copy(), on_started
        other.free_s, other.stuck = self.free_s.copy(), list(self.stuck)
        return other

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer."""
        f = len(frames)
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,)).tolist()
        before_s = np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,)).tolist()
        offsets = Parts.from_counts(read).offsets
        ack, data = np.zeros(f, dtype=np.int64), np.full(offsets[-1], 0xFF, dtype=np.uint8)
        start_s, end_s = np.zeros(f), np.zeros(f)
        buses, broken = frames.to.bus.tolist(), set()
        for i, bus in enumerate(buses):
            start_s[i] = max(float(self.free_s[bus]), before_s[i])
            if i == 0 or bus not in buses[:i]:
                self._choose_mishap(bus, float(start_s[i]))
            if bus in broken:
                ack[i], end_s[i] = Ack.NOT_SENT, start_s[i]
            elif self.stuck[bus]:
                broken.add(bus)
                ack[i], end_s[i] = Ack.STUCK, start_s[i] + _MESSAGE_S
            else:
                out = data[offsets[i] : offsets[i + 1]]
                ack[i], end_s[i] = self._carry(frames, i, bus, float(start_s[i]), out)
            self.free_s[bus] = end_s[i]
        return Replies(ack, start_s, end_s, offsets, data)

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        took_s = _CLOCKS_S if recovery == Recovery.CLOCKS else _RESET_S
        self.free_s[bus] = max(t, self.free_s[bus]) + took_s
        if self.stuck[bus] is Mishap.FREED:
            self.stuck[bus] = None
        return float(self.free_s[bus]), self.stuck[bus] is None

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        _advance(self.memory, np.full(len(self.memory), t))
        low = self.memory["powered"] & (self.memory["alert_s"] <= t)
        return np.unique(self.bus[low])

    def positions(self) -> Counts:
        """Return the true encoders, each robot at the time at which its bus is free, (n, 2)."""
        out = np.empty((len(self.memory), 2), dtype=np.int64)
        _advance(self.memory, self.free_s[self.bus])
        _positions(self.memory, self.free_s[self.bus], out)
        return out

    def advance(self, t: float) -> None:
        """Let time pass without a message, until t [s]."""
        self.free_s = np.maximum(self.free_s, t)
        _advance(self.memory, self.free_s[self.bus])

    def _choose_mishap(self, bus: int, t: float) -> None:
        robots = self.rows[bus].tolist()
        powered = [row for row in robots if self.memory["powered"][row]]
        options: list[Option] = [("robot", row, Mishap.RESET) for row in powered]
        options += [("robot", row, Mishap.POWER_LOST) for row in powered]
        options += [
            ("robot", row, Mishap.JAMMED)
            for row in powered
            if self.memory["state"][row] == _MOVING and np.isinf(self.memory["jam_s"][row, 0])
        ]
        if self.may_stick and self.stuck[bus] is None:
            options += [("bus", bus, Mishap.STUCK), ("bus", bus, Mishap.FREED)]
        options.append((Mishap.RAISES,))
        chosen = self.choices.choose(options)
        if chosen is None:
            return
        what = chosen[-1]
        if what is Mishap.RAISES:
            raise BusError
        at = chosen[1]
        if what in (Mishap.STUCK, Mishap.FREED):
            self.stuck[bus] = what
        elif what is Mishap.JAMMED:
            self.memory["jam_s"][at, 0] = t
        else:
            _power(self.memory, at, False, t)
            if what is Mishap.RESET:
                _power(self.memory, at, True, t)

    def _carry(
        self, frames: Frames, i: int, bus: int, start_s: float, out: np.ndarray
    ) -> tuple[int, float]:
        """Let the robots of a bus receive and answer message i; return its Ack and its end [s]."""
        address, ten_bit = int(frames.to.address[i]), bool(frames.to.ten_bit[i])
        robots = self.rows[bus]
        if address != (ROLL_CALL_ADDRESS if ten_bit else 0):
            robots = robots[self.memory["address"][robots] == address]
        sent = frames.data[frames.offsets[i] : frames.offsets[i + 1]]
        options: list[Option] = [(Fate.LOST,), (Fate.REPLY_LOST,), (Fate.LATE,)]
        if len(sent):
            options += [(Fate.DOUBLED,), (Fate.ASTRAY,)]
        if len(robots) > 1:
            options += [(Fate.MISSED, "robot", row) for row in robots.tolist()]
        chosen = self.choices.choose(options)
        fate = None if chosen is None else chosen[0]
        end_s = start_s + _MESSAGE_S + (_LATE_S if fate is Fate.LATE else 0.0)
        if fate in (Fate.LOST, Fate.ASTRAY):
            return Ack.NO_ADDRESS if fate is Fate.LOST else Ack.OK, end_s
        if chosen is not None and fate is Fate.MISSED:
            robots = robots[robots != chosen[-1]]
        waited = self.memory["state"][robots] != _MOVING
        found, accepted = False, False
        for _ in range(2 if fate is Fate.DOUBLED else 1):
            found, accepted = _deliver(
                self.memory, robots, address, ten_bit, sent, start_s, end_s, out
            )
        for row in robots[waited & (self.memory["state"][robots] == _MOVING)].tolist():
            self.on_started(row)
        if fate is Fate.REPLY_LOST:
            out[:] = 0xFF
            return Ack.OK if len(out) else Ack.NO_ADDRESS, end_s
        return Ack.OK if accepted else Ack.REFUSED if found else Ack.NO_ADDRESS, end_s


@njit(cache=True)
def _deliver(m, rows, address, ten_bit, sent, start_s, end_s, out):
    found, accepted = False, False
    for row in rows:
        r = m[row]
        advance_robot(r, start_s)
        if not r.powered or start_s < r.boots_until_s:
            continue
        found, ok = True, True
        if len(sent):
            ok = receive(r, address, ten_bit, sent, 0, len(sent), end_s)
        if ok and len(out):
            at = end_s if len(sent) else start_s
            if ten_bit and address == ROLL_CALL_ADDRESS:
                reply_to_roll_call(r, at, out)
            else:
                reply(r, at, out)
        accepted |= ok
    return found, accepted


@njit(cache=True)
def _advance(m, t):
    for row in range(len(m)):
        advance_robot(m[row], t[row])


@njit(cache=True)
def _positions(m, t, out):
    for row in range(len(m)):
        for joint in range(2):
            out[row, joint] = encoder(m[row], joint, t[row])


@njit(cache=True)
def _power(m, row, on, t):
    set_power(m[row], on, t)

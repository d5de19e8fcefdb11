# SPDX-License-Identifier: Apache-2.0
"""The simulated positioners of a focal plane; they know only the bytes they receive."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.simulation.drive import encoder
from fiber_bus_bridge.simulation.events import EVENT, apply_events, events_in_order, set_power
from fiber_bus_bridge.simulation.firmware import obey, receive, reply, reply_to_roll_call
from fiber_bus_bridge.simulation.memory import new_memory
from fiber_bus_bridge.simulation.noise import Received
from fiber_bus_bridge.wire import ROLL_CALL_ADDRESS, Addresses, Bytes
from fiber_bus_bridge.wire.commands import command_fault
from fiber_core.array_types import Bools, Codes, Counts, Floats, Ints, Mask, Offsets

__all__ = ["Positioners", "Responses"]

_ENCODER_RANGE = 2**31


class Responses(NamedTuple):
    """Responses of the robots to a batch of frames.

    Args:
        acknowledged: whether a robot acknowledged the address of each frame, shape (f,).
        accepted: whether a robot acknowledged the last byte written, shape (f,).
        data: bytes read, shape (offsets[-1],), 0xFF where no robot answers.
    """

    acknowledged: Bools
    accepted: Bools
    data: Bytes


class Positioners:
    """Simulated positioners: they store orders, check them, and run them on their own clocks.

    A joint moves by the decoded whole numbers; nothing is rounded at a tick. A positioner knows
    nothing but the bytes that it received and their times.

    Not modelled: acceleration, and contact between arms: arms pass through each other, which a
    TrueMotion shows. The positions here are those of the counters; where the arms are, the
    `Mechanics` of the plane say, and no robot knows. The drive notices a jammed joint at once and
    stops both joints. Faults of robots are a table of events, each with its time.

    Args:
        addresses: address of each robot, n rows.
        serial: serial number of each robot, shape (n,), 0..2^32 - 1.
        quantum_prad: size of one encoder count [1e-12 rad].
        position: encoders at the beginning [quanta], shape (n, 2).
        clock_ppm: rate error of each clock, positive when fast [1e-6], one number or (n,).
        start_skew_s: delay of each robot's start after a GO [s], one number or (n,).
        coupling: how gears couple motors and joints [GEAR_UNIT], shape (n, 2, 2), zeros of
            independent joints.
        volatile: whether a boot sets the encoders to 0, as of motors that count their steps, one
            value or (n,).

    Raises:
        WireError: a serial number or an encoder value does not fit its field.
    """

    def __init__(
        self,
        addresses: Addresses,
        serial: ArrayLike,
        quantum_prad: int,
        position: ArrayLike,
        clock_ppm: ArrayLike = 0.0,
        start_skew_s: ArrayLike = 0.0,
        coupling: ArrayLike = 0,
        volatile: ArrayLike = False,
    ):
        serial, position = np.asarray(serial), np.asarray(position)
        for name, wrong, value in (
            ("serial number", (serial < 0) | (serial >= 2**32), serial),
            ("encoder", np.abs(position) >= _ENCODER_RANGE, position),
        ):
            if wrong.any():
                at = int(np.argwhere(wrong)[0][0])
                raise WireError(f"row {at}: {name} {value[at].tolist()} does not fit 32 bits")
        self.bus = addresses.bus
        self.memory = new_memory(
            addresses, serial, quantum_prad, position, clock_ppm, start_skew_s, coupling, volatile
        )
        self.schedule(())

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.bus)

    @property
    def addresses(self) -> Addresses:
        """Present address of each robot, n rows."""
        return Addresses(self.bus, self.memory["address"], self.memory["ten_bit"])

    @property
    def powered(self) -> Mask:
        """Whether each robot has power, shape (n,), writable."""
        return self.memory["powered"]

    def schedule(self, events: Iterable[Any]) -> None:
        """Replace the events of the robots, records of EVENT."""
        table, first = events_in_order(np.array(list(events), dtype=EVENT), self.n)
        self._event_queue = table, first[:-1].copy(), first[1:]

    def advance(self, t: float) -> None:
        """Apply all events until time t [s] and advance every robot to that time."""
        _advance_all(self.memory, *self._event_queue, t)

    def positions(self, t: float) -> Counts:
        """Return the true joint positions at time t [s] [quanta], shape (n, 2).

        The time must not be earlier than any frame that a robot has received.
        """
        self.advance(t)
        out = np.empty((self.n, 2), dtype=np.int64)
        _positions(self.memory, t, out)
        return out

    def states(self, t: float) -> Codes:
        """Return the RobotState of each robot at time t [s], shape (n,)."""
        self.advance(t)
        return self.memory["state"].copy()

    def alerting(self, t: float) -> Mask:
        """Return the robots that pull the alert line of their bus at time t [s], shape (n,).

        A robot pulls the line from its stop or boot until its complete status is read.
        """
        found = np.empty(self.n, dtype=np.bool_)
        _alerting(self.memory, *self._event_queue, t, found)
        return found

    def power(self, rows: ArrayLike, on: bool, t: float) -> None:
        """Switch the power of some robots at time t [s]; with power they boot unconfigured."""
        self.advance(t)
        _set_power_of(self.memory, np.atleast_1d(np.asarray(rows)), on, t)

    def exchange(
        self,
        order: Ints,
        low: Ints,
        high: Ints,
        received: Received,
        offsets: Offsets,
        start_s: Floats,
        end_s: Floats,
    ) -> Responses:
        """Let robots receive frames in turn and answer reads.

        Args:
            order: rows of robots; the targets of frame i are order[low[i] : high[i]].
            low: shape (f,).
            high: shape (f,).
            received: the frames as they arrive, f rows; a frame without data is a plain read.
            offsets: first byte of each reply, shape (f + 1,), as in Replies.
            start_s: start of each frame [s], shape (f,); a plain read takes place at this time.
            end_s: end of each frame [s], shape (f,); a write takes effect at this time.
        """
        acknowledged, accepted = np.zeros((2, len(low)), dtype=np.bool_)
        data = np.full(offsets[-1], 0xFF, dtype=np.uint8)
        _exchange(
            self.memory, *self._event_queue, order, low, high, received.address, received.ten_bit,
            received.first, received.last, received.data, received.reads, offsets, start_s, end_s,
            acknowledged, accepted, data,
        )  # fmt: skip
        return Responses(acknowledged, accepted, data)


@njit(cache=True)
def _exchange(
    m, events, next_event, last_event, order, low, high, address, ten_bit, firsts, lasts, sent,
    reads, offsets, start_s, end_s, acknowledged, accepted, data,
):  # fmt: skip
    for f in range(len(low)):
        first, last = firsts[f], lasts[f]
        called = address[f] == 0 and not ten_bit[f]
        fault, head = 0, np.int64(0)
        if called and last > first:  # the same for all robots
            fault, head = command_fault(address[f], ten_bit[f], sent, first, last)
        for k in range(low[f], high[f]):
            row = order[k]
            eventful = next_event[row] < last_event[row]
            if eventful:  # else `obey`, `receive` and `reply` bring the robot to their time
                apply_events(m, events, next_event, last_event, row, start_s[f])
            r = m[row]
            off = not r.powered or start_s[f] < r.boots_until_s
            if off or r.deaf or (called and r.call_deaf):
                continue
            if last > first and eventful:
                # the robot may lose power before the frame is complete
                apply_events(m, events, next_event, last_event, row, end_s[f])
                if not r.powered:
                    continue
            acknowledged[f] = True
            ok = True
            if last > first and called:
                ok = obey(r, fault, head, sent, first + 1, last, end_s[f])
            elif last > first:
                ok = receive(r, address[f], ten_bit[f], sent, first, last, end_s[f])
            if ok and reads[f]:
                at = end_s[f] if last > first else start_s[f]
                out = data[offsets[f] : offsets[f + 1]]
                if ten_bit[f] and address[f] == ROLL_CALL_ADDRESS:
                    reply_to_roll_call(r, at, out)
                else:
                    reply(r, at, out)
            accepted[f] |= ok


@njit(cache=True)
def _positions(m, t, out):
    for row in range(len(out)):
        for joint in range(2):
            out[row, joint] = encoder(m[row], joint, t)


@njit(cache=True)
def _advance_all(m, events, next_event, last_event, t):
    for row in range(len(m)):
        apply_events(m, events, next_event, last_event, row, t)


@njit(cache=True)
def _alerting(m, events, next_event, last_event, t, out):
    for row in range(len(m)):
        apply_events(m, events, next_event, last_event, row, t)
        out[row] = m[row].powered and m[row].alert_s <= t


@njit(cache=True)
def _set_power_of(m, rows, on, t):
    for row in rows:
        set_power(m[row], on, t)

"""All simulated positioners of a focal plane; they understand the wire format and nothing else."""

import numpy as np
from numba import njit

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.simulation.drive import encoder
from fiber_bus_bridge.simulation.events import EVENT, bring_up, events_in_order, switch
from fiber_bus_bridge.simulation.firmware import answer, hear
from fiber_bus_bridge.simulation.memory import new_memory
from fiber_bus_bridge.wire import Addresses

__all__ = ["Positioners"]

_ENCODER_RANGE = 2**31


class Positioners:
    """Simulated positioners: they store orders, check them, and run them on their own clocks.

    A joint moves by the decoded whole numbers and nothing is ever rounded at a tick.
    Nothing is known to them but the bytes they heard and when.

    Not modelled: acceleration, backlash, and contact between arms: whoever should touch goes
    through, which a TrueMotion shows. A joint that jams is noticed by its drive at once, and
    both joints stop. What befalls robots is a table of events, each at its time.

    Args:
        addresses: where each robot listens, n rows.
        serial: number each was built with, shape (n,), 0..2^32 - 1.
        quantum_prad: what one count of their encoders is [1e-12 rad].
        position: encoders at the beginning [quanta], shape (n, 2).
        clock_ppm: how much faster than true time each clock runs [1e-6], one number or (n,).
        start_skew_s: how long after a GO each begins to move [s], one number or (n,).

    Raises:
        WireError: a serial number or an encoder value does not fit its field.
    """

    def __init__(
        self, addresses: Addresses, serial, quantum_prad: int, position,
        clock_ppm=0.0, start_skew_s=0.0,
    ):  # fmt: skip
        serial, position = np.asarray(serial), np.asarray(position)
        for name, wrong, value in (
            ("serial number", (serial < 0) | (serial >= 2**32), serial),
            ("encoder", np.abs(position) >= _ENCODER_RANGE, position),
        ):
            if wrong.any():
                at = int(np.argwhere(wrong)[0][0])
                raise WireError(f"row {at}: {name} {value[at].tolist()} does not fit 32 bits")
        self.bus = addresses.bus
        self.memory = new_memory(addresses, serial, quantum_prad, position, clock_ppm, start_skew_s)
        self.schedule(())

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.bus)

    @property
    def addresses(self) -> Addresses:
        """Where each robot listens, n rows."""
        return Addresses(self.bus, self.memory["address"], self.memory["ten_bit"])

    @property
    def powered(self) -> np.ndarray:
        """Whether each robot has power, shape (n,), writable."""
        return self.memory["powered"]

    def schedule(self, events) -> None:
        """Let other events befall the robots than those given before, records of EVENT."""
        self._events, first = events_in_order(np.array(list(events), dtype=EVENT), self.n)
        self._next, self._last = first[:-1].copy(), first[1:]
        self._fate = self._events, self._next, self._last

    def bring_up(self, t: float) -> None:
        """Let everything happen that has happened until time t [s]."""
        _bring_up_all(self.memory, *self._fate, t)

    def positions(self, t: float) -> np.ndarray:
        """True joint positions at time t [s], not earlier than anything heard: [quanta], (n, 2)."""
        self.bring_up(t)
        out = np.empty((self.n, 2), dtype=np.int64)
        _positions(self.memory, t, out)
        return out

    def states(self, t: float) -> np.ndarray:
        """RobotState of each robot at time t [s], shape (n,)."""
        self.bring_up(t)
        return self.memory["state"].copy()

    def alerting(self, t: float) -> np.ndarray:
        """Return who pulls the alert line of its bus at time t [s], shape (n,).

        A robot pulls it from when it stops by itself or boots until its whole status is read.
        """
        self.bring_up(t)
        return self.powered & (self.memory["alert_s"] <= t)

    def power(self, rows, on: bool, t: float) -> None:
        """Cut or give power to some robots at time t [s]; with power they boot unconfigured."""
        self.bring_up(t)
        _power(self.memory, np.atleast_1d(rows), on, t)

    def exchange(
        self, order, low, high, heard, offsets, start_s, end_s
    ) -> tuple[np.ndarray, np.ndarray]:
        """Let robots hear frames in turn and answer reads.

        Args:
            order: rows of robots; those listening to frame i are order[low[i] : high[i]].
            low: shape (f,).
            high: shape (f,).
            heard: what arrives at the robots, f rows; a frame without data is a plain read.
            offsets: bytes to answer, shape (f + 1,), as in Replies.
            start_s: when each frame begins [s], shape (f,); a plain read is of that instant.
            end_s: when each is complete [s], shape (f,); writes take effect then.

        Returns:
            Whether anybody acknowledged the address, whether anybody acknowledged the last
            byte written, both shape (f,), and the bytes read, shape (offsets[-1],), 0xFF where
            nobody answers.
        """
        there, accepted = np.zeros((2, len(low)), dtype=np.bool_)
        data = np.full(offsets[-1], 0xFF, dtype=np.uint8)
        _exchange(
            self.memory, *self._fate, order, low, high, heard.address, heard.ten_bit,
            heard.first, heard.last, heard.data, heard.reads, offsets, start_s, end_s,
            there, accepted, data,
        )  # fmt: skip
        return there, accepted, data


@njit(cache=True)
def _exchange(
    m, events, next_event, last_event, order, low, high, address, ten_bit, firsts, lasts, sent,
    reads, offsets, start_s, end_s, there, accepted, data,
):  # fmt: skip
    for f in range(len(low)):
        first, last = firsts[f], lasts[f]
        called = address[f] == 0 and not ten_bit[f]
        for k in range(low[f], high[f]):
            row = order[k]
            bring_up(m, events, next_event, last_event, row, start_s[f])
            r = m[row]
            off = not r.powered or start_s[f] < r.boots_until_s
            if off or r.deaf or (called and r.call_deaf):
                continue
            if last > first:
                # it may break down before the frame is complete
                bring_up(m, events, next_event, last_event, row, end_s[f])
                if not r.powered:
                    continue
            there[f] = True
            ok = True
            if last > first:
                ok = hear(r, address[f], ten_bit[f], sent, first, last, end_s[f])
            if ok and reads[f]:
                at = end_s[f] if last > first else start_s[f]
                answer(r, at, data[offsets[f] : offsets[f + 1]])
            accepted[f] |= ok


@njit(cache=True)
def _positions(m, t, out):
    for row in range(len(out)):
        for joint in range(2):
            out[row, joint] = encoder(m[row], joint, t)


@njit(cache=True)
def _bring_up_all(m, events, next_event, last_event, t):
    for row in range(len(m)):
        bring_up(m, events, next_event, last_event, row, t)


@njit(cache=True)
def _power(m, rows, on, t):
    for row in rows:
        switch(m[row], on, t)

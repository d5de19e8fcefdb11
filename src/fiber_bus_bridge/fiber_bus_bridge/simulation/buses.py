# SPDX-License-Identifier: Apache-2.0
"""Simulated buses with simulated positioners, in simulated time."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus.backend import Ack, Replies
from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.bus.timing import BusTiming, bus_timing
from fiber_bus_bridge.simulation.faults import Faults
from fiber_bus_bridge.simulation.lines import BusLines, carry_in_turn
from fiber_bus_bridge.simulation.noise import Received, add_noise
from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_bus_bridge.wire import ROLL_CALL_ADDRESS, Addresses, Bytes, Frames
from fiber_core.array_types import Bools, Codes, Floats, Ints, Rows
from fiber_core.ragged import Parts

__all__ = ["SimulatedBuses"]

# plain numbers: members of an enumeration are slow to look up batch by batch
_OK, _NO_ADDRESS, _REFUSED = int(Ack.OK), int(Ack.NO_ADDRESS), int(Ack.REFUSED)
_NO_BUS = np.zeros(0, dtype=np.int64)
_KEYS_PER_BUS = 4096  # general call, then 128 seven-bit and 1024 ten-bit addresses


class SimulatedBuses:
    """A set of I2C buses that run in parallel in simulated time.

    Each bus carries its frames one after the other and keeps its own time; the duration of a
    frame follows the formula of the standard. A target without power does not acknowledge its
    address; a target that refuses a frame does not acknowledge the last byte. A general call is
    acknowledged when at least one robot acknowledges it (wired AND), and bytes read from several
    targets at one address are the AND of their bytes. In High-speed mode each batch begins with
    the master code, and its messages are joined by repeated START.

    Bits are read wrong, lines stick, clocks are stretched and arbitration is lost according to
    the faults.

    Not modelled: bits that only one listener reads wrong, wrong START or STOP, arbitration
    bit by bit, levels, rise times and wire delays, start byte, device identification, and
    acknowledges of single bytes: a target judges a complete frame. A half-matched ten-bit
    address takes the time of both address bytes. A line that sticks in the middle of a message
    spoils the complete message. The duration of a frame depends on the targets that are present
    when its batch begins; its effect depends on the targets that are present when it arrives.

    Args:
        positioners: the robots on the buses.
        timing: clock and times of every bus.
        faults: faults of lines and robots; none by default.
        rng: source of bit errors.
    """

    def __init__(
        self,
        positioners: Positioners,
        timing: BusTiming | None = None,
        faults: Faults | None = None,
        rng: np.random.Generator | None = None,
    ):
        self.positioners = positioners
        self.timing = timing or bus_timing("1M")
        self._faults = faults or Faults()
        self._rng = rng or np.random.default_rng(0)
        positioners.schedule(self._faults.events)
        self._buses = np.unique(positioners.bus)
        self._free_s = np.full(len(self._buses), -np.inf)
        self._lines = [
            BusLines(
                at, self._free_s, bus, self._faults,
                np.flatnonzero(positioners.bus == bus), 1.0 / self.timing.clock_hz,
            )
            for at, bus in enumerate(self._buses.tolist())
        ]  # fmt: skip
        self._troubled_s = np.array([line.troubled_from_s for line in self._lines])
        self._index_addresses(positioners.addresses)

    def _index_addresses(self, addresses: Addresses) -> None:
        """Sort robots by bus and address."""
        self._addresses = addresses
        keys = self._at(addresses.bus) * _KEYS_PER_BUS + addresses.ten_bit * 1024
        keys += addresses.address
        self._order = np.argsort(keys, kind="stable")
        self._sorted_keys = keys[self._order]

    def _at(self, buses: Ints) -> Ints:
        """Places of buses among all buses, -1 for a bus without robots."""
        at = np.searchsorted(self._buses, buses)
        return np.where(self._buses[np.minimum(at, len(self._buses) - 1)] == buses, at, -1)

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer."""
        f = len(frames)
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,))
        offsets = Parts.from_counts(read).offsets
        not_before = np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,))
        if f == 0:
            nothing = np.zeros(0)
            return Replies(nothing.astype(np.int64), nothing, nothing, offsets, _no_bytes())
        at = self._at(frames.to.bus)
        self._apply_events(at, not_before)
        low, high, answered = self._listeners(at, frames.to)
        lasts_s = self.timing.message_s(
            np.where(answered, frames.lengths, 0), np.where(answered, read, 0), frames.to.ten_bit
        )
        start_s, end_s, line_ack, delivered = self._schedule(at, lasts_s, not_before, low, high)

        received = Received.without_errors(frames, offsets)
        rate = self._error_rate(frames.to.bus, start_s)
        if rate is not None:
            add_noise(received, frames, offsets, rate, self._rng)
            low, high, _ = self._listeners(
                at, Addresses(frames.to.bus, received.address, received.ten_bit)
            )
        received.reads[received.ack_flipped | received.cut_short | (line_ack != _OK)] = False
        high = np.where(delivered & ~received.lost, high, low)
        responses = self.positioners.exchange(
            self._order, low, high, received, offsets, start_s, end_s
        )
        accepted = (responses.accepted ^ received.ack_flipped) & ~received.cut_short
        ack = np.where(responses.acknowledged, np.where(accepted, _OK, _REFUSED), _NO_ADDRESS)
        ack = np.where(line_ack == _OK, ack, line_ack)
        return Replies(ack, start_s, end_s, offsets, responses.data ^ received.reply_errors)

    @property
    def now_s(self) -> float:
        """Time at which all buses are free [s], 0 before the first message."""
        return max(float(self._free_s.max(initial=-np.inf)), 0.0)

    def run_until(self, t: float) -> None:
        """Let time pass without messages until time t [s]; later messages begin after it."""
        np.maximum(self._free_s, t, out=self._free_s)
        self.positioners.advance(t)

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        end_s, free = self._line(bus).recover(recovery, t)
        if recovery == Recovery.POWER:
            rows = np.flatnonzero(self.positioners.bus == bus)
            self.positioners.power(rows, False, t)
            self.positioners.power(rows, True, end_s)
        return end_s, free

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        alerting = self.positioners.alerting(t)
        return np.unique(self.positioners.bus[alerting]) if alerting.any() else _NO_BUS

    def _line(self, bus: int) -> BusLines:
        return self._lines[int(np.searchsorted(self._buses, bus))]

    def _apply_events(self, at: Ints, not_before: Floats) -> None:
        """Apply the events of the robots until the first message begins."""
        if len(self._faults.events) == 0:
            return
        free_s = self._free_s[at].min()
        self.positioners.advance(max(not_before.min(), free_s))
        if not np.array_equal(self.positioners.memory["address"], self._addresses.address):
            self._index_addresses(self.positioners.addresses)

    def _listeners(self, at: Ints, to: Addresses) -> tuple[Ints, Ints, Bools]:
        """Range of the targets of each frame in the sorted order, and whether one answers."""
        low, high = np.zeros((2, len(at)), dtype=np.int64)
        answered = np.zeros(len(at), dtype=bool)
        _listeners(
            self.positioners.memory, self._order, self._sorted_keys,
            at, to.address, to.ten_bit, low, high, answered,
        )  # fmt: skip
        return low, high, answered

    def _schedule(
        self, at: Ints, lasts_s: Floats, not_before: Floats, low: Ints, high: Ints
    ) -> tuple[Floats, Floats, Codes, Bools]:
        """Start, end, the Ack that the lines allow, and whether targets receive it, per frame."""
        start = not_before.copy()
        end = np.where(at < 0, start + lasts_s, start)
        ack, delivered = np.full(len(lasts_s), _OK), np.ones(len(lasts_s), dtype=bool)
        if self.timing.entry_s:
            lasts_s[np.unique(at, return_index=True)[1]] += self.timing.entry_s
        quiet = at
        if np.isfinite(self._troubled_s).any():
            # no message of this batch lasts beyond this time
            last = np.maximum(self._free_s, not_before.max(initial=-np.inf)) + lasts_s.sum()
            troubled = self._troubled_s < last
            quiet = np.where(troubled[at], -1, at)
        carry_in_turn(quiet, lasts_s, not_before, self._free_s, start, end)
        for bus in np.unique(at[quiet < at]):
            rows = np.flatnonzero(at == bus)

            def listeners(i: int, rows: Rows = rows) -> Rows:
                return self._order[low[rows[i]] : high[rows[i]]]

            found = self._lines[bus].carry(lasts_s[rows], not_before[rows], listeners)
            start[rows], end[rows], ack[rows], delivered[rows] = found
            self._troubled_s[bus] = self._lines[bus].troubled_from_s
        return start, end, ack, delivered

    def _error_rate(self, buses: Ints, start_s: Floats) -> Floats | None:
        """Probability that a bit is read wrong, per frame, shape (f,); None on a quiet wire."""
        if not self._faults.noise:
            return None
        rate = np.zeros(len(buses))
        for bus, since, until, level in self._faults.noise:
            rate[(buses == bus) & (start_s >= since) & (start_s < until)] = level
        return rate if rate.any() else None


def _no_bytes() -> Bytes:
    return np.zeros(0, dtype=np.uint8)


@njit(cache=True)
def _listeners(m, order, keys, at, address, ten_bit, low, high, answered):
    for f in range(len(at)):
        if at[f] < 0:
            continue
        called = address[f] == (ROLL_CALL_ADDRESS if ten_bit[f] else 0)
        key = at[f] * _KEYS_PER_BUS
        if not called:
            key += ten_bit[f] * 1024 + address[f]
        low[f] = np.searchsorted(keys, key)
        high[f] = np.searchsorted(keys, key + (_KEYS_PER_BUS if called else 1))
        for k in range(low[f], high[f]):
            r = m[order[k]]
            if r.powered and not r.deaf:
                answered[f] = True
                break

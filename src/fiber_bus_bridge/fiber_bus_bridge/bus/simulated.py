"""Buses that exist only in simulated time, with simulated positioners on them."""

import numpy as np

from fiber_bus_bridge.bus.backend import Ack, Replies
from fiber_bus_bridge.bus.timing import BusTiming, bus_timing
from fiber_bus_bridge.firmware import Positioners
from fiber_bus_bridge.wire import Frames

__all__ = ["SimulatedBuses"]

_KEYS_PER_BUS = 4096  # general call, then 128 seven-bit and 1024 ten-bit addresses


class SimulatedBuses:
    """A set of I2C buses running in parallel in simulated time.

    Each bus carries its frames one after the other and keeps its own time; a frame takes
    what the standard's formula says. A target that is not powered does not acknowledge
    its address, one that refuses what it was sent does not acknowledge the last byte. A
    general call is acknowledged when anybody does (wired AND), and bytes read from several
    targets at one address are the AND of theirs.

    Not modelled: bit errors, stuck lines, clock stretching, arbitration between
    controllers, entry into High-speed mode (the master code at Fast-mode speed), wire
    delays, start byte, device identification, and acknowledges of single bytes: a target
    judges the whole frame. Half-matched ten-bit addresses cost both address bytes.

    Args:
        positioners: the robots on the buses.
        timing: clock and times of every bus.
    """

    def __init__(self, positioners: Positioners, timing: BusTiming | None = None):
        self.positioners = positioners
        self.timing = timing or bus_timing("1M")
        self._buses = np.unique(positioners.addresses.bus)
        self._free_s: dict[int, float] = {}
        keys = self._keys(positioners.addresses)
        self._order = np.argsort(keys, kind="stable")
        self._sorted_keys = keys[self._order]

    def _keys(self, to):
        bus = np.searchsorted(self._buses, to.bus)
        return bus * _KEYS_PER_BUS + to.ten_bit * 1024 + to.address

    def transfer(self, frames: Frames, read_bytes, not_before_s) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer."""
        f = len(frames)
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,))
        not_before = np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,))
        low, high = self._listeners(frames.to)
        powered = np.concatenate([[0], np.cumsum(self.positioners.powered[self._order])])
        answered = powered[high] > powered[low]
        lasts = np.where(
            answered,
            self.timing.message_s(frames.lengths, read, frames.to.ten_bit),
            self.timing.unanswered_s(frames.to.ten_bit),
        )
        start_s, end_s = self._schedule(frames.to.bus, lasts, not_before)
        offsets = np.concatenate([[0], np.cumsum(read)])
        accepted, data = self.positioners.exchange(
            self._order, low, high, frames, offsets, start_s, end_s
        )
        ack = np.where(answered, np.where(accepted, Ack.OK, Ack.REFUSED), Ack.NO_ADDRESS)
        return Replies(ack, start_s, end_s, offsets, data)

    def _listeners(self, to):
        """Range of the robots, in the sorted order, that listen to each frame."""
        known = np.isin(to.bus, self._buses)
        keys = np.where(known, self._keys(to), -1)
        low = np.searchsorted(self._sorted_keys, keys, side="left")
        called = (to.address == 0) & ~to.ten_bit & known
        last = np.where(called, keys + _KEYS_PER_BUS - 1, keys)
        return low, np.searchsorted(self._sorted_keys, last, side="right")

    def _schedule(self, buses, lasts, not_before):
        """Start and end of each frame: in order on its bus, none before its time."""
        start, end = np.empty_like(lasts), np.empty_like(lasts)
        for bus in np.unique(buses):
            rows = np.flatnonzero(buses == bus)
            # end_i = lasts_i + max(not_before_i, end_{i-1}), unrolled
            total = np.cumsum(lasts[rows])
            begin = np.maximum(not_before[rows], self._free_s.get(bus, -np.inf))
            end[rows] = np.maximum.accumulate(begin - (total - lasts[rows])) + total
            start[rows] = end[rows] - lasts[rows]
            self._free_s[bus] = end[rows[-1]]
        return start, end

"""Reliable talk with robots over buses: retries, checked replies, counters, a record of all."""

from collections.abc import Sequence

import numpy as np

from fiber_bus_bridge.bus import Ack, BusBackend, BusCounters, Exchange, Recovery, Replies
from fiber_bus_bridge.wire import (
    IDENTITY_BYTES,
    STATUS_BYTES,
    VERIFY_BYTES,
    Addresses,
    Frames,
    Identities,
    Opcode,
    Statuses,
    decode_identity,
    decode_status,
    encode_command,
)

__all__ = ["Transactions"]

# plain numbers: members of an enumeration are slow to look up batch by batch
_STUCK, _TIMED_OUT = int(Ack.STUCK), int(Ack.TIMED_OUT)


class Transactions:
    """The controller's side of the wire.

    Whatever may be repeated without harm is tried again when it fails, after a pause
    that grows, on the bus of that robot only. GO is not among it. Lines that stick are freed
    by clocks, then by a reset of the branch; a bus that stays stuck is given up until
    `revive`: nothing is sent there and nobody waits for it.

    Args:
        backend: the buses.
        addresses: where each robot listens, n rows.
        backoff_s: pause before each further try [s].
        traffic_limit: batches kept for whoever wants to see the frames; older ones are dropped.
    """

    def __init__(
        self,
        backend: BusBackend,
        addresses: Addresses,
        backoff_s: Sequence[float] = (1e-3, 10e-3),
        traffic_limit: int = 1000,
    ):
        self.backend = backend
        self.addresses = addresses
        self.backoff_s = tuple(backoff_s)
        self.counters = BusCounters(addresses.bus)
        self.failures = np.zeros(len(addresses), dtype=np.int64)  # tries with each robot
        self.given_up = np.zeros(len(self.buses), dtype=bool)
        self.free_s = np.full(len(self.buses), -np.inf)
        self._limit = traffic_limit
        self._traffic: list[Exchange] = []

    @property
    def now_s(self) -> float:
        """When every bus that is not given up is free [s]."""
        return float(self.free_s[~self.given_up].max(initial=-np.inf))

    def revive(self, power: bool = False, t: float = -np.inf) -> None:
        """Try the buses again that were given up, with a power cycle of their branches or without.

        Args:
            power: whether their robots may lose power, and with it orders and configuration.
            t: not before this time [s].
        """
        for at in np.flatnonzero(self.given_up):
            if power:
                bus = int(self.buses[at])
                self.free_s[at], _ = self.backend.recover(bus, Recovery.POWER, max(t, self.now_s))
        self.given_up[:] = False

    @property
    def buses(self) -> np.ndarray:
        """Bus numbers, shape (b,)."""
        return self.counters.buses

    def take_traffic(self) -> list[Exchange]:
        """Return every batch since the last call, oldest first, and forget it."""
        taken, self._traffic = self._traffic, []
        return taken

    def call(self, frames: Frames, t: float) -> Replies:
        """Send frames once, all buses starting together at time t [s] or when all are free."""
        return self.transfer(frames, 0, max(t, self.now_s))

    def send(self, rows, frames: Frames, t: float) -> np.ndarray:
        """Send each frame to its robot until it is acknowledged or tries run out.

        Args:
            rows: robots addressed, shape (r,), in the order of the frames.
            frames: r frames that may be repeated without harm.
            t: not before this time [s].

        Returns:
            OK, or else REFUSED when a robot answered to any of the tries, or else NO_ADDRESS, (r,).
            Whatever it says, a robot may have taken the frame: only a status tells.
        """
        ack = np.full(len(rows), Ack.NO_ADDRESS, dtype=np.int64)

        def attempt(todo, not_before):
            replies = self.transfer(frames[todo], 0, not_before)
            heard = np.isin(replies.ack, (Ack.OK, Ack.REFUSED))
            ack[todo] = np.where(heard, replies.ack, ack[todo])
            return replies, replies.ack == Ack.OK

        self._repeat(rows, attempt, t)
        return ack

    def command(self, opcode: Opcode, rows, t: float) -> np.ndarray:
        """Send a short command to each robot with retries; returns as send."""
        return self.send(rows, encode_command(opcode, self.addresses[rows]), t)

    def statuses(self, rows, t: float, whole: bool = True) -> Statuses:
        """Read the status of robots, whole or only what VERIFY needs, r rows."""
        width = STATUS_BYTES if whole else VERIFY_BYTES
        return decode_status(self.addresses[rows], self._read(rows, b"", width, decode_status, t))

    def identities(self, rows, t: float) -> Identities:
        """Ask robots who they are, r rows."""
        to = self.addresses[rows]
        asks = encode_command(Opcode.IDENTIFY, to)
        return decode_identity(to, self._read(rows, asks, IDENTITY_BYTES, decode_identity, t))

    def _read(self, rows, asks, width, decode, t):
        to = self.addresses[rows]
        frames = asks or Frames.empty(to)
        # a reply that never came stays all ones, which no decoder accepts
        data = np.full((len(to), width), 0xFF, dtype=np.uint8)

        def attempt(todo, not_before):
            replies = self.transfer(frames[todo], width, not_before)
            data[todo] = replies.table(width)
            good = decode(to[todo], data[todo]).ok
            self.counters.add_bad_replies(to.bus[todo][(replies.ack == Ack.OK) & ~good])
            return replies, good

        self._repeat(rows, attempt, t)
        return data

    def _repeat(self, rows, attempt, t):
        """Run attempt(rows still to do, earliest times) until all succeed or tries run out."""
        rows = np.asarray(rows)
        to = self.addresses[rows]
        todo, not_before = np.arange(len(to)), np.full(len(to), float(t))
        tries = np.zeros(len(to), dtype=np.int64)
        bus = self.at(to.bus)
        while len(todo):
            replies, good = attempt(todo, not_before)
            # what was not sent for the fault of another is not a try
            tries[todo] += replies.ack != Ack.NOT_SENT
            self.failures[rows[todo]] += ~good & (replies.ack != Ack.NOT_SENT)
            again = ~good & (tries[todo] <= len(self.backoff_s)) & ~self.given_up[bus[todo]]
            todo = todo[again]
            # who failed oftener comes later: nobody waits behind one that blocks the bus
            todo = todo[np.argsort(tries[todo], kind="stable")]
            # the bus serves the others first: a robot waits for the end of its bus's batch
            pause = np.array([0.0, *self.backoff_s])[tries[todo]]
            not_before = self.free_s[bus[todo]] + pause
            self.counters.add_retries(to.bus[todo])

    def at(self, buses) -> np.ndarray:
        """Return the places of buses among all, same shape."""
        return np.searchsorted(self.buses, buses)

    def transfer(self, frames: Frames, read_bytes, not_before_s, keep: bool = True) -> Replies:
        """Send a batch once, each frame not before its time; see BusBackend.transfer.

        Frames for buses given up are not sent. With `keep` the batch becomes part of the
        traffic, which can be done afterwards too.
        """
        at = self.at(frames.to.bus)
        live = ~self.given_up[at]
        if live.all():
            replies = self.backend.transfer(frames, read_bytes, not_before_s)
        else:
            f = len(frames)
            read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,))
            before = np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,))
            sent = self.backend.transfer(frames[live], read[live], before[live])
            replies = _with_unsent(sent, live, read, before)
        self.counters.add(Exchange(frames, replies))
        if keep:
            self.keep(frames, replies)
        np.maximum.at(self.free_s, at[live], replies.end_s[live])
        failed = live & ((replies.ack == _STUCK) | (replies.ack == _TIMED_OUT))
        if failed.any():
            for bus in np.unique(at[failed]):
                self._free(bus)
        return replies

    def keep(self, frames: Frames, replies: Replies) -> None:
        """Make a batch part of the traffic."""
        self._traffic.append(Exchange(frames, replies))
        del self._traffic[: -self._limit]

    def _free(self, at):
        """Free the lines of a bus, or give it up."""
        for cure in (Recovery.CLOCKS, Recovery.RESET):
            bus = int(self.buses[at])
            self.free_s[at], free = self.backend.recover(bus, cure, self.free_s[at])
            self.counters.add_recovery(at)
            if free:
                return
        self.given_up[at] = True


def _with_unsent(sent, live, read, not_before):
    """The replies of a batch of which only the live frames were sent."""
    ack = np.full(len(live), Ack.NOT_SENT, dtype=np.int64)
    start_s, end_s = not_before.copy(), not_before.copy()
    ack[live], start_s[live], end_s[live] = sent.ack, sent.start_s, sent.end_s
    offsets = np.concatenate([[0], np.cumsum(read)])
    data = np.full(offsets[-1], 0xFF, dtype=np.uint8)
    data[np.repeat(live, read)] = sent.data
    return Replies(ack, start_s, end_s, offsets, data)

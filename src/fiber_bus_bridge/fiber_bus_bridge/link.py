"""Reliable talk with robots over buses: retries, checked replies, counters, a record of all."""

from collections.abc import Sequence

import numpy as np

from fiber_bus_bridge.bus import Ack, BusBackend, BusCounters, Exchange, Replies
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

__all__ = ["Link"]


class Link:
    """The controller's side of the wire.

    Whatever may be repeated without harm is tried again when it fails, after a pause
    that grows, on the bus of that robot only. GO is not among it.

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
        self.now_s = -np.inf
        self._limit = traffic_limit
        self._traffic: list[Exchange] = []

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
        return self._transfer(frames, 0, max(t, self.now_s))

    def send(self, rows, frames: Frames, t: float) -> np.ndarray:
        """Send each frame to its robot until it is acknowledged or tries run out.

        Args:
            rows: robots addressed, shape (r,), in the order of the frames.
            frames: r frames that may be repeated without harm.
            t: not before this time [s].

        Returns:
            OK, or else REFUSED when a robot heard any of the tries, or else NO_ADDRESS, (r,).
        """
        ack = np.full(len(rows), Ack.NO_ADDRESS, dtype=np.int64)

        def attempt(todo, not_before):
            replies = self._transfer(frames[todo], 0, not_before)
            ack[todo] = np.where(replies.ack == Ack.NO_ADDRESS, ack[todo], replies.ack)
            return replies, replies.ack == Ack.OK

        self._repeat(self.addresses[rows], attempt, t)
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
        frames = asks or Frames.equal_length(to, np.zeros((len(to), 0)))
        # a reply that never came stays all ones, which no decoder accepts
        data = np.full((len(to), width), 0xFF, dtype=np.uint8)

        def attempt(todo, not_before):
            replies = self._transfer(frames[todo], width, not_before)
            data[todo] = replies.table(width)
            good = decode(to[todo], data[todo]).ok
            self.counters.add_bad_replies(to.bus[todo][(replies.ack == Ack.OK) & ~good])
            return replies, good

        self._repeat(to, attempt, t)
        return data

    def _repeat(self, to, attempt, t):
        """Run attempt(rows still to do, earliest times) until all succeed or tries run out."""
        todo, not_before = np.arange(len(to)), np.full(len(to), float(t))
        for pause in (*self.backoff_s, None):
            if len(todo) == 0:
                return
            replies, good = attempt(todo, not_before)
            if pause is None:
                return
            # the bus serves the others first: a robot waits for the end of its bus's batch
            _, bus = np.unique(to.bus[todo], return_inverse=True)
            free = np.zeros(bus.max() + 1)
            np.maximum.at(free, bus, replies.end_s)
            todo, not_before = todo[~good], (free[bus] + pause)[~good]
            self.counters.add_retries(to.bus[todo])

    def _transfer(self, frames, read_bytes, not_before_s):
        replies = self.backend.transfer(frames, read_bytes, not_before_s)
        exchange = Exchange(frames, replies)
        self.counters.add(exchange)
        self._traffic.append(exchange)
        del self._traffic[: -self._limit]
        self.now_s = max(self.now_s, replies.end_s.max(initial=-np.inf))
        return replies

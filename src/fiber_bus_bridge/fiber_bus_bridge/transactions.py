# SPDX-License-Identifier: Apache-2.0
"""Reliable transactions with robots over buses: retries, checked replies, counters, traffic."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import Ack, BusBackend, BusCounters, Exchange, Recovery, Replies
from fiber_bus_bridge.wire import (
    IDENTITY_BYTES,
    STATUS_BYTES,
    VERIFY_BYTES,
    Addresses,
    Bytes,
    Frames,
    Identities,
    Opcode,
    Statuses,
    decode_identity,
    decode_status,
    encode_command,
)
from fiber_core.array_types import Bools, Codes, Floats, Ints, Rows
from fiber_core.ragged import Parts

__all__ = ["Transactions"]

# plain numbers: members of an enumeration are slow to look up batch by batch
_STUCK, _TIMED_OUT = int(Ack.STUCK), int(Ack.TIMED_OUT)
_Decoder: TypeAlias = Callable[[Addresses, Bytes], Statuses | Identities]


class Transactions:
    """The controller's transactions on a set of buses.

    A message that may be repeated without harm is sent again when it fails, after a pause that
    grows, on the bus of that robot only. GO is not among these messages. Stuck lines are freed by
    clocks, then by a reset of the branch. A bus that stays stuck is given up until `revive`: no
    message is sent on it, and no other bus waits for it.

    Args:
        backend: the buses.
        addresses: address of each robot, n rows.
        backoff_s: pause before each retry [s].
        traffic_limit: number of batches kept for `take_traffic`; older batches are dropped.
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
        self.failures: Ints = np.zeros(len(addresses), dtype=np.int64)  # failed tries, per robot
        self.given_up: Bools = np.zeros(len(self.buses), dtype=bool)
        self.free_s: Floats = np.full(len(self.buses), -np.inf)
        self._limit = traffic_limit
        self._traffic: list[Exchange] = []

    @property
    def now_s(self) -> float:
        """Time at which every bus that is not given up is free [s]."""
        return float(self.free_s[~self.given_up].max(initial=-np.inf))

    def revive(self, power: bool = False, t: float = -np.inf) -> None:
        """Use again the buses that were given up.

        Args:
            power: whether to power-cycle their branches first, which deletes the orders and the
                configuration of their robots.
            t: earliest time [s].
        """
        for at in np.flatnonzero(self.given_up):
            if power:
                bus = int(self.buses[at])
                self.free_s[at], _ = self.backend.recover(bus, Recovery.POWER, max(t, self.now_s))
        self.given_up[:] = False

    @property
    def buses(self) -> Ints:
        """Bus numbers, shape (b,)."""
        return self.counters.buses

    def take_traffic(self) -> list[Exchange]:
        """Return every batch since the last call, oldest first, and forget them."""
        taken, self._traffic = self._traffic, []
        return taken

    def call(self, frames: Frames, t: float) -> Replies:
        """Send frames once; all buses start together at time t [s], or later when all are free."""
        return self.transfer(frames, 0, max(t, self.now_s))

    def send(self, rows: Rows, frames: Frames, t: float) -> Codes:
        """Send each frame to its robot until it is acknowledged or the retries are used up.

        Args:
            rows: robots addressed, shape (r,), in the order of the frames.
            frames: r frames that may be repeated without harm.
            t: earliest time [s].

        Returns:
            Ack of each frame, shape (r,): OK, else REFUSED when a robot answered one of the tries,
            else NO_ADDRESS. In every case the robot may have accepted the frame: only its status
            shows whether it has.
        """
        ack = np.full(len(rows), Ack.NO_ADDRESS, dtype=np.int64)

        def attempt(todo: Ints, not_before_s: Floats) -> tuple[Replies, Bools]:
            replies = self.transfer(frames[todo], 0, not_before_s)
            answered = np.isin(replies.ack, (Ack.OK, Ack.REFUSED))
            ack[todo] = np.where(answered, replies.ack, ack[todo])
            return replies, replies.ack == Ack.OK

        self._repeat(rows, attempt, t)
        return ack

    def command(self, opcode: Opcode, rows: Rows, t: float) -> Codes:
        """Send a short command to each robot with retries; arguments and result as in `send`."""
        return self.send(rows, encode_command(opcode, self.addresses[rows]), t)

    def statuses(self, rows: Rows, t: float, complete: bool = True) -> Statuses:
        """Read the status of robots, complete or only the part that VERIFY needs, r rows."""
        width = STATUS_BYTES if complete else VERIFY_BYTES
        data = self._read(rows, None, width, decode_status, t)
        return decode_status(self.addresses[rows], data)

    def identities(self, rows: Rows, t: float) -> Identities:
        """Read the identity of robots, r rows."""
        to = self.addresses[rows]
        requests = encode_command(Opcode.IDENTIFY, to)
        return decode_identity(to, self._read(rows, requests, IDENTITY_BYTES, decode_identity, t))

    def _read(
        self, rows: Rows, requests: Frames | None, width: int, decode: _Decoder, t: float
    ) -> Bytes:
        """Read a reply of each robot, after a request or without, with retries, (r, width)."""
        to = self.addresses[rows]
        frames = Frames.empty(to) if requests is None else requests
        # a reply that never came stays all ones, which no decoder accepts
        data = np.full((len(to), width), 0xFF, dtype=np.uint8)

        def attempt(todo: Ints, not_before_s: Floats) -> tuple[Replies, Bools]:
            replies = self.transfer(frames[todo], width, not_before_s)
            data[todo] = replies.table(width)
            valid = decode(to[todo], data[todo]).ok
            self.counters.add_bad_replies(to.bus[todo][(replies.ack == Ack.OK) & ~valid])
            return replies, valid

        self._repeat(rows, attempt, t)
        return data

    def _repeat(
        self, rows: Rows, attempt: Callable[[Ints, Floats], tuple[Replies, Bools]], t: float
    ) -> None:
        """Run attempt(rows to do, earliest times) until all succeed or retries are used up."""
        rows = np.asarray(rows)
        to = self.addresses[rows]
        todo, not_before_s = np.arange(len(to)), np.full(len(to), float(t))
        tries = np.zeros(len(to), dtype=np.int64)
        bus = self.places(to.bus)
        while len(todo):
            replies, succeeded = attempt(todo, not_before_s)
            # a frame that was not sent because of another robot is not a try
            tries[todo] += replies.ack != Ack.NOT_SENT
            self.failures[rows[todo]] += ~succeeded & (replies.ack != Ack.NOT_SENT)
            retry = ~succeeded & (tries[todo] <= len(self.backoff_s))
            todo = todo[retry & ~self.given_up[bus[todo]]]
            # robots with more failures come later: no robot waits behind one that blocks the bus
            todo = todo[np.argsort(tries[todo], kind="stable")]
            # the bus serves the other robots first: a retry waits for the end of the batch
            pause_s = np.array([0.0, *self.backoff_s])[tries[todo]]
            not_before_s = self.free_s[bus[todo]] + pause_s
            self.counters.add_retries(to.bus[todo])

    def places(self, buses: ArrayLike) -> Ints:
        """Return the places of bus numbers in `buses`, same shape."""
        return np.searchsorted(self.buses, np.asarray(buses, dtype=np.int64))

    def transfer(
        self,
        frames: Frames,
        read_bytes: ArrayLike,
        not_before_s: ArrayLike,
        in_traffic: bool = True,
    ) -> Replies:
        """Send a batch once, each frame not before its time; see BusBackend.transfer.

        Frames for buses that were given up are not sent.

        Args:
            frames: frames to write.
            read_bytes: number of bytes to read after each frame, one number or shape (f,).
            not_before_s: earliest start of each frame [s], one number or shape (f,).
            in_traffic: whether the batch becomes part of the traffic; else see `add_traffic`.
        """
        at = self.places(frames.to.bus)
        live = ~self.given_up[at]
        if live.all():
            replies = self.backend.transfer(frames, read_bytes, not_before_s)
        else:
            f = len(frames)
            read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,))
            before_s = np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,))
            sent = self.backend.transfer(frames[live], read[live], before_s[live])
            replies = _with_unsent(sent, live, read, before_s)
        self.counters.add(Exchange(frames, replies))
        if in_traffic:
            self.add_traffic(frames, replies)
        np.maximum.at(self.free_s, at[live], replies.end_s[live])
        failed = live & ((replies.ack == _STUCK) | (replies.ack == _TIMED_OUT))
        if failed.any():
            for bus in np.unique(at[failed]).tolist():
                self._free(bus)
        return replies

    def add_traffic(self, frames: Frames, replies: Replies) -> None:
        """Add a batch to the traffic."""
        self._traffic.append(Exchange(frames, replies))
        del self._traffic[: -self._limit]

    def _free(self, at: int) -> None:
        """Free the lines of the bus buses[at], or give the bus up."""
        for recovery in (Recovery.CLOCKS, Recovery.RESET):
            bus, t = int(self.buses[at]), float(self.free_s[at])
            self.free_s[at], free = self.backend.recover(bus, recovery, t)
            self.counters.add_recovery(at)
            if free:
                return
        self.given_up[at] = True


def _with_unsent(sent: Replies, live: Bools, read: Ints, not_before_s: Floats) -> Replies:
    """The replies of a batch of which only the live frames were sent."""
    ack = np.full(len(live), Ack.NOT_SENT, dtype=np.int64)
    start_s, end_s = not_before_s.copy(), not_before_s.copy()
    ack[live], start_s[live], end_s[live] = sent.ack, sent.start_s, sent.end_s
    offsets = Parts.from_counts(read).offsets
    data = np.full(offsets[-1], 0xFF, dtype=np.uint8)
    data[np.repeat(live, read)] = sent.data
    return Replies(ack, start_s, end_s, offsets, data)

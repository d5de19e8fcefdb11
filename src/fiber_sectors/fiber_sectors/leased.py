# SPDX-License-Identifier: Apache-2.0
"""Buses that carry no heartbeat after the lease of their sector, however late its process is."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge import Session
from fiber_bus_bridge.bus import BusBackend, Recovery, Replies
from fiber_bus_bridge.wire import CALL_PREFIX, Frames, Opcode
from fiber_core.array_types import Bools, Ints
from fiber_core.ragged import Parts
from fiber_sectors.paced import LeaseEnded, PacedBuses

__all__ = ["LeaseEnded", "LeasedBuses"]

_HEARTBEAT = int(Opcode.HEARTBEAT)


class LeasedBuses:
    """The buses of a sector, which refuse what would be sent too late.

    A process that is paused in a step goes on with it, when its lease may have ended. So the
    clock is looked at before each single heartbeat of a bus. A pause between that look and its
    heartbeat cannot be seen; robots hear a late heartbeat only while they move, so within silence_s
    of the one before, which was sent before the look. Whatever is paused, robots that were last let
    to move under a lease rest less than 2 silence_s after its end. Simulated buses carry a batch at
    the times that follow from one look, whatever is paused: one look is enough for them.

    Args:
        buses: the buses.
        clock: time of this host [s].

    """

    def __init__(self, buses: BusBackend, clock: Callable[[], float]):
        self._buses, self._clock = buses, clock
        self._until_s = math.inf  # outside of a step: a STOP must always be sent

    def advance_one_step(self, session: Session, until_s: float, limit_s: float) -> bool:
        """Let robots be supervised until a time, by one step at most: a lease is asked for each.

        Args:
            session: their session, which uses these buses.
            until_s: time at which or later no step begins [s].
            limit_s: end of the lease, at which or later nothing is sent [s].

        Returns:
            Whether nothing came too late; else the session stops all robots at its next call.
        """
        watch = session.protocol.watch
        if watch is not None:
            until_s = min(until_s, math.nextafter(watch.now_s, math.inf))
        self._until_s = limit_s
        try:
            session.advance(until_s)
        except LeaseEnded:
            return False
        finally:
            self._until_s = math.inf
        return True

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer.

        In a step each real bus carries one heartbeat at a time, and waits for the others after it.

        Raises:
            LeaseEnded: it is too late for the rest of them, which is not sent.
        """
        if math.isinf(self._until_s):
            return self._buses.transfer(frames, read_bytes, not_before_s)
        if isinstance(self._buses, PacedBuses):
            return self._buses.transfer(frames, read_bytes, not_before_s, self._until_s)
        return self._one_by_one(frames, read_bytes, not_before_s)

    def _one_by_one(
        self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike
    ) -> Replies:
        part = _parts(frames)
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (len(frames),))
        before_s = np.broadcast_to(np.asarray(not_before_s, dtype=float), (len(frames),))
        offsets = Parts.from_counts(read).offsets
        joined = Replies(
            np.zeros(len(frames), dtype=np.int64), np.zeros(len(frames)), np.zeros(len(frames)),
            offsets, np.zeros(offsets[-1], dtype=np.uint8),
        )  # fmt: skip
        for each in np.unique(part):
            rows = np.flatnonzero(part == each)
            LeaseEnded.check(self._clock(), self._until_s)
            replies = self._buses.transfer(frames[rows], read[rows], before_s[rows])
            joined.ack[rows] = replies.ack
            joined.start_s[rows], joined.end_s[rows] = replies.start_s, replies.end_s
            joined.data[Parts(offsets).select(rows)[1]] = replies.data
        return joined

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        return self._buses.recover(bus, recovery, t)

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        return self._buses.alert_lines(t)


def _parts(frames: Frames) -> Ints:
    """Return the part in which each frame is sent, shape (f,).

    A heartbeat is alone in its part on its bus, and each bus keeps the order of its frames.
    """
    beats, order = _heartbeats(frames), np.argsort(frames.to.bus, kind="stable")
    bus, so_far = frames.to.bus[order], np.append(0, np.cumsum(beats[order]))
    part = np.empty(len(frames), dtype=np.int64)
    # those of the buses before do not count
    part[order] = 2 * (so_far[1:] - so_far[np.searchsorted(bus, bus)])
    return part - beats


def _heartbeats(frames: Frames) -> Bools:
    """Return which frames are heartbeats, shape (f,)."""
    data = np.append(frames.data, np.zeros(2, dtype=np.uint8))
    first = frames.offsets[:-1]
    called = data[first] == CALL_PREFIX
    return (frames.lengths > 0) & (data[first + called] >> 4 == _HEARTBEAT)

# SPDX-License-Identifier: Apache-2.0
"""Simulated buses whose time is that of a clock: what they carry takes as long as on real ones."""

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import BusBackend, Recovery, Replies
from fiber_bus_bridge.wire import Frames
from fiber_core.array_types import Ints
from fiber_sectors.errors import SectorError

__all__ = ["LeaseEnded", "PacedBuses"]


class LeaseEnded(SectorError):
    """A step was late: its messages would have been sent after the end of the lease."""

    @classmethod
    def check(cls, now_s: float, limit_s: float) -> None:
        """Raise LeaseEnded at `limit_s` or later."""
        if now_s >= limit_s:
            raise cls(f"a step is {1e3 * (now_s - limit_s):.3g} ms too late to be sent")


class PacedBuses:
    """Buses that begin no message before its time, and end a call when its last message has ended.

    A machine that is late sends late, and the robots see it.

    Args:
        buses: the simulated buses.
        clock: time of this host [s]; all times of this class are times of this clock.
        wait: waits for a number of seconds of the clock.
        origin_s: time of the clock at which that of the buses is 0 [s]; None for now.
    """

    def __init__(
        self,
        buses: BusBackend,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
        origin_s: float | None = None,
    ):
        self._buses, self._clock, self._wait = buses, clock, wait
        self._origin_s = clock() if origin_s is None else origin_s

    def transfer(
        self,
        frames: Frames,
        read_bytes: ArrayLike,
        not_before_s: ArrayLike,
        limit_s: float = math.inf,
    ) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer.

        Args:
            frames, read_bytes, not_before_s: the batch.
            limit_s: time at which or later none begins [s].

        Raises:
            LeaseEnded: it is too late for them; none is sent.
        """
        now_s = self._clock()
        LeaseEnded.check(now_s, limit_s)
        begin_s = np.maximum(np.asarray(not_before_s, dtype=float), now_s)
        replies = self._buses.transfer(frames, read_bytes, begin_s - self._origin_s)
        start_s, end_s = replies.start_s + self._origin_s, replies.end_s + self._origin_s
        self._until(float(end_s.max(initial=-np.inf)))
        return Replies(replies.ack, start_s, end_s, replies.offsets, replies.data)

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        begin_s = max(t, self._clock()) - self._origin_s
        end_s, free = self._buses.recover(bus, recovery, begin_s)
        self._until(end_s + self._origin_s)
        return end_s + self._origin_s, free

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        return self._buses.alert_lines(t - self._origin_s)

    def _until(self, t: float) -> None:
        left_s = t - self._clock()
        if left_s > 0.0:
            self._wait(left_s)

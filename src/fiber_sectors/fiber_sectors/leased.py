# SPDX-License-Identifier: Apache-2.0
"""Buses that carry no heartbeat after the lease of their sector, however late its process is."""

import math
from collections.abc import Callable

from numpy.typing import ArrayLike

from fiber_bus_bridge import Session
from fiber_bus_bridge.bus import BusBackend, Recovery, Replies
from fiber_bus_bridge.wire import Frames
from fiber_core.array_types import Ints
from fiber_sectors.errors import SectorError

__all__ = ["LeaseEnded", "LeasedBuses"]


class LeaseEnded(SectorError):
    """A step was late: its messages would have been sent after the end of the lease."""


class LeasedBuses:
    """The buses of a sector, which refuse what would be sent too late.

    A process that is paused in a step goes on with it, when its lease may have ended. Its
    heartbeats would let robots move on for as long as they move without heartbeats.

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

        Raises:
            LeaseEnded: it is too late for them; none is sent.
        """
        if (now_s := self._clock()) >= self._until_s:
            raise LeaseEnded(
                f"a step is {1e3 * (now_s - self._until_s):.3g} ms too late to be sent"
            )
        return self._buses.transfer(frames, read_bytes, not_before_s)

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        return self._buses.recover(bus, recovery, t)

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        return self._buses.alert_lines(t)

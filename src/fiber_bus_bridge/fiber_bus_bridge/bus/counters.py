"""Counts per bus of what went over it, for diagnostics."""

import numpy as np

from fiber_bus_bridge.bus.backend import Ack, Exchange

__all__ = ["BusCounters"]

_COUNTS = (
    "frames", "bytes", "no_address", "refused", "line_errors", "retries", "bad_replies",
    "recoveries",
)  # fmt: skip


# plain numbers: members of an enumeration are slow to look up batch by batch
_OK, _NO_ADDRESS = int(Ack.OK), int(Ack.NO_ADDRESS)
_REFUSED, _LOST = int(Ack.REFUSED), int(Ack.LOST)


class BusCounters:
    """Running totals, one entry per bus, in the order of `buses`.

    Args:
        buses: bus numbers, shape (b,).
    """

    def __init__(self, buses):
        self.buses = np.unique(buses)
        b = len(self.buses)
        for name in _COUNTS:
            setattr(self, name, np.zeros(b, dtype=np.int64))
        self.busy_s = np.zeros(b)

    def add(self, exchange: Exchange) -> None:
        """Count a batch; bytes are data bytes, read and written."""
        frames, replies = exchange.frames, exchange.replies
        at, ack = self._rows(frames.to.bus), replies.ack
        good, refused = ack == _OK, ack == _REFUSED
        moved = np.where(good | refused, frames.lengths, 0)
        moved += np.where(good, np.diff(replies.offsets), 0)
        self.frames += self._count(at)
        self.bytes += self._count(at, moved).astype(np.int64)
        self.busy_s += self._count(at, replies.end_s - replies.start_s)
        if not good.all():
            self.no_address += self._count(at[ack == _NO_ADDRESS])
            self.refused += self._count(at[refused])
            self.line_errors += self._count(at[ack >= _LOST])

    def add_retries(self, buses) -> None:
        """Count one more try on each of these buses, shape (f,)."""
        self.retries += self._count(self._rows(buses))

    def add_bad_replies(self, buses) -> None:
        """Count replies whose checksum was wrong on these buses, shape (f,)."""
        self.bad_replies += self._count(self._rows(buses))

    def add_recovery(self, at: int) -> None:
        """Count an attempt to free the lines of the bus at this place."""
        self.recoveries[at] += 1

    def table(self) -> dict[int, dict[str, float]]:
        """Return the totals of each bus by name."""
        columns = {name: getattr(self, name).tolist() for name in (*_COUNTS, "busy_s")}
        return {
            int(bus): {name: column[i] for name, column in columns.items()}
            for i, bus in enumerate(self.buses)
        }

    def _rows(self, buses):
        return np.searchsorted(self.buses, buses)

    def _count(self, rows, weights=None):
        return np.bincount(rows, weights, minlength=len(self.buses))

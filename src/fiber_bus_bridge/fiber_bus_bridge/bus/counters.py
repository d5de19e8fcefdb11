"""Counts per bus of what went over it, for diagnostics."""

import numpy as np
from numba import njit

from fiber_bus_bridge.bus.backend import Ack, Exchange

__all__ = ["BusCounters"]

_COUNTS = (
    "frames", "bytes", "no_address", "refused", "line_errors", "retries", "bad_replies",
    "recoveries",
)  # fmt: skip


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
        _add(
            self._rows(frames.to.bus), replies.ack, frames.offsets, replies.offsets,
            replies.start_s, replies.end_s, self.frames, self.bytes, self.busy_s,
            self.no_address, self.refused, self.line_errors,
        )  # fmt: skip

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

    def _count(self, rows):
        return np.bincount(rows, minlength=len(self.buses))


@njit(cache=True)
def _add(
    at, ack, written, read, start_s, end_s,
    frames, sizes, busy_s, no_address, refused, line_errors,
):  # fmt: skip
    for f in range(len(at)):
        bus = at[f]
        frames[bus] += 1
        busy_s[bus] += end_s[f] - start_s[f]
        if ack[f] == _OK or ack[f] == _REFUSED:
            sizes[bus] += written[f + 1] - written[f]
        if ack[f] == _OK:
            sizes[bus] += read[f + 1] - read[f]
        no_address[bus] += ack[f] == _NO_ADDRESS
        refused[bus] += ack[f] == _REFUSED
        line_errors[bus] += ack[f] >= _LOST

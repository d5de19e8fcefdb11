# SPDX-License-Identifier: Apache-2.0
"""Counters of the traffic and the errors of each bus, for diagnostics."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus.backend import Ack, Exchange
from fiber_core.array_types import Floats, Ints

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

    def __init__(self, buses: ArrayLike):
        self.buses: Ints = np.unique(np.asarray(buses, dtype=np.int64))
        b = len(self.buses)
        self._counts = {name: np.zeros(b, dtype=np.int64) for name in _COUNTS}
        self._busy_s = np.zeros(b)

    def add(self, exchange: Exchange) -> None:
        """Count a batch; bytes are data bytes, read and written."""
        frames, replies, counts = exchange.frames, exchange.replies, self._counts
        _add(
            self._rows(frames.to.bus), replies.ack, frames.offsets, replies.offsets,
            replies.start_s, replies.end_s, counts["frames"], counts["bytes"], self._busy_s,
            counts["no_address"], counts["refused"], counts["line_errors"],
        )  # fmt: skip

    def add_retries(self, buses: Ints) -> None:
        """Count one retry for each bus number, shape (f,)."""
        self._counts["retries"] += self._count(buses)

    def add_bad_replies(self, buses: Ints) -> None:
        """Count one reply with a wrong checksum for each bus number, shape (f,)."""
        self._counts["bad_replies"] += self._count(buses)

    def add_recovery(self, at: int) -> None:
        """Count an attempt to free the lines of the bus buses[at]."""
        self._counts["recoveries"][at] += 1

    def table(self) -> dict[int, dict[str, float]]:
        """Return the totals of each bus by name; busy_s is the time in use [s]."""
        columns: dict[str, Ints | Floats] = {**self._counts, "busy_s": self._busy_s}
        return {
            int(bus): {name: column[i].item() for name, column in columns.items()}
            for i, bus in enumerate(self.buses)
        }

    def _rows(self, buses: Ints) -> Ints:
        return np.searchsorted(self.buses, buses)

    def _count(self, buses: Ints) -> Ints:
        return np.bincount(self._rows(buses), minlength=len(self.buses))


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

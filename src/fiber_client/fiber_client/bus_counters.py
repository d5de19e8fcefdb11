# SPDX-License-Identifier: Apache-2.0
"""Frames and errors of all buses together, from the counters in the diagnostics."""

import time
from collections.abc import Callable

from fiber_msgs_py import Status

__all__ = ["BusCounterTotals"]

_PREFIX = "bridge: bus "
_NAMES = ("frames", "bytes", "retries", "no_address", "refused", "bad_replies")


class BusCounterTotals:
    """Sums the counters of the buses from the first status of each bus on.

    Args:
        clock: returns seconds, for the rate.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._first: dict[str, dict[str, int]] = {}
        self._latest: dict[str, dict[str, int]] = {}
        self._mark = (0.0, 0)  # when the rate was last taken, and the frames then
        self.frames_per_s = 0.0

    def add(self, status: Status) -> bool:
        """Take the counters of a status; return whether it was the status of a bus."""
        if not status.name.startswith(_PREFIX):
            return False
        counters = {name: status.count(name) for name in _NAMES}
        self._first.setdefault(status.name, counters)
        self._latest[status.name] = counters
        when, frames = self._mark
        passed = self._clock() - when
        if passed >= 1.0:
            total = self.totals["frames"]
            self.frames_per_s = (total - frames) / passed if when else 0.0
            self._mark = (self._clock(), total)
        return True

    @property
    def totals(self) -> dict[str, int]:
        """Sums over all buses, by name of the counter."""
        return {
            name: sum(self._latest[bus][name] - self._first[bus][name] for bus in self._latest)
            for name in _NAMES
        }

    def __str__(self) -> str:
        sums = self.totals
        failed = sums["no_address"] + sums["refused"] + sums["bad_replies"]
        return (
            f"{sums['frames']:,} frames, {self.frames_per_s:,.0f} a second, "
            f"{sums['retries']:,} retries, {failed:,} failed"
        )

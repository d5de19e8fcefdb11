"""What all buses carried together, and how fast, from the counters in the diagnostics."""

import time
from collections.abc import Callable

from fiber_msgs_py import Status

__all__ = ["BusCounterTotals"]

_PREFIX = "bridge: bus "
_NAMES = ("frames", "bytes", "retries", "no_address", "refused", "bad_replies")


class BusCounterTotals:
    """Sums the counters of the buses since each was first heard.

    Args:
        clock: seconds, for the rate.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._first: dict[str, dict[str, int]] = {}
        self._now: dict[str, dict[str, int]] = {}
        self._mark = (0.0, 0)  # when the rate was last taken, and the frames then
        self.frames_per_s = 0.0

    def hear(self, status: Status) -> bool:
        """Take in a status; return whether it was that of a bus."""
        if not status.name.startswith(_PREFIX):
            return False
        counters = {name: int(status.values.get(name, 0)) for name in _NAMES}
        self._first.setdefault(status.name, counters)
        self._now[status.name] = counters
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
            name: sum(self._now[bus][name] - self._first[bus][name] for bus in self._now)
            for name in _NAMES
        }

    def __str__(self) -> str:
        sums = self.totals
        failed = sums["no_address"] + sums["refused"] + sums["bad_replies"]
        return (
            f"{sums['frames']:,} frames, {self.frames_per_s:,.0f} a second, "
            f"{sums['retries']:,} retries, {failed:,} failed"
        )

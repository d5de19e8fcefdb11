# SPDX-License-Identifier: Apache-2.0
"""The time grid: instants at which profiles may change speed, in whole ticks of the wire."""

import math
from dataclasses import dataclass, replace

import numpy as np

from fiber_core.array_types import Times

__all__ = ["TimeGrid", "time_grid"]

_LEAST = 4  # intervals; the moves of the local search need as many
_FEWER, _MORE = 0.85, 1.3  # range of the number of intervals, in units of the wanted one


@dataclass(frozen=True)
class TimeGrid:
    """Equal intervals of whole ticks.

    A breakpoint between two ticks cannot be sent. To round it would displace an arm of a slow
    instrument by 0.15 mm (half of a 60 ms tick at 12 deg/s and 24 mm).

    Args:
        tick_s: one tick of the wire [s].
        ticks: length of an interval [ticks].
        intervals: their number.
    """

    tick_s: float
    ticks: int
    intervals: int

    @property
    def step_s(self) -> float:
        """Length of an interval [s]."""
        return self.ticks * self.tick_s

    @property
    def makespan_s(self) -> float:
        """End of the last interval [s]."""
        return self.intervals * self.step_s

    @property
    def time_s(self) -> Times:
        """The instants [s], shape (intervals + 1,)."""
        return self.step_s * np.arange(self.intervals + 1)

    def lasting(self, least_s: float) -> "TimeGrid":
        """Return this grid with more intervals at its end, so that it lasts `least_s` [s]."""
        intervals = math.ceil(least_s / self.step_s - 1e-9)
        return replace(self, intervals=max(self.intervals, intervals))


def time_grid(least_s: float, tick_s: float, wanted: int) -> TimeGrid:
    """Return a grid of about the wanted number of intervals that exceeds a makespan least.

    There are 0.45 to 2.6 times the wanted intervals: few ticks cannot be divided more evenly.

    Args:
        least_s: makespan that the grid must last, more than zero [s].
        tick_s: one tick of the wire [s].
        wanted: number of intervals, 4 or more, if there are as many ticks.
    """
    total = max(_LEAST, math.ceil(least_s / tick_s - 1e-9))
    if total <= wanted:
        return TimeGrid(tick_s, 1, total)
    longest = min(int(total / (_FEWER * wanted)) + 1, total // _LEAST)
    lengths = range(max(1, int(total / (_MORE * wanted))), longest + 1)
    grids = [TimeGrid(tick_s, ticks, -(-total // ticks)) for ticks in lengths]
    return min(grids, key=lambda grid: (grid.ticks * grid.intervals, abs(grid.intervals - wanted)))

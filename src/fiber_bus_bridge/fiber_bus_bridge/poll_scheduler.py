# SPDX-License-Identifier: Apache-2.0
"""Division of the time of each bus between the roll call and reading the status of robots."""

from copy import copy

import numpy as np
from numba import njit

from fiber_core.array_types import Floats, Ints, Mask, Rows

__all__ = ["PollScheduler"]

_FIRST = 1  # robots of a bus read in the first step, before the time of a read is known
_HALF = 0.5  # part of the budget that a bus uses while the roll is called


class PollScheduler:
    """Chooses, for each step and each bus, the robots to read, one after the other in turn.

    While the roll is called, call and reads take half of the budget, so that a bus is soon free for
    what follows; otherwise the reads take all of it.

    Args:
        bus: place of the bus of each robot, shape (n,).
        buses: number of buses.
        budget_s: time of a bus for polls in each step [s].
        read_s: time of one read as far as it is known beforehand, 0 when unknown [s].
    """

    def __init__(self, bus: Ints, buses: int, budget_s: float, read_s: float = 0.0):
        self._bus, self._budget_s = bus, budget_s
        self._order = np.argsort(bus, kind="stable")
        self._first = np.searchsorted(bus[self._order], np.arange(buses + 1))
        # the longest of the last step, 0 when unknown
        self._read_s, self._call_s = np.full(buses, read_s), np.zeros(buses)
        self._next = np.zeros(buses, dtype=np.int64)

    def copy(self) -> "PollScheduler":
        """Return a scheduler that goes on from here by itself."""
        other = copy(self)
        other._read_s, other._call_s = self._read_s.copy(), self._call_s.copy()
        other._next = self._next.copy()
        return other

    def state(self) -> list[bytes]:
        """Return what has an influence on the next choices, as bytes."""
        return [column.tobytes() for column in (self._read_s, self._call_s, self._next)]

    def next(self, robots: Mask, call: bool) -> Rows:
        """Return the rows to read, in the order of their buses.

        Args:
            robots: robots to read, shape (n,).
            call: whether the roll is called in this step.
        """
        left_s = np.full(len(self._next), self._budget_s)
        if call:
            left_s = _HALF * left_s - self._call_s
        rows = np.empty(len(robots), dtype=np.int64)
        chosen = _next(self._order, self._first, robots, left_s, self._read_s, self._next, rows)
        return rows[:chosen]

    def observe(self, read: Rows, read_took_s: Floats, called: Ints, call_took_s: Floats) -> None:
        """Take over the measured times of the reads and the roll calls of a step [s].

        Args:
            read: rows that were read, shape (r,).
            read_took_s: time of each read [s], shape (r,).
            called: places of the buses on which the roll was called, shape (c,).
            call_took_s: time of each roll call [s], shape (c,).
        """
        _longest(self._bus, read, read_took_s, self._read_s)
        self._call_s[called] = call_took_s


@njit(cache=True)
def _next(order, first, robots, left_s, read_s, after, rows):
    # The next robots of each bus after the last chosen one; returns the number of entries of rows.
    k = 0
    for bus in range(len(read_s)):
        size, begin = first[bus + 1] - first[bus], after[bus]
        end = k + (max(int(left_s[bus] / read_s[bus]), 1) if read_s[bus] > 0.0 else _FIRST)
        for i in range(size):
            if k == end:
                break
            place = (begin + i) % size
            row = order[first[bus] + place]
            if robots[row]:
                rows[k] = row
                after[bus] = place + 1
                k += 1
    return k


@njit(cache=True)
def _longest(bus, rows, took_s, longest_s):
    for row in rows:
        longest_s[bus[row]] = 0.0
    for i in range(len(rows)):
        longest_s[bus[rows[i]]] = max(longest_s[bus[rows[i]]], took_s[i])

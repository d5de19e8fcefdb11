"""Division of the time of each bus between reading the status of robots and testing their presence.

A presence test is a write without data: a robot with power acknowledges its address, which takes
a tenth of the time of a status.
"""

import numpy as np
from numba import njit

from fiber_core.array_types import Floats, Ints, Mask, Rows

__all__ = ["PollScheduler"]

_FIRST = 1  # robots of a bus read in the first step, before the time of a read is known
# part of the time budget for presence tests: where it suffices for all robots, and where not
_ALL, _SOME = 0.6, 0.3
_TEST = 0.15  # time of a presence test in times of a read, before it is known
_EARLY = 0.5  # part of the budget that a bus uses on which all robots are tested


class PollScheduler:
    """Chooses, for each step and each bus, the robots to read and the robots to test.

    Where all robots of a bus can be tested in the first half of each step, they are, so that the
    loss of power is noticed by then. A larger bus uses the whole budget, and less of it for tests.

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
        self._read_s, self._test_s = np.full(buses, read_s), np.zeros(buses)
        self._read_next, self._test_next = np.zeros((2, buses), dtype=np.int64)

    def next(self, robots: Mask, test: bool) -> tuple[Rows, Rows]:
        """Return the rows to read and the rows to test, each in the order of their buses.

        Args:
            robots: robots to poll, shape (n,).
            test: whether presence is tested in this step.
        """
        reads = np.empty(len(robots), dtype=np.int64)
        tests = np.empty(len(robots), dtype=np.int64)
        r, a = _next(
            self._order, self._first, robots, test, self._budget_s, self._read_s, self._test_s,
            self._read_next, self._test_next, reads, tests,
        )  # fmt: skip
        return reads[:r], tests[:a]

    def observe(self, read: Rows, read_took_s: Floats, tested: Rows, test_took_s: Floats) -> None:
        """Take over the measured times of the reads and the tests of a step [s].

        Args:
            read: rows that were read, shape (r,).
            read_took_s: time of each read [s], shape (r,).
            tested: rows that were tested, shape (a,).
            test_took_s: time of each test [s], shape (a,).
        """
        _longest(self._bus, read, read_took_s, self._read_s)
        _longest(self._bus, tested, test_took_s, self._test_s)


@njit(cache=True)
def _next(order, first, robots, test, budget_s, read_s, test_s, read_next, test_next, reads, tests):
    r = a = 0
    for bus in range(len(read_s)):
        present = 0
        for k in range(first[bus], first[bus + 1]):
            present += robots[order[k]]
        if present == 0:
            continue
        left_s = budget_s
        if test and read_s[bus] > 0.0:
            one_s = test_s[bus] if test_s[bus] > 0.0 else _TEST * read_s[bus]
            if present * one_s <= _ALL * _EARLY * budget_s:
                many, left_s = present, _EARLY * budget_s
            else:
                many = min(present, max(int(_SOME * budget_s / one_s), 1))
            a = _round_robin(order, first, bus, robots, many, test_next, tests, a)
            left_s -= many * one_s
        many = max(int(left_s / read_s[bus]), 1) if read_s[bus] > 0.0 else _FIRST
        r = _round_robin(order, first, bus, robots, many, read_next, reads, r)
    return r, a


@njit(cache=True)
def _round_robin(order, first, bus, robots, many, after, out, k):
    # The next robots of a bus after the last chosen one; returns the number of entries of out.
    size, begin, end = first[bus + 1] - first[bus], after[bus], k + many
    for i in range(size):
        if k == end:
            break
        place = (begin + i) % size
        row = order[first[bus] + place]
        if robots[row]:
            out[k] = row
            after[bus] = place + 1
            k += 1
    return k


@njit(cache=True)
def _longest(bus, rows, took_s, out):
    for row in rows:
        out[bus[row]] = 0.0
    for i in range(len(rows)):
        out[bus[rows[i]]] = max(out[bus[rows[i]]], took_s[i])

"""Whose turn it is on each bus: who is read, and who is only asked whether it is there."""

import numpy as np
from numba import njit

__all__ = ["PollScheduler"]

_FIRST = 1  # robots of a bus read in the first step, before it is known how long that takes
_ALL, _SOME = 0.6, 0.3  # of that time for asking: where it is enough for all, and where not
_ASK = 0.15  # of the time of a reading that asking takes, before it is known
_EARLY = 0.5  # of its time that a bus on which all are asked uses, so that it is soon free


class PollScheduler:
    """Shares the time of each step on each bus between reading robots and asking them.

    Where all robots of a bus can be asked in the first half of each step they are, so that one
    that has lost power is noticed by then; larger buses use all of it, less for asking.

    Args:
        bus: place of the bus of each robot, shape (n,).
        buses: how many there are.
        room_s: time of a bus in each step [s].
        read_s: how long one reading takes, as far as is known beforehand [s].
    """

    def __init__(self, bus, buses: int, room_s: float, read_s: float = 0.0):
        self._bus, self._room_s = bus, room_s
        self._order = np.argsort(bus, kind="stable")
        self._first = np.searchsorted(bus[self._order], np.arange(buses + 1))
        # the longest of the last step, 0 unknown
        self._read_s, self._ask_s = np.full(buses, read_s), np.zeros(buses)
        self._read_next, self._ask_next = np.zeros((2, buses), dtype=np.int64)

    def next(self, robots, ask: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows to read and those to ask, each in the order of their buses.

        Args:
            robots: who takes part, shape (n,).
            ask: whether robots are asked at all.
        """
        reads = np.empty(len(robots), dtype=np.int64)
        asks = np.empty(len(robots), dtype=np.int64)
        r, a = _next(
            self._order, self._first, robots, ask, self._room_s, self._read_s, self._ask_s,
            self._read_next, self._ask_next, reads, asks,
        )  # fmt: skip
        return reads[:r], asks[:a]

    def learn(self, read, read_took_s, asked, ask_took_s) -> None:
        """Take note of how long the readings and askings of a step took [s]."""
        _longest(self._bus, read, read_took_s, self._read_s)
        _longest(self._bus, asked, ask_took_s, self._ask_s)


@njit(cache=True)
def _next(order, first, robots, ask, room_s, read_s, ask_s, read_next, ask_next, reads, asks):
    r = a = 0
    for bus in range(len(read_s)):
        there = 0
        for k in range(first[bus], first[bus + 1]):
            there += robots[order[k]]
        if there == 0:
            continue
        left_s = room_s
        if ask and read_s[bus] > 0.0:
            one_s = ask_s[bus] if ask_s[bus] > 0.0 else _ASK * read_s[bus]
            if there * one_s <= _ALL * _EARLY * room_s:
                many, left_s = there, _EARLY * room_s
            else:
                many = min(there, max(int(_SOME * room_s / one_s), 1))
            a = _turn(order, first, bus, robots, many, ask_next, asks, a)
            left_s -= many * one_s
        many = max(int(left_s / read_s[bus]), 1) if read_s[bus] > 0.0 else _FIRST
        r = _turn(order, first, bus, robots, many, read_next, reads, r)
    return r, a


@njit(cache=True)
def _turn(order, first, bus, robots, many, after, out, k):
    # The next robots of a bus, from where the last turn ended; returns how many out holds.
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

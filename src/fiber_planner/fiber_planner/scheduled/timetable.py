# SPDX-License-Identifier: Apache-2.0
"""When each move begins: first-fit placing of moves under a limit of motors that are on at once.

A robot makes up to six *legs*: each joint a run to an angle on the way, a run, an approach. Legs of
a joint follow each other; otherwise each may begin when it wants.
"""

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Ints

__all__ = ["APPROACHES", "LEGS", "PHI_APPROACH", "PHI_RUN", "PHI_VIA", "RUNS", "THETA_APPROACH"]
__all__ += ["THETA_RUN", "THETA_VIA", "Timetable", "VIAS"]

LEGS = 6
THETA_VIA, THETA_RUN, THETA_APPROACH, PHI_VIA, PHI_RUN, PHI_APPROACH = range(LEGS)
VIAS, RUNS, APPROACHES = slice(0, None, 3), slice(1, None, 3), slice(2, None, 3)  # of both joints


class Timetable:
    """How many motors of each supply are on at each tick.

    Args:
        group: number of the supply of each robot, 0 .. g - 1, shape (n,).
        allowed: motors of its supply that may be on at once, shape (n,).
        ticks: length of the timetable.
    """

    def __init__(self, group: Ints, allowed: Ints, ticks: int):
        self.group, self.allowed = group, allowed
        self.on = np.zeros((int(group.max(initial=0)) + 1, ticks), dtype=np.int64)

    @property
    def ticks(self) -> int:
        """Length of the timetable."""
        return self.on.shape[1]

    def extend(self, ticks: int) -> None:
        """Make the timetable longer."""
        more = np.zeros((len(self.on), ticks - self.ticks), dtype=np.int64)
        self.on = np.concatenate([self.on, more], axis=1)

    def place(
        self, rows: Ints, own: Ints, own_on: Ints, on: Ints, wanted: Ints
    ) -> tuple[Ints, Bools]:
        """Find the first times from those wanted at which legs fit, each robot for itself.

        Args:
            rows: the robots, shape (m,); one may be there several times.
            own, own_on: first ticks and lengths of the legs that each robot has now and that make
                way, shape (m, 6).
            on: ticks that the motor of each new leg is on, 0 for no leg, shape (m, 6).
            wanted: earliest tick of each leg, shape (m, 6).

        Returns:
            First tick of each leg, shape (m, 6), and whether all fit, shape (m,).
        """
        return _place(self.on, self.group[rows], self.allowed[rows], own, own_on, on, wanted)

    def enter(self, order: Ints, on: Ints, wanted: Ints, starts: Ints) -> Bools:
        """Place and enter the legs of robots one after another.

        Args:
            order: rows of the robots, shape (m,).
            on, wanted: as for `place`, of all robots, shape (n, 6).
            starts: first ticks, shape (n, 6); those of the robots in the order are set.

        Returns:
            Whether the legs of each robot were entered, shape (n,).
        """
        return _place_in_turn(self.on, self.group, self.allowed, order, on, wanted, starts)

    def put(self, rows: Ints, starts: Ints, on: Ints, now: Ints, now_on: Ints) -> Bools:
        """Enter new legs in place of those of some robots, one after another, where they still fit.

        Args:
            rows: the robots, shape (m,).
            starts, on: the new legs, shape (m, 6).
            now, now_on: the present legs, shape (m, 6).

        Returns:
            Whether the new legs were entered, shape (m,).
        """
        return _put(self.on, self.group[rows], self.allowed[rows], starts, on, now, now_on)


@nb.njit(cache=True)
def _first_fit(full, begin, length, ticks):
    # the first start from `begin` at which `length` ticks in a row are not full, -1 for none
    start, t = begin, begin
    while t < start + length:
        if t >= ticks:
            return -1
        if full[t]:
            start = t + 1
        t += 1
    return start


@nb.njit(cache=True)
def _place_one(load, allowed, on, wanted, starts):
    # place the legs of one robot and enter them in the load; returns whether all fit
    ticks = len(load)
    full = np.empty(ticks, dtype=np.bool_)
    ends = np.zeros(LEGS, dtype=np.int64)
    # runs first: they are short, and approaches fit where something is left
    for leg in (PHI_VIA, THETA_VIA, THETA_RUN, PHI_RUN, THETA_APPROACH, PHI_APPROACH):
        first = leg == THETA_VIA or leg == PHI_VIA
        before = 0 if first else ends[leg - 1]
        begin = max(before, wanted[leg])
        starts[leg], ends[leg] = begin, before
        if on[leg] == 0:
            continue
        for t in range(ticks):
            full[t] = load[t] >= allowed
        start = _first_fit(full, begin, on[leg], ticks)
        if start < 0:
            return False
        starts[leg], ends[leg] = start, start + on[leg]
        for t in range(start, ends[leg]):
            load[t] += 1
    return True


@nb.njit(cache=True)
def _place(table, group, allowed, own, own_on, on, wanted):
    m = len(group)
    starts, fits = np.zeros((m, LEGS), dtype=np.int64), np.ones(m, dtype=np.bool_)
    for i in range(m):
        load = table[group[i]].copy()
        for leg in range(LEGS):
            for t in range(own[i, leg], own[i, leg] + own_on[i, leg]):
                load[t] -= 1
        fits[i] = _place_one(load, allowed[i], on[i], wanted[i], starts[i])
    return starts, fits


@nb.njit(cache=True)
def _place_in_turn(table, group, allowed, order, on, wanted, starts):
    fits = np.zeros(len(group), dtype=np.bool_)
    for i in order:
        load = table[group[i]].copy()
        fits[i] = _place_one(load, allowed[i], on[i], wanted[i], starts[i])
        if fits[i]:
            table[group[i]] = load
    return fits


@nb.njit(cache=True)
def _put(table, group, allowed, starts, on, now, now_on):
    m = len(group)
    entered = np.zeros(m, dtype=np.bool_)
    for i in range(m):
        load = table[group[i]]
        for leg in range(LEGS):
            for t in range(now[i, leg], now[i, leg] + now_on[i, leg]):
                load[t] -= 1
        fits = True
        for leg in range(LEGS):
            for t in range(starts[i, leg], starts[i, leg] + on[i, leg]):
                load[t] += 1
                fits = fits and load[t] <= allowed[i]
        entered[i] = fits
        if not fits:
            for leg in range(LEGS):
                for t in range(starts[i, leg], starts[i, leg] + on[i, leg]):
                    load[t] -= 1
                for t in range(now[i, leg], now[i, leg] + now_on[i, leg]):
                    load[t] += 1
    return entered

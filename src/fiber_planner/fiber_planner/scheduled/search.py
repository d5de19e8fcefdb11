# SPDX-License-Identifier: Apache-2.0
"""Local search for times and angles on the way at which no robots come too close."""

from typing import Protocol

import numba as nb
import numpy as np

from fiber_core.array_types import Floats, Ints, Mask, Rows
from fiber_planner.interface import ProgressCallback
from fiber_planner.scheduled.conflicts import Conflicts
from fiber_planner.scheduled.moves import Motors
from fiber_planner.scheduled.orders import Legs, legs_by_way_of
from fiber_planner.scheduled.timetable import (
    LEGS,
    PHI_APPROACH,
    PHI_RUN,
    PHI_VIA,
    THETA_APPROACH,
    THETA_RUN,
    Timetable,
)

__all__ = ["Effort", "Search"]

_FOLDED_RAD = np.deg2rad(115.0)  # with phi this far in, an arm reaches few neighbours
_PHASES = (1.0, 0.5, 0.25, 0.0)  # how much of the longest leg all robots wait for
_FEW = 0.02  # share of robots for which no longer timetable is tried
_OTHER = 0.3  # share of candidates with any elbow and turn
_MANY, _MOST_TIMES = 200, 3  # robots in a round; below that many, each tries more motions
_NO_PLACE = 10.0  # cost of a robot whose legs fit nowhere, in pairs that are too close
_HELPS = 0.6  # with fewer conflicts than this share of those before, longer timetables help
_LONGER = 1.04  # a timetable in which conflicts are left becomes longer by this


class Effort(Protocol):
    """How much a search may spend: the fields of ScheduledParameters."""

    @property
    def rounds(self) -> int:
        """Rounds at each length of the timetable."""
        ...

    @property
    def candidates(self) -> int:
        """Motions that a robot in conflict tries in a round."""
        ...


class Search:
    """The legs of all robots and their first ticks, while conflicts are searched and solved.

    Args:
        conflicts: the pairs that can come too close.
        motors: what the motors can do.
        group: number of the supply of each robot, 0 .. g - 1, shape (n,).
        allowed: motors of its supply that may be on at once, shape (n,).
        turn: how far the joints are to turn [quanta], shape (n, 2).
        others: all turns that bring each robot to its target [quanta], shape (n, k, 2).
        ticks: length of the timetable at first.
        rng: random numbers.

    Attributes:
        legs: the moves of all robots.
        starts: first tick of each leg, shape (n, 5).
        given_up: robots that rest because their legs fitted nowhere, shape (n,).
    """

    def __init__(
        self,
        conflicts: Conflicts,
        motors: Motors,
        group: Ints,
        allowed: Ints,
        turn: Ints,
        others: Ints,
        ticks: int,
        rng: np.random.Generator,
    ):
        self._conflicts, self._motors, self._rng = conflicts, motors, rng
        self._turn, self._others = turn.copy(), others
        self._table = Timetable(group, allowed, ticks)
        plane, units = conflicts.plane, conflicts.units
        self._high = units.range_counts(plane)[:, 1, 1] - units.to_counts(np.deg2rad(1.0))
        n = plane.n
        self._every = np.arange(n)
        self.legs = legs_by_way_of(motors, self._every, turn, self._via_folded())
        self.starts = np.zeros((n, LEGS), dtype=np.int64)
        self.given_up: Mask = np.zeros(n, dtype=np.bool_)
        self._weights = np.ones(len(conflicts.pairs))

    def run(self, effort: Effort, longest: int, progress: ProgressCallback | None = None) -> None:
        """Search until no pair is too close, or a longer timetable is of no use.

        Args:
            effort: rounds and candidates.
            longest: greatest length of the timetable [ticks].
            progress: called with the fraction that is done and a short text.
        """
        longest = max(longest, self._table.ticks)
        self._first_timetable(longest)
        self._motion = self._conflicts.curves(self._every, self.legs, self.starts)
        self._unsafe = self._conflicts.unsafe(self._motion)
        before = np.inf
        while True:
            for k in range(effort.rounds):
                if self._left == 0:
                    return
                if progress is not None:
                    progress(k / effort.rounds, f"{self._left} conflicts are left")
                self._round(effort.candidates)
            few = self._left <= _FEW * np.count_nonzero(self._turn.any(axis=1))
            if few or self._left > _HELPS * before or self._table.ticks >= longest:
                return
            before = self._left
            self._table.extend(min(longest, int(np.ceil(_LONGER * self._table.ticks))))

    @property
    def _left(self) -> int:
        # pairs that are too close, and robots without a place
        return int(self._unsafe.sum()) + int(self.given_up.sum())

    @property
    def turn(self) -> Ints:
        """How far the joints of each robot are to turn [quanta], shape (n, 2)."""
        return self._turn

    def _via_folded(self) -> Ints:
        # how far phi turns to be folded, or as far in as at its ends
        start = self._conflicts.start[:, 1]
        folded = int(self._conflicts.units.to_counts(_FOLDED_RAD))
        ends = np.maximum(start, start + self._turn[:, 1])
        moves = self._turn.any(axis=1)
        return np.where(moves, np.maximum(ends, np.minimum(folded, self._high)) - start, 0)

    def _first_timetable(self, longest: int) -> None:
        # All fold, then theta turns, then phi goes out; the less these phases are kept the more
        # robots fit. Robots that need longest are first; what fits nowhere goes straight.
        legs = self.legs
        straight = legs_by_way_of(self._motors, self._every, self._turn, np.zeros_like(self._every))
        left = self._every
        while True:
            for phases in _PHASES:
                self.legs = legs
                left = self._entered(np.flatnonzero(legs.on.any(axis=1)), phases)
                if not len(left):
                    return
            self.legs = legs.with_rows(left, straight.take(left))
            left = self._enter(left, np.zeros_like(self.legs.on))
            if not len(left) or self._table.ticks >= longest:
                self._rest(left)
                return
            if len(left) <= _FEW * len(self._every):
                self._rest(left)  # the search finds a place for them
                return
            self._table.extend(min(longest, int(np.ceil(_LONGER * self._table.ticks))))

    def _entered(self, rows: Rows, phases: float) -> Rows:
        # enter all robots in an empty timetable; returns those that did not fit
        self._table.on[:] = 0
        on, end = self.legs.on, self._table.ticks
        folded = np.maximum(on[:, PHI_VIA], int(phases * on[:, PHI_VIA].max(initial=0)))
        turned = folded + np.maximum(
            on[:, THETA_RUN], int(phases * on[:, THETA_RUN].max(initial=0))
        )
        wanted = np.zeros_like(on)
        latest = end - on[:, THETA_RUN] - on[:, THETA_APPROACH]
        wanted[:, THETA_RUN] = np.clip(latest, 0, folded)
        latest = end - on[:, PHI_RUN] - on[:, PHI_APPROACH]
        wanted[:, PHI_RUN] = np.clip(latest, 0, turned)
        return self._enter(self._enter(rows, wanted), 0 * wanted)

    def _enter(self, rows: Rows, wanted: Ints) -> Rows:
        # enter robots, those first that need longest; returns those that did not fit
        longest_first = np.argsort(-self.legs.on[rows].sum(axis=1), kind="stable")
        fits = self._table.enter(rows[longest_first], self.legs.on, wanted, self.starts)
        return rows[~fits[rows]]

    def _rest(self, rows: Rows) -> None:
        none = np.zeros((len(rows), 2), dtype=np.int64)
        still = legs_by_way_of(self._motors, rows, none, none[:, 0])
        self.legs = self.legs.with_rows(rows, still)
        self.given_up[rows] = True

    def _round(self, candidates: int) -> None:
        # robots in conflict, no two of them neighbours, take the best of some motions
        conflicts = self._conflicts
        robots = self._chosen()
        if not len(robots):
            return  # all that are in conflict have nothing to turn
        # few robots try more motions: a round costs as much
        rows = np.repeat(robots, candidates * max(1, min(_MOST_TIMES, _MANY // len(robots))))
        legs, wanted, turn = self._drawn(rows)
        starts, fits = self._table.place(
            rows, self.starts[rows], self.legs.on[rows], legs.on, wanted
        )
        kept = np.flatnonzero(fits)
        rows, legs, starts, turn = rows[kept], legs.take(kept), starts[kept], turn[kept]
        curves = conflicts.curves(rows, legs, starts)
        parts, number, unsafe = conflicts.of_candidates(self._motion, rows, curves)
        cost = parts.sums(self._weights[number] * unsafe)
        now = self._costs()
        best = _best_of(rows, cost, now)
        chosen = rows[best]
        entered = self._table.put(
            chosen, starts[best], legs.on[best], self.starts[chosen], self.legs.on[chosen]
        )
        best, chosen = best[entered], chosen[entered]
        self.legs = self.legs.with_rows(chosen, legs.take(best))
        self.starts[chosen] = starts[best]
        self._turn[chosen], self.given_up[chosen] = turn[best], False
        self._motion = self._motion.with_robots(chosen, curves.of_robots(best))
        _, at = parts.select(best)
        self._unsafe[number[at]] = unsafe[at]
        self._weights[self._unsafe] += 1.0

    def _costs(self) -> Floats:
        # weights of the unsafe pairs of each robot, shape (n,)
        a, b = self._conflicts.pairs[self._unsafe].T
        weights, rows = self._weights[self._unsafe], len(self._conflicts.bodies.center)
        both = np.bincount(a, weights, rows) + np.bincount(b, weights, rows)
        costs: Floats = both[: self._conflicts.plane.n].astype(np.float64)
        costs[self.given_up] += _NO_PLACE
        return costs

    def _chosen(self) -> Rows:
        # robots in conflict that can move, in random order, no two of them neighbours
        near, n = self._conflicts.neighbours, self._conflicts.plane.n
        movable = self._turn.any(axis=1)
        unsafe = np.flatnonzero((self._costs() > 0.0) & movable)
        return _apart(self._rng.permutation(unsafe), near.offsets, near.body, n)

    def _drawn(self, rows: Rows) -> tuple[Legs, Ints, Ints]:
        # random legs of these robots, the times at which they want to begin, and their turns
        m, end = len(rows), self._table.ticks
        u = self._rng.random((m, 8))
        start, turn = self._conflicts.start[rows, 1], self._turn[rows]
        k = self._others.shape[1]
        other = self._others[rows, np.minimum((u[:, 7] / _OTHER * k).astype(np.int64), k - 1)]
        turn = np.where((u[:, 7] < _OTHER)[:, None], other, turn)
        ends = np.maximum(start, start + turn[:, 1])
        out = (ends + u[:, 0] * np.maximum(self._high[rows] - ends, 0)).astype(np.int64) - start
        straight = u[:, 1] < 0.4
        legs = legs_by_way_of(self._motors, rows, turn, np.where(straight, 0, out))
        on = legs.on
        wanted = np.zeros((m, LEGS), dtype=np.int64)
        for leg, after, k, early in (
            (PHI_VIA, PHI_RUN, 2, 0.6),
            (THETA_RUN, THETA_APPROACH, 3, 0.2),
            (PHI_RUN, PHI_APPROACH, 4, 0.1),
        ):
            share = np.maximum(u[:, k] - early, 0.0) / (1.0 - early)
            wanted[:, leg] = share * np.maximum(end - on[:, leg] - on[:, after], 0)
        for leg, k in ((THETA_APPROACH, 5), (PHI_APPROACH, 6)):
            share = np.maximum(u[:, k] - 0.5, 0.0) / 0.5
            wanted[:, leg] = share * np.maximum(end - on[:, leg], 0)
        return legs, wanted, turn


def _best_of(rows: Rows, cost: Floats, now: Floats) -> Ints:
    # of the candidates of each robot the first with the least cost, if it is no worse than now
    order = np.lexsort([cost, rows])
    first = order[np.unique(rows[order], return_index=True)[1]]
    return first[cost[first] <= now[rows[first]]]


@nb.njit(cache=True)
def _apart(order, offsets, neighbours, n):
    taken, chosen = np.zeros(n, dtype=np.bool_), []
    for i in order:
        if taken[i]:
            continue
        chosen.append(i)
        for e in range(offsets[i], offsets[i + 1]):
            if neighbours[e] < n:
                taken[neighbours[e]] = True
    return np.array(chosen, dtype=np.int64)

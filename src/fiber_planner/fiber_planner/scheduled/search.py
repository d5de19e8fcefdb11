# SPDX-License-Identifier: Apache-2.0
"""Local search for times and angles on the way at which no robots come too close."""

from typing import Any, NamedTuple, Protocol

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Floats, Ints, Mask, Rows
from fiber_core.drive import CurveMotion
from fiber_core.ragged import Parts
from fiber_planner.interface import ProgressCallback
from fiber_planner.scheduled.candidates import Candidates, draw
from fiber_planner.scheduled.conflicts import Conflicts
from fiber_planner.scheduled.moves import Motors, jogs
from fiber_planner.scheduled.orders import legs_by_way_of
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
_FEW = 0.01  # share of robots for which no longer timetable is tried
_MANY, _MOST_TIMES = 200, 8  # robots in a round; below that many, each tries more motions
_NO_PLACE = 10.0  # cost of a robot that rests at first, in pairs that are too close
_TRIES = 30  # times as many motions show that no way is free, as a robot in conflict tries
_SETTLING = 4  # times as many rounds in which robots may rest
_HELPS = 0.6  # with fewer conflicts than this share of those before, longer timetables help
# A timetable in which conflicts are left, or legs do not fit, becomes longer by the first of these,
# where arms need time to fold, and then by the second.
_LONGER, _LITTLE_LONGER = 1.04, 1.01


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


class _Examined(NamedTuple):
    # motions that fit in the timetable: when their legs begin, their curves, and the pairs of each
    # as parts, with their numbers and whether they are too close
    drawn: Candidates
    starts: Ints
    curves: CurveMotion
    parts: Parts
    number: Ints
    unsafe: Bools


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
        far: whether arms fold on the way, and robots that are given up may go anywhere.
        blocked: robots with a target to which they have no way, shape (n,).

    Attributes:
        legs: the moves of all robots.
        starts: first tick of each leg, shape (n, 6).
        given_up: robots that were given up: they rest, or make way for others, shape (n,).
        blocked: those of them that have no way past bodies that rest, shape (n,).
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
        far: bool,
        blocked: Mask,
    ):
        self._far, self._longer = far, _LONGER if far else _LITTLE_LONGER
        self._conflicts, self._motors, self._rng = conflicts, motors, rng
        self._turn, self._others = turn.copy(), others
        self._table = Timetable(group, allowed, ticks)
        n = conflicts.plane.n
        self._every = np.arange(n)
        self.legs = legs_by_way_of(motors, self._every, conflicts.start, turn, self._via_folded())
        self.starts = np.zeros((n, LEGS), dtype=np.int64)
        self.given_up, self.blocked = blocked.copy(), blocked.copy()
        self._can_move = turn.any(axis=1) | blocked
        self._weights = np.ones(len(conflicts.pairs))
        self._rest_costs = np.full(n, _NO_PLACE)

    def run(self, effort: Effort, longest: int, progress: ProgressCallback | None = None) -> None:
        """Search until no pair is too close, or a longer timetable is of no use.

        In the end some robots rest at their starts, so that no pair is too close that can be kept
        apart.

        Args:
            effort: rounds and candidates.
            longest: greatest length of the timetable [ticks].
            progress: called with the fraction that is done and a short text.
        """
        longest = max(longest, self._table.ticks)
        self._first_timetable(longest)
        self.given_up |= ~self.legs.possible
        self._motion = self._conflicts.curves(self._every, self.legs, self.starts)
        self._unsafe = self._conflicts.unsafe(self._motion)
        before = np.inf
        while True:
            self._rounds(effort.rounds, effort.candidates, 0.5, False, progress)
            self._free_blocked(effort)
            few = self._left <= _FEW * np.count_nonzero(self._can_move)
            if few or self._left > _HELPS * before or self._table.ticks >= longest:
                break
            before = self._left
            self._extend(longest)
        self._free_blocked(effort)
        self._rounds(_SETTLING * effort.rounds, effort.candidates, 1.0, True, progress)
        self._settle(effort.rounds, effort.candidates)

    def _rounds(
        self,
        rounds: int,
        candidates: int,
        done: float,
        may_rest: bool,
        progress: ProgressCallback | None,
    ) -> None:
        # rounds until no conflict is left; the state with the fewest is kept
        least, best = self._left, self._state()
        for k in range(rounds):
            if self._left == 0:
                return
            if progress is not None:
                share = done - 0.5 + 0.5 * k / rounds
                progress(share, f"{self._left} conflicts are left")
            self._round(candidates, may_rest)
            if self._left < least:
                least, best = self._left, self._state()
        self._restore(best)

    def _state(self) -> tuple[Any, ...]:
        arrays = self.starts, self._turn, self.given_up, self._table.on, self._unsafe
        return (self.legs, self._motion, *(array.copy() for array in arrays))

    def _restore(self, state: tuple[Any, ...]) -> None:
        self.legs, self._motion, self.starts, self._turn, self.given_up, on, self._unsafe = state
        self._table.on = on

    @property
    def _left(self) -> int:
        # pairs that are too close, and robots without a place
        return int(self._unsafe.sum()) + int((self.given_up & ~self.blocked).sum())

    @property
    def turn(self) -> Ints:
        """How far the joints of each robot are to turn [quanta], shape (n, 2)."""
        return self._turn

    def _via_folded(self) -> Ints:
        # how far joints turn first: phi to be folded, or as far in as at its ends; theta beyond
        # a near goal
        start = self._conflicts.start[:, 1]
        folded = int(self._conflicts.units.to_counts(_FOLDED_RAD))
        ends = np.maximum(start, start + self._turn[:, 1])
        moves = self._turn.any(axis=1)
        via = jogs(self._motors, self._every, self._turn)
        if not self._far:
            return via
        inward = np.maximum(ends, np.minimum(folded, self._motors.ranges[:, 1, 1])) - start
        via[:, 1] = np.where(moves, inward, 0)
        return via

    def _first_timetable(self, longest: int) -> None:
        # All fold, then theta turns, then phi goes out; the less these phases are kept the more
        # robots fit. Robots that need longest are first; what fits nowhere goes straight.
        straight = legs_by_way_of(
            self._motors, self._every, self._conflicts.start, self._turn, 0 * self._turn
        )
        left = np.flatnonzero(~self.legs.possible)
        legs = self.legs.with_rows(left, straight.take(left))
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
            self._extend(longest)

    def _extend(self, longest: int) -> None:
        ticks = int(np.ceil(self._longer * self._table.ticks))
        self._table.extend(min(longest, ticks))
        self._longer = _LITTLE_LONGER

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
        # enter robots, those first that have the joint that needs longest, as both joints can turn
        # at once; returns those that did not fit
        of_joints = self.legs.on[rows].reshape(len(rows), 2, LEGS // 2).sum(axis=2)
        longest_first = np.argsort(-of_joints.max(axis=1), kind="stable")
        fits = self._table.enter(rows[longest_first], self.legs.on, wanted, self.starts)
        return rows[~fits[rows]]

    def _rest(self, rows: Rows) -> None:
        none = np.zeros((len(rows), 2), dtype=np.int64)
        still = legs_by_way_of(self._motors, rows, self._conflicts.start[rows], none, none)
        self.legs = self.legs.with_rows(rows, still)
        self.given_up[rows] = True

    def _round(self, candidates: int, may_rest: bool) -> None:
        # robots in conflict, no two of them neighbours, take the best of some motions
        robots = self._chosen(self._costs() > 0.0)
        if not len(robots):
            return  # all that are in conflict have nothing to turn
        blocked = self.blocked[robots]
        freed = robots if may_rest else robots[blocked]
        drawn = self._drawn(robots[~blocked], candidates, freed)
        self._take_best(self._examined(drawn), self._costs())
        self._weights[self._unsafe] += 1.0
        self._rest_costs[self.given_up] += 1.0

    def _drawn(self, robots: Rows, candidates: int, freed: Rows) -> Candidates:
        # motions to the targets of robots, and others of robots that are given up; few robots try
        # more of them: a round costs as much
        each = candidates * max(1, min(_MOST_TIMES, _MANY // max(1, len(robots))))
        return draw(
            self._rng, self._motors, np.repeat(robots, each), self._conflicts.start, self._turn,
            self._others, self._table.ticks, np.repeat(freed, candidates if self._far else 1),
        )  # fmt: skip

    def _examined(self, drawn: Candidates) -> _Examined:
        # those that the supplies have motors for, with the pairs in which they are too close
        starts, fits = self._table.place(
            drawn.rows, self.starts[drawn.rows], self.legs.on[drawn.rows], drawn.legs.on,
            drawn.wanted,
        )  # fmt: skip
        kept = np.flatnonzero(fits & drawn.legs.possible)
        drawn, starts = drawn.take(kept), starts[kept]
        curves = self._conflicts.curves(drawn.rows, drawn.legs, starts)
        found = self._conflicts.of_candidates(self._motion, drawn.rows, curves)
        return _Examined(drawn, starts, curves, *found)

    def _take_best(self, examined: _Examined, most: Floats) -> None:
        # each robot takes the motion of least cost, if that is no more than what it may cost
        rows, freed = examined.drawn.rows, examined.drawn.freed
        weights = self._weights[examined.number] * examined.unsafe
        cost = examined.parts.sums(weights) + self._rest_costs[rows] * (freed & ~self.blocked[rows])
        self._take(examined, _best_of(rows, cost, most))

    def _take(self, examined: _Examined, best: Ints) -> None:
        # robots take these motions, of each robot one, where they still fit
        (rows, legs, _, turn, freed), starts = examined.drawn, examined.starts
        chosen = rows[best]
        entered = self._table.put(
            chosen, starts[best], legs.on[best], self.starts[chosen], self.legs.on[chosen]
        )
        best, chosen = best[entered], chosen[entered]
        self.legs = self.legs.with_rows(chosen, legs.take(best))
        self.starts[chosen] = starts[best]
        self._turn[chosen], self.given_up[chosen] = turn[best], freed[best]
        self._motion = self._motion.with_robots(chosen, examined.curves.of_robots(best))
        _, at = examined.parts.select(best)
        self._unsafe[examined.number[at]] = examined.unsafe[at]

    def _free_blocked(self, effort: Effort) -> None:
        # robots in conflict are given up if none of many motions is clear of all bodies that rest
        n, pairs = self._conflicts.plane.n, self._conflicts.pairs
        rests = np.ones(len(self._conflicts.bodies.center), dtype=np.bool_)
        rests[:n] = ~self._can_move
        doubtful = np.zeros_like(rests)
        doubtful[pairs[self._unsafe & rests[pairs].any(axis=1)]] = True
        rows = np.flatnonzero(doubtful[:n] & ~rests[:n] & ~self.blocked)
        if not len(rows):
            return
        drawn = self._drawn(np.repeat(rows, _TRIES * effort.candidates), 1, rows[:0])
        load, self._table.on = self._table.on, np.zeros_like(self._table.on)
        tried = self._examined(drawn)  # whatever the supplies have motors for
        self._table.on = load
        a, b = pairs[tried.number].T
        other = np.where(a == tried.drawn.rows[tried.parts.owner], b, a)
        close = tried.parts.sums((tried.unsafe & rests[other]).astype(np.int64))
        blocked = rows[~np.isin(rows, tried.drawn.rows[close == 0])]
        self.given_up[blocked] = self.blocked[blocked] = True

    def _settle(self, rounds: int, candidates: int) -> None:
        # Robots rest, first those with which most conflicts end, until no pair is too close of
        # which one moves; then those that rest try to move beside all others.
        self._weights[:] = 1.0
        self._rest_costs[:] = 0.0
        while (at := (self._costs() > 0.0) & self.legs.on.any(axis=1)).any():
            rows = np.flatnonzero(at)
            still = self._examined(self._drawn(rows[:0], 1, rows))
            ended = self._costs()[rows] - still.parts.sums(1.0 * still.unsafe)
            self._take(still, np.array([np.argmax(ended)]))
        for _ in range(rounds):
            robots = self._chosen(self.given_up & ~self.blocked)
            if not len(robots):
                return
            drawn = self._examined(self._drawn(robots, candidates, robots[:0]))
            self._take_best(drawn, np.zeros(self._conflicts.plane.n))

    def _costs(self) -> Floats:
        # weights of the unsafe pairs of each robot, shape (n,)
        a, b = self._conflicts.pairs[self._unsafe].T
        weights, rows = self._weights[self._unsafe], len(self._conflicts.bodies.center)
        both = np.bincount(a, weights, rows) + np.bincount(b, weights, rows)
        costs: Floats = both[: self._conflicts.plane.n].astype(np.float64)
        costs += self._rest_costs * (self.given_up & ~self.blocked)
        return costs

    def _chosen(self, of: Mask) -> Rows:
        # of these robots those that can move, in random order, no two of them neighbours
        near, n = self._conflicts.neighbours, self._conflicts.plane.n
        rows = np.flatnonzero(of & self._can_move)
        return _apart(self._rng.permutation(rows), near.offsets, near.body, n)


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

# SPDX-License-Identifier: Apache-2.0
"""Shorter plans: further searches at shorter makespans, for as long as the effort lasts."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace

from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.search import Search
from fiber_planner.direct.search_result import SearchResult
from fiber_planner.interface import ProgressCallback

__all__ = ["shortest_plan"]

_SLICE = 100.0  # moves of each search, per robot, between two decisions
_PATIENCE = 300.0  # moves after which a search is given up
_QUICK = 150.0  # moves after which one that began with a compressed plan is given up
_NEAR = 0.04  # share of the time alone by which a compressed plan is shorter at first
_NEAR_AT_MOST = 0.16
_LEAST = 10.0  # moves with which a search is worth to be begun
_EASY = 30.0  # moves; after a search of fewer the next compressed plan is shorter by twice as much
_FINEST = 0.01  # of the time alone: no plan is sought that is shorter by less
_POLL_S = 0.1


class _EndedError(Exception):
    """The caller has ended the planning."""


def shortest_plan(
    problem: Problem,
    parameters: DirectParameters,
    progress: ProgressCallback | None,
    clock: Callable[[], float],
) -> SearchResult:
    """Search for a plan, then on a dense plane for shorter ones in which as many robots arrive.

    Two searches go on side by side at two makespans between the time that the slowest robot needs
    alone and the makespan of the best plan. The longer one begins with the best plan compressed, a
    little shorter, and is followed at once by the next one when it succeeds; the other one begins
    anew, in the middle of the range. A search that succeeds moves the upper end of the range. The
    latter, when it has failed for long, moves the lower end; the former is soon tried again with
    half of the compression. Decisions are made at fixed numbers of moves, so the plan depends
    neither on the number of cores nor on their speed, unless there is a budget of time.

    Args:
        problem: robots sorted by their places; robots that may not be moved are disabled.
        parameters: clearance to keep, effort to spend.
        progress: called with the fraction of the work that is done and a short text.
        clock: seconds, for the budget.
    """
    end_s = clock() + parameters.budget_s
    first = Search(problem, parameters, progress, clock)
    found = first.run()
    # a loose plane takes longer because of a few robots beside static arms: to search for all
    # robots again costs minutes there
    if not first.dense:
        return found
    if not first.certified:
        return first.simplify()
    return _Shortening(problem, parameters, clock, end_s, first).run(progress)


@dataclass
class _Lane:
    # Searches that go on one after another in one thread, and the best plan that is known there.
    found: float  # its makespan, in units of the time alone
    best: Search
    seed: int  # of the next search; those of the other lane lie between
    search: Search | None = None
    spent: float = 0.0


class _Shortening:
    # The range of makespans in units of the time alone, and the searches in it: one that began
    # anew, and those that began with the best plan compressed. What a lane writes no other reads
    # before both have ended.

    def __init__(
        self,
        problem: Problem,
        parameters: DirectParameters,
        clock: Callable[[], float],
        end_s: float,
        first: Search,
    ):
        self._problem, self._parameters = problem, parameters
        self._clock, self._end_s = clock, end_s
        self._released = first.released
        self._failed, self._nearer = 1.0, _NEAR
        self._anew, self._compressed = (
            _Lane(first.stretch, first, parameters.seed + number) for number in (1, 2)
        )
        self._stuck, self._ended = False, threading.Event()

    def run(self, progress: ProgressCallback | None) -> SearchResult:
        with ThreadPoolExecutor(2, "shortening") as pool:
            while self._worthwhile:
                self._begin_anew()
                futures = [pool.submit(self._go_on_anew), pool.submit(self._go_on_compressed)]
                try:
                    while wait(futures, _POLL_S).not_done:
                        self._report(progress)
                    self._report(progress)
                except BaseException:
                    self._ended.set()  # the pool waits for its threads
                    raise
                for future in futures:
                    future.result()
                self._compare()
        return self._compressed.best.simplify()

    @property
    def _worthwhile(self) -> bool:
        enough = self._spent >= self._parameters.shortening
        return not (enough or self._near_enough or self._clock() >= self._end_s)

    @property
    def _near_enough(self) -> bool:
        return self._compressed.found - 1.0 <= _FINEST

    @property
    def _spent(self) -> float:
        return self._anew.spent + self._compressed.spent

    def _report(self, progress: ProgressCallback | None) -> None:
        if progress is not None:
            share, found = self._spent / self._parameters.shortening, self._compressed.found
            text = f"a plan of {found:.2f} of the least makespan, looking for less"
            progress(min(share, 1.0), text)

    def _begin_anew(self) -> None:
        lane = self._anew
        if lane.found - self._failed <= 2.0 * _FINEST:
            self._failed = 1.0  # other random numbers may find what others missed
        if lane.search is None:
            compressed = self._compressed.search
            nearer = compressed.stretch if compressed is not None else lane.found - self._step
            self._begin(lane, 0.5 * (self._failed + nearer), None)

    def _go_on_anew(self) -> None:
        before = self._anew.spent
        self._go_on(self._anew, _SLICE)
        self._stuck = self._anew.spent == before

    def _go_on_compressed(self) -> None:
        # one search after another, until all moves of a slice are spent
        lane = self._compressed
        until = lane.spent + _SLICE
        while until - lane.spent > _LEAST and not self._near_enough:
            if lane.search is None:
                self._begin(lane, lane.found - self._step, lane.best)
            before = lane.spent
            search = self._go_on(lane, until - lane.spent)
            if lane.search is None:
                if search.spent <= _EASY:
                    self._nearer = min(2.0 * self._nearer, _NEAR_AT_MOST)
                continue
            stuck = lane.spent == before
            if stuck or search.spent >= _QUICK:
                self._nearer = max(0.5 * (lane.found - lane.search.stretch), _FINEST)
                lane.search = None
            if stuck:
                return

    @property
    def _step(self) -> float:
        # by which the next compressed plan is shorter
        return min(self._nearer, (self._compressed.found - self._failed) / 3.0)

    def _begin(self, lane: _Lane, stretch: float, like: Search | None) -> None:
        parameters = replace(
            self._parameters,
            seed=lane.seed % 2**32,
            budget_s=max(0.0, self._end_s - self._clock()),
        )
        lane.seed += 2
        lane.search = Search(self._problem, parameters, self._check, self._clock)
        lane.search.begin_at(stretch, self._released, like)

    def _check(self, fraction: float, text: str) -> None:
        if self._ended.is_set():
            raise _EndedError

    def _go_on(self, lane: _Lane, moves: float) -> Search:
        # a search that has found a plan leaves its lane
        search = lane.search
        assert search is not None
        before = search.spent
        found = search.go_on(moves)
        lane.spent += search.spent - before
        if found:
            lane.found, lane.best, lane.search = search.stretch, search, None
        return search

    def _compare(self) -> None:
        # Both lanes know the best plan. Searches that have failed end, as do those at makespans
        # outside the range.
        anew, compressed = self._anew, self._compressed
        better = anew if anew.found <= compressed.found else compressed
        for lane in (anew, compressed):
            lane.found, lane.best = better.found, better.best
            if lane.search is not None and lane.search.stretch >= better.found:
                lane.search = None
        if anew.search is not None and (self._stuck or anew.search.spent >= _PATIENCE):
            self._failed, anew.search = max(self._failed, anew.search.stretch), None

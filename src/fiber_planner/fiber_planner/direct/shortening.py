# SPDX-License-Identifier: Apache-2.0
"""Shorter plans: the best plan is compressed again and again, for as long as the effort lasts."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.search import Search
from fiber_planner.direct.search_result import SearchResult
from fiber_planner.interface import ProgressCallback

__all__ = ["shortest_plan"]

_MOVES = 25.0  # moves per robot of one search: those that succeed need mostly fewer than 30
_MOVES_OF_LATE = 2.0  # the same where only robots that are late are searched
_NEAR = 0.04  # share of the time alone by which a compressed plan is shorter at first
_NEAR_AT_MOST = 0.16
_OF_RANGE = 1.0 / 3.0  # of what the best plan takes longer than the time alone, at most
_EASY = 30.0  # moves; after a search of fewer the next compressed plan is shorter by twice as much
_FINEST = 0.005  # of the time alone: no plan is sought that is shorter by less
_IN_VAIN = 4  # rounds of searches that are shorter by the least, after which the plan is kept
_NEAR_ENOUGH = 0.01  # of the time alone: a plan that takes longer by less is not compressed
_POLL_S = 0.1


class _EndedError(Exception):
    """The caller has ended the planning."""


def shortest_plan(
    problem: Problem,
    parameters: DirectParameters,
    progress: ProgressCallback | None,
    clock: Callable[[], float],
) -> SearchResult:
    """Search for a plan, then for shorter ones in which as many robots arrive.

    On a loose plane a few robots alone need more time than the slowest one does. These are sped up,
    so that they end half as late, or less much where that was in vain.

    On a dense plane the best plan is compressed: all robots go their ways sped up by one factor,
    and the conflicts of those at their speed limits are searched. A search that succeeds is the
    next best plan. One that fails is soon given up, and two follow side by side, one with half of
    the compression and one with a quarter. Decisions are made at fixed numbers of moves, so the
    plan depends neither on the number of cores nor on their speed, unless there is a budget of
    time.

    Args:
        problem: robots sorted by their places; robots that may not be moved are disabled.
        parameters: clearance to keep, effort to spend.
        progress: called with the fraction of the work that is done and a short text.
        clock: seconds, for the budget.
    """
    end_s = clock() + parameters.budget_s
    first = Search(problem, parameters, progress, clock)
    found = first.run()
    if not first.dense:
        wanted = first.certified and parameters.shortening > 0.0
        return _with_late_sooner(first) if wanted else found
    if not first.certified:
        return first.simplify()
    return _Shortening(problem, parameters, clock, end_s, first).run(progress)


def _with_late_sooner(search: Search) -> SearchResult:
    intervals, least = search.intervals
    fewer = (intervals - least) // 2
    while fewer > 0:
        if search.end_after(intervals - fewer, _MOVES_OF_LATE):
            intervals -= fewer
            fewer = (intervals - least) // 2
        else:
            fewer //= 2
    return search.result()


class _Shortening:
    # The best plan, and the searches that are made of it; makespans in units of the time alone.

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
        self._best, self._released = first, first.released
        self._nearer, self._failed = _NEAR, False  # the next step, and whether the last one failed
        self._spent, self._begun, self._in_vain = 0.0, 0, 0
        self._ended = threading.Event()

    def run(self, progress: ProgressCallback | None) -> SearchResult:
        with ThreadPoolExecutor(2, "shortening") as pool:
            while self._worthwhile:
                steps = [self._step]
                if self._failed and self._step > _FINEST:
                    steps.append(max(0.5 * self._step, _FINEST))
                elif self._failed:
                    steps.append(self._step)  # with other random numbers
                searches = [self._begin(step) for step in steps]
                futures = [pool.submit(search.go_on, _MOVES) for search in searches]
                try:
                    while wait(futures, _POLL_S).not_done:
                        self._report(progress)
                    self._report(progress)
                except BaseException:
                    self._ended.set()  # the pool waits for its threads
                    raise
                found = [future.result() for future in futures]
                self._compare(searches, found)
        return self._best.simplify()

    @property
    def _worthwhile(self) -> bool:
        enough = self._spent >= self._parameters.shortening or self._in_vain >= _IN_VAIN
        near = self._best.stretch - 1.0 <= _NEAR_ENOUGH
        return not (enough or near or self._clock() >= self._end_s)

    @property
    def _step(self) -> float:
        # by which the next compressed plan is shorter
        return min(self._nearer, (self._best.stretch - 1.0) * _OF_RANGE)

    def _report(self, progress: ProgressCallback | None) -> None:
        if progress is not None:
            share, found = self._spent / self._parameters.shortening, self._best.stretch
            text = f"a plan of {found:.2f} of the least makespan, looking for less"
            progress(min(share, 1.0), text)

    def _begin(self, step: float) -> Search:
        self._begun += 1
        parameters = replace(
            self._parameters,
            seed=(self._parameters.seed + self._begun) % 2**32,
            budget_s=max(0.0, self._end_s - self._clock()),
        )
        search = Search(self._problem, parameters, self._check, self._clock)
        search.begin_at(self._best.stretch - step, self._released, self._best)
        return search

    def _check(self, fraction: float, text: str) -> None:
        if self._ended.is_set():
            raise _EndedError

    def _compare(self, searches: list[Search], found: list[bool]) -> None:
        self._spent += sum(search.spent for search in searches)
        shorter = [search for search, ok in zip(searches, found) if ok]
        finest = self._step <= _FINEST
        self._failed = not shorter
        if shorter:
            best = min(shorter, key=lambda search: search.stretch)
            self._nearer = self._best.stretch - best.stretch
            if best.spent <= _EASY:
                self._nearer = min(2.0 * self._nearer, _NEAR_AT_MOST)
            self._best, self._in_vain = best, 0
        else:
            least = self._best.stretch - searches[-1].stretch
            self._nearer = max(0.5 * least, _FINEST)
            self._in_vain += finest

# SPDX-License-Identifier: Apache-2.0
"""Shorter plans: further searches at shorter makespans, for as long as the effort lasts."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.search import Search, SearchResult
from fiber_planner.interface import ProgressCallback

__all__ = ["shortest_plan"]

_SLICE = 100.0  # moves of each search, per robot, between two decisions
_PATIENCE = 1000.0  # moves after which a search is given up
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
    """Search for a plan, then on a crowded plane for shorter ones in which as many robots arrive.

    Two searches go on side by side at two makespans between the time that the slowest robot needs
    alone and the makespan of the best plan. A search that succeeds moves the upper end of the
    range, one that has failed for long is given up and moves the lower end. Decisions are made
    at fixed numbers of moves, so the plan depends neither on the number of cores nor on their
    speed, unless there is a budget of time.

    Args:
        problem: robots sorted by their places; robots that may not be moved are disabled.
        parameters: clearance to keep, effort to spend.
        progress: called with the fraction of the work that is done and a short text.
        clock: seconds, for the budget.
    """
    end_s = clock() + parameters.budget_s
    first = Search(problem, parameters, progress, clock)
    best = first.run()
    # a loose plane takes longer because of a few robots beside static arms: to search for all
    # robots again costs minutes there
    if not (first.certified and first.crowded):
        return best
    return _Shortening(problem, parameters, clock, end_s, first).run(best, progress)


class _Shortening:
    # The range of makespans in units of the time alone, and the searches in it, shorter first.

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
        self._failed, self._found = 1.0, first.stretch
        self._spent, self._begun = 0.0, 0
        self._searches: list[Search] = []
        self._ended = threading.Event()

    def run(self, best: SearchResult, progress: ProgressCallback | None) -> SearchResult:
        with ThreadPoolExecutor(2, "shortening") as pool:
            while self._worthwhile:
                self._begin_searches()
                before = [search.spent for search in self._searches]
                futures = [pool.submit(search.go_on, _SLICE) for search in self._searches]
                try:
                    while wait(futures, _POLL_S).not_done:
                        self._report(progress)
                    self._report(progress)
                except BaseException:
                    self._ended.set()  # the pool waits for its threads
                    raise
                results = [future.result() for future in futures]
                after = [search.spent for search in self._searches]
                self._spent += sum(after) - sum(before)
                best = self._shortest_of(results) or best
                self._drop([spent <= old for spent, old in zip(after, before)])
        return best

    @property
    def _worthwhile(self) -> bool:
        late = self._clock() >= self._end_s
        return (
            self._found - 1.0 > _FINEST and self._spent < self._parameters.shortening and not late
        )

    def _report(self, progress: ProgressCallback | None) -> None:
        if progress is not None:
            share = min(self._spent / self._parameters.shortening, 1.0)
            progress(share, f"a plan of {self._found:.2f} of the least makespan, looking for less")

    def _begin_searches(self) -> None:
        # so that two are in the range
        if not self._searches:
            if self._found - self._failed <= 2.0 * _FINEST:
                self._failed = 1.0  # other random numbers may find what others missed
            third = (self._found - self._failed) / 3.0
            self._searches = [self._begin(self._failed + third), self._begin(self._found - third)]
        elif len(self._searches) == 1:
            self._searches.append(self._begin(0.5 * (self._searches[0].stretch + self._found)))

    def _begin(self, stretch: float) -> Search:
        self._begun += 1
        parameters = replace(
            self._parameters,
            seed=(self._parameters.seed + self._begun) % 2**32,
            budget_s=max(0.0, self._end_s - self._clock()),
        )
        search = Search(self._problem, parameters, self._check, self._clock)
        search.begin_at(stretch, self._released)
        return search

    def _check(self, fraction: float, text: str) -> None:
        if self._ended.is_set():
            raise _EndedError

    def _shortest_of(self, results: list[SearchResult | None]) -> SearchResult | None:
        for search, result in zip(self._searches, results):
            if result is not None:
                self._found = search.stretch
                return result
        return None

    def _drop(self, stuck: list[bool]) -> None:
        # searches that have failed, and those at makespans outside the range
        for search, is_stuck in zip(self._searches, stuck):
            if search.stretch < self._found and (is_stuck or search.spent >= _PATIENCE):
                self._failed = max(self._failed, search.stretch)
        self._searches = [
            search for search in self._searches if self._failed < search.stretch < self._found
        ]

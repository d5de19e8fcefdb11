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
_QUICK = 200.0  # moves after which one that began with a compressed plan is given up
_NEAR = 0.04  # share of the time alone by which a compressed plan is shorter at first
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
    little shorter; the other one begins anew, in the middle of the range. A search that succeeds
    moves the upper end of the range. The latter, when it has failed for long, moves the lower end;
    the former is soon tried again with half of the compression. Decisions are made at fixed numbers
    of moves, so the plan depends neither on the number of cores nor on their speed, unless there is
    a budget of time.

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
    if not (first.certified and first.dense):
        return best
    return _Shortening(problem, parameters, clock, end_s, first).run(best, progress)


class _Shortening:
    # The range of makespans in units of the time alone, and the searches in it: one that began
    # anew, and one that began with the best plan compressed.

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
        self._failed, self._found, self._nearer = 1.0, first.stretch, _NEAR
        self._best = first
        self._spent, self._begun = 0.0, 0
        self._anew: Search | None = None
        self._compressed: Search | None = None
        self._ended = threading.Event()

    def run(self, best: SearchResult, progress: ProgressCallback | None) -> SearchResult:
        with ThreadPoolExecutor(2, "shortening") as pool:
            while self._worthwhile:
                searches = self._begin_searches()
                before = [search.spent for search in searches]
                futures = [pool.submit(search.go_on, _SLICE) for search in searches]
                try:
                    while wait(futures, _POLL_S).not_done:
                        self._report(progress)
                    self._report(progress)
                except BaseException:
                    self._ended.set()  # the pool waits for its threads
                    raise
                results = [future.result() for future in futures]
                after = [search.spent for search in searches]
                self._spent += sum(after) - sum(before)
                best = self._shortest_of(searches, results) or best
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

    def _begin_searches(self) -> list[Search]:
        # so that there are both
        if self._found - self._failed <= 2.0 * _FINEST:
            self._failed = 1.0  # other random numbers may find what others missed
        third = (self._found - self._failed) / 3.0
        if self._compressed is None:
            near = self._found - min(self._nearer, third)
            self._compressed = self._begin(near, self._best)
        if self._anew is None:
            self._anew = self._begin(0.5 * (self._failed + self._compressed.stretch), None)
        return [self._anew, self._compressed]

    def _begin(self, stretch: float, like: Search | None) -> Search:
        self._begun += 1
        parameters = replace(
            self._parameters,
            seed=(self._parameters.seed + self._begun) % 2**32,
            budget_s=max(0.0, self._end_s - self._clock()),
        )
        search = Search(self._problem, parameters, self._check, self._clock)
        search.begin_at(stretch, self._released, like)
        return search

    def _check(self, fraction: float, text: str) -> None:
        if self._ended.is_set():
            raise _EndedError

    def _shortest_of(
        self, searches: list[Search], results: list[SearchResult | None]
    ) -> SearchResult | None:
        found = [(search.stretch, k) for k, search in enumerate(searches) if results[k] is not None]
        if not found:
            return None
        self._found, at = min(found)
        self._best = searches[at]
        return results[at]

    def _drop(self, stuck: list[bool]) -> None:
        # searches that have failed, and those at makespans outside the range
        anew, compressed = self._anew, self._compressed
        assert anew is not None and compressed is not None
        if anew.stretch < self._found and (stuck[0] or anew.spent >= _PATIENCE):
            self._failed, self._anew = max(self._failed, anew.stretch), None
        elif anew.stretch >= self._found:
            self._anew = None
        if compressed.stretch < self._found and (stuck[1] or compressed.spent >= _QUICK):
            self._nearer, self._compressed = max(0.5 * self._nearer, _FINEST), None
        elif compressed.stretch >= self._found:
            self._compressed = None

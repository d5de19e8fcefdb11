"""Shorter plans: further searches at shorter makespans, for as long as the effort lasts."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.search import Search, SearchResult
from fiber_planner.interface import ProgressCallback

__all__ = ["shortest_plan"]

_SLICE = 100.0  # moves of each search, per robot, between two decisions
_PATIENCE = 1000.0  # moves after which a search is given up
_FINEST = 0.01  # of the stretch: no plan is sought that is shorter by less


def shortest_plan(
    problem: Problem,
    parameters: DirectParameters,
    progress: ProgressCallback | None,
    clock: Callable[[], float],
) -> SearchResult:
    """Search for a plan, then for shorter ones in which as many robots arrive.

    Two searches go on side by side at two makespans between the time that the slowest robot needs
    alone and the best plan. What one of them finds moves the range; a search that has found
    nothing for long is given up. Decisions are made at fixed numbers of moves, so the plan
    depends neither on the number of cores nor on their speed, unless there is a budget of time.

    Args:
        problem: robots sorted by their places; robots that may not be moved are disabled.
        parameters: clearance to keep, effort to spend.
        progress: called with the fraction of the work that is done and a short text.
        clock: seconds, for the budget.
    """
    end_s = clock() + parameters.budget_s
    first = Search(problem, parameters, progress, clock)
    best = first.run()
    if not first.certified or parameters.shortening == 0.0:
        return best
    return _Shortening(problem, parameters, clock, end_s, first).run(best, progress)


class _Shortening:
    # The range of makespans, from the longest given up to the shortest found, and the searches
    # in it, shorter makespan first.

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
        self._crowded, self._released = first.crowded, first.released
        self._failed, self._found = 1.0, first.stretch
        self._number = 0
        self._spent = 0.0
        self._searches: list[Search] = []

    def run(self, best: SearchResult, progress: ProgressCallback | None) -> SearchResult:
        with ThreadPoolExecutor(2) as pool:
            while self._fill():
                if progress is not None:
                    share = min(self._spent / self._parameters.shortening, 1.0)
                    progress(share, f"a plan of {self._found:.2f} times the bound; trying shorter")
                before = [search.spent for search in self._searches]
                results = list(pool.map(self._go_on, self._searches))
                self._spent += sum(search.spent for search in self._searches) - sum(before)
                best = self._judge(results, before) or best
        return best

    def _fill(self) -> bool:
        # two searches in the range; False when there is nothing left to do
        if self._spent >= self._parameters.shortening or self._clock() >= self._end_s:
            return False
        if self._found - 1.0 <= _FINEST:
            return False
        if not self._searches:
            if self._found - self._failed <= 2.0 * _FINEST:
                self._failed = 1.0  # what was given up once may be found with other numbers
            third = (self._found - self._failed) / 3.0
            self._searches = [self._begin(self._failed + third), self._begin(self._found - third)]
        elif len(self._searches) == 1:
            between = 0.5 * (self._searches[0].stretch + self._found)
            self._searches.append(self._begin(between))
        return True

    def _begin(self, stretch: float) -> Search:
        self._number += 1
        seed = (self._parameters.seed + self._number) % 2**32
        budget_s = max(0.0, self._end_s - self._clock())
        search = Search(
            self._problem,
            replace(self._parameters, seed=seed, budget_s=budget_s),
            None,
            self._clock,
        )
        search.begin_at(stretch, self._crowded)
        return search

    def _go_on(self, search: Search) -> SearchResult | None:
        return search.go_on(_SLICE, self._released)

    def _judge(
        self, results: list[SearchResult | None], before: list[float]
    ) -> SearchResult | None:
        # Take over the shortest plan found, and drop the searches that are of no use any more.
        best = None
        import os
        if os.environ.get("TRACE"):
            print("  ", [(round(s.stretch, 3), r is not None, round(s.spent)) for s, r in zip(self._searches, results)], flush=True)
        for search, result in zip(self._searches, results):
            if result is not None:
                self._found, best = search.stretch, result
                break
        going_on = []
        for search, spent in zip(self._searches, before):
            if search.stretch >= self._found:
                continue
            stuck = search.spent <= spent
            if search.spent >= _PATIENCE or stuck:
                self._failed = max(self._failed, search.stretch)
            else:
                going_on.append(search)
        self._searches = [s for s in going_on if s.stretch > self._failed]
        return best

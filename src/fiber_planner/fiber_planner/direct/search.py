# SPDX-License-Identifier: Apache-2.0
"""The search for a plan: straight motions, local search, longer makespans, best effort."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fiber_core.array_types import Bools
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_planner.direct.best_effort import (
    at_borders,
    hold_idle,
    hold_one_of_tangled,
    hold_worst,
    near_static_arms,
    release_worst,
)
from fiber_planner.direct.blocks import blocks_of, shortcut_all, sweep_parts
from fiber_planner.direct.certify_changed import MORE_MM, require_more, shortfall_mm
from fiber_planner.direct.compression import compress_late, compress_profiles
from fiber_planner.direct.initial_plan import choose_ends, straight_plan
from fiber_planner.direct.local_search import fold_arms, raise_weights, restore
from fiber_planner.direct.other_ends import fold_around_conflicts
from fiber_planner.direct.parameters import DirectParameters, effort_share
from fiber_planner.direct.plan_state import count_conflicts, measure_all, measure_pairs
from fiber_planner.direct.scene import scene_of
from fiber_planner.direct.search_result import SearchResult
from fiber_planner.direct.simplification import simplify_plan
from fiber_planner.direct.slowing import slow_close_starts
from fiber_planner.direct.stretches import stretches_of
from fiber_planner.direct.time_grid import time_grid
from fiber_planner.interface import ProgressCallback

__all__ = ["Search"]

# If straight motions conflict in more pairs than half the number of robots the plane is crowded,
# and arms fold on their way from the beginning. Of each tuple: loose plane, crowded plane.
_CROWDED = 0.5
_SHORTENED = 0.33  # with more conflicts than this share, shorter plans are sought
_FOLD_FROM = (1.4, 1.2)  # stretch from which arms are folded on their way
_RELEASE_FROM = (1.02, 1.5)  # stretch from which stuck robots near static arms are released
_FOLDING = 0.7  # share of moves that fold the arm, once arms are folded
_DRAWS = (30, 100)  # moves of a robot in a sweep: not folding, folding
_LINES = 60  # profiles of fewer segments that are tried for each robot
_LAST_LINES = (400, 400)  # the same of a plan that is not searched any more, one after the other
_SWEEPS = (60, 24)  # of one local search: not folding, folding
_IN_VAIN = 8  # sweeps without folding
# So few pairs in conflict are searched deeper beside static bodies. They, or 2 in 1000, fold.
_FEW, _SHARE_OF_FEW, _FOLDED = 5, 0.002, 1  # times at one makespan
_FEW_FOLD_FROM = 1.1  # stretch; and in the time alone
_DRAWS_OF_FEW = 15000  # in a sweep; 5 us each
_VISITS = 100  # robots between two reports of progress, at least
_PARTS = 50  # reports of progress in a sweep, at most
# Moves per robot after which no more robots are folded anew, at makespans after which a longer one
# is tried, and at those after which robots lose their targets.
_AT_ONE_MAKESPAN = (60, 200)
_REFOLDED_AT_MOST = 20  # times at one makespan
_CERTIFIED_AT_MOST = 8  # rounds of certificate and local search
_RELEASE_ROUNDS = 12
_LAST_EFFORT = 900  # moves per robot granted to each of the last of these rounds
_RESTORE_DRAWS = 300


class Search:
    """The search for one plan: the problem, the plan as it is now, and the effort spent.

    A robot is released when it loses its target: it may then end anywhere and makes way.

    Args:
        problem: robots sorted by their places; robots that may not be moved are disabled.
        parameters: clearance to keep, effort to spend.
        progress: called with the fraction of the work that is done and a short text.
        clock: seconds, for the budget.
    """

    def __init__(
        self,
        problem: Problem,
        parameters: DirectParameters,
        progress: ProgressCallback | None,
        clock: Callable[[], float],
    ):
        self._problem, self._parameters = problem, parameters
        self._progress, self._clock = progress, clock
        self._end_s = clock() + parameters.budget_s
        self._scene = scene_of(problem, parameters)
        self._blocks = blocks_of(problem.plane.n, self._scene.near)
        self._ends = choose_ends(problem, self._scene, parameters)
        self._reason, self._alone_s = self._ends.reason, self._ends.alone_s
        self._tick_s = WireUnits.for_plane(problem.plane).tick_s
        self._spent, self._sweep, self._folding = 0, 0, 0.0
        self._done = 0.0  # fraction of the makespans that were tried
        self._effort_share = effort_share(problem.plane.n)
        self._limit = parameters.effort * self._effort_share
        self._at_one_makespan = 0.0
        self._refolded_at_most = _REFOLDED_AT_MOST
        self.crowded, self.dense, self.stretch, self.certified = False, False, 1.0, False
        near_static = near_static_arms(self._scene, problem.plane.n)
        self._first_released = near_static | at_borders(self._scene, problem.plane)
        self._may_be_blocked = bool(near_static.any()) or len(problem.plane.walls) > 0
        self._at_most = np.zeros(len(self._scene.pairs), dtype=bool)  # see require_more

    def run(self) -> SearchResult:
        """Search at longer and longer makespans, and return the motion that was found."""
        conflicts = self._start_straight(1.0)
        if not (self._plan.choice >= 0).any():  # pairs that start too close are not parted either
            return self.result()
        self.crowded = conflicts > _CROWDED * self._problem.plane.n
        self.dense = conflicts > _SHORTENED * self._problem.plane.n
        crowded = int(self.crowded)
        stretches = stretches_of(
            self._problem.plane, self.crowded, self._alone_s, self._parameters.stretch
        )
        if crowded:
            conflicts = self._start_straight(stretches[0])
        for number, stretch in enumerate(stretches):
            self.stretch, releases = stretch, stretch >= _RELEASE_FROM[crowded]
            self._at_one_makespan = _AT_ONE_MAKESPAN[int(releases)] * self._effort_share
            self._lengthen(stretch)
            if stretch >= _FOLD_FROM[crowded] and self._folding == 0.0:
                conflicts = self._fold_all()
            self._done = number / len(stretches)
            self._report_progress(conflicts)
            conflicts = self._certified_search()
            for _ in range(_RELEASE_ROUNDS):
                if conflicts == 0 or not releases or self._exhausted:
                    break
                released = self._release_worst(self._releasable())
                if not (released or hold_idle(self._scene, self._plan)):
                    break
                conflicts = self._certified_search()
            if conflicts == 0 or self._exhausted:
                break
        self.certified = conflicts == 0
        if conflicts:
            self._resolve_by_release()
        self._restore()
        return self.result()

    def begin_at(self, stretch: float, released: Bools, like: "Search") -> None:
        """Begin a search at one makespan with a longer plan compressed, for `go_on`.

        Args:
            stretch: the makespan, in units of the time that the slowest robot needs alone.
            released: robots that have lost their targets in an earlier search, shape (n,).
            like: a search that has found a longer plan of the same problem.
        """
        self.stretch, self.crowded, self._limit = stretch, True, 0.0
        self._refolded_at_most = 10 * _REFOLDED_AT_MOST
        self._ends.choice[released] = -1
        self._ends.angles[released] = self._problem.start[released]
        self._reason[released] = Reason.NOT_CONVERGED
        self._start_straight(stretch)
        self._folding = _FOLDING
        other = like._plan
        compress_profiles(self._scene, self._plan, other.q, other.choice, self._grid.step_s)
        self._plan.changed[:] = self._plan.shortcut_due[:] = True
        measure_all(self._scene, self._plan)

    def go_on(self, moves: float) -> bool:
        """Go on with a search at one makespan, and return whether a certified plan was found.

        Args:
            moves: moves that may be evaluated, per robot for which effort is granted.
        """
        self._limit += moves * self._effort_share
        self._at_one_makespan = self._limit
        self.certified = self._certified_search() == 0
        if self.certified:
            self._restore()
        return self.certified

    def end_after(self, intervals: int, moves: float) -> bool:
        """Let a certified plan end sooner, if its late robots find ways that are certified too.

        Args:
            intervals: of the time grid, fewer than now.
            moves: moves that may be evaluated, per robot for which effort is granted.
        """
        sooner = compress_late(self._scene, self._plan, intervals, self._grid.step_s)
        if sooner is None or self._exhausted:
            return False
        before, at_most = (self._plan, self._grid, self._folding), self._at_most.copy()
        self._folding, self._refolded_at_most = _FOLDING, _FOLDED
        self._at_one_makespan = moves * self._effort_share
        self._plan, self._grid = sooner, replace(self._grid, intervals=intervals)
        if self._certified_search() == 0:
            self.stretch = self._grid.makespan_s / self._alone_s
            return True
        self._plan, self._grid, self._folding = before
        self._at_most[:] = at_most
        return False

    def simplify(self) -> SearchResult:
        """Give robots of a certified plan profiles of fewer lines where those are certified too."""
        for lines in _LAST_LINES:
            if not self._late:
                step_s, unconfirmed = self._grid.step_s, self._unconfirmed_pairs
                simplify_plan(self._scene, self._plan, step_s, lines, self._blocks, unconfirmed)
        return self.result()

    @property
    def intervals(self) -> tuple[int, int]:
        """Grid intervals of the plan, and those of the time that the slowest robot needs alone."""
        return self._grid.intervals, math.ceil(self._alone_s / self._grid.step_s - 1e-9)

    @property
    def spent(self) -> float:
        """Moves evaluated, per robot for which effort is granted."""
        return self._spent / self._effort_share

    @property
    def released(self) -> Bools:
        """Robots that have lost their targets in the search, shape (n,)."""
        return self._reason == Reason.NOT_CONVERGED

    def _start_straight(self, stretch: float) -> int:
        # the straight plan on a grid for that makespan; returns the number of conflicts
        problem, parameters = self._problem, self._parameters
        self._grid = time_grid(stretch * self._alone_s, self._tick_s, parameters.intervals)
        self._plan, self._tangled = straight_plan(
            problem, self._scene, parameters, self._ends, self._grid
        )
        hold_one_of_tangled(self._scene, self._plan, self._ends, self._tangled)
        self._at_most[:] = False
        return measure_all(self._scene, self._plan)

    def _lengthen(self, stretch: float) -> None:
        # More time at the end, in which all robots rest at first: no pair comes nearer.
        longer = self._grid.lasting(stretch * self._alone_s)
        more = longer.intervals - self._grid.intervals
        if more > 0:
            rest = np.repeat(self._plan.q[:, :, -1:], more, axis=2)
            self._plan = self._plan._replace(q=np.concatenate([self._plan.q, rest], axis=2))
            self._plan.changed[:] = self._plan.shortcut_due[:] = True
            self._grid = longer
            self._slow_close_starts(self._plan.cost > 0.0)

    def _slow_close_starts(self, among: Bools) -> None:
        lasts_s, plane = self._grid.makespan_s, self._problem.plane
        slow_close_starts(plane, self._scene, self._plan, among, lasts_s)

    def _report_progress(self, conflicts: int) -> None:
        if self._progress is not None:
            self._progress(self._done, f"{conflicts} conflicts, {self._grid.makespan_s:.2f} s")

    @property
    def _exhausted(self) -> bool:
        return self._spent >= self._limit or self._late

    @property
    def _late(self) -> bool:
        return math.isfinite(self._end_s) and self._clock() >= self._end_s

    def _fold_all(self) -> int:
        self._folding = _FOLDING
        self._plan.weight[:] = 1.0
        fold_arms(self._scene, self._plan, self._scene.movable, self._grid.step_s)
        return measure_all(self._scene, self._plan)

    def _local_search(self) -> int:
        # sweeps until no pair is in conflict; returns the number of conflicts left
        until = self._spent + self._at_one_makespan
        conflicts = self._sweep_repeatedly(self._folding)
        if self._folding > 0.0:
            return self._fold_anew(conflicts, self._refolded_at_most, until)
        plane = self._problem.plane
        few = conflicts <= max(_FEW, _SHARE_OF_FEW * plane.n) and not self._without_target.any()
        # a plan of much more time is found sooner; coupled motors have no time to fold
        little = 1.0 < self.stretch < _FEW_FOLD_FROM
        if little or not few or plane.coupling.shape[1] or conflicts == 0:
            return conflicts
        before = self._plan.saved()
        left = self._fold_anew(conflicts, _FOLDED, until)
        if left >= conflicts:
            self._plan.take_back(before)
        return min(left, conflicts)

    def _fold_anew(self, conflicts: int, times: int, until: float) -> int:
        for number in range(times):
            if conflicts == 0 or self._spent >= until or self._exhausted:
                break
            fold_around_conflicts(
                self._scene, self._plan, self._grid.step_s, self._sweep,
                straight=number % 2 == 1, other_ends=number % 4 >= 2,
            )  # fmt: skip
            conflicts = self._sweep_repeatedly(_FOLDING)
        return conflicts

    def _sweep_repeatedly(self, folding: float) -> int:
        # whole sweeps, made in parts so that a budget is kept, and the search can be ended by its
        # progress callback, on planes of any size; the last few stuck robots are searched deeper
        n, draws, sweeps = self._problem.plane.n, _DRAWS[folding > 0.0], _SWEEPS[folding > 0.0]
        patience = _IN_VAIN if folding == 0.0 else sweeps
        deeper = self._may_be_blocked and folding == 0.0 and not self._without_target.any()
        visits = max(_VISITS, n // _PARTS)
        least, in_vain = n * n, 0
        for _ in range(sweeps):
            conflicts = count_conflicts(self._plan)
            in_vain = 0 if conflicts < least else in_vain + 1
            least = min(least, conflicts)
            if conflicts == 0 or self._exhausted or in_vain == patience:
                break
            if deeper and in_vain >= patience // 2 and conflicts <= _FEW:
                draws = _DRAWS_OF_FEW // conflicts
            for wave in self._blocks.waves(backwards=self._sweep % 2 == 1):
                for first in range(0, max(map(len, wave)), visits):
                    self._report_progress(conflicts)
                    self._spent += sweep_parts(
                        self._scene, self._plan, self._grid.step_s, folding, self._sweep,
                        [rows[first : first + visits] for rows in wave], draws,
                    )  # fmt: skip
                    if self._late:
                        break
            raise_weights(self._plan)
            self._sweep += 1
        return count_conflicts(self._plan)

    def _certified_search(self) -> int:
        # Local search, then the certificate; pairs that it does not confirm are required to
        # keep a little more. Returns the number of pairs in conflict or not confirmed.
        unconfirmed = 0
        for _ in range(_CERTIFIED_AT_MOST):
            conflicts = self._local_search()
            if conflicts:
                return conflicts
            shortcut_all(self._scene, self._plan, self._grid.step_s, _LINES, 0, self._blocks)
            short = self._unconfirmed_pairs()
            unconfirmed = int(np.count_nonzero(short))
            if not unconfirmed:
                return 0
            measure_pairs(self._scene, self._plan, np.flatnonzero(short))
            self._plan.cost[short] = np.maximum(self._plan.cost[short], MORE_MM)
        return unconfirmed

    def _unconfirmed_pairs(self) -> Bools:
        plane, scene, plan, at_most = self._problem.plane, self._scene, self._plan, self._at_most
        asked = self._parameters
        missing = shortfall_mm(plane, scene, asked, plan, self._grid, self._tangled, at_most)
        require_more(plane, scene, plan, missing, at_most)
        short = missing > 0.0
        self._slow_close_starts(short)
        return short

    def _resolve_by_release(self) -> None:
        for _ in range(_RELEASE_ROUNDS):
            if self._late:
                break
            self._release_worst(self._scene.movable)
            self._limit = max(self._limit, self._spent + _LAST_EFFORT * self._problem.plane.n)
            if self._certified_search() == 0:
                return
        lost = hold_worst(self._scene, self._plan, self._unconfirmed_pairs)
        self._reason[lost] = Reason.NOT_CONVERGED

    def _releasable(self) -> Bools:
        # Robots near static arms and at borders of sectors, and once one of them was released,
        # all: a few robots that are stuck there are no reason for a longer makespan of all.
        released = (self._reason == Reason.NOT_CONVERGED).any()
        return self._scene.movable if released else self._first_released

    def _restore(self) -> None:
        # Released robots go to their targets after all if that motion is free and certified.
        released = np.flatnonzero(self._without_target)
        if not len(released):
            return
        before = self._plan.saved()
        restored = 0
        for first in range(0, len(released), _VISITS):
            if self._late:
                break
            self._report_progress(0)
            restored += restore(
                self._scene, self._plan, self._grid.step_s, self._folding,
                released[first : first + _VISITS], self._sweep, _RESTORE_DRAWS,
            )  # fmt: skip
        if restored and self._unconfirmed_pairs().any():
            self._plan.take_back(before)

    def _release_worst(self, among: Bools) -> int:
        worst = release_worst(self._scene, self._plan, among)
        self._reason[worst] = Reason.NOT_CONVERGED
        return len(worst)

    @property
    def _without_target(self) -> Bools:
        # robots that were released, or had to give up their targets from the beginning, (n,)
        return (self._reason == Reason.NOT_CONVERGED) | (self._reason == Reason.GOAL_BLOCKED)

    def result(self) -> SearchResult:
        """Return the motion of the plan as it is."""
        plan, n = self._plan, self._problem.plane.n
        arrived = plan.choice >= 0
        self._reason[self._without_target & arrived] = Reason.OK
        goal = np.where(arrived[:, None], plan.q[:n, :, -1], plan.q[:n, :, 0])
        time_s, tangled = self._grid.time_s, self._scene.pairs[self._tangled]
        return SearchResult(time_s, plan.q, goal, self._reason, tangled)

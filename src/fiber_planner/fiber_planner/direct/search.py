"""The search for a plan: straight moves, then repair, longer times, and best effort."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_planner.direct.certify_changed import missing_mm
from fiber_planner.direct.initial_plan import choose_ends, straight_draft
from fiber_planner.direct.local_search import add_weight, fold_first, go_straight, restore, sweep
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.plan_state import count_conflicts, measure, measure_some
from fiber_planner.direct.scene import scene_of
from fiber_planner.direct.shortcut import simplify
from fiber_planner.direct.time_grid import time_grid
from fiber_planner.interface import ProgressCallback

__all__ = ["Found", "Search"]

# Where straight moves meet in more pairs than half the number of robots the plane is crowded
# and arms fold on their way from the beginning. Of each pair: loose plane, crowded plane.
_CROWDED = 0.5
_STRETCHES = (
    (1.0, 1.02, 1.05, 1.1, 1.15, 1.25, 1.4, 1.6, 1.8, 2.0),
    (1.2, 1.35, 1.5, 1.75, 2.0, 2.15),
)
_FOLD_FROM = (1.4, 1.2)  # stretch from which arms are folded on their way
_PATIENCE = (1.1, 1.5)  # stretch at which robots stuck beside what cannot move are given up
_LONGER = 1.4  # growth of the stretch beyond those
_FOLDING = 0.7  # share of candidates that fold, once arms are folded
_DRAWS = (30, 100)  # candidates of a robot in a sweep: not folding, folding
_SWEEPS = (60, 24)  # of a repair: not folding, folding
_VISITS = 100  # robots between two looks at the clock, at least
_PARTS = 50  # looks at the clock in a sweep, at most
_AT_ONE_MAKESPAN = 200  # candidates per robot after which no more are folded anew
_REFOLDED_AT_MOST = 20  # times at one makespan
_CERTIFIED_AT_MOST = 8  # rounds of certificate and repair
_GIVE_UP_ROUNDS = 12
_LAST_EFFORT = 900  # candidates per robot granted to each of these rounds
_RESTORE_DRAWS = 300
_TINY_PLANE, _LARGE_PLANE, _TIMES = 100, 1000, 4  # see _granted
_MORE_MM = 0.005  # asked for beyond what the certificate misses


class Found(NamedTuple):
    """What a search found.

    Args:
        time_s: instants of the motion [s], shape (k + 1,).
        q: joint angles then [rad], shape (b, 2, k + 1), obstacles included.
        goal: as in PlannedMotion, like all that follow.
        reason: why each robot does not arrive.
        tangled: pairs that start too close.
    """

    time_s: np.ndarray
    q: np.ndarray
    goal: np.ndarray
    reason: np.ndarray
    tangled: np.ndarray


class Search:
    """One plan in the making: the problem, the draft and what has been spent on it.

    Args:
        problem: robots sorted by their places; who may not be moved is disabled.
        parameters: what to keep apart, how long to search.
        progress: told now and then how far the work is.
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
        self._crowd = scene_of(problem, parameters.seed)
        self._ends = choose_ends(problem, self._crowd, parameters)
        self._reason, self._alone_s = self._ends.reason, self._ends.alone_s
        self._tick_s = WireUnits.for_plane(problem.plane).tick_s
        self._spent, self._sweep, self._folding = 0, 0, 0.0
        self._granted = _granted(problem.plane.n)
        self._limit = parameters.effort * self._granted
        # beside an arm that cannot move; a fixed disc blocks no more than a passage
        pairs, movable, robots = self._crowd.pairs, self._crowd.movable, problem.plane.n
        beside = pairs[((pairs < robots) & ~movable[pairs]).any(axis=1)]
        self._walled = movable & np.isin(np.arange(len(movable)), beside)

    def run(self) -> Found:
        """Search, and return what was found."""
        conflicts = self._begin(1.0)
        crowded = int(conflicts > _CROWDED * self._problem.plane.n)
        stretches = self._stretches(_STRETCHES[crowded])
        if crowded:
            conflicts = self._begin(stretches[0])
        for number, stretch in enumerate(stretches):
            self._lengthen(stretch)
            if stretch >= _FOLD_FROM[crowded] and self._folding == 0.0:
                conflicts = self._fold_all()
            self._tell(number / len(stretches), conflicts)
            conflicts = self._certified_repair()
            for _ in range(_GIVE_UP_ROUNDS):
                if conflicts == 0 or stretch < _PATIENCE[crowded] or self._over:
                    break
                if not self._free_the_worst(self._may_be_given_up()):
                    break
                conflicts = self._certified_repair()
            if conflicts == 0 or self._over:
                break
        if conflicts:
            self._give_up()
        self._restore()
        return self._result()

    def _begin(self, stretch):
        # everybody straight, on a grid for that makespan; returns the pairs in conflict
        problem, parameters = self._problem, self._parameters
        self._grid = time_grid(stretch * self._alone_s, self._tick_s, parameters.intervals)
        self._draft, self._tangled = straight_draft(
            problem, self._crowd, parameters, self._ends, self._grid
        )
        self._let_wait()
        return measure(self._crowd, self._draft)

    def _let_wait(self):
        # Of two that start too close one rests, best one without a target: timing errors
        # of two that move could let them touch.
        ends, movable = self._ends, self._crowd.movable
        for a, b in self._crowd.pairs[self._tangled]:
            if movable[a] and movable[b]:
                row = a if ends.choice[a] < 0 <= ends.choice[b] else b
                movable[row] = False
                self._draft.q[row] = self._problem.start[row][:, None]
                self._draft.choice[row] = ends.choice[row] = -1
                ends.angles[row] = self._problem.start[row]
                if self._reason[row] == Reason.OK:
                    self._reason[row] = Reason.TANGLED

    def _stretches(self, usual):
        # The makespans to try, in units of the time alone: at least long enough to fold,
        # go, and unfold, however short the way is.
        plane = self._problem.plane
        bend = np.minimum(np.pi, np.diff(plane.limits[:, 1])[:, 0])
        fold_s = float((bend / plane.speeds[:, 1]).max(initial=0.0))
        most = max(self._parameters.stretch, 1.0 + 2.0 * fold_s / max(self._alone_s, 1e-9))
        tried = [stretch for stretch in usual if stretch <= most] or [most]
        while tried[-1] * _LONGER <= most:
            tried.append(tried[-1] * _LONGER)
        return tried

    def _lengthen(self, stretch):
        # More time at the end, in which everybody rests so far: no pair comes nearer.
        longer = self._grid.lasting(stretch * self._alone_s)
        more = longer.intervals - self._grid.intervals
        if more > 0:
            rest = np.repeat(self._draft.q[:, :, -1:], more, axis=2)
            self._draft = self._draft._replace(q=np.concatenate([self._draft.q, rest], axis=2))
            self._draft.changed[:] = self._draft.around[:] = True
            self._grid = longer

    def _tell(self, part, conflicts):
        if self._progress is not None:
            makespan_s = self._grid.makespan_s
            self._progress(part, f"{conflicts} conflicts in {makespan_s:.2f} s of motion")

    @property
    def _over(self):
        return self._spent >= self._limit or self._late

    @property
    def _late(self):
        return math.isfinite(self._end_s) and self._clock() >= self._end_s

    # -- search

    def _fold_all(self):
        # Everybody who has far to go folds first and unfolds last, as fast as possible.
        self._folding = _FOLDING
        self._draft.weight[:] = 1.0
        fold_first(self._crowd, self._draft, self._crowd.movable, self._grid.step_s)
        return measure(self._crowd, self._draft)

    def _fold_around(self, straight):
        # The robots in conflict and all around them begin again, with equal weights: what
        # is stuck for long has pushed its weights beyond everything else. Two whose arms pass
        # each other when both go straight may not be able to when both fold.
        pairs, movable = self._crowd.pairs, self._crowd.movable
        stuck = np.zeros(len(movable), dtype=bool)
        stuck[pairs[self._draft.depth > 0.0]] = True
        near = stuck.copy()
        near[pairs[near[pairs].any(axis=1)]] = True
        self._draft.weight[:] = 1.0
        fold_first(self._crowd, self._draft, near & movable, self._grid.step_s)
        if straight:
            go_straight(self._crowd, self._draft, stuck & movable)
        measure(self._crowd, self._draft)

    def _repair(self):
        folding = int(self._folding > 0.0)
        until = self._spent + _AT_ONE_MAKESPAN * self._granted
        conflicts = self._sweep_over(_SWEEPS[folding])
        for number in range(_REFOLDED_AT_MOST * folding):
            if conflicts == 0 or self._spent >= until or self._over:
                break
            self._fold_around(straight=number % 2 == 1)
            conflicts = self._sweep_over(_SWEEPS[folding])
        return conflicts

    def _sweep_over(self, sweeps):
        # whole sweeps, looked at in parts so that a budget is kept on planes of any size
        n, folding = self._problem.plane.n, self._folding
        draws = _DRAWS[int(folding > 0.0)]
        visits = max(_VISITS, n // _PARTS) if math.isfinite(self._end_s) else n
        for _ in range(sweeps):
            if count_conflicts(self._draft) == 0 or self._over:
                break
            for first in range(0, n, visits):
                self._spent += sweep(
                    self._crowd, self._draft, self._grid.step_s, folding,
                    self._sweep, first, min(first + visits, n), draws,
                )  # fmt: skip
                if self._late:
                    break
            add_weight(self._draft)
            self._sweep += 1
        return count_conflicts(self._draft)

    def _certified_repair(self):
        # Repair, then have the certificate confirm it; pairs it does not confirm are
        # asked for a little more room.
        for _ in range(_CERTIFIED_AT_MOST):
            conflicts = self._repair()
            if conflicts:
                return conflicts
            simplify(self._crowd, self._draft)
            short = self._short()
            if not short.any():
                return 0
            measure_some(self._crowd, self._draft, np.flatnonzero(short))
            self._draft.depth[short] = np.maximum(self._draft.depth[short], _MORE_MM)
        return short.sum()

    def _short(self):
        # Pairs the certificate does not confirm, (p,); from now on they are asked for more.
        missing = missing_mm(
            self._problem.plane, self._crowd, self._parameters,
            self._draft, self._grid, self._tangled,
        )  # fmt: skip
        short = missing > 0.0
        self._draft.required[short] += missing[short] + _MORE_MM
        return short

    # -- best effort

    def _give_up(self):
        for _ in range(_GIVE_UP_ROUNDS):
            if self._late:
                break
            self._free_the_worst(self._crowd.movable)
            self._limit = max(self._limit, self._spent + _LAST_EFFORT * self._problem.plane.n)
            if self._certified_repair() == 0:
                return
        self._freeze()

    def _may_be_given_up(self):
        # Robots beside what cannot move, and once some of them were given up, everybody: more
        # time for all is no price for a few that are stuck behind those.
        given_up = (self._reason == Reason.NOT_CONVERGED).any()
        return self._crowd.movable if given_up else self._walled

    def _restore(self):
        # Who was given up goes after all where that meets nobody and is certified.
        given_up = np.flatnonzero(self._reason == Reason.NOT_CONVERGED)
        if not len(given_up):
            return
        before = [np.copy(column) for column in self._draft]
        restored = 0
        for first in range(0, len(given_up), _VISITS):
            if self._late:
                break
            restored += restore(
                self._crowd, self._draft, self._grid.step_s, self._folding,
                given_up[first : first + _VISITS], self._sweep, _RESTORE_DRAWS,
            )  # fmt: skip
        if restored and self._short().any():
            for column, old in zip(self._draft, before):
                column[...] = old

    def _worse(self, bad, among):
        # Of every bad pair, (p,), the robot with most conflict, if it is among those, (b,).
        crowd, draft = self._crowd, self._draft
        pressure = np.zeros(len(crowd.movable))
        for side in range(2):
            np.add.at(pressure, crowd.pairs[bad, side], (draft.weight * draft.depth)[bad])
        pressure[~among] = -1.0
        a, b = crowd.pairs[bad].T
        worse = np.where(pressure[a] >= pressure[b], a, b)
        return np.unique(worse[among[worse]])

    def _free_the_worst(self, among):
        # The robots with most conflict may end anywhere; returns how many they are.
        draft = self._draft
        seeking = among.copy()
        seeking[: len(draft.choice)] &= draft.choice >= 0
        worse = self._worse(draft.depth > 0.0, seeking)
        draft.choice[worse] = -1
        draft.around[worse] = True
        self._reason[worse] = Reason.NOT_CONVERGED
        draft.weight[:] = 1.0
        return len(worse)

    def _freeze(self):
        # The robots with most conflict rest at their starts, and whoever then meets them.
        crowd, draft = self._crowd, self._draft
        draft.weight[:] = 1.0
        moving = crowd.movable.copy()
        while True:
            bad = draft.depth > 0.0 if measure(crowd, draft) else self._short()
            rows = self._worse(bad, moving)
            if not len(rows):
                return
            moving[rows] = False
            draft.q[rows] = self._problem.start[rows][:, :, None]
            draft.changed[rows] = True
            rows = rows[draft.choice[rows] >= 0]
            draft.choice[rows] = -1
            self._reason[rows] = Reason.NOT_CONVERGED

    # -- the result

    def _result(self):
        draft, n = self._draft, self._problem.plane.n
        arrived = draft.choice >= 0
        self._reason[(self._reason == Reason.NOT_CONVERGED) & arrived] = Reason.OK
        goal = np.where(arrived[:, None], draft.q[:n, :, -1], draft.q[:n, :, 0])
        tangled = self._crowd.pairs[self._tangled]
        return Found(self._grid.time_s, draft.q, goal, self._reason, tangled)


def _granted(robots):
    # The robots for which effort is granted. A stuck pair is no easier for having few around it:
    # each robot gets some times its share, as long as that is not more than a large plane has.
    return max(_TINY_PLANE, robots, min(_TIMES * robots, _LARGE_PLANE))

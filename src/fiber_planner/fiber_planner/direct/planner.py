"""The planner: everybody straight to the target at once, and repair where they would meet."""

from dataclasses import dataclass

import numpy as np

from fiber_core.clearance import certify, gaps
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner.direct.crowd import Crowd, crowd_of
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.pieces import straight_pieces
from fiber_planner.direct.reach import reachable
from fiber_planner.direct.repair import (
    Draft,
    fold_first,
    measure,
    repair,
    restore,
    straighten,
)
from fiber_planner.goals import choose_goals
from fiber_planner.protocol import PlannedMotion, Progress

__all__ = ["DirectPlanner"]

# Where straight moves meet in more pairs than half the number of robots the plane is crowded
# and arms fold on their way from the beginning. Of each pair: loose plane, crowded plane.
_CROWDED = 0.5
_STRETCHES = (
    (1.0, 1.02, 1.05, 1.1, 1.15, 1.25, 1.4, 1.6, 1.8, 2.0),
    (1.2, 1.3, 1.4, 1.6, 1.8, 2.0, 2.2),
)
_FOLD_FROM = (1.4, 1.2)  # stretch from which arms are folded on their way
_PATIENCE = (1.1, 1.8)  # stretch at which robots stuck beside what cannot move are given up
_LONGER = 1.4  # growth of the stretch beyond those
_FOLDING = 0.7  # share of candidates that fold, once arms are folded
_DRAWS = (30, 100)  # candidates of a robot in a sweep: not folding, folding
_SWEEPS = (60, 48)  # at each makespan: not folding, folding
_CERTIFIED_AT_MOST = 8  # rounds of certificate and repair
_GIVE_UP_ROUNDS = 12
_LAST_EFFORT = 900  # candidates per robot granted to each of these rounds
_RESTORE_DRAWS = 300
_SMALL_PLANE = 100  # the effort granted to a plane of fewer robots
_EPS_MM = 1e-6
_MORE_MM = 0.005  # asked for beyond what the certificate misses


class DirectPlanner:
    """Straight moves over the whole makespan, repaired by guided local search.

    Every motor turns at constant speed from start to goal, all in the time the slowest
    robot would need alone. Robots that would meet try other profiles: windows of that
    time, third angles on the way, other elbows and turns. Where that does not clear
    everybody the makespan is stretched; who cannot be cleared at all is held where it
    is safe. The plan is certified in continuous time before it is returned.

    Args:
        parameters: what to keep apart, how long to search.
    """

    name = "direct"

    def __init__(self, parameters: DirectParameters | None = None):
        self.parameters = parameters or DirectParameters()

    def plan(self, problem: Problem, progress: Progress | None = None) -> PlannedMotion:
        """Plan the motion of every robot, see Planner.plan."""
        plane = problem.plane
        if plane.n == 0:
            nothing = SampledMotion([0.0], np.zeros((0, 2, 1)))
            return PlannedMotion(nothing, np.zeros((0, 2)), np.zeros(0))
        # Robots are taken in the order of their places: the plan does not depend on
        # how they are numbered.
        order = np.lexsort([plane.centers[:, 1], plane.centers[:, 0]])
        # Who stands outside its joint limits may not be moved: an obstacle like the disabled.
        low, high = np.moveaxis(plane.limits, -1, 0)
        inside = ((problem.start >= low) & (problem.start <= high)).all(axis=1)
        movable = plane.with_enabled(plane.enabled & inside)
        sorted_problem = Problem(
            movable.permuted(order), problem.start[order], problem.targets[order]
        )
        motion, goal, reason = _Search(sorted_problem, self.parameters, progress).run()
        back = np.argsort(order)
        reason[back[problem.asked & plane.enabled & ~inside]] = Reason.START_OUTSIDE_LIMITS
        return PlannedMotion(
            SampledMotion(motion.time_s, motion.angles[back]), goal[back], reason[back]
        )


@dataclass
class _Search:
    # One plan in the making: the problem, the draft and what has been spent on it.
    problem: Problem
    parameters: DirectParameters
    progress: Progress | None

    def __post_init__(self):
        problem, parameters = self.problem, self.parameters
        self.crowd: Crowd = crowd_of(problem, parameters.seed)
        self.spent, self.sweep, self.folding = 0, 0, 0.0
        self.limit = parameters.effort * max(_SMALL_PLANE, problem.plane.n)

    def run(self):
        self._begin()
        conflicts = measure(self.crowd, self.draft)
        crowded = conflicts > _CROWDED * self.problem.plane.n
        patience, fold_from = _PATIENCE[int(crowded)], _FOLD_FROM[int(crowded)]
        stretches = self._stretches(_STRETCHES[int(crowded)])
        for number, stretch in enumerate(stretches):
            self._stretch_to(stretch)
            if stretch >= fold_from and self.folding == 0.0:
                conflicts = self._fold_all()
            if self.progress is not None:
                part = number / len(stretches)
                self.progress(part, f"{conflicts} conflicts in {self.makespan_s:.2f} s of motion")
            conflicts = self._certified_repair()
            for _ in range(_GIVE_UP_ROUNDS):
                if conflicts == 0 or stretch < patience or not self._free_the_worst(self.walled):
                    break
                conflicts = self._certified_repair()
            if conflicts == 0 or self.spent >= self.limit:
                break
        if conflicts:
            self._give_up()
        self._restore()
        return self._finish()

    # -- the first draft

    def _begin(self):
        problem, crowd, parameters = self.problem, self.crowd, self.parameters
        plane, n, steps = problem.plane, problem.plane.n, parameters.intervals
        self.reason = np.full(n, int(Reason.OK))
        self.reason[~problem.asked] = Reason.NO_TARGET
        self.reason[problem.asked & ~plane.enabled] = Reason.DISABLED
        least = parameters.margin_mm
        blocked = problem.asked & plane.enabled & ~reachable(problem, crowd.pairs, least)
        self.reason[blocked] = Reason.GOAL_BLOCKED

        seeking = self.reason == Reason.OK
        travel = np.abs(crowd.option - problem.start[:, None]) / plane.speeds[:, None]
        self.alone_s = float(travel[seeking, 0].max(initial=0.0))
        goal, _ = choose_goals(problem, least + parameters.allowance_mm)
        away = np.abs(crowd.option - goal[:, None]).max(axis=2)
        away[np.arange(crowd.option.shape[1]) >= crowd.options[:, None]] = np.inf
        choice = np.where(seeking, away.argmin(axis=1), -1)
        time = travel.max(axis=2)[np.arange(n), choice]
        choice[seeking & (time > self.alone_s)] = 0

        end = np.where(
            seeking[:, None], crowd.option[np.arange(n), np.maximum(choice, 0)], problem.start
        )
        q = np.zeros((len(crowd.movable), 2, steps + 1))
        q[:n] = problem.start[:, :, None] + (end - problem.start)[:, :, None] * (
            np.arange(steps + 1) / steps
        )
        q[:n, :, -1] = end
        pairs = len(crowd.pairs)
        self.draft = Draft(
            q, choice.astype(np.int64), np.zeros(pairs), np.ones(pairs), np.zeros(pairs),
            np.zeros((n, 2), dtype=np.int64),
        )  # fmt: skip
        if self.alone_s == 0.0:  # nobody has to move; leave time to get out of the way
            self.alone_s = float((0.1 / plane.speeds).max(initial=0.0))
        self._stretch_to(1.0)
        self._require()
        beside = crowd.pairs[~crowd.movable[crowd.pairs].all(axis=1)]
        self.walled = crowd.movable & np.isin(np.arange(len(crowd.movable)), beside)

    def _stretches(self, usual):
        # The makespans to try, in units of the time alone: at least long enough to fold,
        # go, and unfold, however short the way is.
        plane = self.problem.plane
        fold_s = float(
            (np.minimum(np.pi, np.diff(plane.limits[:, 1])[:, 0]) / plane.speeds[:, 1]).max(
                initial=0.0
            )
        )
        most = max(self.parameters.stretch, 1.0 + 2.0 * fold_s / max(self.alone_s, 1e-9))
        tried = [stretch for stretch in usual if stretch <= most] or [most]
        while tried[-1] * _LONGER <= most:
            tried.append(tried[-1] * _LONGER)
        return tried

    def _require(self):
        # What safety asks at full speed and the allowance on top; less where the start
        # or the chosen goals are closer than that. A pair that starts too close must not
        # come closer.
        problem, crowd, parameters = self.problem, self.crowd, self.parameters
        plane = problem.plane
        speed = np.vstack([plane.speeds, np.zeros((len(plane.obstacles), 2))]) * np.stack(
            [crowd.lever[:, 0] + crowd.lever[:, 1], crowd.lever[:, 1]], axis=1
        )
        late = parameters.clock_ppm * 1e-6 * self.makespan_s + parameters.start_skew_s
        least = parameters.margin_mm + late * speed.sum(axis=1)[crowd.pairs].sum(axis=1)
        self.at_start = gaps(plane, crowd.pairs, problem.start) - _EPS_MM
        at_goal = gaps(plane, crowd.pairs, self.draft.q[: plane.n, :, -1]) - _EPS_MM
        wanted = np.minimum(least + parameters.allowance_mm, np.minimum(self.at_start, at_goal))
        self.draft.required[:] = np.minimum(np.maximum(wanted, least), self.at_start)

    def _stretch_to(self, stretch):
        self.makespan_s = stretch * self.alone_s
        self.step_s = self.makespan_s / self.parameters.intervals

    def _fold_all(self):
        # Everybody who has far to go folds first and unfolds last, as fast as possible.
        crowd, draft = self.crowd, self.draft
        self.folding = _FOLDING
        draft.weight[:] = 1.0
        fold_first(crowd, draft, self.step_s)
        return measure(crowd, draft)

    # -- search

    def _repair(self, sweeps):
        conflicts, done, spent = repair(
            self.crowd, self.draft, self.step_s, self.folding, self.sweep, sweeps,
            _DRAWS[int(self.folding > 0.0)],
            self.limit - self.spent,
        )  # fmt: skip
        self.sweep += done
        self.spent += spent
        return conflicts

    def _certified_repair(self):
        # Repair, then have the certificate confirm it; pairs it does not confirm are
        # asked for a little more room.
        for _ in range(_CERTIFIED_AT_MOST):
            conflicts = self._repair(_SWEEPS[int(self.folding > 0.0)])
            if conflicts:
                return conflicts
            straighten(self.crowd, self.draft, self.step_s)
            short = self._short()
            if not short.any():
                return 0
            measure(self.crowd, self.draft)
            self.draft.depth[short] = np.maximum(self.draft.depth[short], _MORE_MM)
        return short.sum()

    def _short(self):
        # pairs the certificate does not confirm, those too close from the start left out
        certificate = certify(
            self.problem.plane,
            straight_pieces(self._motion()),
            self.parameters.safety,
            self.crowd.pairs,
        )
        short = certificate.unsafe & (self.at_start >= certificate.required_mm)
        missing = certificate.required_mm - certificate.gap_mm
        self.draft.required[short] += missing[short] + _MORE_MM
        return short

    # -- best effort

    def _give_up(self):
        for _ in range(_GIVE_UP_ROUNDS):
            self._free_the_worst(self.crowd.movable)
            self.limit = max(self.limit, self.spent + _LAST_EFFORT * len(self.crowd.start))
            if self._certified_repair() == 0:
                return
        self._freeze()

    def _restore(self):
        # Who was given up goes after all where that meets nobody and is certified.
        before = [np.copy(column) for column in self.draft]
        restored = restore(
            self.crowd, self.draft, self.step_s, self.folding,
            self.reason == Reason.NOT_CONVERGED, self.sweep, _RESTORE_DRAWS,
        )  # fmt: skip
        if restored and self._short().any():
            for column, old in zip(self.draft, before):
                column[...] = old

    def _free_the_worst(self, among):
        # Of every pair in conflict the robot with most of it may end anywhere, if it is
        # among those, shape (b,). Returns how many robots that are.
        crowd, draft = self.crowd, self.draft
        pressure = np.zeros(len(crowd.movable))
        bad = draft.depth > 0
        for side in range(2):
            np.add.at(pressure, crowd.pairs[bad, side], (draft.weight * draft.depth)[bad])
        seeking = among.copy()
        seeking[: len(draft.choice)] &= draft.choice >= 0
        pressure[~seeking] = -1.0
        pairs = crowd.pairs[bad]
        worse = np.where(pressure[pairs[:, 0]] >= pressure[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
        worse = np.unique(worse[seeking[worse]])
        draft.choice[worse] = -1
        self.reason[worse] = Reason.NOT_CONVERGED
        draft.weight[:] = 1.0
        return len(worse)

    def _freeze(self):
        # Robots still in conflict rest at their starts, and whoever then meets them too.
        crowd, draft = self.crowd, self.draft
        resting = ~crowd.movable
        while True:
            bad = draft.depth > 0 if measure(crowd, draft) else self._short()
            rows = np.unique(crowd.pairs[bad])
            rows = rows[~resting[rows]]
            if not len(rows):
                return
            resting[rows] = True
            draft.q[rows] = self.problem.start[rows][:, :, None]
            rows = rows[draft.choice[rows] >= 0]
            draft.choice[rows] = -1
            self.reason[rows] = Reason.NOT_CONVERGED

    # -- the result

    def _motion(self):
        n = self.problem.plane.n
        return SampledMotion(
            self.step_s * np.arange(self.parameters.intervals + 1), self.draft.q[:n]
        )

    def _finish(self):
        n = self.problem.plane.n
        arrived = self.draft.choice >= 0
        goal = np.where(arrived[:, None], self.draft.q[:n, :, -1], self.problem.start)
        self.reason[(self.reason == Reason.NOT_CONVERGED) & arrived] = Reason.OK
        return self._motion(), goal, self.reason

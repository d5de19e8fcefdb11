# SPDX-License-Identifier: Apache-2.0
"""The order in which robots are discretized: each has the space that the others leave.

The paper gives each of two neighbours half of the space between them, though most robots
need none: a straight line is enough. So all robots begin with straight lines. A robot that
comes too close to a neighbour on its straight line follows its trajectory instead, and so do
the robots that are in the way of these trajectories, until the motion is as safe as the
trajectories are. From there robots are discretized one after another, never two neighbours at
a time. Each selects the fewest segments that are proven safe with the present motion of all
others: straight lines, one joint around what is in its way, both joints along the trajectory.
A robot that is in no conflict stays so; the order decides which of two robots bends.
"""

import numpy as np

from fiber_core.array_types import Codes, Counts, Mask, Rows
from fiber_core.clearance import Safety, hold_until_safe
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.motors import motors_broken
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.options import DiscretizeOptions, ProgressCallback
from fiber_discretizer.sequential.candidates import Candidates
from fiber_discretizer.sequential.segment_plan import SegmentPlan
from fiber_discretizer.sequential.selection import Selection

__all__ = ["discretize_sequentially"]

_LATER_TICKS = 20  # how much longer than planned rounding makes a motion
_WAITING_MM = 0.002  # width within which a robot traces its trajectory until it is discretized
_TRACES_MM = (0.02, 0.004, 0.001)  # widths of traces for a robot without a better motion
_SLACKS_RAD = (0.25, 0.05, 0.01)  # shifts of the lines of a trajectory by rounding, widest first
_SIDES = (1, -1)
_MANY = 3  # segments of one joint; a robot with more tries other motions
# When a robot without a short motion can turn theta and phi: as soon as possible, as slowly
# as possible, or as late as possible.
_FAST, _SLOW, _LATE = range(3)
_TIMINGS = (
    (_SLOW, _FAST), (_FAST, _SLOW), (_FAST, _FAST), (_LATE, _FAST), (_FAST, _LATE),
    (_SLOW, _SLOW), (_LATE, _SLOW), (_SLOW, _LATE), (_LATE, _LATE),
)  # fmt: skip
_DETOURS = ((1, 1), (0, -1), (0, 1), (1, -1))  # joint that bends and the side it passes


def discretize_sequentially(
    plane: FocalPlane,
    trajectory: SampledMotion,
    start_counts: Counts,
    units: WireUnits,
    safety: Safety,
    options: DiscretizeOptions,
    reason: Codes,
    progress: ProgressCallback,
) -> tuple[WireMotion, Codes, int]:
    """Return the orders of all robots, robot after robot with the space that the others leave.

    Args:
        plane, trajectory, start_counts, units, safety, options, progress: as for discretize;
            robots that are held already rest in the trajectory.
        reason: Reason of each robot so far, shape (n,).

    Returns:
        The orders; the Reason of each robot, with those held here, shape (n,); and how often
        robots without a safe motion were tried again.
    """
    reason = reason.copy()
    makespan_s = trajectory.time_s[-1] + _LATER_TICKS * units.tick_s
    plan = SegmentPlan(plane, units, start_counts, safety, makespan_s)
    candidates = Candidates(plan, start_counts, trajectory, options)
    rounds = _fill(plan, candidates, safety, options, progress)
    idle = np.flatnonzero(candidates.moving_joints.astype(bool) & ~plan.motion.moves)
    reason[idle] = Reason.UNSAFE
    reason[candidates.too_many_segments(idle)] = Reason.TOO_MANY_SEGMENTS
    return WireMotion.nearest(plan.motion, units), reason, rounds


def _fill(
    plan: SegmentPlan,
    candidates: Candidates,
    safety: Safety,
    options: DiscretizeOptions,
    progress: ProgressCallback,
) -> int:
    # Fill a plan with the fewest segments found for all robots that can be moved safely; the
    # others rest. Returns how often robots without a safe motion were tried again.
    search = _Search(plan, candidates, options, progress)
    search.begin_straight()
    remaining = ~plan.is_rounded | (plan.in_conflict & candidates.moves)
    search.begin_step(0.2, 0.5, f"discretizing {remaining.sum()} robots one after another")
    search.improve(remaining)
    unsolved = candidates.moves & ~plan.is_rounded
    if unsolved.any():
        search.improve(unsolved)
    plan.rest(~plan.is_rounded)
    rounds = 0
    while rounds < options.rounds:
        remaining = search.idle | (plan.in_conflict & candidates.moves)
        if not remaining.any():
            break
        done = rounds / options.rounds
        fraction = 0.5 + 0.3 * done
        search.begin_step(fraction, fraction, f"trying {remaining.sum()} robots again")
        changed = search.improve(remaining)
        _, held, _ = hold_until_safe(plan.plane, plan.motion, safety, plan.pairs)
        plan.rest(held)
        rounds += 1
        if not (changed or held.any()):
            break
    search.begin_step(0.8, 0.8, "shortening the orders")
    search.follow_trajectories()
    search.improve(plan.motion.counts.max(axis=1) > _MANY)
    search.shorten_longest()
    return rounds


class _Search:
    # Local search over a SegmentPlan: each step replaces the segments of some robots.

    def __init__(
        self,
        plan: SegmentPlan,
        candidates: Candidates,
        options: DiscretizeOptions,
        progress: ProgressCallback,
    ):
        self.plan, self.candidates, self.options = plan, candidates, options
        self._progress, self._step, self._done = progress, (0.0, 0.0, ""), 0.0
        self.moving_joints = candidates.moving_joints
        self.enough = self.moving_joints + 2
        # A robot without a short motion may take as long as its trajectory, and longer than
        # all other robots need alone.
        slowest = 1.5 * candidates.fastest_s.max(initial=0.0)
        self.horizon_s = min(candidates.time_s[-1], slowest)

    @property
    def idle(self) -> Mask:
        """Robots that rest though they are to move, shape (n,)."""
        return (self.moving_joints > 0) & ~self.plan.motion.moves

    def begin_step(self, begin: float, end: float, text: str) -> None:
        """Begin a step that lasts from one fraction of the work to another; report it."""
        self._step, self._done = (begin, end, text), max(self._done, begin)
        self._progress(self._done, text)

    def _report(self, part: float) -> None:
        # that a part of the step is done; the callback may end the work
        begin, end, text = self._step
        self._done = max(self._done, begin + part * (end - begin))
        self._progress(self._done, text)

    def begin_straight(self) -> None:
        # straight lines, and the trajectory for each robot that they bring into conflict, or whose
        # coupled motors cannot follow them
        plan, moves = self.plan, self.candidates.moves
        rows = np.flatnonzero(moves)
        plan.assign(rows, self.candidates.straight(rows))
        conflicting = (plan.in_conflict | motors_broken(plan.plane, plan.motion)) & moves
        while conflicting.any():
            rows = np.flatnonzero(conflicting)
            plan.assign(rows, self.candidates.traced(rows, _WAITING_MM), is_rounded=False)
            conflicting = plan.in_conflict & plan.is_rounded & moves

    def improve(self, robots: Mask) -> int:
        # Let some robots select anew, no two neighbours at a time; returns how many changed.
        # Robots with few conflicts come first: they go straight, and a robot with many
        # conflicts bends once.
        plan, n = self.plan, self.plan.plane.n
        conflicts = np.bincount(plan.pairs[plan.unsafe].ravel(), minlength=n)[:n]
        rank = conflicts * n + np.arange(n)
        pairs = plan.pairs[(plan.pairs < n).all(axis=1)]
        remaining, changed = robots.copy(), 0
        while remaining.any():
            a, b = pairs[remaining[pairs].all(axis=1)].T
            later = np.zeros(n, dtype=bool)
            later[np.where(rank[a] > rank[b], a, b)] = True
            rows = np.flatnonzero(remaining & ~later)
            changed += self._select(rows)
            remaining[rows] = False
            self._report(1.0 - float(remaining.sum() / max(robots.sum(), 1)))
        return changed

    def follow_trajectories(self) -> None:
        # A robot without a safe motion among the present ones follows its trajectory, the robots
        # then in its way follow theirs, and so on: where all trajectories together are safe,
        # this succeeds.
        plan, candidates = self.plan, self.candidates
        for row in np.flatnonzero(self.idle):
            before, following = plan.snapshot(), np.zeros(plan.plane.n, dtype=bool)
            conflicting = np.array([row])
            while len(conflicting):
                following[conflicting] = True
                traces = candidates.traced_rounded(conflicting, _TRACES_MM[0])
                plan.assign(conflicting, traces)
                conflicting = np.flatnonzero(plan.in_conflict & candidates.moves & ~following)
            too_many = plan.motion.counts[following].max() > self.options.max_segments
            too_many |= motors_broken(plan.plane, plan.motion).any()
            if too_many or (plan.unsafe & ~before.unsafe).any():
                plan.restore(before)
            else:
                self.improve(following)

    def shorten_longest(self) -> None:
        # A robot that still has many segments follows its trajectory, and the robots then in
        # its way select anew. Where one of them gets many segments or is in conflict, the
        # plan is restored.
        plan, candidates = self.plan, self.candidates
        for row in np.flatnonzero(plan.motion.counts.max(axis=1) > _MANY):
            trace = candidates.traced_rounded(np.array([row]), _TRACES_MM[0])
            if trace.counts.max() > _MANY or motors_broken(plan.plane, trace, [row]).any():
                continue
            before = plan.snapshot()
            plan.assign(np.array([row]), trace)
            conflicting = plan.in_conflict & candidates.moves
            conflicting[row] = False
            self.improve(conflicting)
            too_many = plan.motion.counts[conflicting].max(initial=0) > _MANY
            if too_many or (plan.unsafe & ~before.unsafe).any():
                plan.restore(before)

    def _select(self, rows: Rows) -> int:
        # Let robots, no two of them neighbours, select a motion; returns how many changed.
        plan, candidates, options = self.plan, self.candidates, self.options
        selection = Selection(
            plan, rows, self.idle[rows], options.allowance_mm, options.max_segments
        )
        required_mm = selection.required_mm
        one_more = self.moving_joints[rows] + 1
        selection.evaluate(np.arange(len(rows)), candidates.straight(rows))
        self._evaluate_planned(selection)
        for joint in (1, 0):
            for side in _SIDES:
                if len(which := selection.longer_than(one_more)):
                    bent = candidates.bent(rows[which], plan.motion, required_mm, joint, side)
                    selection.evaluate(which, *bent)
        # the other order of the joints has fewer segments in one of a hundred robots
        which = selection.longer_than(one_more)
        for joint in (options.first_joint, 1 - options.first_joint):
            if len(which):
                along = candidates.along_trajectory(rows[which], plan.motion, required_mm, joint)
                selection.evaluate(which, *along)
            which = selection.unsolved()
        if len(selection.longer_than(self.enough[rows])):
            self._evaluate_timings(selection)
        for width in _TRACES_MM:
            if len(which := selection.unsolved()):
                selection.evaluate(which, candidates.traced_rounded(rows[which], width))
        return len(selection.commit())

    def _evaluate_planned(self, selection: Selection) -> None:
        # the lines of the trajectory; the wider the shift that is allowed, the fewer segments
        candidates = self.candidates
        which = selection.longer_than(self.moving_joints[selection.rows])
        lines = candidates.planned_lines(selection.rows[which], _TRACES_MM[0])
        segments = np.full(len(selection.rows), np.inf)
        segments[which] = np.maximum(lines.counts - 1, 0).reshape(-1, 2).sum(axis=1)
        for slack_rad in _SLACKS_RAD:
            left = np.flatnonzero(np.isin(which, selection.longer_than(segments)))
            if len(left):
                at = (2 * left[:, None] + np.arange(2)).ravel()
                rows = selection.rows[which[left]]
                selection.evaluate(which[left], candidates.rounded(rows, lines.of(at), slack_rad))

    def _evaluate_timings(self, selection: Selection) -> None:
        # straight lines and detours at other times than planned
        plan, candidates, rows = self.plan, self.candidates, selection.rows
        enough = self.enough[rows]
        fastest = candidates.fastest_s[rows]
        as_planned = candidates.arrival_s[rows].max(axis=1)[:, None]
        end = np.maximum(np.maximum(self.horizon_s, as_planned), fastest)
        spans = np.stack([[0 * end, fastest], [0 * end, end], [end - fastest, end]])
        # shape (m, 2, 3, 2): robot, joint, fast, slow or late, (begin, end)
        spans = spans.transpose(2, 3, 0, 1)
        for theta, phi in _TIMINGS:
            if len(which := selection.longer_than(enough)):
                windows = spans[which][:, [0, 1], [theta, phi]]
                selection.evaluate(which, candidates.straight(rows[which], windows))
        if plan.plane.coupling.shape[1]:
            return  # a joint that turns at another time than planned is too fast for the motors
        for joint, side in _DETOURS:
            for timing in (_FAST, _LATE):
                if len(which := selection.longer_than(enough)):
                    windows = spans[which][:, :, _SLOW].copy()
                    windows[:, 1 - joint] = spans[which][:, 1 - joint, timing]
                    bent = candidates.bent(
                        rows[which], plan.motion, selection.required_mm, joint, side, windows
                    )
                    selection.evaluate(which, *bent)

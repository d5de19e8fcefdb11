"""Robots take turns: each has all the space that the others leave at that moment.

The paper gives each of two neighbours half of the space between them, though most robots
need none of it: a straight line does. So everybody begins with straight lines. Who then
comes too close to somebody goes back to the plan, and whoever is in the way of these plans
with them, until what remains is as safe as the plan. From there robots take turns, no two
neighbours at a time. Each chooses the fewest segments that are proven safe beside all
others as they are then: straight lines, one motor around what is in its way, both motors
along the plan. Whoever is not in conflict stays so; the order decides who bends.
"""

from collections.abc import Callable

import numpy as np

from fiber_core.clearance import Safety, hold_until_safe
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.sequential.candidates import Candidates
from fiber_discretizer.sequential.segment_plan import Draft
from fiber_discretizer.sequential.selection import Choice

__all__ = ["take_turns"]

_PLAN_MM = 0.002  # how closely the plan is followed by who waits for its turn
_FINE_MM = (0.02, 0.004, 0.001)  # and by who finds nothing better
_SIDES = (1, -1)
_MANY = 3  # who has more segments of a motor looks once more for something else
# When a robot that is stuck may turn theta and phi: as soon as possible, as slowly as
# possible, or as late as possible.
_FAST, _SLOW, _LATE = range(3)
_TIMINGS = (
    (_SLOW, _FAST), (_FAST, _SLOW), (_FAST, _FAST), (_LATE, _FAST), (_FAST, _LATE),
    (_SLOW, _SLOW), (_LATE, _SLOW), (_SLOW, _LATE), (_LATE, _LATE),
)  # fmt: skip
_DETOURS = ((1, 1), (0, -1), (0, 1), (1, -1))  # joint that bends and the side it passes


def take_turns(
    draft: Draft,
    candidates: Candidates,
    safety: Safety,
    options: DiscretizeOptions,
    progress: Callable[[float, str], None],
) -> int:
    """Fill a draft: the fewest segments found for all that can be moved safely, rest for others.

    Args:
        draft: segments of everybody; those of robots that are to move are replaced.
        candidates: what is asked, and what can be chosen from.
        safety: gap asked for and timing errors to survive.
        options: how it is done.
        progress: told now and then the part of the work done (0..1) and a few words.

    Returns:
        How often robots that had no safe motion were done again.
    """
    table = _Turns(draft, candidates, options)
    table.begin()
    todo = ~draft.settled | (draft.in_conflict & candidates.moves)
    progress(0.2, f"{todo.sum()} robots take turns")
    table.sweep(todo)
    stuck = candidates.moves & ~draft.settled
    if stuck.any():
        table.sweep(stuck)
    draft.rest(~draft.settled)
    done = 0
    while done < options.rounds:
        todo = table.idle | (draft.in_conflict & candidates.moves)
        if not todo.any():
            break
        progress(0.5 + 0.3 * done / options.rounds, f"{todo.sum()} robots are done again")
        taken = table.sweep(todo)
        _, held, _ = hold_until_safe(draft.plane, draft.motion, safety, draft.pairs)
        draft.rest(held)
        done += 1
        if not (taken or held.any()):
            break
    table.rescue()
    table.sweep(draft.counts().max(axis=1) > _MANY)
    table.make_room()
    return done


class _Turns:
    def __init__(self, draft, candidates, options):
        self.draft, self.candidates, self.options = draft, candidates, options
        self.motors = candidates.motors
        self.enough = self.motors + 2
        # Who is stuck may take as long as its plan, and longer than all others need alone.
        slowest = 1.5 * candidates.fastest_s.max(initial=0.0)
        self.horizon_s = min(candidates.time_s[-1], slowest)

    @property
    def idle(self):
        """Robots that rest though they are to move, shape (n,)."""
        return (self.motors > 0) & ~self.draft.counts().any(axis=1)

    def begin(self):
        # straight lines, and the plan for whoever they bring too close to somebody
        draft, moves = self.draft, self.candidates.moves
        rows = np.flatnonzero(moves)
        draft.give(rows, self.candidates.straight(rows))
        fresh = draft.in_conflict & moves
        while fresh.any():
            rows = np.flatnonzero(fresh)
            draft.give(rows, self.candidates.planned(rows, _PLAN_MM), settled=False)
            fresh = draft.in_conflict & draft.settled & moves

    def sweep(self, todo):
        # Robots in few conflicts come first: they go straight, and who is in many bends once.
        draft, n = self.draft, self.draft.plane.n
        conflicts = np.bincount(draft.pairs[draft.unsafe].ravel(), minlength=n)[:n]
        rank = conflicts * n + np.arange(n)
        pairs = draft.pairs[(draft.pairs < n).all(axis=1)]
        todo, taken = todo.copy(), 0
        while todo.any():
            a, b = pairs[todo[pairs].all(axis=1)].T
            later = np.zeros(n, dtype=bool)
            later[np.where(rank[a] > rank[b], a, b)] = True
            rows = np.flatnonzero(todo & ~later)
            taken += self._turn(rows)
            todo[rows] = False
        return taken

    def rescue(self):
        # Whoever found nothing beside what the others chose goes by its plan, those then in
        # its way by theirs, and so on: where all plans together are safe this ends well.
        draft, candidates = self.draft, self.candidates
        for row in np.flatnonzero(self.idle):
            before, planned = draft.snapshot(), np.zeros(draft.plane.n, dtype=bool)
            fresh = np.array([row])
            while len(fresh):
                planned[fresh] = True
                draft.give(fresh, candidates.rounded_plan(fresh, _FINE_MM[0]))
                fresh = np.flatnonzero(draft.in_conflict & candidates.moves & ~planned)
            crowded = draft.counts()[planned].max() > self.options.max_segments
            if crowded or (draft.unsafe & ~before.unsafe).any():
                draft.go_back(before)
            else:
                self.sweep(planned)

    def make_room(self):
        # Whoever still has many segments goes by its plan, and those then in its way choose
        # anew beside it. Where one of them ends up with many or in conflict, all is as before.
        draft, candidates = self.draft, self.candidates
        many = np.flatnonzero(draft.counts().max(axis=1) > _MANY)
        for row in many:
            plan = candidates.rounded_plan(np.array([row]), _FINE_MM[0])
            if plan.counts.max() > _MANY:
                continue
            before = draft.snapshot()
            draft.give(np.array([row]), plan)
            beside = draft.in_conflict & candidates.moves
            beside[row] = False
            self.sweep(beside)
            crowded = draft.counts()[beside].max(initial=0) > _MANY
            if crowded or (draft.unsafe & ~before.unsafe).any():
                draft.go_back(before)

    def _turn(self, rows):
        draft, candidates, options = self.draft, self.candidates, self.options
        choice = Choice(draft, rows, self.idle[rows], options.allowance_mm, options.max_segments)
        one_more = self.motors[rows] + 1
        choice.consider(np.arange(len(rows)), candidates.straight(rows))
        for joint in (1, 0):
            for side in _SIDES:
                if len(which := choice.longer_than(one_more)):
                    bent = candidates.bent(
                        rows[which], draft.profiles, choice.asked_mm, joint, side
                    )
                    choice.consider(which, *bent)
        for joint in (options.first_joint, 1 - options.first_joint):
            if len(which := choice.longer_than(one_more)):
                along = candidates.along_plan(rows[which], draft.profiles, choice.asked_mm, joint)
                choice.consider(which, *along)
        if len(which := choice.longer_than(self.enough[rows])):
            self._other_times(choice)
        for width in _FINE_MM:
            if len(which := choice.without()):
                choice.consider(which, candidates.rounded_plan(rows[which], width))
        return len(choice.settle())

    def _other_times(self, choice):
        draft, candidates, rows = self.draft, self.candidates, choice.rows
        enough = self.enough[rows]
        fastest = candidates.fastest_s[rows]
        as_planned = candidates.arrival_s[rows].max(axis=1)[:, None]
        end = np.maximum(np.maximum(self.horizon_s, as_planned), fastest)
        spans = np.stack([[0 * end, fastest], [0 * end, end], [end - fastest, end]])
        # shape (m, 2, 3, 2): robot, joint, fast, slow or late, (begin, end)
        spans = spans.transpose(2, 3, 0, 1)
        for theta, phi in _TIMINGS:
            if len(which := choice.longer_than(enough)):
                windows = spans[which][:, [0, 1], [theta, phi]]
                choice.consider(which, candidates.straight(rows[which], windows))
        for joint, side in _DETOURS:
            for timing in (_FAST, _LATE):
                if len(which := choice.longer_than(enough)):
                    windows = spans[which][:, :, _SLOW].copy()
                    windows[:, 1 - joint] = spans[which][:, 1 - joint, timing]
                    bent = candidates.bent(
                        rows[which], draft.profiles, choice.asked_mm, joint, side, windows
                    )
                    choice.consider(which, *bent)

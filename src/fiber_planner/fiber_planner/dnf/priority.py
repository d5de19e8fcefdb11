# SPDX-License-Identifier: Apache-2.0
"""Priorities between robots that block each other: they resolve the deadlocks of the control law.

Two robots that push against each other with equal strength stand still for ever. Tao et
al. (SPIE 2018) give the robots of MOONS priorities and a small state machine: a robot that
would block a more important one has its attraction switched off. Here priorities are used
only for robots that are blocked, and are handed on: a robot that gives way inherits the rank
of the one it gives way to, so that the robots behind it make way in turn, and a robot that
claims the way without success falls back (priority inheritance with backtracking, Okumura et
al., IJCAI 2019).

    FREE      follows the control law; all ranks are equal.
              stands still for patience_s: -> CLAIMING
    CLAIMING  has a rank and ignores neighbours of lower rank, so it moves on against them; a
              neighbour that shortens its step and has lower standing is called to give way.
              at its goal: -> FREE; still stands still for yield_s: -> YIELDING, without rank
    YIELDING  folds its arm, then turns it, folded, towards its goal. A neighbour that
              shortens its step is called in turn, with the rank of this robot.
              yield_s after the last call: -> FREE, or WAITING if it has a wait
    WAITING   makes way before it is called, from the start on, because a rehearsal showed that
              it would be (rehearsal.py): it folds its arm and then turns it, folded, towards
              its goal, or stays at its start. It has no rank.
              its wait is over: -> FREE

Standing is a total order: more often given way, then the longer way from start to goal, then
the place. So robots give way only to a better standing, and their own improves each time. A
robot that falls back frees a neighbour that it has cornered. Claims are limited: a robot that
has used up its claims follows the plain control law, and the plan ends when every robot has
arrived, or has no claim left and stands still.

Neither the control law nor the rule of steps (tip_repulsion.py, arm_repulsion.py) knows of
states: their proofs hold whatever the states are. A robot uses only its neighbours' state, and
all decide at once from the step before, so the plan does not depend on the order of the rows.
"""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.array_types import Angles, Floats, Ints, Mask, Pairs
from fiber_planner.dnf.navigation_function import Swarm

__all__ = ["CLAIMING", "FREE", "WAITING", "YIELDING", "NoPriorities", "Priorities", "Run", "Waits",
           "folded_phi"]  # fmt: skip

FREE, CLAIMING, YIELDING, WAITING = 0, 1, 2, 3

_HINDERED = 0.5  # a step shortened to less than this fraction is hindered
_STILL = 1e-4  # of the speed limits: if no robot is faster, no robot will move any more
_SLOW = 0.5  # a robot that makes less than this part of the way it could make stands still


class Waits(NamedTuple):
    """How long each robot makes way from the start on, before any neighbour calls it.

    Args:
        until_s: end of the wait [s], shape (n,); 0 for none.
        at_start: whether the robot waits at its start, else folded, shape (n,).
    """

    until_s: Floats
    at_start: Mask

    @classmethod
    def none(cls, n: int) -> "Waits":
        """Return the waits of n robots that all set out at once."""
        return cls(np.zeros(n), np.zeros(n, dtype=bool))


class Run(NamedTuple):
    """What a run showed, for the next rehearsal.

    Args:
        waits: the waits of the run.
        arrived_s: since when each robot is at its goal [s], shape (n,); inf: it is not.
        called_s: first call to each robot outside its wait [s], shape (n,); inf if none.
        calls_s: first call by each robot [s], shape (n,); inf if none.
        pairs: rows of callers and of the robots that they called, shape (k, 2).
    """

    waits: Waits
    arrived_s: Floats
    called_s: Floats
    calls_s: Floats
    pairs: Pairs

    @property
    def score(self) -> tuple[int, float]:
        """Robots that do not arrive, and the last arrival of the others [s]; less is better."""
        there = np.isfinite(self.arrived_s)
        return int((~there).sum()), float(self.arrived_s[there].max(initial=0.0))


def folded_phi(swarm: Swarm) -> Floats:
    """Return the angle of phi at which each arm is folded farthest [rad], shape (n,)."""
    low, high = swarm.low[:, 1], swarm.high[:, 1]
    folds = np.stack([np.clip(np.pi, low, high), np.clip(-np.pi, low, high)])
    flattest = np.abs(np.abs(folds) - np.pi).argmin(axis=0)
    return folds[flattest, np.arange(len(low))]


class NoPriorities:
    """All robots are equal, as in the papers.

    Args:
        swarm: the robots.
        dt: time step [s].
    """

    def __init__(self, swarm: Swarm, dt: float):
        self.ranks = np.zeros(len(swarm.goal))
        self.aim = swarm.goal
        self._slowest = _STILL * dt * swarm.speed

    def update(self, before: Angles, after: Angles, fraction: Floats, blocker: Ints) -> bool:
        """Return whether a step was the last one: no robot moves any more.

        Args:
            before: joint angles before the step [rad], shape (n, 2).
            after: joint angles after it [rad], shape (n, 2).
            fraction: fraction of its step that each robot made, shape (n,); not used.
            blocker: row that limited each step, shape (n,); not used.
        """
        return bool((np.abs(after - before) <= self._slowest).all())


class Priorities:
    """The state of every robot, its rank and the angles that it aims at, step by step.

    Args:
        swarm: the robots, with the goals that they shall end at.
        start: joint angles at the start [rad], shape (n, 2).
        alone_s: time that each robot needs from start to goal if it is alone [s],
            shape (n,); robots that need no time make way for all and claim nothing.
        dt: time step [s].
        patience_s: time that a robot stands still before it claims the way [s].
        yield_s: time that it gives way after a call, and that it claims the way without
            success [s].
        claims: how often a robot may claim the way.
        waits: how long each robot makes way from the start on; None for not at all.
    """

    def __init__(
        self,
        swarm: Swarm,
        start: Angles,
        alone_s: Floats,
        dt: float,
        patience_s: float,
        yield_s: float,
        claims: int,
        waits: Waits | None = None,
    ):
        n = len(alone_s)
        self._swarm, self._start, self._times = swarm, start, (dt, patience_s, yield_s)
        self._waits = Waits.none(n) if waits is None else waits
        self._time_s = 0.0
        self.state = np.where(self._waits.until_s > 0.0, WAITING, FREE)
        self.ranks = np.zeros(n)  # 0, or the standing of the robot that the claim was made for
        self.aim = np.array(swarm.goal)
        self._standing = np.empty(n)
        self._standing[np.lexsort((*swarm.center.T, alone_s))] = np.arange(1.0, n + 1.0)
        self._standing[alone_s == 0.0] = 0.0
        self._claims = np.where(alone_s > 0.0, claims, 0)
        self._still, self._left = np.zeros(n), np.zeros(n)  # [s]
        self._folded = folded_phi(swarm)
        _aim_waiting(0.0, yield_s, start, start, self._folded, self.state, self.aim, self._waits)
        self._called_s, self._calls_s = np.full(n, np.inf), np.full(n, np.inf)
        self._arrived_s = np.where(swarm.movable, np.inf, 0.0)
        self._pairs: list[Pairs] = [np.zeros((0, 2), dtype=np.int64)]

    def shown(self) -> Run:
        """Return what the run up to now showed: arrivals, and the calls of all robots."""
        pairs = np.unique(np.concatenate(self._pairs), axis=0)
        return Run(self._waits, self._arrived_s, self._called_s, self._calls_s, pairs)

    def update(self, before: Angles, after: Angles, fraction: Floats, blocker: Ints) -> bool:
        """Update states, ranks and aims after a step; return whether it was the last one.

        Args:
            before: joint angles before the step [rad], shape (n, 2).
            after: joint angles after it [rad], shape (n, 2).
            fraction: fraction of its step that each robot made, shape (n,).
            blocker: row that limited each step, -1 if none did, shape (n,).
        """
        called, calls = _calls(
            self.ranks, self.state, self._standing, self._swarm.movable, fraction, blocker
        )
        self._note(called, calls, blocker)
        dt, patience_s, yield_s = self._times
        self._time_s += dt
        last = _update_states(
            before, after, called, self._swarm, self._folded, self.state, self.ranks, self.aim,
            self._standing, self._claims, self._still, self._left, self._arrived_s,
            self._waits, self._time_s, dt, patience_s, yield_s,
        )  # fmt: skip
        _aim_waiting(
            self._time_s, yield_s, after, self._start, self._folded, self.state, self.aim,
            self._waits,
        )  # fmt: skip
        return last

    def _note(self, called: Floats, calls: Mask, blocker: Ints) -> None:
        callers = np.flatnonzero(calls)
        if len(callers):
            self._pairs.append(np.stack([callers, blocker[callers]], axis=1))
        self._calls_s[callers] = np.minimum(self._calls_s[callers], self._time_s)
        again = (called > 0.0) & (self._time_s >= self._waits.until_s)
        self._called_s[again] = np.minimum(self._called_s[again], self._time_s)


@nb.njit(cache=True)
def _calls(ranks, state, standing, movable, fraction, blocker):
    # The rank with which each robot is called to give way, just below that of the caller, 0 if
    # it is not called; and whether each robot calls its blocker.
    n = len(ranks)
    called, calls = np.zeros(n), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        j = blocker[i]
        if ranks[i] == 0.0 or fraction[i] >= _HINDERED or j < 0 or j >= n or not movable[j]:
            continue
        # a robot without a claim does not give way to lower standing either
        giving_way = state[j] == YIELDING or state[j] == WAITING
        own = ranks[j] if giving_way else max(ranks[j], standing[j])
        if own < ranks[i]:
            called[j], calls[i] = max(called[j], np.nextafter(ranks[i], 0.0)), True
    return called, calls


@nb.njit(cache=True)
def _update_states(
    before, after, called, swarm, folded, state, ranks, aim,
    standing, claims, still, left, arrived, waits, time_s, dt, patience_s, yield_s,
):  # fmt: skip
    n, last = len(state), True
    for i in range(n):
        if not swarm.movable[i]:
            continue
        was, now = _time_to_goal(before[i], swarm, i), _time_to_goal(after[i], swarm, i)
        arrived[i] = min(arrived[i], time_s) if now == 0.0 else np.inf
        # grows as time passes for a robot that does not move, and falls for one that makes
        # more than _SLOW of the way it could make
        still[i] = max(0.0, still[i] + dt - (was - now) / _SLOW)
        if now == 0.0 or state[i] == YIELDING or state[i] == WAITING:
            still[i] = 0.0
        waits_on = time_s < waits.until_s[i]
        if called[i] > 0.0:
            state[i], ranks[i], left[i] = YIELDING, called[i], yield_s
        elif state[i] == YIELDING or state[i] == WAITING:
            left[i] -= dt
            if left[i] <= 0.0 and waits_on:
                state[i], ranks[i] = WAITING, 0.0
            elif left[i] <= 0.0:
                state[i], ranks[i] = FREE, 0.0
                standing[i] += n if standing[i] > 0.0 else 0.0
        elif now == 0.0:
            state[i], ranks[i] = FREE, 0.0
        elif state[i] == FREE and still[i] > patience_s and claims[i] > 0:
            state[i], ranks[i], still[i] = CLAIMING, standing[i], 0.0
            claims[i] -= 1
        elif state[i] == CLAIMING and still[i] > yield_s:
            state[i], ranks[i], left[i] = YIELDING, 0.0, yield_s
        aim[i] = swarm.goal[i]
        if state[i] == YIELDING:
            aim[i, 1] = folded[i]
            if left[i] > 0.5 * yield_s:
                aim[i, 0] = after[i, 0]
        given_up = state[i] == FREE and claims[i] == 0 and still[i] > yield_s
        last &= now == 0.0 or given_up
    return last


@nb.njit(cache=True)
def _aim_waiting(time_s, yield_s, angles, start, folded, state, aim, waits):
    # the angles that robots aim at while they wait: the first ones fold before they turn
    for i in range(len(state)):
        if state[i] != WAITING:
            continue
        if waits.at_start[i]:
            aim[i] = start[i]
        else:
            aim[i, 1] = folded[i]
            if time_s < 0.5 * yield_s:
                aim[i, 0] = angles[i, 0]


@nb.njit(cache=True)
def _time_to_goal(angles, swarm, i):
    # time that robot i needs to its goal if it is alone [s]
    theta = abs(angles[0] - swarm.goal[i, 0]) / swarm.speed[i, 0]
    return max(theta, abs(angles[1] - swarm.goal[i, 1]) / swarm.speed[i, 1])

"""Who goes first where robots block each other: the cure of the law's deadlocks.

Two robots that press against each other with equal strength stand still for ever. Tao et
al. (SPIE 2018) give the robots of MOONS priorities and a small state machine: who would
block a more important one has its attraction switched off. Here priorities are only used
where somebody is blocked, and are handed on: who gives way inherits the rank of the one
it gives way to, so that those behind it make room in turn, and who presses on in vain
falls back (priority inheritance with backtracking, Okumura et al., IJCAI 2019).

    FREE      follows the law; all are equal.
              stands still for patience_s: -> GOING
    GOING     has a rank and does not feel those of lower rank, so it presses on; whoever
              shortens its step and is of lower standing is called to give way.
              home: -> FREE; stands still for yield_s even so: -> YIELDING, without rank
    YIELDING  folds its arm, then turns it, folded, towards its goal. Whoever shortens its
              step is called in turn, for its rank.
              yield_s after the last call: -> FREE

Standing is a total order: who has given way more often, then who has the longer way from
start to goal, then the place. So robots give way to better standing only, and with each
time their own improves. Who falls back lets out a robot that it has cornered. Claims are
limited: who has used up its own follows the plain law, and the plan ends when everybody
is home, or has no claim left and stands still.

Neither the law nor the rule of steps (tips.py, arms.py) knows about states: what is proved
there holds whatever the states are. A robot looks at its neighbours only, and all decide
at once from the step before, so neither the order nor the numbers of the robots matter.
"""

import numba as nb
import numpy as np

from fiber_planner.dnf.navigation_function import Swarm

__all__ = ["FREE", "GOING", "YIELDING", "Equals", "Priorities"]

FREE, GOING, YIELDING = 0, 1, 2

_HINDERED = 0.5  # a step shortened to less than this part is hindered
_STILL = 1e-4  # of the speed limits: where nobody is faster, nothing more will happen
_SLOW = 0.5  # who makes less than this part of the way it could stands still


class Equals:
    """Nobody goes first, as in the papers.

    Args:
        swarm: the Swarm.
        dt: time step [s].
    """

    def __init__(self, swarm: Swarm, dt):
        self.ranks = np.zeros(len(swarm.goal))
        self.aim = swarm.goal
        self._slowest = _STILL * dt * swarm.speed

    def watch(self, before, after, part, hinderer):
        """Return whether a step was the last: nobody moves any more.

        Args:
            before: joint angles before the step [rad], shape (n, 2).
            after: joint angles after it [rad], shape (n, 2).
            part: which part of its turn each robot made, shape (n,); not used.
            hinderer: who left it no more, shape (n,); not used.
        """
        return bool((np.abs(after - before) <= self._slowest).all())


class Priorities:
    """The state of every robot, its rank and what it aims at, step by step.

    Args:
        swarm: the Swarm, its goal where each robot shall end.
        alone_s: how long each robot needs from start to goal if it is alone [s],
            shape (n,); those that need no time make way for all and claim nothing.
        dt: time step [s].
        patience_s: how long a robot stands still before it claims the way [s].
        yield_s: how long it gives way after a call, and how long it presses on [s].
        claims: how often a robot may claim the way.
    """

    def __init__(self, swarm: Swarm, alone_s, dt, patience_s, yield_s, claims):
        n = len(alone_s)
        self._swarm, self._times = swarm, (dt, patience_s, yield_s)
        self.state = np.full(n, FREE)
        self.ranks = np.zeros(n)  # 0 or standing of the one a robot goes or yields for
        self.aim = np.array(swarm.goal)
        self._standing = np.empty(n)
        self._standing[np.lexsort((*swarm.center.T, alone_s))] = np.arange(1.0, n + 1.0)
        self._standing[alone_s == 0.0] = 0.0
        self._claims = np.where(alone_s > 0.0, claims, 0)
        self._still, self._left = np.zeros(n), np.zeros(n)  # [s]
        low, high = swarm.low[:, 1], swarm.high[:, 1]
        folds = np.stack([np.clip(np.pi, low, high), np.clip(-np.pi, low, high)])
        flattest = np.abs(np.abs(folds) - np.pi).argmin(axis=0)
        self._folded = folds[flattest, np.arange(n)]

    def watch(self, before, after, part, hinderer):
        """Take a step into account: new states, ranks and aims. Return whether it was the last.

        Args:
            before: joint angles before the step [rad], shape (n, 2).
            after: joint angles after it [rad], shape (n, 2).
            part: which part of its turn each robot made, shape (n,).
            hinderer: who left it no more, -1 if nobody did, shape (n,).
        """
        called = _calls(self.ranks, self.state, self._standing, self._swarm.movable, part, hinderer)
        return _decide(
            before, after, called, self._swarm, self._folded, self.state, self.ranks, self.aim,
            self._standing, self._claims, self._still, self._left, *self._times,
        )  # fmt: skip


@nb.njit(cache=True)
def _calls(ranks, state, standing, movable, part, hinderer):
    # the rank each robot is called to give way with, just below that of who calls; else 0
    n = len(ranks)
    called = np.zeros(n)
    for i in range(n):
        j = hinderer[i]
        if ranks[i] == 0.0 or part[i] >= _HINDERED or j < 0 or j >= n or not movable[j]:
            continue
        # without a claim as well, nobody gives way to lower standing
        own = ranks[j] if state[j] == YIELDING else max(ranks[j], standing[j])
        if own < ranks[i]:
            called[j] = max(called[j], np.nextafter(ranks[i], 0.0))
    return called


@nb.njit(cache=True)
def _decide(
    before, after, called, swarm, folded, state, ranks, aim,
    standing, claims, still, left, dt, patience_s, yield_s,
):  # fmt: skip
    n, last = len(state), True
    for i in range(n):
        if not swarm.movable[i]:
            continue
        was, now = _to_go(before[i], swarm, i), _to_go(after[i], swarm, i)
        # runs at the pace of the clock for a robot that does not move, and backwards for
        # one that makes more than its part
        still[i] = max(0.0, still[i] + dt - (was - now) / _SLOW)
        if now == 0.0 or state[i] == YIELDING:
            still[i] = 0.0
        if called[i] > 0.0:
            state[i], ranks[i], left[i] = YIELDING, called[i], yield_s
        elif state[i] == YIELDING:
            left[i] -= dt
            if left[i] <= 0.0:
                state[i], ranks[i] = FREE, 0.0
                standing[i] += n if standing[i] > 0.0 else 0.0
        elif now == 0.0:
            state[i], ranks[i] = FREE, 0.0
        elif state[i] == FREE and still[i] > patience_s and claims[i] > 0:
            state[i], ranks[i], still[i] = GOING, standing[i], 0.0
            claims[i] -= 1
        elif state[i] == GOING and still[i] > yield_s:
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
def _to_go(angles, swarm, i):
    # how long robot i needs to its goal if it is alone [s]
    theta = abs(angles[0] - swarm.goal[i, 0]) / swarm.speed[i, 0]
    return max(theta, abs(angles[1] - swarm.goal[i, 1]) / swarm.speed[i, 1])

# SPDX-License-Identifier: Apache-2.0
"""The motions of the robots, as bridge and encoders tell of them: where each began, and rest."""

import threading
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fiber_core.array_types import Angles
from fiber_metrology.errors import MetrologyError
from fiber_msgs_py import Attempt, PlanStamp

__all__ = ["Motions", "Rest"]

_KEPT = 64  # joint states at rest, among which is the one before a motion
_SETTLED_S = 2.0  # longest wait for the outcome and the encoders of a plan that has ended


class Rest(NamedTuple):
    """Robots at rest.

    Args:
        counters: joint angles by the counters [rad], shape (n, 2).
        plan: the last plan that has ended, None before the first.
        since_ns: time of the first joint states that show this rest [ns].
        session: id of the session of the bridge.
        begin_heard: whether it is known where the last motion began; if not, no image tells that a
            joint did not turn in it.
    """

    counters: Angles
    plan: PlanStamp | None
    since_ns: int
    session: str | None
    begin_heard: bool = True

    def lasts_until(self, later: "Rest") -> bool:
        """Return whether nothing was told to move between this rest and a later look at it."""
        same = self.plan == later.plan and self.session == later.session
        return same and bool(np.array_equal(self.counters, later.counters))


class Motions:
    """Follows plans and encoders, in whichever order their messages come.

    A motion without targets, such as `home`, shows by its outcome alone.

    Args:
        begin: called with the joint angles [rad], shape (n, 2), at which a motion begins, and
            whether it is a correction.
    """

    def __init__(self, begin: Callable[[Angles, bool], None]):
        self._begin = begin
        self.lock = threading.Condition(threading.RLock())
        self._session: str | None = None
        self._reset()

    def _reset(self) -> None:
        self._at_rest: dict[int, Angles] = {}  # joint states by stamp
        self._first: Angles | None = None  # the first ones at rest that were heard
        # the last plan of which no joint states surely tell where it began, and the likeliest ones
        self._unsure: tuple[PlanStamp, Angles | None] | None = None
        self._newest_ns, self._moving = -1, False
        self._rests_since_ns: int | None = None
        self._waiting: tuple[PlanStamp, int, bool] | None = None  # its joint states have not come
        self._ended: PlanStamp | None = None  # the last plan that has
        self._begun: PlanStamp | None = None  # the last plan that was accepted, or moved robots

    def open(self, session: str | None) -> None:
        """Forget what was heard of the robots if they are of another session now."""
        with self.lock:
            if session != self._session:
                self._reset()
                self._session = session

    def hear_states(self, ns: int, angles: Angles, moving: bool) -> None:
        """Take joint states of the encoders, stamped with a time [ns]."""
        with self.lock:
            if ns >= self._newest_ns:
                self._newest_ns, self._moving = ns, moving
                if moving:
                    self._rests_since_ns = None
                elif self._rests_since_ns is None:
                    self._rests_since_ns = ns
            if not moving:
                self._first = angles if self._first is None else self._first
                self._at_rest[ns] = angles
                for old in sorted(self._at_rest)[:-_KEPT]:
                    del self._at_rest[old]
            self._begin_motion()
            self.lock.notify_all()

    def hear_accepted(self, attempt: Attempt, straight: bool) -> None:
        """Take a plan that the bridge has accepted; `straight` for a correction."""
        with self.lock:
            self._begun = max(attempt.plan, self._begun or attempt.plan)
            if attempt.since_ns is not None and attempt.number == 1:
                self._waiting = attempt.plan, attempt.since_ns, straight
                self._begin_motion()

    def hear_outcome(self, plan: PlanStamp) -> None:
        """Take the end of a plan."""
        with self.lock:
            self._ended = plan if self._ended is None else max(plan, self._ended)
            if self._begun is None or plan > self._begun:  # nothing was accepted for it
                self._begun, self._waiting = plan, (plan, plan.ns, False)
            self._begin_motion()
            # joint states of before may overtake the outcome: the next ones tell
            self._rests_since_ns = None
            self.lock.notify_all()

    def _begin_motion(self) -> None:
        # the bridge tells with each plan which joint states it begins at; of these only the newest
        # is sure to come
        if self._waiting is None:
            return
        plan, since_ns, straight = self._waiting
        ended = self._ended is not None and plan <= self._ended
        if ended:  # newer ones may be of after the motion
            found = [ns for ns in sorted(self._at_rest) if ns <= since_ns][-1:]
        else:
            found = [ns for ns in sorted(self._at_rest) if ns >= since_ns]
        if found:
            self._begin(self._at_rest[found[0]], straight)
        elif ended:  # this node was started after its targets were sent, and maybe before it moved
            self._unsure = plan, self._first
            if self._first is not None:
                self._begin(self._first, straight)
        if found or ended:
            self._waiting = None

    def at_rest(self) -> Rest:
        """Return where the robots rest; waits for messages that are under way.

        Raises:
            MetrologyError: robots move, a plan has not ended, or no robot was heard of.
        """
        with self.lock:
            self.lock.wait_for(lambda: bool(self._at_rest) or self._moving, _SETTLED_S)
            if not self._at_rest and not self._moving:
                raise MetrologyError("no plane is known yet: there is no bridge in the graph")
            # topics overtake each other: a client may know the outcome before this node
            self.lock.wait_for(self._has_settled, _SETTLED_S)
            if self._moving:
                raise MetrologyError("robots are moving")
            if not self._at_rest:
                raise MetrologyError("the bridge has begun anew: nothing is known of its robots")
            if self._rests_since_ns is None or not self._has_settled():
                raise MetrologyError(f"plan {self._begun} has not ended: start it, or clear")
            angles = self._at_rest[max(self._at_rest)]
            heard = self._unsure is None or self._unsure[0] != self._ended
            if not heard and self._unsure is not None and self._unsure[1] is not None:
                # joint states that differ from those after the motion are of before it
                heard = not np.array_equal(self._unsure[1], angles)
            return Rest(angles, self._ended, self._rests_since_ns, self._session, heard)

    def _has_settled(self) -> bool:
        ended = self._begun is None or (self._ended is not None and self._begun <= self._ended)
        return ended and self._rests_since_ns is not None and not self._moving

# SPDX-License-Identifier: Apache-2.0
"""What a sector may do, decided from the beats that it has heard and from its own clock alone.

A sector counts down when it is told to, and begins to move only under a lease: a beat MOVE that
answers one of its own reports, of the countdown or of the motion. The lease ends a fixed time after
that report was *sent*, on the sector's clock: neither delays nor other clocks can lengthen it.
"""

import math
from enum import Enum

from fiber_sectors.messages import Beat, Order, Report, Stage
from fiber_sectors.terms import Terms

__all__ = ["Decision", "Member"]


class Decision(Enum):
    """What a sector does next."""

    WAIT = "go on with what is under way, and do not begin to move"
    GO = "send the GO for the start"
    MOVE = "move, or begin to"
    STOP = "stop all robots, now"


class Member:
    """One sector in the runs of a plane, without a clock: each call is given its time [s].

    Args:
        sector: number of the sector.
        boot: names this process, not 0.
        terms: the times on which all agree.

    Attributes:
        run: number of the run.
        stage: how far this sector is.
        start_s: instant of the start on this clock [s]; nan before it is told.
        why: why this sector stops; empty while it does not.
    """

    def __init__(self, sector: int, boot: int, terms: Terms):
        self._sector, self._boot, self._terms = sector, boot, terms
        self.run = 0
        self._begin(Stage.STOPPED)

    def _begin(self, stage: Stage) -> None:
        self.stage, self.start_s, self.why = stage, math.nan, ""
        self._newest: Beat | None = None
        self._heard_s = self._confirmed_s = self._lease_s = -math.inf
        self._deadline_s = math.inf
        self._now_s = -math.inf

    def begin(self, run: int, now_s: float) -> bool:
        """Begin to load the orders of a run; return whether the run is newer than the last one."""
        if run <= self.run:
            return False
        self.run = run
        self._begin(Stage.LOADING)
        self._heard_s = self._now_s = now_s
        return True

    def ready(self) -> None:
        """The orders of the run are loaded and verified."""
        self.stage = Stage.READY

    def confirmed(self, start_s: float, deadline_s: float, now_s: float) -> None:
        """All robots count down.

        Args:
            start_s: instant at which they begin to move [s].
            deadline_s: time after which a STOP may come too late for some of them [s].
            now_s: the present [s].
        """
        self.stage, self.start_s = Stage.COUNTING, start_s
        self._confirmed_s, self._deadline_s = now_s, deadline_s

    def ended(self) -> None:
        """All robots have arrived, or none was started."""
        self.stage = Stage.ENDED

    def stopped(self, why: str) -> None:
        """The robots were stopped, or will not be started."""
        self.stage, self.why = Stage.STOPPED, self.why or why

    def hear(self, beat: Beat, now_s: float) -> None:
        """Take a beat; doubled, late and foreign ones change nothing."""
        if beat.run > self.run and self.stage not in (Stage.ENDED, Stage.STOPPED):
            self.why = self.why or f"run {beat.run} has begun"
        own = beat.run == self.run and self._sector < len(beat.answers_s)
        if not own or (self._newest is not None and beat.number <= self._newest.number):
            return
        self._newest, self._heard_s = beat, now_s
        answered = beat.boots[self._sector] == self._boot
        if beat.order is Order.STOP:
            self.why = self.why or "the coordinator stops the run"
        elif beat.order is Order.GO and answered and self.stage is Stage.READY:
            self.start_s = beat.starts_s[self._sector]
        elif beat.order is Order.MOVE and answered:
            answer_s = beat.answers_s[self._sector]
            if self._confirmed_s <= answer_s <= now_s:
                self._lease_s = max(self._lease_s, answer_s + self._terms.lease_s)

    def decide(self, now_s: float) -> Decision:
        """Return what to do now."""
        if self.stage in (Stage.ENDED, Stage.STOPPED):
            return Decision.WAIT
        if now_s < self._now_s:
            self.why = self.why or f"the clock went back by {self._now_s - now_s:.3g} s"
        self._now_s = max(self._now_s, now_s)
        leased = self._lease_s > -math.inf
        if self.stage in (Stage.LOADING, Stage.READY):
            if now_s > self._heard_s + self._terms.ready_s:
                self.why = self.why or "the coordinator is silent"
        elif leased and now_s >= self._lease_s:
            self.why = self.why or "the lease has ended: the coordinator is silent"
        elif not leased and now_s >= self._deadline_s:
            self.why = self.why or "not all sectors have confirmed the countdown in time"
        if self.why:
            return Decision.STOP
        if self.stage is Stage.READY and not math.isnan(self.start_s):
            return Decision.GO
        if leased:
            if now_s >= self.start_s:
                self.stage = Stage.MOVING
            return Decision.MOVE
        return Decision.WAIT

    def answered(self, sent_s: float) -> bool:
        """Whether the newest beat answers the report that was sent at a time [s], or a later."""
        beat = self._newest
        return beat is not None and beat.answers_s[self._sector] >= sent_s

    @property
    def lease_s(self) -> float:
        """Time at which the lease ends [s]; -inf without a lease."""
        return self._lease_s

    def report(self, now_s: float) -> Report:
        """Return the report to send now."""
        beat = self._newest
        return Report(
            self._sector, self._boot, self.run, self.stage, now_s,
            math.nan if beat is None else beat.sent_s,
            math.nan if beat is None else self._heard_s,
            self.start_s,
        )  # fmt: skip

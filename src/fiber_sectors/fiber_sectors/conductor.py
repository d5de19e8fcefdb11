# SPDX-License-Identifier: Apache-2.0
"""What the coordinator lets the sectors do, decided from their reports and from its own clock.

A run: all sectors are ready, count down, move, end. The coordinator lets them begin to move when
all have confirmed the countdown, in time for the beat that says so to be lost a few times. It lets
them move on as long as each of them has lately answered a beat and has not stopped.
"""

import math
from collections.abc import Sequence
from enum import Enum

from fiber_sectors.clock_fit import ClockFit
from fiber_sectors.errors import SectorError
from fiber_sectors.messages import Beat, Order, Report, Stage
from fiber_sectors.terms import Terms

__all__ = ["Conductor", "Step"]

_AT_REST = (Stage.ENDED, Stage.STOPPED)


class Step(Enum):
    """How far a run is."""

    OVER = "no run is under way"
    LOADING = "the sectors load and verify"
    COUNTING = "the sectors count down"
    MOVING = "the sectors move"
    STOPPING = "the sectors are told to stop"


_ORDERS = {
    Step.OVER: Order.STOP,
    Step.LOADING: Order.WAIT,
    Step.COUNTING: Order.GO,
    Step.MOVING: Order.MOVE,
    Step.STOPPING: Order.STOP,
}


class Conductor:
    """The coordinator of the sectors of a plane, without a clock: each call is given its time [s].

    Args:
        sectors: number of sectors.
        terms: the times on which all agree.

    Attributes:
        step: how far the run is.
        why: why the run was stopped; empty if it was not.
        stopped_by: the sector because of which it was stopped; None for none.
        stop_s: time at which the stop was decided [s]; nan without.
        clocks: the clocks of the sectors, measured in all runs.
    """

    def __init__(self, sectors: int, terms: Terms):
        self._n, self._terms = sectors, terms
        self.clocks = [ClockFit(terms.drift_ppm) for _ in range(sectors)]
        self.step, self._run, self._number = Step.OVER, 0, 0
        self._clear(0.0, range(sectors))

    def _clear(self, now_s: float, part: Sequence[int]) -> None:
        self._part = tuple(part)
        self._reports: list[Report | None] = [None] * self._n
        self._heard_s = [now_s] * self._n
        self._answered_s = [-math.inf] * self._n
        self._counts_s = [math.inf] * self._n  # when each sector was known to count down
        self._given_up: set[int] = set()
        self._jumps = [clock.jumps for clock in self.clocks]
        self._began_s = self._now_s = now_s
        self._start_s, self._ahead_s = math.nan, 0.0
        self._errors_s = [0.0] * self._n
        self.why, self.stopped_by, self.stop_s = "", None, math.nan

    def begin(self, run: int, now_s: float, part: Sequence[int] | None = None) -> None:
        """Begin a run, in which the sectors load and verify.

        Args:
            run: its number, larger than that of every run before it, also of other coordinators.
            now_s: the present [s].
            part: the sectors that take part; by default all.

        Raises:
            SectorError: a run is under way, or the number is not larger.
        """
        if self.step is not Step.OVER:
            raise SectorError(f"run {self._run} is under way")
        if run <= self._run:
            raise SectorError(f"run {run} does not follow run {self._run}")
        self._run, self._number, self.step = run, 0, Step.LOADING
        self._clear(now_s, range(self._n) if part is None else part)

    def hear(self, report: Report, now_s: float) -> None:
        """Take a report; doubled, late and foreign ones change nothing."""
        k = report.sector
        if report.run != self._run or k not in self._part:
            return
        before = self._reports[k]
        if before is not None and report.boot != before.boot:
            self.stop(f"sector {k} has begun anew", now_s, k)
            return
        if before is not None and report.sent_s <= before.sent_s:
            return
        if not math.isnan(report.beat_s):
            self.clocks[k].add(report.beat_s, report.heard_s, report.sent_s, now_s)
            self._answered_s[k] = max(self._answered_s[k], report.beat_s)
        if report.stage is Stage.COUNTING:
            self._counts_s[k] = min(self._counts_s[k], now_s)
        self._reports[k], self._heard_s[k] = report, now_s

    def beats_go_on(self, now_s: float) -> None:
        """No beat was sent for a while: the silence of the sectors counts from now on [s]."""
        self._heard_s = [max(heard_s, now_s) for heard_s in self._heard_s]
        self._now_s = max(self._now_s, now_s)

    def clocks_known(self, now_s: float) -> bool:
        """Whether the clocks of all sectors to be started are known as well as the start needs."""
        return self._unknown_clock(now_s) is None

    def _unknown_clock(self, now_s: float) -> int | None:
        for k in self._part:
            bound_s = self.clocks[k].offset(now_s).bound_s
            if self.stage(k) is Stage.READY and bound_s > self._terms.start_error_s:
                return k
        return None

    def stage(self, sector: int) -> Stage:
        """Return the stage of a sector by its newest report."""
        report = self._reports[sector]
        return Stage.LOADING if report is None else report.stage

    @property
    def ready(self) -> bool:
        """Whether all sectors have loaded and verified, or have nothing to move."""
        stages = [self.stage(k) for k in self._part]
        loaded = all(stage in (Stage.READY, Stage.ENDED) for stage in stages)
        return self.step is Step.LOADING and loaded

    @property
    def part(self) -> tuple[int, ...]:
        """The sectors that take part in the run."""
        return self._part

    def unanswered(self, sent_s: float) -> list[int]:
        """Return the sectors, not at rest, that have not answered the beat of a time [s]."""
        waiting = []
        for k in self._part:
            report = self._reports[k]
            beat_s = math.nan if report is None else report.beat_s
            if self.stage(k) not in _AT_REST and not beat_s >= sent_s and k not in self._given_up:
                waiting.append(k)
        return waiting

    def give_up(self, sector: int) -> None:
        """Wait no longer for a sector."""
        self._given_up.add(sector)
        self._heard_s[sector] = -math.inf

    @property
    def lost(self) -> tuple[int, ...]:
        """Sectors that are not known to rest at the end of a run that was stopped."""
        over = self.step is Step.OVER
        return tuple(k for k in self._part if over and self.stage(k) not in _AT_REST)

    @property
    def start_skew_bound_s(self) -> float:
        """Largest difference between the starts of two sectors by what was measured [s]."""
        worst = sorted(self._errors_s)[-2:]
        return sum(worst) if len(worst) > 1 else 0.0

    def go(self, start_s: float, ahead_s: float, now_s: float) -> None:
        """Let the sectors count down.

        Args:
            start_s: instant at which they begin to move [s].
            ahead_s: time before the start after which a sector stops without a lease [s].
            now_s: the present [s].

        Raises:
            SectorError: not all are ready, or the clock of a sector is not known well enough.
        """
        if not self.ready:
            raise SectorError("not all sectors are ready")
        if (k := self._unknown_clock(now_s)) is not None:
            bound_s = self.clocks[k].offset(now_s).bound_s
            raise SectorError(
                f"the clock of sector {k} is known to {1e3 * bound_s:.3g} ms, the certificate "
                f"contains {1e3 * self._terms.start_error_s:.3g} ms"
            )
        self._start_s, self._ahead_s, self.step = start_s, ahead_s, Step.COUNTING

    def stop(self, why: str, now_s: float, sector: int | None = None) -> None:
        """Stop the run, whatever it does."""
        if self.step in (Step.OVER, Step.STOPPING):
            return
        self.step, self.why, self.stopped_by, self.stop_s = Step.STOPPING, why, sector, now_s

    def beat(self, now_s: float) -> Beat:
        """Decide what comes next, and return the beat that says it."""
        self.advance(now_s)
        self._number += 1
        reports = self._reports
        starts_s = [self._start_s + c.offset(now_s).middle_s for c in self.clocks]
        return Beat(
            self._run, self._number, _ORDERS[self.step], now_s,
            tuple(0 if r is None else r.boot for r in reports),
            tuple(math.nan if r is None else r.sent_s for r in reports),
            tuple(starts_s if self.step in (Step.COUNTING, Step.MOVING) else [math.nan] * self._n),
        )  # fmt: skip

    def advance(self, now_s: float) -> None:
        """Decide what comes next."""
        if self.step is not Step.OVER and now_s < self._now_s:
            self.stop(f"the clock went back by {self._now_s - now_s:.3g} s", now_s)
        self._now_s = max(self._now_s, now_s)
        if self.step in (Step.LOADING, Step.COUNTING, Step.MOVING):
            self._look_for_trouble(now_s)
        if self.step is Step.COUNTING:
            self._count(now_s)
        elif self.step is Step.MOVING:
            if all(self.stage(k) is Stage.ENDED for k in self._part):
                self.step = Step.OVER
        elif self.step is Step.LOADING and now_s > self._began_s + self._terms.ready_s:
            slow = next((k for k in self._part if self.stage(k) is Stage.LOADING), None)
            if slow is not None:
                self.stop(f"sector {slow} has not loaded its orders in time", now_s, slow)
        if self.step is Step.STOPPING:
            gone_s = now_s - self._terms.gone_s
            if all(self.stage(k) in _AT_REST or self._heard_s[k] < gone_s for k in self._part):
                self.step = Step.OVER

    def _look_for_trouble(self, now_s: float) -> None:
        loading = self.step is Step.LOADING
        for k in self._part:
            stage = self.stage(k)
            if stage is Stage.STOPPED:
                self.stop(f"sector {k} has stopped", now_s, k)
            elif stage is Stage.ENDED:
                continue
            elif not loading and self.clocks[k].jumps != self._jumps[k]:
                self.stop(f"the clock of sector {k} has jumped", now_s, k)
            elif self.step is Step.MOVING and now_s > self._answered_s[k] + self._terms.fresh_s:
                self.stop(f"sector {k} is silent", now_s, k)
            elif now_s > self._heard_s[k] + self._terms.gone_s:
                self.stop(f"sector {k} is gone", now_s, k)

    def _count(self, now_s: float) -> None:
        """Let all move when each has confirmed, and has done so for the right instant."""
        waiting = [k for k in self._part if not self._confirmed(k)]
        latest_s = self._start_s - self._ahead_s - self._terms.spare * self._terms.period_s
        if now_s > latest_s:
            first = waiting[0] if waiting else None
            text = f"sectors {waiting} have not" if waiting else "the last sector has not"
            self.stop(f"{text} confirmed the countdown in time", now_s, first)
        elif not waiting:
            self.step = Step.MOVING

    def _confirmed(self, k: int) -> bool:
        """Whether a sector counts down to the right instant, or has nothing to move.

        The clock is measured anew, after the sector has begun to count: if it jumped before, the
        instant at which the robots will start is off by as much.
        """
        report = self._reports[k]
        if report is None or report.stage not in (Stage.COUNTING, Stage.ENDED):
            return False
        if report.stage is Stage.ENDED:
            return True
        newest = self.clocks[k].newest
        self._errors_s[k] = abs(report.start_s - newest.middle_s - self._start_s) + newest.bound_s
        measured = report.beat_s >= self._counts_s[k]
        return measured and self._errors_s[k] <= self._terms.start_error_s

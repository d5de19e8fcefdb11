# SPDX-License-Identifier: Apache-2.0
"""The messages of a coordinator: calls that all sectors answer, beats, and the end of a run."""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from fiber_bus_bridge.bus import Exchange
from fiber_bus_bridge.protocol import Context
from fiber_core.array_types import Ints, Rows
from fiber_core.outcomes import Reason
from fiber_sectors.calls import (
    CALL,
    MOST_NUMBER,
    Call,
    Columns,
    Kind,
    decode_call,
    encode_call,
    number_of,
)
from fiber_sectors.conductor import Conductor, Step
from fiber_sectors.errors import SectorError
from fiber_sectors.messages import decode_report, encode_beat
from fiber_sectors.tables import COUNTERS, take_table
from fiber_sectors.terms import Terms
from fiber_sectors.traffic import traffic_of

__all__ = ["Links", "Pace", "Sectors"]

_BATCHES = 1000  # of traffic that wait for a clock to be known
_AGAIN_S = 0.1  # between two sendings of a beat that is not answered
_CALL_AGAIN_S = 1.0  # the same of a call
_INSTANT_S = 1e-6  # between two beats, while the time of simulated buses stands still


@dataclass(frozen=True)
class Pace:
    """How time goes on for a coordinator, and how long it waits.

    Args:
        clock: time of this host [s]; None for simulated buses, whose time goes on with beats.
        patience_s: longest wait for a sector while simulated time stands still [s].
        call_s: longest wait for the answer of a call [s].
        scale: seconds of the clock in one of this machine.
        wall: time of the machine [s].
        number: a number that rises, also from one process to the next.
    """

    clock: Callable[[], float] | None = None
    patience_s: float = 5.0
    call_s: float = 120.0
    scale: float = 1.0
    wall: Callable[[], float] = time.monotonic
    number: Callable[[], int] = time.time_ns


class Links(Protocol):
    """The connections of a coordinator with its sectors."""

    def send(self, sector: int, data: bytes) -> None:
        """Send bytes to one sector."""
        ...

    def receive(self, wait_s: float) -> list[bytes]:
        """Return what has come from any sector, or wait for it [s]."""
        ...

    def left(self, sector: int) -> bool:
        """Return whether a sector was connected, and is not any more."""
        ...


class Sectors:
    """The sectors of a plane, as their coordinator reaches them.

    Args:
        c: the controller of the plane, whose tables are kept up to date.
        terms: the times on which all sectors agree.
        links: the connections with the sectors.
        pace: how time goes on.

    Attributes:
        number: number of sectors.
        rows: for each sector the rows of its robots.
        conductor: the run under way, or the last one.
        gone: sectors that do not answer.
        why: why the last run was stopped, or not started.
        malformed: sectors whose answer to the last call was none, and why.
    """

    def __init__(self, c: Context, terms: Terms, links: Links, pace: Pace):
        self._c, self._terms, self._links, self._pace = c, terms, links, pace
        self._clock, self._wall = pace.clock, pace.wall
        sector = c.plane.sector
        self.number = int(sector.max(initial=0)) + 1
        self.rows: list[Rows] = [np.flatnonzero(sector == k) for k in range(self.number)]
        self._buses: list[Ints] = [np.unique(c.bus[rows]) for rows in self.rows]
        self.conductor = Conductor(self.number, terms)
        self.gone: set[int] = set()
        self.why, self.malformed = "", dict[int, str]()
        self._counters: dict[int, dict[str, float]] = {}
        self._last = 0
        self._traffic: list[tuple[int, Exchange]] = []  # of sectors whose clocks are not known
        self._at_s = 0.0

    @property
    def in_real_time(self) -> bool:
        """Whether the time of the buses is that of the hosts."""
        return self._clock is not None

    def counters(self) -> dict[int, dict[str, float]]:
        """Return the counters of each bus, as of BusCounters.table."""
        nothing: dict[str, float] = dict.fromkeys(COUNTERS, 0)
        return {
            int(bus): self._counters.get(int(bus), nothing) for bus in self._c.transactions.buses
        }

    def next_number(self) -> int:
        """Return the number of the next call or run: larger than those before it.

        It comes from the wall clock, so that it is larger than those of an earlier coordinator; a
        clock that is behind them is found out by the first call, which sectors refuse.
        """
        self._last = min(max(self._pace.number(), self._last + 1), MOST_NUMBER)
        return self._last

    def now_s(self) -> float:
        """Return the time of the coordinator [s]."""
        if self._clock is not None:
            self._at_s = self._clock()
        self._c.transactions.free_s[:] = self._at_s
        return self._at_s

    def _hear(self, data: bytes) -> Call | None:
        """Take a message of a sector; return it if it is an answer that was asked for."""
        try:
            if data[:4] != CALL:
                report = decode_report(data)
                if self._clock is None:
                    self._at_s = max(self._at_s, report.sent_s)
                self.conductor.hear(report, self.now_s())
                return None
            call = decode_call(data)
            if not 0 <= call.sector < self.number:
                return None
            if call.number or call.kind is not Kind.TABLE:
                return call
            self._take_table(call)
        except SectorError:
            pass  # is sent again
        return None

    def _take_table(self, call: Call, of_run: Sequence[str] = ()) -> None:
        k = call.sector
        counters = take_table(self._c, self.rows[k], self._buses[k], call.columns, of_run)
        self._counters |= counters

    def call(
        self,
        kind: Kind,
        columns: dict[int, Columns],
        wait_s: float | None = None,
        of_run: Sequence[str] = (),
    ) -> dict[int, Columns]:
        """Call sectors side by side; return the answers of those that did not refuse.

        The table in each answer is taken over. A sector that does not answer, or not as it should,
        is gone.
        """
        until_s = self._wall() + (self._pace.call_s if wait_s is None else wait_s)
        self.malformed = {}
        answers: dict[int, Columns] = {}
        waiting, behind = set(columns), set(columns)
        while behind:  # another coordinator's clock was ahead: the second time the number is larger
            behind = self._call_once(kind, columns, behind, answers, waiting, until_s, of_run)
        self._tell_traffic()
        self.gone = (self.gone | waiting) - set(answers)
        for k in waiting:
            self._lose(k)
        return answers

    def _call_once(
        self,
        kind: Kind,
        columns: dict[int, Columns],
        called: set[int],
        answers: dict[int, Columns],
        waiting: set[int],
        until_s: float,
        of_run: Sequence[str],
    ) -> set[int]:
        """Call sectors under one number; return those that have heard a larger one."""
        number, asked, behind = self.next_number(), set(called), set[int]()
        data = {k: encode_call(k, kind, number, columns[k]) for k in called}
        while asked and (now_s := self._wall()) < until_s:
            if all(self._links.left(k) for k in asked):
                break
            for k in asked:
                self._links.send(k, data[k])
            again_s = min(now_s + _CALL_AGAIN_S, until_s)
            while asked and (left_s := again_s - self._wall()) > 0.0:
                for message in self._links.receive(left_s):
                    answer = self._hear(message)
                    if answer is None or answer.number != number or answer.sector not in asked:
                        continue
                    asked.discard(answer.sector)
                    first = kind in (Kind.LOOK, Kind.CONFIGURE)  # calls of a new coordinator
                    if first and self._is_behind(answer):
                        behind.add(answer.sector)
                    elif self._take(answer, answers, of_run):
                        waiting.discard(answer.sector)
        return behind

    def _is_behind(self, answer: Call) -> bool:
        """Whether a sector has answered an earlier coordinator under a larger number."""
        if not answer.refusal or "newest" not in answer.columns:
            return False
        try:
            newest = number_of(answer.columns, "newest", "i8", 0, MOST_NUMBER)
        except SectorError:
            return False
        self._last = max(self._last, newest)
        return True

    def _take(self, answer: Call, answers: dict[int, Columns], of_run: Sequence[str]) -> bool:
        """Take over an answer; return whether the sector is there."""
        k = answer.sector
        if answer.refusal:
            self.why = f"sector {k}: {answer.refusal}"
            return True
        try:
            self._take_table(answer, of_run)
        except SectorError as error:
            self.malformed[k] = self.why = f"sector {k}: {error}"
            return False
        answers[k] = answer.columns
        with suppress(SectorError):  # which a recording misses, and nothing else
            traffic = traffic_of(answer.columns, self._c.transactions.buses[self._buses[k]])
            if traffic is not None:
                self._traffic.append((k, traffic))
        return True

    def _tell_traffic(self) -> None:
        """Hand on the traffic of the sectors whose clocks are known, in the time of this host."""
        traffic, self._traffic = self._traffic[-_BATCHES:], []
        for k, each in traffic:
            frames, replies = each.frames, each.replies
            ahead_s = self.conductor.clocks[k].newest.middle_s if self.in_real_time else 0.0
            if math.isnan(ahead_s):
                self._traffic.append((k, each))
                continue
            here = replace(
                replies, start_s=replies.start_s - ahead_s, end_s=replies.end_s - ahead_s
            )
            self._c.transactions.add_traffic(frames, here)

    def _lose(self, k: int) -> None:
        """A sector does not answer: its robots are obstacles, at unknown places if they moved."""
        robots, rows = self._c.robots, self.rows[k]
        robots["known"][rows] = False
        robots["verified"][rows] = False
        robots["state"][rows] = 0
        robots["lost"][rows] |= robots["started"][rows] & ~robots["arrived"][rows]
        self._c.transactions.given_up[self._buses[k]] = True

    def exchange(self) -> None:
        """Send a beat, and take the reports that answer it.

        The time of simulated buses goes on when all sectors that are under way have answered.
        """
        if self._clock is None:
            self._at_s += _INSTANT_S
        beat = self.conductor.beat(self.now_s())
        data, begin_s = encode_beat(beat), self._wall()
        if self._clock is not None:
            self._send_all(data)
            until_s = begin_s + self._terms.period_s / self._pace.scale
            while (left_s := until_s - self._wall()) > 0.0:
                for message in self._links.receive(left_s):
                    self._hear(message)
            return
        self._send_all(data)
        for k in self.gone:  # it may hear, and is not waited for
            self.conductor.give_up(k)
        moving = self.conductor.step is Step.MOVING
        until_s = begin_s + (self._pace.patience_s if moving else self._pace.call_s)
        while self.conductor.unanswered(beat.sent_s) and (now_s := self._wall()) < until_s:
            if all(self._links.left(k) for k in self.conductor.unanswered(beat.sent_s)):
                break
            again_s = min(now_s + _AGAIN_S, until_s)
            while (left_s := again_s - self._wall()) > 0.0:
                for message in self._links.receive(left_s):
                    self._hear(message)
                if not self.conductor.unanswered(beat.sent_s):
                    return
            self._send_all(data)
        for k in self.conductor.unanswered(beat.sent_s):
            self.conductor.stop(f"sector {k} is silent", self.now_s(), k)
            self.gone.add(k)
            self.conductor.give_up(k)

    def _send_all(self, data: bytes) -> None:
        for k in self.conductor.part:
            self._links.send(k, data)

    def finish(self, why: str = "", of_run: Sequence[str] = ()) -> None:
        """End the run, and read the tables of all sectors that took part.

        Args:
            why: why it is stopped, if it is under way.
            of_run: columns of the run that are taken over.
        """
        conductor = self.conductor
        if why:
            conductor.stop(why, self.now_s())
        while conductor.step is not Step.OVER:
            self.exchange()
        self.why = conductor.why or self.why
        lost = set(conductor.lost)
        for k in lost:
            self._lose(k)
        self.gone |= lost
        present = {k: {} for k in conductor.part if k not in lost}
        cause = self._c.robots["cause"].copy()
        self.call(Kind.TABLE, present, 5.0, of_run)
        # a fault of an earlier run of this plan stays its cause
        self._c.robots["cause"] = np.where(cause != Reason.OK, cause, self._c.robots["cause"])

# SPDX-License-Identifier: Apache-2.0
"""The messages of a coordinator: calls that all sectors answer, beats, and the end of a run."""

import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from fiber_bus_bridge.protocol import Context
from fiber_core.array_types import Ints, Rows
from fiber_core.outcomes import Reason
from fiber_sectors.calls import CALL, Call, Columns, Kind, decode_call, encode_call
from fiber_sectors.conductor import Conductor, Step
from fiber_sectors.errors import SectorError
from fiber_sectors.messages import decode_report, encode_beat
from fiber_sectors.tables import take_table
from fiber_sectors.terms import Terms

__all__ = ["Links", "Sectors"]

_AGAIN_S = 0.1  # between two sendings of a beat that is not answered
_CALL_AGAIN_S = 1.0  # the same of a call
_INSTANT_S = 1e-6  # between two beats, while the time of simulated buses stands still
_COUNTERS = (
    "frames", "bytes", "no_address", "refused", "line_errors", "retries", "bad_replies",
    "recoveries", "busy_s",
)  # fmt: skip


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
        clock: time of this host [s]; None for simulated buses, whose time goes on with beats.
        patience_s: longest wait for a sector while simulated time stands still [s].
        call_s: longest wait for the answer of a call [s].
        wall: time of the machine [s].

    Attributes:
        number: number of sectors.
        rows: for each sector the rows of its robots.
        conductor: the run under way, or the last one.
        gone: sectors that do not answer.
        why: why the last run was stopped, or not started.
    """

    def __init__(
        self,
        c: Context,
        terms: Terms,
        links: Links,
        clock: Callable[[], float] | None,
        patience_s: float,
        call_s: float,
        wall: Callable[[], float] = time.monotonic,
    ):
        self._c, self._terms, self._links = c, terms, links
        self._clock, self._wall = clock, wall
        self._patience_s, self._call_s = patience_s, call_s
        sector = c.plane.sector
        self.number = int(sector.max(initial=0)) + 1
        self.rows: list[Rows] = [np.flatnonzero(sector == k) for k in range(self.number)]
        self._buses: list[Ints] = [np.unique(c.bus[rows]) for rows in self.rows]
        self.conductor = Conductor(self.number, terms)
        self.gone: set[int] = set()
        self.why = ""
        self._counters: dict[int, dict[str, float]] = {}
        self._last_call = time.time_ns()  # above the numbers of an earlier coordinator
        self._at_s = 0.0

    def counters(self) -> dict[int, dict[str, float]]:
        """Return the counters of each bus, as of BusCounters.table."""
        nothing: dict[str, float] = dict.fromkeys(_COUNTERS, 0)
        return {
            int(bus): self._counters.get(int(bus), nothing) for bus in self._c.transactions.buses
        }

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
            if call.number or call.kind is not Kind.TABLE or not 0 <= call.sector < self.number:
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

        The table in each answer is taken over. A sector that does not answer is gone.
        """
        self._last_call += 1
        number, waiting = self._last_call, set(columns)
        data = {k: encode_call(k, kind, number, each) for k, each in columns.items()}
        answers: dict[int, Columns] = {}
        until_s = self._wall() + (self._call_s if wait_s is None else wait_s)
        while waiting and (now_s := self._wall()) < until_s:
            if all(self._links.left(k) for k in waiting):
                break
            for k in waiting:
                self._links.send(k, data[k])
            again_s = min(now_s + _CALL_AGAIN_S, until_s)
            while waiting and (left_s := again_s - self._wall()) > 0.0:
                for message in self._links.receive(left_s):
                    answer = self._hear(message)
                    if answer is None or answer.number != number or answer.sector not in waiting:
                        continue
                    waiting.discard(answer.sector)
                    if answer.refusal:
                        self.why = f"sector {answer.sector}: {answer.refusal}"
                        continue
                    self._take_table(answer, of_run)
                    answers[answer.sector] = answer.columns
        self.gone = (self.gone | waiting) - set(answers)
        for k in waiting:
            self._lose(k)
        return answers

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
            until_s = begin_s + self._terms.period_s
            while (left_s := until_s - self._wall()) > 0.0:
                for message in self._links.receive(left_s):
                    self._hear(message)
            return
        moving = self.conductor.step is Step.MOVING
        until_s = begin_s + (self._patience_s if moving else self._call_s)
        while self.conductor.unanswered(beat.sent_s) and (now_s := self._wall()) < until_s:
            if all(self._links.left(k) for k in self.conductor.unanswered(beat.sent_s)):
                break
            self._send_all(data)
            again_s = min(now_s + _AGAIN_S, until_s)
            while (left_s := again_s - self._wall()) > 0.0:
                for message in self._links.receive(left_s):
                    self._hear(message)
                if not self.conductor.unanswered(beat.sent_s):
                    break
        for k in self.conductor.unanswered(beat.sent_s):
            self.conductor.stop(f"sector {k} is silent", self.now_s(), k)
            self.gone.add(k)
            self.conductor.give_up(k)

    def _send_all(self, data: bytes) -> None:
        for k in self.conductor.part:
            if k not in self.gone:
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

# SPDX-License-Identifier: Apache-2.0
"""A sector at work: its session with its robots, on the orders of the coordinator.

All of it runs in one thread, which takes messages from a queue. While a run is under way the
steps of the motion and the messages alternate.

The time of simulated buses stands still while a sector waits for a beat: a motion goes on when all
sectors have come to the same instant, however slow their machines are. Buses of this machine follow
its clock, and nothing waits.
"""

import time
import zlib
from collections.abc import Callable
from dataclasses import astuple

import numpy as np

from fiber_bus_bridge import Session, SessionState
from fiber_bus_bridge.protocol.decisions import countdown_s
from fiber_bus_bridge.protocol.ending import find_causes
from fiber_core.clearance import Certificate, Safety
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_sectors.calls import (
    CALL,
    MOST_NUMBER,
    Call,
    Columns,
    Kind,
    column,
    decode_call,
    encode_call,
    number_of,
    text_columns,
)
from fiber_sectors.errors import SectorError
from fiber_sectors.inbox import Inbox
from fiber_sectors.leased import LeasedBuses
from fiber_sectors.member import Decision, Member
from fiber_sectors.messages import decode_beat, encode_report
from fiber_sectors.tables import motion_of, table_of, take_places
from fiber_sectors.terms import Terms
from fiber_sectors.traffic import traffic_columns

__all__ = ["Sector", "certified_elsewhere"]

_TABLE_S = 0.1  # between two tables while robots move
_INSTANT_S = 1e-8
_GO_AFTER_S = 2e-3  # until a GO is sent whose instant is computed now
_IDLE_S = 0.2  # between two looks at whether to end


def certified_elsewhere(
    plane: FocalPlane, motion: SegmentMotion, safety: Safety
) -> tuple[SegmentMotion, np.ndarray, Certificate]:
    """Hold no robot: the coordinator certifies what the sectors hold, all together."""
    nothing, none = np.zeros(0), np.zeros(plane.n, dtype=bool)
    pairs, no_pair = np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=bool)
    certificate = Certificate(pairs, nothing, nothing, nothing, no_pair, none, none, no_pair)
    return motion, none, certificate


class Sector:
    """One sector of a plane.

    Args:
        number: number of the sector.
        session: the session with its robots, which certifies nothing and never resumes by itself.
        terms: the times on which all sectors agree.
        boot: names this process.
        send: sends bytes to the coordinator.
        clock: time of the buses [s]; None for simulated ones, whose time goes on with beats.
        patience_s: longest wait for a beat while the time of simulated buses stands still [s].
        scale: seconds of the clock in one of this machine.
        wall: time of the machine [s].

    Raises:
        SectorError: the settings of the session do not keep to the terms.
    """

    def __init__(
        self,
        number: int,
        session: Session,
        terms: Terms,
        boot: int,
        send: Callable[[bytes], None],
        clock: Callable[[], float] | None = None,
        patience_s: float = 5.0,
        scale: float = 1.0,
        wall: Callable[[], float] = time.monotonic,
    ):
        terms.check_session(session.config)
        self._number, self._session, self._terms = number, session, terms
        self._leased = LeasedBuses(session.transactions.backend, clock) if clock else None
        if self._leased is not None:
            session.transactions.backend = self._leased
        session.look_back(lambda _: None)  # the coordinator notes it
        self._send, self._clock, self._wall = send, clock, wall
        self._patience_s, self._scale = patience_s, scale
        self.member = Member(number, boot, terms)
        self.inbox = Inbox()
        self._at_s = 0.0
        self._call: Call | None = None  # that is answered, or was last
        self._answered: bytes | None = None
        self._later: list[bytes] = []  # calls that came during a run
        self._asked = self._alone = self._ends = self._owes = False
        self._tabled_s = self._sent_s = 0.0

    def serve(self, ended: Callable[[], bool]) -> None:
        """Serve calls and beats until `ended` says so."""
        while not ended():
            later, self._later = self._later, []
            for data in [*later, *self.inbox.take(0.0 if later else _IDLE_S)]:
                self._handle(data)

    def end(self) -> None:
        """Stop robots that move, at their next step: this process ends. From any thread."""
        self._ends = True  # a run that begins in this moment ends as well
        self._check_end()

    def _check_end(self) -> None:
        if self._ends:
            self.member.why = self.member.why or "the sector ends"

    # --- messages ------------------------------------------------------------

    def _handle(self, data: bytes) -> None:
        if data[:4] != CALL:
            self._hear(data)
            return
        try:
            call = decode_call(data)
        except SectorError:
            return  # is sent again
        if call.sector != self._number:
            return
        if self._call is not None and call.number <= self._call.number:
            self._answer_again(call, self._call.number)
            return
        self._call, self._answered = call, None
        try:
            columns = self._serve(call)
            if self._answered is None:
                self._answer(columns)
        except FiberError as error:
            self._answer(text_columns(str(error)), Kind.REFUSED)

    def _answer_again(self, call: Call, newest: int) -> None:
        """Answer a call that has come again; refuse one from before the newest."""
        if call.number == newest:
            if self._answered is not None:
                self._send(self._answered)
            return
        refused = text_columns(f"call {call.number} comes after call {newest}")
        columns = refused | {"newest": np.array(newest)}
        self._send(encode_call(self._number, Kind.REFUSED, call.number, columns))

    def _answer(self, columns: Columns, kind: Kind | None = None) -> None:
        call = self._call
        assert call is not None  # a call is being served
        if kind is not Kind.REFUSED:
            columns = columns | traffic_columns(self._session.transactions.take_traffic())
        self._answered = encode_call(self._number, kind or call.kind, call.number, columns)
        self._send(self._answered)

    def _hear(self, data: bytes) -> None:
        self._take_beat(data)
        if self._in_time():
            self._report()
        else:
            self._owes = True

    def _in_time(self) -> bool:
        """Whether the robots have had heartbeats lately enough to move.

        After a pause they may rest already: an answer would tell that they move.
        """
        watch = self._session.protocol.watch
        if self._clock is None or watch is None:
            return True
        return self._clock() <= watch.now_s + self._terms.step_s

    def _take_beat(self, data: bytes) -> None:
        try:
            beat = decode_beat(data)
        except SectorError:
            return  # another one comes
        if beat.run == self.member.run and self._clock is None:
            self._at_s = max(self._at_s, beat.sent_s)
        self.member.hear(beat, self._now_s())

    def _report(self) -> None:
        self._now_s()
        self._at_s += _INSTANT_S  # no two reports have one time
        report = self.member.report(self._at_s)
        self._sent_s = report.sent_s
        self._send(encode_report(report))

    def _now_s(self) -> float:
        if self._clock is not None:
            self._at_s = self._clock()
        else:
            self._at_s = max(self._at_s, self._session.transactions.now_s)
        return self._at_s

    # --- calls ---------------------------------------------------------------

    def _serve(self, call: Call) -> Columns:
        session = self._session
        if call.kind is Kind.PREPARE:
            self._run(call)
        elif call.kind in (Kind.LOOK, Kind.CONFIGURE):
            take_places(session, call.columns, np.flatnonzero(~session.robots["placed"]))
            if call.kind is Kind.LOOK:
                find_causes(session.protocol, self._now_s())
            elif session.state is not SessionState.STOPPED:
                session.configure(self._now_s())
        elif call.kind is Kind.VOUCH:
            self._vouch(call.columns)
        elif call.kind is Kind.CLEAR and session.state is not SessionState.UNCONFIGURED:
            session.clear(self._now_s())
        elif call.kind is Kind.STOP:
            session.stop(self._now_s())
        return table_of(session)

    def _vouch(self, columns: Columns) -> None:
        session = self._session
        ids = column(columns, "ids", "i8", (None,))
        rows = session.plane.index_of(ids)
        rows = rows[(rows >= 0) & session.robots["lost"][rows]]
        take_places(session, columns, rows)
        session.robots["lost"][rows] = True  # for which it is vouched now
        session.vouch(session.plane.ids[rows])

    def _run(self, call: Call) -> None:
        """Carry out a run: load, wait for the others, count down, move."""
        session, run = self._session, number_of(call.columns, "run", "i8", 1, MOST_NUMBER)
        motion = motion_of(session.units, call.columns)
        if session.state in (SessionState.STOPPED, SessionState.READY):
            session.clear(self._now_s())  # the coordinator has decided that
        if not self.member.begin(run, self._now_s()):
            raise SectorError(f"run {run} does not follow run {self.member.run}")
        self._check_end()
        self._asked = self._alone = False
        complete = False
        try:
            session.submit(motion)
            session.start(self._now_s(), self._may_go)
            complete = session.state is SessionState.IDLE and not session.robots["started"].any()
            if session.state is SessionState.MOVING:
                self._move()
                complete = session.state is SessionState.IDLE
        finally:
            if session.state is SessionState.MOVING:
                session.stop(self._now_s())
            if complete and not self.member.why:
                self.member.ended()
            else:
                self.member.stopped("robots have failed, or did not confirm the countdown")
            self._report()
        if self._answered is None:  # no order could be verified
            self._answer(self._loaded())

    def _loaded(self) -> Columns:
        """What was loaded and verified, and the time that its countdown takes."""
        session, phase = self._session, self._session.protocol.phase
        c, config = session.protocol, session.config
        frames = None if phase is None else phase.frames
        data = b"" if frames is None else frames.data.tobytes()
        verify_s = 0.0 if phase is None else phase.verify_s
        lasts_s = countdown_s(verify_s, c.silence_s, config.heartbeat_period_s)
        return table_of(session) | {
            "crc": np.array(zlib.crc32(data)),
            "terms": np.array(astuple(self._terms), dtype=float),
            "in_real_time": np.array(self._clock is not None),
            "lasts_s": np.array(lasts_s),
            "ahead_s": np.array(self._ahead_s),
        }

    @property
    def _ahead_s(self) -> float:
        """Time before the start after which a STOP may come too late for some robots [s]."""
        c = self._session.protocol
        return c.silence_s + 2.0 * self._session.config.heartbeat_period_s

    # --- a run ---------------------------------------------------------------

    def _may_go(self) -> bool:
        """Tell what was verified; wait until all sectors have, and for the start."""
        if self._asked:
            self.member.stopped("a robot has not confirmed the countdown")
            return False  # the coordinator begins a new run
        self._asked = True
        self._answer(self._loaded())
        if not self._session.robots["verified"].any():
            return True  # nothing to start
        self.member.ready()
        period_s = self._terms.period_s / self._scale
        while True:
            decision = self.member.decide(self._now_s())
            if decision is Decision.GO:
                self._session.protocol.start_at_s = self.member.start_s
                phase = self._session.protocol.phase
                if phase is not None and self._clock is not None:
                    # the buses have waited: a GO that is late would begin the motion late
                    phase.t = max(phase.t, self._now_s() + _GO_AFTER_S)
                return True
            if decision is Decision.STOP:
                return False
            self._listen(self._terms.ready_s if self._clock is None else period_s)

    def _listen(self, wait_s: float) -> None:
        """Hear the beats that have come, or wait for one; keep calls for later."""
        taken = self.inbox.take(wait_s)
        for data in taken:
            if data[:4] == CALL:
                self._keep(data)
            else:
                self._hear(data)
        if not taken and self._clock is None:
            # the time that nothing was heard for passes on the buses as well
            self._alone = True
            self._at_s += wait_s

    def _keep(self, data: bytes) -> None:
        """Keep a call for later; one that is newer than this run ends it.

        A coordinator calls no sector that is under way: this one was killed, and another began.
        """
        self._later.append(data)
        try:
            call = decode_call(data)
        except SectorError:
            return  # is sent again
        newest = 0 if self._call is None else self._call.number
        if call.sector == self._number and call.number > newest:
            self.member.why = self.member.why or "the coordinator has begun anew"

    def _move(self) -> None:
        session, member, period_s = self._session, self.member, self._terms.period_s
        c, phase = session.protocol, session.protocol.phase
        assert phase is not None  # robots count down
        deadline_s = phase.start_s - self._ahead_s
        member.confirmed(phase.start_s, deadline_s, self._now_s())
        self._report()
        told = member.stage
        while session.state is SessionState.MOVING:
            if self._clock is None and not self._alone:
                self._wait_for_answer()
            now_s = self._now_s()
            decision = member.decide(now_s)
            if decision is Decision.STOP:
                session.stop(now_s)
                return
            limit_s = member.lease_s if decision is Decision.MOVE else deadline_s
            until_s = min(now_s + (period_s if self._clock is None else 0.0), limit_s)
            if self._leased is None:
                session.advance(until_s)
            elif not self._leased.advance_one_step(session, until_s, limit_s):
                member.why = member.why or "the lease has ended: a step came late"
                continue  # to the decision, which is STOP
            if self._clock is None:
                self._at_s = max(self._at_s, until_s)
            if session.state is not SessionState.MOVING:
                return  # a beat that is answered from now on would tell that it moves
            if self._clock is not None:
                # to the next step of the supervision; a beat is heard in between
                due_s = period_s / 4 if c.watch is None else c.watch.now_s - self._now_s()
                self._listen(min(max(due_s, 0.0), period_s / 4) / self._scale)
            self._tell_table(now_s)
            # beats are answered as they come
            owes = self._clock is None or member.stage is not told or self._owes
            if owes and self._in_time():
                self._owes = False
                self._report()
                told = member.stage

    def _wait_for_answer(self) -> None:
        """Wait for a beat that answers the last report; the time of the buses stands still."""
        until_s = self._wall() + self._patience_s
        while not self.member.answered(self._sent_s) and not self.member.why:
            left_s = until_s - self._wall()
            if left_s <= 0.0:
                self._alone = True  # the motion goes on to the end of the lease
                return
            for data in self.inbox.take(left_s):
                if data[:4] == CALL:
                    self._keep(data)
                else:
                    self._take_beat(data)
                    if not self.member.answered(self._sent_s):
                        self._report()

    def _tell_table(self, now_s: float) -> None:
        if now_s >= self._tabled_s + _TABLE_S or now_s < self._tabled_s:
            self._tabled_s = now_s
            self._send(encode_call(self._number, Kind.TABLE, 0, table_of(self._session)))

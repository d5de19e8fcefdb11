# SPDX-License-Identifier: Apache-2.0
"""The session with a plane of many sectors: the calls and the states of any session.

The protocol and its table of states are those of one bridge; the steps that use buses are others:
they call the sectors, which use theirs.
"""

import zlib
from collections.abc import Callable, Iterable
from dataclasses import astuple
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge import Session, SessionConfig
from fiber_bus_bridge.bus import Recovery, Replies
from fiber_bus_bridge.protocol import Context, Event, Phase, State, Watch
from fiber_bus_bridge.protocol.ending import end_plan, rests
from fiber_bus_bridge.protocol.loading import certify, commit
from fiber_bus_bridge.protocol.stopping import judge_stopped, resume_cleared
from fiber_bus_bridge.protocol.tables import begin_watch
from fiber_bus_bridge.wire import Frames, encode_load
from fiber_core.array_types import Ints, Mask, Rows
from fiber_core.clearance import Safety
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireUnits
from fiber_sectors.calls import Columns, Kind
from fiber_sectors.conductor import Step
from fiber_sectors.errors import SectorError
from fiber_sectors.exchange import Links, Pace, Sectors
from fiber_sectors.tables import Loaded, loaded_of, motion_columns, place_columns
from fiber_sectors.terms import Terms

__all__ = ["SectoredSession"]

_ROUNDS = 6  # runs tried before nothing is started
_VOUCH_S = 10.0
_MEASURED = 100  # beats by which the clocks are measured before a start is given up
_SPARE = 4  # periods of a countdown for the exchange of confirmations


class _NoBuses:
    # a coordinator has no buses of its own

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        raise AssertionError("a coordinator has no buses")

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        return t, True

    def alert_lines(self, t: float) -> Ints:
        return np.zeros(0, dtype=np.int64)


class SectoredSession(Session):
    """The controller of a plane whose buses are shared out to sectors.

    Args:
        plane: the focal plane, with its sectors.
        units: tick, quantum and widths of the wire format.
        safety: clearance required of every started motion, that at borders included.
        assumed: angles of robots that have never answered [rad], shape (n, 2).
        config: settings.
        terms: the times on which all sectors agree.
        links: the connections with the sectors.
        pace: how time goes on.

    Raises:
        MotionError: the safety contains less than the terms allow.
        SectorError: the settings do not keep to the terms.
    """

    has_buses: ClassVar[bool] = False

    def __init__(
        self,
        plane: FocalPlane,
        units: WireUnits,
        safety: Safety,
        assumed: ArrayLike,
        config: SessionConfig,
        terms: Terms,
        links: Links,
        pace: Pace,
    ):
        self.border_skews_s = terms.border_skews_s(safety)
        safety.check_borders(*self.border_skews_s)
        terms.check_session(config)
        if not config.counters_kept:
            raise SectorError(
                "session.counters_kept is false: a plane of sectors cannot find robots at unknown "
                "places; one bridge for the plane can"
            )
        super().__init__(plane, units, safety, _NoBuses(), assumed, config)
        self._terms = terms
        self.sectors = Sectors(self.protocol, terms, links, pace)
        self._ahead_s = self._lasts_s = 0.0
        self.transactions.counters.table = self.sectors.counters  # type: ignore[method-assign]
        self.protocol.steps = {
            State.CONFIGURING: self._configure_sectors,
            State.LOADING: self._of_phase(self._load),
            State.VERIFIED: self._of_phase(certify),
            State.DISARMING: self._of_phase(self._disarm),
            State.CERTIFIED: self._of_phase(self._go),
            State.COUNTDOWN: self._of_phase(self._count_down),
            State.CANCELLING: self._of_phase(self._cancel),
            State.DROPPING: self._of_phase(self._drop),
            State.MOVING: self._of_phase(self._move),
            State.STOPPING: self._of_phase(self._stop_sectors),
            State.RESUMING: self._of_phase(resume_cleared),
            State.HALTING: self._halt,
            State.CLEARING: self._clear_sectors,
        }

    @staticmethod
    def _of_phase(step: Callable[[Context, Phase], Event]) -> Callable[[Context], Event]:
        def run_step(c: Context) -> Event:
            assert c.phase is not None  # a phase is under way in this state
            return step(c, c.phase)

        return run_step

    def vouch(self, ids: ArrayLike) -> None:
        """Believe that robots that do not answer rest where they were read last, or assumed.

        Their sectors are told; one that is away is told when it is configured again.

        Args:
            ids: ids of the robots, shape (k,).

        Raises:
            SessionError: as of Session.vouch.
            SectorError: a sector does not believe it.
        """
        robots = self.robots
        before = robots["placed"].copy(), robots["lost"].copy()
        super().vouch(ids)
        vouched = np.isin(self.plane.ids, ids)
        present = [k for k in range(self.sectors.number) if k not in self.sectors.gone]
        columns = {
            k: place_columns(self.protocol, rows) | {"ids": self.plane.ids[rows[vouched[rows]]]}
            for k, rows in enumerate(self.sectors.rows)
            if k in present and vouched[rows].any()
        }
        self.sectors.why = ""
        if self.sectors.call(Kind.VOUCH, columns, _VOUCH_S).keys() != columns.keys():
            robots["placed"], robots["lost"] = before
            raise SectorError(self.sectors.why or "a sector does not answer")

    # --- steps ---------------------------------------------------------------

    def _configure_sectors(self, c: Context) -> Event:
        sectors: Iterable[int] = range(self.sectors.number)
        if c.note_ends is not None:
            sectors = self._look(c, c.note_ends)
        answers = self._ask(Kind.CONFIGURE, sectors)
        self._check_answers()
        c.robots["lost"] |= ~c.robots["placed"]
        if c.note_ends is not None:  # some may have stopped meanwhile
            c.note_ends(rests(c))
        stopped = any(bool(answer["stopped"]) for answer in answers.values())
        return Event.FOUND_STOPPED if stopped or c.was_stopped else Event.CONFIGURED

    def _look(self, c: Context, note_ends: Callable[[Mask], None]) -> list[int]:
        """Note why the robots rest; return the sectors that have told it.

        Another sector is not configured: its robots would forget what was not noted.
        """
        answers = self._ask(Kind.LOOK, range(self.sectors.number))
        self._check_answers()
        silent = ~np.isin(c.plane.sector, list(answers))
        c.robots["state"][silent], c.robots["rest_cause"][silent] = 0, Reason.BUS_FAILED
        note_ends(rests(c))
        return list(answers)

    def _ask(
        self, kind: Kind, sectors: Iterable[int], wait_s: float | None = None
    ) -> dict[int, Columns]:
        """Let sectors find their robots, and tell them where those rest that may not answer."""
        places = {k: place_columns(self.protocol, self.sectors.rows[k]) for k in sectors}
        return self.sectors.call(kind, places, wait_s)

    def _check_answers(self) -> None:
        for text in self.sectors.malformed.values():
            raise SectorError(text)

    def _load(self, c: Context, phase: Phase) -> Event:
        """Let the sectors with robots to move load and verify, side by side."""
        if self.sectors.conductor.step is not Step.OVER:
            self.sectors.finish("the orders are loaded again")
        self.sectors.why = ""
        if phase.rounds == _ROUNDS:
            return Event.EXHAUSTED
        phase.rounds += 1
        robots, wanted = c.robots, c.robots["wanted"].copy()
        part = [k for k in range(self.sectors.number) if wanted[self.sectors.rows[k]].any()]
        for k in [k for k in part if k in self.sectors.gone]:
            part.remove(k)
            robots["reason"][self.sectors.rows[k]] = np.where(
                wanted[self.sectors.rows[k]],
                Reason.BUS_FAILED,
                robots["reason"][self.sectors.rows[k]],
            )
        run = self.sectors.next_number()
        self.sectors.conductor.begin(run, self.sectors.now_s(), part)
        motion = phase.motion.only(wanted)
        columns = {
            k: motion_columns(motion.of_robots(self.sectors.rows[k])) | {"run": np.array(run)}
            for k in part
        }
        reason = robots["reason"].copy()
        answers = self.sectors.call(Kind.PREPARE, columns, of_run=("verified", "reason"))
        robots["reason"] = np.where(wanted, robots["reason"], reason)
        sequence = c.buses["sequence"][c.bus]
        phase.frames = encode_load(c.transactions.addresses, sequence, motion, c.listed)
        others: list[int] = []  # sectors that hold other orders or other terms, or do not answer
        told: list[Loaded] = []
        for k in part:
            rows, answer = self.sectors.rows[k], answers.get(k)
            loaded = None if answer is None else self._agreed(answer, phase.frames, rows)
            if loaded is not None:
                told.append(loaded)
                continue
            others.append(k)
            robots["verified"][rows] = False
            why = Reason.BUS_FAILED if answer is None else Reason.NOT_VERIFIED
            robots["reason"][rows[wanted[rows]]] = why
        robots["verified"] &= wanted
        robots["wanted"] &= robots["reason"] == Reason.OK
        if others:  # what they hold is not what is certified: a run that they are in never starts
            self.sectors.finish(f"sectors {others} do not hold these orders under these terms")
            return self._load(c, phase)
        self._ahead_s = max((each.ahead_s for each in told), default=0.0)
        self._lasts_s = max((each.lasts_s for each in told), default=0.0)
        return Event.VERIFIED

    def _agreed(self, answer: Columns, frames: Frames, rows: Rows) -> Loaded | None:
        """What a sector has loaded; None if it holds other orders or moves under other terms."""
        try:
            loaded = loaded_of(answer)
        except SectorError as error:
            self.sectors.why = str(error)
            return None
        # the certificate is of these bytes, and of the lease that the terms give
        terms = np.array(astuple(self._terms), dtype=float)
        agrees = _crc(frames, rows) == loaded.crc and np.array_equal(loaded.terms, terms)
        agrees &= loaded.in_real_time == self.sectors.in_real_time
        return loaded if agrees else None

    def _disarm(self, c: Context, phase: Phase) -> Event:
        """Begin a new run without the unsafe robots: no sector starts what it holds."""
        c.robots["verified"] = False
        phase.motion = phase.motion.only(c.robots["wanted"])
        return Event.ARMED

    def _go(self, c: Context, phase: Phase) -> Event:
        if not c.may_go():
            return Event.REFUSED
        if not c.robots["verified"].any():
            self.sectors.finish("there is nothing to move")
            phase.go_s = phase.start_s = self.sectors.now_s()
            commit(c, phase)
            return Event.NONE_LEFT
        conductor, terms = self.sectors.conductor, self._terms
        conductor.beats_go_on(self.sectors.now_s())  # the plane was certified
        while not conductor.ready and conductor.step is Step.LOADING:
            self.sectors.exchange()
        for measured in range(_MEASURED):
            known = measured >= _SPARE and conductor.clocks_known(self.sectors.now_s())
            if known or conductor.step is not Step.LOADING:
                break
            self.sectors.exchange()
        extra_s = self._ahead_s + (terms.spare + _SPARE) * terms.period_s
        phase.go_s = self.sectors.now_s()
        phase.start_s = phase.go_s + self._lasts_s + extra_s
        try:
            conductor.go(phase.start_s, self._ahead_s, phase.go_s)
        except SectorError as error:
            self.sectors.why = conductor.why or str(error)
            return Event.REFUSED
        begin_watch(c.robots, c.buses, phase.go_s)
        c.watch = Watch(phase.go_s, {}, np.zeros(0, dtype=np.int64))
        return Event.GO_SENT

    def _count_down(self, c: Context, phase: Phase) -> Event:
        self.sectors.exchange()
        watch, step = self._watch(c), self.sectors.conductor.step
        if step is Step.COUNTING:
            return Event.POLLED
        if step is Step.MOVING:
            lasts_s = commit(c, phase).makespan_s + c.plane.drive.longest_ramp_s
            watch.ends_s = phase.start_s + lasts_s
            c.robots["confirmed"] = c.robots["started"]
            return Event.CONFIRMED
        return Event.UNCONFIRMED

    def _watch(self, c: Context) -> Watch:
        assert c.watch is not None  # sectors count down, or move
        c.watch.now_s = self.sectors.now_s()
        return c.watch

    def _cancel(self, c: Context, phase: Phase) -> Event:
        """No lease was given: no robot has moved. Leave out those that did not take part."""
        robots, was, reason = c.robots, c.robots["wanted"].copy(), c.robots["reason"].copy()
        self.sectors.finish(of_run=("reason",))
        robots["reason"] = np.where(was, robots["reason"], reason)
        failed = was & (~robots["known"] | (robots["reason"] != Reason.OK))
        gone = np.isin(c.plane.sector, list(self.sectors.gone))
        robots["reason"][failed & gone] = Reason.BUS_FAILED
        vague = failed & (robots["reason"] == Reason.OK)
        robots["reason"][vague] = Reason.NOT_ACKNOWLEDGED
        robots["wanted"] = was & ~failed
        robots["started"] = False
        c.watch = None
        return Event.CANCELLED

    def _drop(self, c: Context, phase: Phase) -> Event:
        robots = c.robots
        robots["reason"][robots["wanted"]] = Reason.STOPPED
        self.sectors.finish(self.sectors.why or "the start was refused")
        robots["verified"] = robots["started"] = False
        phase.loaded = phase.motion.only(robots["verified"])
        _, _, phase.certificate = c.certify(c.plane, phase.loaded.decoded(), c.safety)
        phase.go_s = phase.start_s = self.sectors.now_s()
        commit(c, phase)
        return Event.DROPPED

    def _move(self, c: Context, phase: Phase) -> Event:
        self.sectors.exchange()
        watch, conductor = self._watch(c), self.sectors.conductor
        if conductor.step is Step.MOVING:
            return Event.STEPPED
        if conductor.why:
            stop_s = conductor.stop_s
            watch.stop_all_at_s = watch.now_s if np.isnan(stop_s) else stop_s
            return Event.FAILURE
        self.sectors.finish(of_run=("arrived", "cause"))
        return Event.ARRIVED

    def _stop_sectors(self, c: Context, phase: Phase) -> Event:
        assert c.watch is not None and c.watch.stop_all_at_s is not None
        phase.stopped_at_s, c.watch = c.watch.stop_all_at_s, None
        moved = c.robots["started"] & ~c.robots["arrived"]
        self.sectors.finish(of_run=("arrived", "cause"))
        moved &= ~c.robots["arrived"]
        c.t = self.sectors.now_s()
        own = c.robots["cause"].copy()
        event = judge_stopped(c, moved, np.zeros(c.plane.n, dtype=bool))
        # what the sector has seen as it happened says more
        c.robots["cause"] = np.where(own != Reason.OK, own, c.robots["cause"])
        return event

    def _halt(self, c: Context) -> Event:
        c.watch = None
        c.transactions.revive()
        self.sectors.finish("the coordinator stops all", ("arrived", "cause"))
        present = {k: {} for k in range(self.sectors.number) if k not in self.sectors.gone}
        self.sectors.call(Kind.STOP, present, 10.0)
        end_plan(c)
        return Event.HALTED

    def _clear_sectors(self, c: Context) -> Event:
        end_plan(c)
        c.was_stopped = False
        c.transactions.revive()
        self.sectors.finish("cleared")
        present = {k: {} for k in range(self.sectors.number) if k not in self.sectors.gone}
        self.sectors.call(Kind.CLEAR, present)
        if self.sectors.gone:  # one that began anew
            self._ask(Kind.CONFIGURE, self.sectors.gone, 1.0)
        return Event.CLEARED if c.robots["known"].any() else Event.NONE_KNOWN


def _crc(frames: Frames, rows: Rows) -> int:
    return zlib.crc32(frames[rows].data.tobytes())

"""What robots were told to do and how far they got, read back from the bytes on the buses."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fiber_bus_bridge.wire import Addresses, Frames, RobotState, decode_load
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.executed_orders import follow
from fiber_recording.phases import Phase, executed_motion
from fiber_recording.status_replies import StatusReplies, rows_of_frames
from fiber_recording.stop_time import stop_time_s

__all__ = ["Replay", "replay", "unexplained"]

_TOGETHER_S = 0.01  # starts this near to each other are one


@dataclass(frozen=True, eq=False)
class Replay:
    """A plan as its bytes tell it.

    Args:
        phases: the orders that were started, and how far robots got with them; one more for
            each time they went on after a stop.
        started: robots that a GO reached with an order for it, shape (n,).
        lost: robots that stopped and were not heard of again, shape (n,). One that fell
            silent alone is where it was last heard. Where a whole bus did, its robots, which
            hear nothing either, stop by themselves just when the others are stopped.
        load_bytes: bytes of the order each of them was started with first, shape (n,), else 0.
        load_s: when the first LOAD began, simulated time [s], nan without one.
        go_s: when the last GO of the first phase began [s], nan without one.
        start_s: when its countdown was over [s], but for the 0.1 ms the frame itself takes.
    """

    phases: tuple[Phase, ...]
    started: np.ndarray
    lost: np.ndarray
    load_bytes: np.ndarray
    load_s: float
    go_s: float
    start_s: float

    @property
    def motion(self) -> WireMotion:
        """The orders that were started first, to their end."""
        return self.phases[0].motion

    @property
    def end(self) -> np.ndarray:
        """Where encoders are after it all [quanta], shape (n, 2)."""
        return self.phases[-1].end

    @cached_property
    def executed(self) -> SegmentMotion:
        """The motion as it was carried out."""
        return executed_motion(self.phases)

    @property
    def bus_time_s(self) -> float:
        """Time from the first LOAD to the GO on the buses [s], 0 without a GO."""
        return float(self.go_s - self.load_s) if np.isfinite(self.go_s) else 0.0


def replay(
    plane: FocalPlane, units: WireUnits, counts, logs: Iterable[FrameLog], heard=None
) -> Replay:
    """Follow the frames of a plan as the robots do, through stops and new starts.

    Where a robot came to rest on its way is what its encoders say afterwards.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of the wire format.
        counts: encoders before the plan [quanta], shape (n, 2).
        logs: its frames, in the order they were published.
        heard: where encoders were last heard to be [quanta], shape (n, 2); by default what is
            in the frames, which are not all published while robots move.
    """
    log = FrameLog.joined(logs)
    runs = follow(plane, log)
    order = np.argsort(runs.begin_s, kind="stable")
    runs = runs.only(order)
    of_leg = _together(runs.begin_s)
    # what was told to go together was certified together: who was called off belongs to it,
    # unless all were
    began = np.isin(of_leg, of_leg[~runs.off])
    runs, of_leg = runs.only(began), _together(runs.begin_s[began])
    count = int(of_leg.max(initial=-1)) + 1
    begins_s = np.array([runs.begin_s[of_leg == phase][0] for phase in range(count)])
    frames = Frames(Addresses(log.bus, log.address, log.ten_bit), log.offsets, log.data)
    said = _Said(log, plane, heard)
    lost = np.zeros(plane.n, dtype=bool)
    phases, here = [], np.asarray(counts)
    next_s = _next_of_robot(runs)
    for phase, begin_s in enumerate(begins_s):
        chosen = np.flatnonzero(of_leg == phase)
        chosen = chosen[np.argsort(runs.row[chosen], kind="stable")]
        mine = runs.only(chosen)
        motion = _motion(units, here, mine.row, frames[mine.frame])
        phases.append(_phase(plane, motion, mine, begin_s, next_s[chosen], begins_s[0], said, lost))
        here = phases[-1].end
    first = runs.only(of_leg == 0)
    started, load_bytes = np.zeros(plane.n, dtype=bool), np.zeros(plane.n, dtype=np.int64)
    runs = runs.only(~runs.off)
    started[runs.row] = True
    load_bytes[runs.row[::-1]] = frames[runs.frame[::-1]].lengths
    nothing = Phase.whole(WireMotion(units, here, np.zeros(2 * plane.n + 1), [], []))
    return Replay(
        tuple(phases) or (nothing,), started, lost, load_bytes, runs.load_s,
        float(first.go_s.max()) if count else np.nan, float(begins_s[0]) if count else np.nan,
    )  # fmt: skip


def _together(begin_s):
    # which starts are one, numbered from 0, of starts in order
    return np.cumsum(np.diff(begin_s, prepend=-np.inf) > _TOGETHER_S) - 1


def _next_of_robot(runs):
    # when the robot of each run begins its next one [s]
    next_s = np.full(len(runs.row), np.inf)
    order = np.lexsort([runs.begin_s, runs.row])
    again = runs.row[order[1:]] == runs.row[order[:-1]]
    next_s[order[:-1][again]] = runs.begin_s[order[1:][again]]
    return next_s


class _Said:
    """Where robots said they were, by robot and in time."""

    def __init__(self, log, plane, heard):
        self.heard = heard
        replies = StatusReplies(log, rows_of_frames(plane, log))
        kept = np.flatnonzero(replies.placed)
        kept = kept[np.lexsort([log.time_s[replies.frame[kept]], replies.row[kept]])]
        self.time_s = log.time_s[replies.frame[kept]]
        self.position, self.state = replies.position[kept], replies.state[kept]
        self._row = replies.row[kept]
        self._first = np.searchsorted(self._row, np.arange(plane.n + 1))

    def since(self, time_s):
        """Robots that said something from a time on."""
        return np.unique(self._row[self.time_s >= time_s])

    def last(self, row, since_s, until_s):
        """The last reading of a robot between two times, or None."""
        part = slice(self._first[row], self._first[row + 1])
        at = self._first[row] + np.searchsorted(self.time_s[part], until_s) - 1
        return at if at >= self._first[row] and self.time_s[at] > since_s else None


def _motion(units, counts, rows, frames) -> WireMotion:
    # the orders of some robots, in the order of their rows; the others rest
    orders = decode_load(units, frames)
    segments = np.zeros((len(counts), 2), dtype=np.int64)
    segments[rows] = np.diff(orders.offsets).reshape(-1, 2)
    offsets = np.concatenate([[0], np.cumsum(segments)])
    return WireMotion(units, counts, offsets, orders.ticks, orders.velocity)


def _phase(plane, motion, runs, begin_s, next_s, zero_s, said, lost) -> Phase:
    n, ends_s = len(motion.start), motion.decoded().durations.max(axis=1)
    stop_us, stop = np.full(n, -1), np.zeros((n, 2), dtype=np.int64)
    begin_us = round(1e6 * (begin_s - zero_s))

    def stands(row, about_s, place):
        stood_s = stop_time_s(motion, row, place, min(about_s, ends_s[row]))
        stop_us[row], stop[row] = begin_us + round(1e6 * stood_s), place

    off = runs.row[runs.off]
    stop_us[off], stop[off] = begin_us, motion.start[off]
    runs, next_s = runs.only(~runs.off), next_s[~runs.off]
    first_s = runs.stop_s.min(initial=np.inf)
    together_s, talks = first_s - begin_s, plane.bus[said.since(first_s)]
    silent = []
    for row, told_s, until_s in zip(runs.row.tolist(), runs.stop_s.tolist(), next_s.tolist()):
        at, told_s = said.last(row, begin_s, until_s), told_s - begin_s
        if at is None and min(told_s, together_s) >= ends_s[row]:
            continue  # nothing says that it did not get to its end
        moved_on = at is not None and said.state[at] == RobotState.MOVING
        if at is None or (moved_on and said.time_s[at] < begin_s + ends_s[row]):
            silent.append((row, said.position[at] if at is not None else motion.start[row]))
        elif (said.position[at] != motion.end[row]).any():
            stands(row, told_s, said.position[at])
    whole = Phase.whole(motion)
    for row, place in silent:
        lost[row] = True
        if plane.bus[row] in talks or not np.isfinite(together_s):
            stands(row, together_s, place if said.heard is None else said.heard[row])
        elif together_s < ends_s[row]:
            stop_us[row] = begin_us + round(1e6 * together_s)
            stop[row] = whole.counts_at([row], [round(1e6 * together_s)])[0]
    return Phase(motion, begin_us, stop_us, stop)


def unexplained(plane: FocalPlane, told: Replay, ended: PlanOutcome, counts) -> np.ndarray:
    """Return the robots that are elsewhere than a replay takes them, shape (n,).

    Args:
        plane: the focal plane.
        told: the replay.
        ended: what became of its plan; robots that failed or were stopped may be anywhere.
        counts: encoders now [quanta], shape (n, 2).
    """
    ended = ended.of(plane.ids)
    obeyed = (ended.outcome != Outcome.FAILED) & (ended.reason != Reason.STOPPED)
    return (told.end != counts).any(axis=1) & obeyed

# SPDX-License-Identifier: Apache-2.0
"""Follows the frames of a plan as robots do, and returns the motion that robots executed."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.wire import Addresses, Frames, RobotState, Speeds, decode_load
from fiber_core.array_types import Bools, Codes, Counts, Ints, Mask, Rows, Times
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.executed_orders import StartedOrders, started_orders
from fiber_recording.phases import Phase, executed_motion
from fiber_recording.status_replies import StatusReplies, rows_of_frames
from fiber_recording.stop_time import stop_time_s

__all__ = ["Replay", "replay", "unexplained"]

_SAME_START_S = 0.01  # orders that begin this close to each other are of the same phase


@dataclass(frozen=True, eq=False)
class Replay:
    """The motion of a plan, as its frames show it.

    Args:
        phases: the orders that were started, and how far robots got with them; one more for
            each time the robots were resumed after a stop.
        started: robots that received a GO for an order that they stored, shape (n,).
        lost: robots that stopped and sent no position afterwards, shape (n,). If other robots
            of its bus still answer, a lost robot is placed where its last reply said. If no
            robot of the bus answers, none receives a heartbeat either, so all of them stop by
            themselves about when the other robots are stopped; they are placed there.
        load_bytes: size of the first order of each started robot [bytes], shape (n,), else 0.
        load_s: begin of the first LOAD, in the time of the frames [s], nan without one.
        go_s: begin of the last GO of the first phase [s], nan without one.
        start_s: end of its countdown [s], but for the 0.1 ms that the frame of the GO lasts.
    """

    phases: tuple[Phase, ...]
    started: Mask
    lost: Mask
    load_bytes: Ints
    load_s: float
    go_s: float
    start_s: float

    @property
    def motion(self) -> WireMotion:
        """The orders of the first phase, to their end."""
        return self.phases[0].motion

    @property
    def end(self) -> Counts:
        """Encoders after the last phase [quanta], shape (n, 2)."""
        return self.phases[-1].end

    @cached_property
    def executed(self) -> SegmentMotion:
        """The motion that robots executed."""
        return executed_motion(self.phases)

    @property
    def bus_time_s(self) -> float:
        """Time from the first LOAD to the GO [s], 0 without a GO."""
        return float(self.go_s - self.load_s) if np.isfinite(self.go_s) else 0.0


def replay(
    plane: FocalPlane,
    units: WireUnits,
    counts_before: ArrayLike,
    logs: Iterable[FrameLog],
    counts_after: ArrayLike | None = None,
) -> Replay:
    """Follow the frames of a plan as robots do, through stops and resumed motion.

    A robot that did not reach the end of its order is placed where its encoders were afterwards.

    Args:
        plane: the focal plane, with bus and address of every robot.
        units: tick, quantum and field widths of the orders.
        counts_before: encoders before the plan [quanta], shape (n, 2).
        logs: the frames of the plan, in the order in which the buses carried them.
        counts_after: last known encoders [quanta], shape (n, 2), for lost robots; by default
            those in the frames, of which some are missing while robots move.

    Raises:
        FiberError: the frames do not fit the plane.
    """
    log = FrameLog.joined(logs)
    orders, phase_of = _orders_by_phase(plane, log)
    count = int(phase_of.max(initial=-1)) + 1
    begins_s = np.array([orders.begin_s[phase_of == k][0] for k in range(count)])
    frames = Frames(Addresses(log.bus, log.address, log.ten_bit), log.offsets, log.data)
    stops = _Stops(plane, log, None if counts_after is None else np.asarray(counts_after))
    next_s = _next_begin_s(orders)
    phases, counts = [], np.asarray(counts_before)
    for k, begin_s in enumerate(begins_s):
        chosen = np.flatnonzero(phase_of == k)
        chosen = chosen[np.argsort(orders.row[chosen], kind="stable")]
        own = orders.only(chosen)
        motion = _motion(plane, units, counts, own.row, frames[own.frame])
        phases.append(stops.phase(motion, own, begin_s, next_s[chosen], begins_s[0]))
        counts = phases[-1].end
    first = orders.only(phase_of == 0)
    started, load_bytes = np.zeros(plane.n, dtype=bool), np.zeros(plane.n, dtype=np.int64)
    orders = orders.only(~orders.cancelled)
    started[orders.row] = True
    load_bytes[orders.row[::-1]] = frames[orders.frame[::-1]].lengths
    return Replay(
        phases=tuple(phases) or (Phase.whole(WireMotion.at_rest(units, counts)),),
        started=started,
        lost=stops.lost,
        load_bytes=load_bytes,
        load_s=orders.load_s,
        go_s=float(first.go_s.max()) if count else np.nan,
        start_s=float(begins_s[0]) if count else np.nan,
    )


def _orders_by_phase(plane: FocalPlane, log: FrameLog) -> tuple[StartedOrders, Ints]:
    """Return the started orders in the order of their begin, and the phase of each.

    Orders that begin together were certified together. So a cancelled order belongs to the phase
    of the others, unless all of them were cancelled.
    """
    orders = started_orders(plane, log)
    orders = orders.only(np.argsort(orders.begin_s, kind="stable"))
    phase_of = _numbered(orders.begin_s)
    orders = orders.only(np.isin(phase_of, phase_of[~orders.cancelled]))
    return orders, _numbered(orders.begin_s)


def _numbered(begin_s: Times) -> Ints:
    """Number the begins, which ascend, from 0; the same number for the same start."""
    return np.cumsum(np.diff(begin_s, prepend=-np.inf) > _SAME_START_S) - 1


def _next_begin_s(orders: StartedOrders) -> Times:
    """Return for each order when the next order of its robot begins [s], inf without one."""
    next_s = np.full(len(orders.row), np.inf)
    order = np.lexsort([orders.begin_s, orders.row])
    same_robot = orders.row[order[1:]] == orders.row[order[:-1]]
    next_s[order[:-1][same_robot]] = orders.begin_s[order[1:][same_robot]]
    return next_s


def _motion(
    plane: FocalPlane, units: WireUnits, counts: Counts, rows: Rows, frames: Frames
) -> WireMotion:
    """Return the motion of some robots, rows ascending, from their LOADs; other robots rest."""
    lists = Speeds.of(plane, units)
    orders = decode_load(units, frames, None if lists is None else lists[rows])
    return WireMotion.at_rest(units, counts).with_robots(rows, orders.motion)


class _Reports:
    """Positions that robots reported, sorted by robot and time."""

    def __init__(self, plane: FocalPlane, log: FrameLog):
        replies = StatusReplies(log, rows_of_frames(plane, log))
        kept = np.flatnonzero(replies.placed)
        kept = kept[np.lexsort([log.time_s[replies.frame[kept]], replies.row[kept]])]
        self.time_s: Times = log.time_s[replies.frame[kept]]
        self.position: Counts = replies.position[kept]
        self.state: Codes = replies.state[kept]
        self._row = replies.row[kept]
        self._first = np.searchsorted(self._row, np.arange(plane.n + 1))

    def rows_since(self, time_s: float) -> Rows:
        """Return the robots with a report at or after a time."""
        return np.unique(self._row[self.time_s >= time_s])

    def last(self, row: int, since_s: float, until_s: float) -> int | None:
        """Return the last report of a robot between two times, None without one."""
        part = slice(self._first[row], self._first[row + 1])
        at = int(self._first[row] + np.searchsorted(self.time_s[part], until_s)) - 1
        return at if at >= self._first[row] and self.time_s[at] > since_s else None


class _Stops:
    """Finds where and when robots stopped before the end of their orders.

    Args:
        plane: the focal plane.
        log: all frames of the plan.
        counts_after: last known encoders, as for replay.

    Attributes:
        lost: robots that were lost in a phase so far, shape (n,).
    """

    def __init__(self, plane: FocalPlane, log: FrameLog, counts_after: Counts | None):
        self.lost: Bools = np.zeros(plane.n, dtype=bool)
        self._bus, self._counts_after = plane.bus, counts_after
        self._reports = _Reports(plane, log)

    def phase(
        self,
        motion: WireMotion,
        orders: StartedOrders,
        begin_s: float,
        next_s: Times,
        zero_s: float,
    ) -> Phase:
        """Return a phase: its motion, and where robots stopped on it.

        Args:
            motion: the orders of the phase.
            orders: their robots and times, rows ascending.
            begin_s: begin of the phase, in the time of the frames [s].
            next_s: begin of the next order of each robot [s].
            zero_s: begin of the first phase [s].
        """
        n, ends_s = len(motion.start), motion.decoded().durations.max(axis=1)
        stop_us, stop_counts = np.full(n, -1), np.zeros((n, 2), dtype=np.int64)
        begin_us = round(1e6 * (begin_s - zero_s))

        def set_stop(row: int, near_s: float, counts: Counts) -> None:
            stop_s = stop_time_s(motion, row, counts, min(near_s, ends_s[row]))
            stop_us[row], stop_counts[row] = begin_us + round(1e6 * stop_s), counts

        cancelled = orders.row[orders.cancelled]
        stop_us[cancelled], stop_counts[cancelled] = begin_us, motion.start[cancelled]
        orders, next_s = orders.only(~orders.cancelled), next_s[~orders.cancelled]
        first_stop_s = orders.stop_s.min(initial=np.inf)
        stop_all_s = first_stop_s - begin_s
        lost = []  # row, last reported encoders
        reports, ends = self._reports, motion.end
        for row, stop_s, until_s in zip(
            orders.row.tolist(), orders.stop_s.tolist(), next_s.tolist()
        ):
            at, stop_s = reports.last(row, begin_s, until_s), stop_s - begin_s
            if at is None and min(stop_s, stop_all_s) >= ends_s[row]:
                continue  # there is no sign that it stopped before its end
            moving = at is not None and reports.state[at] == RobotState.MOVING
            if at is None or (moving and reports.time_s[at] < begin_s + ends_s[row]):
                lost.append((row, motion.start[row] if at is None else reports.position[at]))
            elif (reports.position[at] != ends[row]).any():
                set_stop(row, stop_s, reports.position[at])
        answering = self._bus[reports.rows_since(first_stop_s)]  # buses with a later report
        whole = Phase.whole(motion)
        for row, counts in lost:
            self.lost[row] = True
            if self._bus[row] in answering or not np.isfinite(stop_all_s):
                known = counts if self._counts_after is None else self._counts_after[row]
                set_stop(row, stop_all_s, known)
            elif stop_all_s < ends_s[row]:
                stop_us[row] = begin_us + round(1e6 * stop_all_s)
                stop_counts[row] = whole.counts_at([row], [round(1e6 * stop_all_s)])[0]
        return Phase(motion, begin_us, stop_us, stop_counts)


def unexplained(
    plane: FocalPlane, followed: Replay, outcome: PlanOutcome, counts: ArrayLike
) -> Mask:
    """Return the robots with other encoders than a replay leads to, shape (n,).

    Args:
        plane: the focal plane.
        followed: the replay of a plan.
        outcome: how the robots ended the plan; one that failed or was stopped is never returned,
            because it may be anywhere.
        counts: encoders now [quanta], shape (n, 2).
    """
    outcome = outcome.of(plane.ids)
    obeyed = (outcome.outcome != Outcome.FAILED) & (outcome.reason != Reason.STOPPED)
    return (followed.end != np.asarray(counts)).any(axis=1) & obeyed

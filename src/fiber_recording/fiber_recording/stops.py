# SPDX-License-Identifier: Apache-2.0
"""Finds where and when robots stopped before the end of their orders."""

import numpy as np

from fiber_bus_bridge.wire import RobotState
from fiber_core.array_types import Bools, Counts, Times
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.wire_units import WireMotion
from fiber_recording.counters import Counters
from fiber_recording.executed_orders import StartedOrders
from fiber_recording.phases import SETTLING_S, Phase
from fiber_recording.stop_time import StopOnWay, stop_on_way

__all__ = ["Stops"]

_OFF_WAY_RAD = 0.05  # farther from its way no robot comes as it stops: its counters were changed


class Stops:
    """Finds where and when robots stopped before the end of their orders.

    A counter that was set, or lost with the power of its robot, tells of no motion: a reading after
    that is believed where it is on the way of the orders.

    Args:
        plane: the focal plane.
        log: all frames of the plan.
        counts_after: last known encoders, as for replay.

    Attributes:
        lost: robots that were lost in a phase so far, shape (n,).
        changed: robots whose counters changed without motion so far, shape (n,).
    """

    def __init__(self, plane: FocalPlane, log: FrameLog, counts_after: Counts | None):
        self.lost: Bools = np.zeros(plane.n, dtype=bool)
        self.changed: Bools = np.zeros(plane.n, dtype=bool)
        self._bus, self._counts_after = plane.bus, counts_after
        self._counters = Counters(plane, log)
        # counters less where the motion leads, by changes since the begin of the first phase
        self._off: Counts = np.zeros((plane.n, 2), dtype=np.int64)

    def begin(self, counts: Counts, since_s: float, begin_s: float) -> Counts:
        """Return the encoders at the begin of a phase [quanta], shape (n, 2).

        Args:
            counts: those before it [quanta], shape (n, 2).
            since_s: begin of the phase before, -inf without one [s].
            begin_s: begin of the phase [s].
        """
        off = self._counters.with_settings(counts + self._off, since_s, begin_s) - counts
        self.changed |= (off != self._off).any(axis=1)
        if np.isinf(since_s):  # the motion begins where they were set
            return counts + off
        self._off = off
        return counts

    def phase(
        self,
        motion: WireMotion,
        orders: StartedOrders,
        begin_s: float,
        next_s: Times,
        over_s: float,
        zero_s: float,
    ) -> Phase:
        """Return a phase: its motion, and where robots stopped on it.

        Args:
            motion: the orders of the phase.
            orders: their robots and times, rows ascending.
            begin_s: begin of the phase, in the time of the frames [s].
            next_s: begin of the next order of each robot [s].
            over_s: begin of the next phase, until which all robots have stopped [s].
            zero_s: begin of the first phase [s].
        """
        cancelled = orders.row[orders.cancelled]
        orders, next_s = orders.only(~orders.cancelled), next_s[~orders.cancelled]
        until_s = np.minimum(next_s, [self._counters.set_after(row, begin_s) for row in orders.row])
        off = self._off_when_done(motion, orders, begin_s, until_s)
        if begin_s == zero_s:
            motion = motion.starting_at(motion.start + off)
        else:
            self._off += off
        found = _Found(motion, begin_s, over_s, zero_s)
        found.stop_us[cancelled] = found.begin_us
        found.stop_counts[cancelled] = motion.start[cancelled]
        first_stop_s = orders.stop_s.min(initial=np.inf)
        stop_all_s = first_stop_s - begin_s
        lost = []  # row, last reported encoders, and when they were reported
        readings, ends, ends_s = self._counters, motion.end, found.ends_s
        for row, stop_s, end_s in zip(orders.row.tolist(), orders.stop_s.tolist(), until_s):
            (at, lost_power), stop_s = self._reading(found, row, end_s), stop_s - begin_s
            self.changed[row] |= lost_power
            if at is None and min(stop_s, stop_all_s) >= ends_s[row] and not lost_power:
                continue  # there is no sign that it stopped before its end
            time_s = 0.0 if at is None else float(readings.time_s[at]) - begin_s
            moving = at is not None and readings.state[at] == RobotState.MOVING
            if at is None or (moving and time_s < ends_s[row]):
                counts = motion.start[row] if at is None else self._place(at, row)
                lost.append((row, counts, time_s))
            elif (self._place(at, row) != ends[row]).any():
                near_s = min(stop_s, time_s)
                if not found.stop(row, near_s, self._place(at, row)):
                    self.changed[row] = True
                    found.stop_at(row, near_s)
        # buses with a later report
        answering = self._bus[readings.rows_since(first_stop_s)]
        for row, counts, time_s in lost:
            self.lost[row] = True
            if self._bus[row] in answering or not np.isfinite(stop_all_s):
                after = self._counts_after
                after = None if after is None else after[row] - self._off[row]
                if after is None or not found.stop(row, stop_all_s, after, time_s):
                    self.changed[row] |= after is not None
                    if not found.stop(row, stop_all_s, counts):
                        found.stop_at(row, time_s)
            elif stop_all_s < ends_s[row]:
                found.stop_at(row, stop_all_s)
        return Phase(motion, found.begin_us, found.stop_us, found.stop_counts)

    def _place(self, at: int, row: int) -> Counts:
        """A reading, as the counters counted at the begin of the first phase [quanta], (2,)."""
        return self._counters.position[at] - self._off[row]

    def _off_when_done(
        self, motion: WireMotion, orders: StartedOrders, begin_s: float, until_s: Times
    ) -> Counts:
        """How far robots that say they are done are from where their orders lead, shape (n, 2).

        They have made all of their way: so their counters were others when it began.
        """
        off, ends = np.zeros_like(motion.start), motion.end
        for row, end_s in zip(orders.row.tolist(), until_s):
            at = self._counters.last(row, begin_s, end_s)
            if at is not None and self._counters.state[at] == RobotState.DONE:
                off[row] = self._place(at, row) - ends[row]
        self.changed |= off.any(axis=1)
        return off

    def _reading(self, found: "_Found", row: int, until_s: float) -> tuple[int | None, bool]:
        """The last reading of a robot that tells of its motion, and whether it lost its power."""
        readings, begin_s = self._counters, found.begin_s
        at, boot = readings.last(row, begin_s, until_s), readings.boot_at(row, begin_s)
        if at is None or boot is None or readings.boot[at] == boot:
            return at, False
        # it has lost its power since: either its counter outlived that, or it tells nothing
        own = readings.last_of_boot(row, boot, begin_s, until_s)
        since_s = 0.0 if own is None else float(readings.time_s[own]) - begin_s
        time_s = float(readings.time_s[at]) - begin_s
        if found.way(row, time_s, self._place(at, row), since_s, time_s).off_rad <= _OFF_WAY_RAD:
            return at, False
        return own, True


class _Found:
    """Stops of the robots in a phase, as they are found.

    Args:
        motion: the orders of the phase.
        begin_s: begin of the phase, in the time of the frames [s].
        over_s: begin of the next phase [s].
        zero_s: begin of the first phase [s].
    """

    def __init__(self, motion: WireMotion, begin_s: float, over_s: float, zero_s: float):
        n = len(motion.start)
        self.begin_s, self.begin_us = begin_s, round(1e6 * (begin_s - zero_s))
        self.ends_s = motion.decoded().durations.max(axis=1)
        self.stop_us, self.stop_counts = np.full(n, -1), np.zeros((n, 2), dtype=np.int64)
        self._motion, self._whole = motion, Phase.whole(motion)
        self._last_s = over_s - begin_s - 2.0 * SETTLING_S

    def way(
        self, row: int, near_s: float, counts: Counts, since_s: float, until_s: float
    ) -> StopOnWay:
        """As stop_on_way, no later than all robots have stopped."""
        near_s, until_s = min(near_s, self.ends_s[row]), min(until_s, self._last_s)
        return stop_on_way(self._motion, row, counts, near_s, since_s, until_s)

    def stop(self, row: int, near_s: float, counts: Counts, since_s: float = 0.0) -> bool:
        """Take over that a robot stopped at some encoders; return whether they are on its way."""
        stop = self.way(row, near_s, counts, since_s, np.inf)
        if stop.off_rad > _OFF_WAY_RAD:
            return False
        self.stop_us[row] = self.begin_us + round(1e6 * stop.time_s)
        self.stop_counts[row] = counts
        return True

    def stop_at(self, row: int, time_s: float) -> None:
        """Take over that a robot stopped on its way at a time, from the begin of the phase [s]."""
        at_us = round(1e6 * min(time_s, self._last_s, self.ends_s[row]))
        self.stop_us[row] = self.begin_us + at_us
        self.stop_counts[row] = self._whole.counts_at([row], [at_us])[0]

"""Synchronised start and stop: no robot moves until all have confirmed GO; STOP is repeated."""

from typing import NamedTuple

import numpy as np

from fiber_bus_bridge.motion_monitor import MotionMonitor, StatusHandler
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import (
    COUNTDOWN_S,
    VERIFY_BYTES,
    Opcode,
    RobotState,
    Statuses,
    encode_command,
    general_call,
)
from fiber_core.array_types import Ints, Mask, Rows

__all__ = ["AT_REST", "Start", "StartStop"]

AT_REST = (RobotState.UNCONFIGURED, RobotState.STOPPED, RobotState.FAULT)
_LONGEST_S = 0.65  # largest countdown that its field can carry
_SLACK_S = 10e-3  # for robots that need another poll or another GO
_CALLS = 3  # repetitions of the general call STOP
_STOPS = 3  # attempts to stop a single robot


class Start(NamedTuple):
    """Result of a GO.

    Args:
        go_s: time at which the GO was complete [s].
        start_s: time at which the robots begin to move [s].
        monitor: the monitor of the robots; None when the start was cancelled and no robot moves.
        missing: robots because of which the start was cancelled: no confirmation, shape (n,).
        late: robots on buses on which the GO was late and that are not `missing`, shape (n,).
    """

    go_s: float
    start_s: float
    monitor: MotionMonitor | None
    missing: Mask
    late: Mask


class StartStop:
    """Starts robots together and stops them.

    GO is never repeated blindly. It is repeated only to a robot that reports LOADED, with the
    time left of the countdown, so that this robot starts with all others. If a robot does not
    confirm the GO in time, all robots are stopped before one has moved. A robot that cannot be
    told to stop also gets no heartbeat, so it does not start.

    Args:
        transactions: the transactions with the robots.
        silence_s: time without a heartbeat after which robots stop by themselves [s].
        period_s: time between two steps of the monitor [s].
        stretch_s: how much longer than the shortest a heartbeat may take, as in MotionMonitor [s].
        skew_s: largest delay of the GO on a bus after the first bus [s].
        on_statuses: called with rows, their valid statuses, and the time of the poll.
    """

    def __init__(
        self,
        transactions: Transactions,
        silence_s: float,
        period_s: float,
        stretch_s: float,
        skew_s: float,
        on_statuses: StatusHandler,
    ):
        self.transactions, self.on_statuses = transactions, on_statuses
        self.silence_s, self.period_s = silence_s, period_s
        self.stretch_s, self.skew_s = stretch_s, skew_s
        self._bus = transactions.places(transactions.addresses.bus)

    def go(
        self, rows: Rows, known: Mask, sequence: Ints, boot: Ints, verify_s: float, t: float
    ) -> Start:
        """Start robots that are loaded and verified.

        Args:
            rows: robots to start, shape (r,).
            known: robots that can be commanded, shape (n,): a STOP reaches all of them.
            sequence: sequence number of each bus, shape (b,).
            boot: boot counters of all robots, shape (n,).
            verify_s: time to VERIFY all robots once [s].
            t: earliest time [s].
        """
        t = max(t, self.transactions.now_s)
        none = np.zeros(len(boot), dtype=bool)
        if len(rows) == 0:
            return Start(t, t, None, none, none)
        buses = np.unique(self._bus[rows])
        countdown_s = 1.2 * verify_s + _SLACK_S + self.silence_s + 2.0 * self.period_s
        units = round(min(countdown_s, _LONGEST_S) / COUNTDOWN_S)
        calls = encode_command(
            Opcode.GO, general_call(self.transactions.buses[buses]), sequence[buses], units
        )
        replies = self.transactions.call(calls, t)
        took_s = float((replies.end_s - replies.start_s).min())
        go_s = float(replies.start_s.min() + took_s)
        start_s = go_s + units * COUNTDOWN_S
        late = none.copy()
        late[rows] = (replies.end_s > go_s + self.skew_s)[np.searchsorted(buses, self._bus[rows])]
        monitor = MotionMonitor(
            self.transactions, rows, boot, sequence, go_s,
            self.silence_s, self.period_s, self.stretch_s,
            verify_s / np.bincount(self._bus[rows]).max(), self.on_statuses,
        )  # fmt: skip
        if late.any():  # a clock held low delayed the GO on the bus of these robots
            missing = self._cancel(rows, known, monitor, ~none)
            return Start(go_s, start_s, None, missing, late & ~missing)
        missing = self._await_confirmations(rows, known, monitor, sequence, took_s, start_s)
        if missing is not None:
            return Start(go_s, start_s, None, missing, none)
        monitor.counting_down = False
        return Start(go_s, start_s, monitor, none, none)

    def _await_confirmations(
        self,
        rows: Rows,
        known: Mask,
        monitor: MotionMonitor,
        sequence: Ints,
        took_s: float,
        start_s: float,
    ) -> Mask | None:
        """Poll until all robots have confirmed the GO: None, or else the missing robots, (n,)."""
        # without a heartbeat after this time no robot starts
        until_s = start_s - self.silence_s - self.period_s
        while not monitor.go_confirmed[rows].all():
            monitor.step(VERIFY_BYTES)
            confirmed = monitor.go_confirmed
            over = monitor.now_s >= until_s and not confirmed[rows].all()
            if monitor.stop_all_at_s is not None or over:
                # after an early cancel most robots without confirmation were not polled yet
                return self._cancel(rows, known, monitor, confirmed if over else ~monitor.failing)
            self._repeat_go(monitor, sequence, took_s, start_s)
        return None

    def _repeat_go(
        self, monitor: MotionMonitor, sequence: Ints, took_s: float, start_s: float
    ) -> None:
        """Send GO, for the same start, to each robot that reports LOADED after the first GO."""
        rows = np.flatnonzero(monitor.missed_go)
        if len(rows) == 0:
            return
        rows = rows[np.argsort(self._bus[rows], kind="stable")]
        bus = self._bus[rows]
        slot = np.arange(len(rows)) - np.searchsorted(bus, bus)
        # heartbeats must not wait: the remaining robots get their GO after the next step
        soon = 1.5 * took_s * (slot + 1) <= 0.5 * self.period_s
        soon |= slot == 0
        rows, bus, slot = rows[soon], bus[soon], slot[soon]
        begin_s = np.maximum(monitor.now_s, self.transactions.free_s[bus]) + 1.5 * took_s * slot
        left = np.rint((start_s - begin_s - took_s) / COUNTDOWN_S)
        frames = encode_command(
            Opcode.GO, self.transactions.addresses[rows], sequence[bus], np.maximum(left, 1)
        )
        self.transactions.transfer(frames, 0, begin_s)
        monitor.missed_go[rows] = False

    def _cancel(self, rows: Rows, known: Mask, monitor: MotionMonitor, responding: Mask) -> Mask:
        """Stop and clear all robots before one moves; return the robots to leave out, (n,)."""
        all_rows = np.flatnonzero(known)
        status = self.stop(all_rows, monitor.now_s)
        stopped = status.ok & (status.state == RobotState.STOPPED)
        self.transactions.command(Opcode.CLEAR, all_rows[stopped], monitor.now_s)
        was_stopped = np.isin(rows, all_rows[stopped])
        missing = np.zeros(len(responding), dtype=bool)
        missing[rows] = ~was_stopped | ~responding[rows]
        # a bus without heartbeats is out, even if its robots have answered before
        bus = self._bus[rows]
        last_s = monitor.heartbeat_s
        missing[rows] |= last_s[bus] < last_s[bus].max() - 2 * self.period_s
        return missing

    def stop(self, rows: Rows, t: float) -> Statuses:
        """Stop robots by general call, then singly where needed; return their statuses.

        The call is repeated at once, because a lost STOP costs less time than finding out about
        it. No bus waits for another bus.

        Args:
            rows: robots to stop, shape (r,).
            t: earliest time [s].
        """
        calls = encode_command(
            Opcode.STOP, general_call(np.repeat(self.transactions.buses, _CALLS))
        )
        self.transactions.transfer(calls, 0, t)
        status = self.transactions.statuses(rows, t)
        for _ in range(_STOPS):
            moving = rows[~(status.ok & np.isin(status.state, AT_REST))]
            if len(moving) == 0:
                break
            self.transactions.command(Opcode.STOP, moving, t)
            status = self.transactions.statuses(rows, t)
        self.on_statuses(rows[status.ok], status.select(status.ok), self.transactions.now_s)
        return status

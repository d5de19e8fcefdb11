"""Supervision of robots that count down or move: heartbeats, alert lines, polls."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numba import njit

from fiber_bus_bridge.bus import Ack, Replies
from fiber_bus_bridge.poll_scheduler import PollScheduler
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import (
    STATUS_BYTES,
    VERIFY_BYTES,
    Addresses,
    Frames,
    Opcode,
    RobotState,
    Statuses,
    decode_status,
    encode_command,
    general_call,
    roll_call,
    roll_call_bytes,
    roll_call_slots,
)
from fiber_core.array_types import Bools, Floats, Ints, Mask, Rows

__all__ = ["MotionMonitor", "StatusHandler"]

StatusHandler: TypeAlias = Callable[[Rows, Statuses, float], None]

_POLLS = 3  # polls of a robot in one step, retries included
_LOST_REPLIES = 6  # missed replies in a row after which a robot counts as lost
_ABSENT, _GARBLED = 2, 1  # missed replies counted for no acknowledge, and for an invalid reply
_TRAFFIC_S = 0.1  # of each robot at most one poll in this time becomes part of the traffic
_RETRIED = 2  # robots of a bus polled again in one step
_HEARTBEATS = 2  # calls in a row, twice in each step, so that a single loss has no effect
_HEARTBEAT_KNOWN = 0.4  # part of a step after which the success of its heartbeats is known
_OVERRUN = 0.1  # part of a step during which a bus may still be busy with the step before
_SLOW = 3  # slow heartbeats in a row after which a STOP would come too late
# plain numbers: members of an enumeration are slow to look up step by step
_OK, _NO_ADDRESS, _LOST = int(Ack.OK), int(Ack.NO_ADDRESS), int(Ack.LOST)
_LOADED, _MOVING = int(RobotState.LOADED), int(RobotState.MOVING)
_DONE = int(RobotState.DONE)


class MotionMonitor:
    """Supervises every robot that was sent a GO until it has arrived.

    Each step sends heartbeats on all buses, calls the roll, reads the status of the next few
    robots of each bus, sends heartbeats again, and reads the alert lines. An anomaly sets
    `stop_all_at_s`, the time at which all robots must stop. It is the present, when a robot has
    stopped by itself, does not answer or holds the clock. When no heartbeat gets through to a bus,
    it is the time at which the robots of that bus will stop by themselves, so that all robots stop
    together. No bus waits for a slow bus.

    The traffic for recordings omits steps in which no robot arrives and only robots are polled
    that were polled a moment ago; a capture has all steps.

    Args:
        transactions: the transactions with the robots.
        rows: robots that were sent a GO, shape (r,).
        boot: boot counters of all robots, shape (n,).
        sequence: sequence number of the orders of each bus, shape (b,).
        go_s: time at which the GO was complete [s].
        silence_s: time without a heartbeat after which robots stop by themselves [s].
        period_s: time between two steps [s].
        stretch_s: how much longer than the shortest a heartbeat may take on a bus [s]. A STOP would
            be late by as much, so after three such heartbeats in a row the bus gets no more of
            them, and its robots stop by themselves.
        verify_s: time to read VERIFY_BYTES of one robot, 0 when unknown [s].
        on_statuses: called with rows, their valid statuses, and the time of the poll.
    """

    def __init__(
        self,
        transactions: Transactions,
        rows: Rows,
        boot: Ints,
        sequence: Ints,
        go_s: float,
        silence_s: float,
        period_s: float,
        stretch_s: float = np.inf,
        verify_s: float = 0.0,
        on_statuses: StatusHandler = lambda rows, statuses, t: None,
    ):
        n, buses = len(transactions.addresses), len(transactions.buses)
        self.transactions, self.on_statuses = transactions, on_statuses
        self.counting_down = True  # a robot that missed the GO can still be sent another
        self.moves_until_s = np.inf  # a loss of power after this time is harmless
        self.silence_s, self.period_s, self.stretch_s = silence_s, period_s, stretch_s
        self.now_s = go_s
        self.stop_all_at_s: float | None = None
        self.go_confirmed: Mask = np.zeros(n, dtype=bool)
        self.arrived: Mask = np.zeros(n, dtype=bool)
        self.not_executing: Mask = np.zeros(n, dtype=bool)
        self.missed_go: Mask = np.zeros(n, dtype=bool)
        self._ordered = np.zeros(n, dtype=bool)
        self._ordered[rows] = True
        self._bus = transactions.places(transactions.addresses.bus)
        budget_s = (1.0 - _OVERRUN) * period_s
        self._schedulers = {
            VERIFY_BYTES: PollScheduler(self._bus, buses, budget_s, verify_s),
            STATUS_BYTES: PollScheduler(self._bus, buses, budget_s),
        }
        self._slot = roll_call_slots(transactions.addresses)
        self._roll_call_bytes = roll_call_bytes(np.bincount(self._bus, minlength=buses))
        self._called_s = self._called_before_s = np.full(buses, go_s)
        self._boot, self._sequence = boot, sequence[self._bus]
        self._missed_replies = np.zeros(n, dtype=np.int64)
        self._in_traffic_s = np.full(n, -np.inf)
        self.heartbeat_s = np.full(buses, go_s)
        self._shortest_s, self._slow = np.full(buses, np.inf), np.zeros(buses, dtype=np.int64)
        self._heartbeat_buses = b""
        self._heartbeats = Frames.empty(transactions.addresses[np.zeros(0, dtype=np.int64)])
        # a line that is low already carries no news
        self._low_lines = transactions.backend.alert_lines(go_s)

    @property
    def running(self) -> Mask:
        """Robots that have not arrived, shape (n,)."""
        return self._ordered & ~self.arrived

    @property
    def failing(self) -> Mask:
        """Robots that do not execute their order or miss replies in a row, shape (n,)."""
        return self.not_executing | (self._missed_replies >= _LOST_REPLIES)

    def step(self, width: int = STATUS_BYTES) -> None:
        """Send heartbeats, poll the next few robots, and decide whether all must stop.

        Args:
            width: number of bytes to read of each robot, STATUS_BYTES or VERIFY_BYTES.
        """
        t, running = self.now_s, self.running
        ready = np.bincount(self._bus[running], minlength=len(self.heartbeat_s)) > 0
        ready &= self._buses_ready()
        call = not self.counting_down and t < self.moves_until_s
        scheduler = self._schedulers[width]
        wanted = running & ~self.go_confirmed if self.counting_down else running
        read = scheduler.next(wanted & ready[self._bus], call)
        called = np.flatnonzero(ready & call)
        buses = np.repeat(np.flatnonzero(ready), _HEARTBEATS)
        b, a, r = len(buses), len(called), len(read)
        frames = self._frames(buses, called, self.transactions.addresses[read])
        read_bytes = np.zeros(len(frames), dtype=np.int64)
        calls, reads = slice(b, b + a), slice(b + a, b + a + r)
        read_bytes[calls], read_bytes[reads] = self._roll_call_bytes[called], width
        replies = self.transactions.transfer(frames, read_bytes, t, in_traffic=False)

        took_s = replies.end_s - replies.start_s
        for beats in (slice(0, b), slice(b + a + r, None)):
            _record_heartbeats(
                buses, replies.ack[beats], replies.end_s[beats], took_s[beats],
                self.silence_s or np.inf, self.stretch_s,
                self.heartbeat_s, self._shortest_s, self._slow,
            )  # fmt: skip
        arrived = self._handle_replies(read, replies, reads, width)
        absent = self._handle_roll_call(running, called, replies, calls)
        scheduler.observe(read, took_s[reads], called, took_s[calls])
        if arrived or (t - self._in_traffic_s[read] >= _TRAFFIC_S).any():
            self.transactions.add_traffic(frames, replies)
            self._in_traffic_s[read] = t
        self._retry(np.concatenate([absent, read]), t, width)
        self.now_s = t + self.period_s
        self._decide_stop(running)

    def _buses_ready(self) -> Bools:
        """Buses on which the step that begins now can send, shape (b,)."""
        free = self.transactions.free_s <= self.now_s + _OVERRUN * self.period_s
        return free & ~self.transactions.given_up & (self._slow < _SLOW)

    def _frames(self, buses: Ints, called: Ints, to: Addresses) -> Frames:
        """Heartbeats on some buses, roll calls, frames without data to robots, heartbeats again."""
        key = buses.tobytes()
        if key != self._heartbeat_buses:
            calls = general_call(self.transactions.buses[buses])
            self._heartbeats = encode_command(Opcode.HEARTBEAT, calls)
            self._heartbeat_buses = key
        polls = Frames.empty(to)
        if len(called):
            polls = roll_call(self.transactions.buses[called]).then(polls)
        return self._heartbeats.then(polls).then(self._heartbeats)

    def _handle_roll_call(
        self, running: Mask, called: Ints, replies: Replies, calls: slice
    ) -> Rows:
        """Count a missed reply for each running robot that is absent; return the rows of these."""
        if len(called) == 0:
            return called
        self._called_before_s, self._called_s = self._called_s, self._called_s.copy()
        self._called_s[called] = replies.start_s[calls]
        # a failure of the lines is not a missed reply of the robots
        valid = replies.ack[calls] < _LOST
        offsets = replies.offsets[calls.start : calls.stop + 1]
        first = np.full(len(self._called_s), -1)
        first[called[valid]] = (offsets[:-1] - offsets[0])[valid]
        rows = np.flatnonzero(running & (first[self._bus] >= 0))
        bits = np.unpackbits(replies.data[offsets[0] : offsets[-1]])
        absent = rows[bits[8 * first[self._bus[rows]] + self._slot[rows]] == 1]
        self._missed_replies[absent] += _ABSENT
        return absent

    def _retry(self, rows: Rows, t: float, width: int) -> None:
        """Poll again some of the robots that did not reply, as a robot must not be silent long."""
        rows = np.unique(rows[self._missed_replies[rows] > 0])
        if len(rows) == 0:
            return
        rows = rows[np.argsort(self._bus[rows], kind="stable")]
        bus = self._bus[rows]
        rows = rows[np.arange(len(rows)) - np.searchsorted(bus, bus) < _RETRIED]
        for _ in range(_POLLS - 1):
            missed = self._missed_replies[rows] > 0
            rows = rows[missed & ~self.transactions.given_up[self._bus[rows]]]
            if len(rows) == 0:
                return
            frames = Frames.empty(self.transactions.addresses[rows])
            replies = self.transactions.transfer(frames, width, t, in_traffic=False)
            if self._handle_replies(rows, replies, slice(None), width):
                self.transactions.add_traffic(frames, replies)

    def _handle_replies(self, rows: Rows, replies: Replies, reads: slice, width: int) -> bool:
        """Handle the replies of polled robots; return whether one of the robots has arrived."""
        if len(rows) == 0:
            return False
        begin = replies.offsets[:-1][reads][0]
        data = replies.data[begin : begin + width * len(rows)].reshape(-1, width)
        status = decode_status(self.transactions.addresses[rows], data)
        valid = rows
        if not status.ok.all():
            # a failure of the lines is not a missed reply of the robot
            ack, missed = replies.ack[reads], rows[~status.ok]
            count = np.where(ack == _NO_ADDRESS, _ABSENT, np.where(ack < _LOST, _GARBLED, 0))
            self._missed_replies[missed] += count[~status.ok]
            valid, status = rows[status.ok], status.select(status.ok)
        self._missed_replies[valid] = 0
        same = (status.boot == self._boot[valid]) & (status.sequence == self._sequence[valid])
        done = same & (status.state == _DONE)
        executing = done | (same & (status.state == _MOVING))
        self.go_confirmed[valid] |= executing
        arrived = bool((done & ~self.arrived[valid]).any())
        self.arrived[valid] |= done
        self.missed_go[valid] = same & (status.state == _LOADED) & self.counting_down
        self.not_executing[valid] |= ~executing & ~self.missed_go[valid]
        if width == STATUS_BYTES and len(valid):
            self.on_statuses(valid, status, self.now_s)
        return arrived

    def _between(self, bus: Ints) -> Floats:
        """Time at which to stop all for a silent robot of each of some buses [s].

        A robot that lost power stopped after the roll call before, at the earliest. A robot that
        receives nothing stops silence_s after the last heartbeat before this roll call, at the
        latest. The time half way between is least far from both.
        """
        return 0.5 * (self._called_before_s[bus] + self._called_s[bus] + self.silence_s)

    def _decide_stop(self, running: Mask) -> None:
        """Decide whether all robots must stop, and when."""
        failing = running & self.failing
        if failing.any():
            # known when the bus has finished the polls, which takes its time on a slow bus
            bus = self._bus[failing]
            at_s = self.transactions.free_s[bus]
            at_s = np.where(self.not_executing[failing], at_s, np.maximum(at_s, self._between(bus)))
            if at_s.min() <= self.now_s:
                self.stop_all_at_s = float(at_s.min())
                return
        low = self.transactions.backend.alert_lines(self.now_s)
        if len(low) and not np.isin(low, self._low_lines).all():
            self.stop_all_at_s = self.now_s
            return
        running = running & ~self.arrived
        buses = np.bincount(self._bus[running], minlength=len(self.heartbeat_s)) > 0
        if self.silence_s > 0 and buses.any():
            last_s = self.heartbeat_s + self.silence_s
            # time at which the success of the heartbeats of the next step is known
            known_s = np.where(self._buses_ready(), _HEARTBEAT_KNOWN, 1.0) * self.period_s
            if (buses & (known_s + self.now_s >= last_s)).any():
                self.stop_all_at_s = float(max(last_s[buses].min(), self.now_s))


@njit(cache=True)
def _record_heartbeats(
    buses, ack, end_s, took_s, silence_s, stretch_s, heartbeat_s, shortest_s, slow
):
    # Record the time of each heartbeat that got through, and count slow ones in a row.
    for i in range(len(buses)):
        bus = buses[i]
        # robots that missed heartbeats for too long have stopped and do not begin again
        if ack[i] != _OK or end_s[i] > heartbeat_s[bus] + silence_s:
            continue
        heartbeat_s[bus] = end_s[i]
        shortest_s[bus] = min(shortest_s[bus], took_s[i])
        slow[bus] = slow[bus] + 1 if took_s[i] > shortest_s[bus] + stretch_s else 0

"""Robots that count down or move are watched: beats, alert lines, a look at each in turn."""

from collections.abc import Callable

import numpy as np
from numba import njit

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.poll_scheduler import PollScheduler
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import (
    STATUS_BYTES,
    VERIFY_BYTES,
    Frames,
    Opcode,
    RobotState,
    Statuses,
    decode_status,
    encode_command,
    general_call,
)

__all__ = ["MotionMonitor"]

_LOOKS = 3  # at a robot in one step
_SILENT = 6  # doubts in a row that make a robot a silent one
_ABSENT, _GARBLED = 2, 1  # doubts when it does not acknowledge, and when what it says is wrong
_KEPT_S = 0.1  # of each robot no more than one look in this time becomes part of the traffic
_AGAIN = 2  # robots of a bus looked at once more in one step
_BEATS = 2  # calls in a row, twice in each step: one lost costs nothing
_BEAT_KNOWN = 0.4  # of a step after which it is known whether its BEATs got through
_OVERRUN = 0.1  # of a step that a bus may still be busy with the one before
_SLOW = 3  # BEATs in a row that take too long tell that a STOP would come too late
# plain numbers: members of an enumeration are slow to look up step by step
_OK, _NO_ADDRESS, _LOST = int(Ack.OK), int(Ack.NO_ADDRESS), int(Ack.LOST)
_LOADED, _MOVING = int(RobotState.LOADED), int(RobotState.MOVING)
_DONE = int(RobotState.DONE)


class MotionMonitor:
    """Watches every robot that heard a GO until it has arrived.

    Each step sends BEATs on all buses, asks robots whether they are there, reads the next few
    of each bus, sends BEATs once more, and looks at the alert lines. A robot that is there
    acknowledges its address, which takes a tenth of the time of a status. Something wrong
    gives `freeze_s`, the instant at which everybody must stop: at once, when a robot has
    stopped by itself, does not answer or holds the clock; when no HEARTBEAT gets through to a bus,
    the instant at which its robots will stop themselves, so that all stop together. No bus
    waits for a slow one. Steps in which nobody arrives and only robots are read that were
    read a moment ago are left out of the traffic, which is for people and recordings; a
    capture has them all.

    Args:
        link: the wire.
        rows: robots that were told to go, shape (r,).
        boot: boot counters of all robots, shape (n,).
        sequence: sequence number of the orders of each bus, shape (b,).
        go_s: when the GO was complete [s].
        silence_s: after how long without a HEARTBEAT robots stop themselves [s].
        period_s: time between two steps [s].
        stretch_s: how much longer than the shortest a HEARTBEAT may take on a bus [s]. A STOP would
            be as late there, so after three in a row its robots are left to stop themselves.
        verify_s: how long it takes to read VERIFY_BYTES of one robot, 0 unknown [s].
        listen: called with rows, their valid statuses, and the time of the look.
    """

    def __init__(
        self,
        link: Transactions,
        rows,
        boot,
        sequence,
        go_s: float,
        silence_s: float,
        period_s: float,
        stretch_s: float = np.inf,
        verify_s: float = 0.0,
        listen: Callable[[np.ndarray, Statuses, float], None] = lambda *_: None,
    ):
        n, buses = len(link.addresses), len(link.buses)
        self.link, self.listen = link, listen
        self.counting = True  # a robot that has not heard the GO may still be told
        self.moves_until_s = np.inf  # who loses power later does no harm
        self.silence_s, self.period_s, self.stretch_s = silence_s, period_s, stretch_s
        self.now_s = go_s
        self.freeze_s: float | None = None
        self.seen, self.arrived, self.wrong, self.deaf = np.zeros((4, n), dtype=bool)
        self._running = np.zeros(n, dtype=bool)
        self._running[rows] = True
        self._bus = link.at(link.addresses.bus)
        room_s = (1.0 - _OVERRUN) * period_s
        self._turns = {
            VERIFY_BYTES: PollScheduler(self._bus, buses, room_s, verify_s),
            STATUS_BYTES: PollScheduler(self._bus, buses, room_s),
        }
        self._boot, self._sequence = boot, sequence[self._bus]
        self._doubt = np.zeros(n, dtype=np.int64)
        self._kept_s = np.full(n, -np.inf)
        self.beat_s = np.full(buses, go_s)
        self._shortest_s, self._slow = np.full(buses, np.inf), np.zeros(buses, dtype=np.int64)
        self._beats_key = b""
        # a line that is low already tells nothing
        self._low = link.backend.alert_lines(go_s)

    @property
    def running(self) -> np.ndarray:
        """Robots that have not arrived, shape (n,)."""
        return self._running & ~self.arrived

    @property
    def failing(self) -> np.ndarray:
        """Robots that said something wrong or, time and again, nothing, shape (n,)."""
        return self.wrong | (self._doubt >= _SILENT)

    def step(self, width: int = STATUS_BYTES) -> None:
        """Beat, look at the next few robots, and judge.

        Args:
            width: bytes to read of each, STATUS_BYTES or VERIFY_BYTES.
        """
        t, running = self.now_s, self.running
        ready = np.bincount(self._bus[running], minlength=len(self.beat_s)) > 0
        ready &= self._open()
        ask = not self.counting and t < self.moves_until_s
        turns = self._turns[width]
        wanted = running & ~self.seen if self.counting else running
        looked, asked = turns.next(wanted & ready[self._bus], ask)
        buses = np.repeat(np.flatnonzero(ready), _BEATS)
        b, a, r = len(buses), len(asked), len(looked)
        to = self.link.addresses[np.concatenate([asked, looked])]
        frames = self._frames(buses, to)
        read = np.zeros(len(frames), dtype=np.int64)
        looks = slice(b + a, b + a + r)
        read[looks] = width
        replies = self.link.transfer(frames, read, t, keep=False)

        took_s = replies.end_s - replies.start_s
        for beats in (slice(0, b), slice(b + a + r, None)):
            _beaten(
                buses, replies.ack[beats], replies.end_s[beats], took_s[beats],
                self.silence_s or np.inf, self.stretch_s,
                self.beat_s, self._shortest_s, self._slow,
            )  # fmt: skip
        arrived = self._hear(looked, replies, looks, width)
        self._doubt[asked[replies.ack[b : b + a] == _NO_ADDRESS]] += _ABSENT
        turns.learn(looked, took_s[looks], asked, took_s[b : b + a])
        if arrived or (t - self._kept_s[looked] >= _KEPT_S).any():
            self.link.keep(frames, replies)
            self._kept_s[looked] = t
        self._look_again(np.concatenate([asked, looked]), t, width)
        self.now_s = t + self.period_s
        self._judge(running)

    def _open(self):
        """Buses on which the step that begins now can send, shape (b,)."""
        free = self.link.free_s <= self.now_s + _OVERRUN * self.period_s
        return free & ~self.link.given_up & (self._slow < _SLOW)

    def _frames(self, buses, to):
        """BEATs on some buses, frames without data to robots, and BEATs again."""
        key = buses.tobytes()
        if key != self._beats_key:
            self._beats = encode_command(Opcode.HEARTBEAT, general_call(self.link.buses[buses]))
            self._beats_key = key
        return self._beats.then(Frames.empty(to)).then(self._beats)

    def _look_again(self, rows, t, width):
        """Look once more at some that gave no answer; a robot may not be silent for long."""
        rows = np.unique(rows[self._doubt[rows] > 0])
        if len(rows) == 0:
            return
        rows = rows[np.argsort(self._bus[rows], kind="stable")]
        bus = self._bus[rows]
        rows = rows[np.arange(len(rows)) - np.searchsorted(bus, bus) < _AGAIN]
        for _ in range(_LOOKS - 1):
            rows = rows[(self._doubt[rows] > 0) & ~self.link.given_up[self._bus[rows]]]
            if len(rows) == 0:
                return
            frames = Frames.empty(self.link.addresses[rows])
            replies = self.link.transfer(frames, width, t, keep=False)
            if self._hear(rows, replies, slice(None), width):
                self.link.keep(frames, replies)

    def _hear(self, rows, replies, looks, width):
        """Take in what robots said; returns whether one of them has arrived."""
        if len(rows) == 0:
            return False
        status = decode_status(self.link.addresses[rows], replies.data.reshape(-1, width))
        good = rows
        if not status.ok.all():
            # when the lines fail it is not the robot that is silent
            ack, missed = replies.ack[looks], rows[~status.ok]
            doubts = np.where(ack == _NO_ADDRESS, _ABSENT, np.where(ack < _LOST, _GARBLED, 0))
            self._doubt[missed] += doubts[~status.ok]
            good, status = rows[status.ok], status.only(status.ok)
        self._doubt[good] = 0
        same = (status.boot == self._boot[good]) & (status.sequence == self._sequence[good])
        done = same & (status.state == _DONE)
        runs = done | (same & (status.state == _MOVING))
        self.seen[good] |= runs
        arrived = bool((done & ~self.arrived[good]).any())
        self.arrived[good] |= done
        self.deaf[good] = same & (status.state == _LOADED) & self.counting
        self.wrong[good] |= ~runs & ~self.deaf[good]
        if width == STATUS_BYTES and len(good):
            self.listen(good, status, self.now_s)
        return arrived

    def _judge(self, running):
        """Decide whether all must stop, and when."""
        wrong = running & self.failing
        if wrong.any():
            # known as soon as the bus is through with them, which on a slow one takes its time
            known = self.link.free_s[self._bus[wrong]].min()
            if known <= self.now_s:
                self.freeze_s = float(known)
                return
        low = self.link.backend.alert_lines(self.now_s)
        if len(low) and not np.isin(low, self._low).all():
            self.freeze_s = self.now_s
            return
        running = running & ~self.arrived
        buses = np.bincount(self._bus[running], minlength=len(self.beat_s)) > 0
        if self.silence_s > 0 and buses.any():
            last = self.beat_s + self.silence_s
            # when it is known whether the BEATs of the next step have got through, if any do
            known = np.where(self._open(), _BEAT_KNOWN, 1.0) * self.period_s + self.now_s
            if (buses & (known >= last)).any():
                self.freeze_s = max(last[buses].min(), self.now_s)


@njit(cache=True)
def _beaten(buses, ack, end_s, took_s, silence_s, stretch_s, beat_s, shortest_s, slow):
    # Take note of which BEATs got through when, and how slowly.
    for i in range(len(buses)):
        bus = buses[i]
        # who has not heard one for too long does not begin again
        if ack[i] != _OK or end_s[i] > beat_s[bus] + silence_s:
            continue
        beat_s[bus] = end_s[i]
        shortest_s[bus] = min(shortest_s[bus], took_s[i])
        slow[bus] = slow[bus] + 1 if took_s[i] > shortest_s[bus] + stretch_s else 0

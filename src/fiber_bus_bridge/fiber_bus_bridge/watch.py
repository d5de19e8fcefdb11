"""Robots that count down or move are watched: beats, alert lines, a look at each in turn."""

from collections.abc import Callable

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.link import Link
from fiber_bus_bridge.wire import (
    STATUS_BYTES,
    Addresses,
    Frames,
    Opcode,
    RobotState,
    Statuses,
    decode_status,
    encode_command,
    general_call,
)

__all__ = ["Watch"]

_TRIES = 3  # looks at a robot that fail in a row before it counts as silent
_KEPT_S = 0.1  # of each robot no more than one look in this time becomes part of the traffic
_FIRST_CHUNK = 8  # robots of a bus looked at in the first step, before their time is known


class Watch:
    """Watches every robot that heard a GO until it has arrived.

    Each step sends a BEAT on all buses at one instant, reads the next few robots of each
    bus, and looks at the alert lines. Something wrong gives `freeze_s`, the instant at which
    everybody must stop: now, when a robot has stopped by itself; when no BEAT gets through to
    a bus, the instant at which its robots will stop themselves, so that all stop together.
    Steps in which nobody arrives and only robots are read that were read a moment ago are
    left out of the traffic, which is for people and recordings; a capture has them all.

    Args:
        link: the wire.
        rows: robots that were told to go, shape (r,).
        boot: boot counters of all robots, shape (n,).
        sequence: sequence number of the orders of each bus, shape (b,).
        go_s: when the GO was complete [s].
        silence_s: after how long without a BEAT robots stop themselves [s].
        period_s: shortest time between two steps [s].
        listen: called with rows, their valid statuses, and the time of the look.
    """

    def __init__(
        self,
        link: Link,
        rows,
        boot,
        sequence,
        go_s: float,
        silence_s: float,
        period_s: float,
        listen: Callable[[np.ndarray, Statuses, float], None] = lambda *_: None,
    ):
        n = len(link.addresses)
        self.link, self.listen = link, listen
        self.counting = True  # a robot that has not heard the GO may still be told
        self.silence_s, self.period_s = silence_s, period_s
        self.now_s = go_s
        self.freeze_s: float | None = None
        self.seen, self.arrived, self.wrong, self.deaf = np.zeros((4, n), dtype=bool)
        self._running = np.zeros(n, dtype=bool)
        self._running[rows] = True
        self._bus = link.at(link.addresses.bus)
        self._boot, self._sequence = boot, sequence[self._bus]
        self._tries = np.zeros(n, dtype=np.int64)
        self._read_s, self._kept_s = np.full((2, n), -np.inf)
        self._chunk = np.full(len(link.buses), _FIRST_CHUNK)
        self.beat_s = np.full(len(link.buses), go_s)
        # a line that is low already tells nothing
        self._low = link.backend.alert_lines(go_s)

    @property
    def running(self) -> np.ndarray:
        """Robots that have not arrived, shape (n,)."""
        return self._running & ~self.arrived

    def step(self, width: int = STATUS_BYTES) -> None:
        """Beat, look at the next few robots, and judge.

        Args:
            width: bytes to read of each, STATUS_BYTES or VERIFY_BYTES.
        """
        t = self.now_s
        buses = np.unique(self._bus[self.running])
        ready = buses[(self.link.free_s[buses] <= t + 1e-9) & ~self.link.given_up[buses]]
        rows = self._next(ready)
        calls = encode_command(Opcode.BEAT, general_call(self.link.buses[ready]))
        frames = _joined(calls, self.link.addresses[rows])
        read = np.where(np.arange(len(frames)) < len(ready), 0, width)
        replies = self.link.transfer(frames, read, t, keep=False)
        beats, looks = np.arange(len(ready)), np.arange(len(ready), len(frames))

        through = ready[replies.ack[beats] == Ack.OK]
        self.beat_s[through] = replies.end_s[beats][replies.ack[beats] == Ack.OK]
        arrived = self._hear(rows, replies, looks, width)
        if arrived or (t - self._kept_s[rows] >= _KEPT_S).any():
            self.link.keep(frames, replies)
            self._kept_s[rows] = t
        for _ in range(_TRIES - 1):
            self._look_again(rows, t, width)
        free = self.link.free_s[through[~self.link.given_up[through]]]
        self.now_s = max(t + self.period_s, free.max(initial=-np.inf))
        self._judge()

    def _next(self, ready):
        """The robots of each ready bus that were not looked at for longest."""
        rows = np.flatnonzero(self.running & np.isin(self._bus, ready))
        rows = rows[np.lexsort([self._read_s[rows], self._bus[rows]])]
        bus = self._bus[rows]
        place = np.arange(len(rows)) - np.searchsorted(bus, bus)
        return rows[place < self._chunk[bus]]

    def _look_again(self, rows, t, width):
        """Look once more at those that gave no answer; a robot may not be silent for long."""
        rows = rows[(self._tries[rows] > 0) & ~self.link.given_up[self._bus[rows]]]
        if len(rows):
            to = self.link.addresses[rows]
            frames = Frames(to, np.zeros(len(rows) + 1, dtype=np.int64), np.zeros(0, np.uint8))
            replies = self.link.transfer(frames, width, t, keep=False)
            if self._hear(rows, replies, np.arange(len(rows)), width):
                self.link.keep(frames, replies)

    def _hear(self, rows, replies, looks, width):
        """Take in what robots said; returns whether one of them has arrived."""
        data = replies.data.reshape(-1, width)
        status = decode_status(self.link.addresses[rows], data)
        took = (replies.end_s - replies.start_s)[looks]
        bus, count = self._bus[rows[status.ok]], len(self._chunk)
        looks_of = np.bincount(bus, minlength=count)
        took_of = np.bincount(bus, took[status.ok], minlength=count)
        known = looks_of > 0
        fit = self.period_s * looks_of[known] / took_of[known]
        self._chunk[known] = np.maximum(fit.astype(np.int64), 1)
        # when the lines fail it is not the robot that is silent
        missed = ~status.ok & (replies.ack[looks] < Ack.LOST)
        self._tries[rows[missed]] += 1
        good = rows[status.ok]
        self._tries[good], self._read_s[good] = 0, replies.end_s[looks][status.ok]
        state = status.state[status.ok]
        same = status.boot[status.ok] == self._boot[good]
        same &= status.sequence[status.ok] == self._sequence[good]
        runs = same & ((state == RobotState.MOVING) | (state == RobotState.DONE))
        self.seen[good] |= runs
        arrived = runs & (state == RobotState.DONE) & ~self.arrived[good]
        self.arrived[good] |= arrived
        self.deaf[good] = same & (state == RobotState.LOADED) & self.counting
        self.wrong[good] |= ~runs & ~self.deaf[good]
        if width == STATUS_BYTES and status.ok.any():
            self.listen(good, status.only(status.ok), self.now_s)
        return bool(arrived.any())

    def _judge(self):
        running = self.running
        low = np.setdiff1d(self.link.backend.alert_lines(self.now_s), self._low)
        if (self.wrong | (self._tries >= _TRIES))[running].any() or len(low):
            self.freeze_s = self.now_s
            return
        buses = np.unique(self._bus[running])
        if self.silence_s > 0 and len(buses):
            last = self.beat_s[buses].min() + self.silence_s
            if self.now_s + self.period_s >= last:
                self.freeze_s = max(last, self.now_s)


def _joined(calls: Frames, to: Addresses) -> Frames:
    """General calls, then plain reads of robots, in one batch."""
    both = Addresses(
        np.concatenate([calls.to.bus, to.bus]),
        np.concatenate([calls.to.address, to.address]),
        np.concatenate([calls.to.ten_bit, to.ten_bit]),
    )
    offsets = np.concatenate([calls.offsets, np.full(len(to), calls.offsets[-1])])
    return Frames(both, offsets, calls.data)

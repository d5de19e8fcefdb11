"""GO, and nobody moves before everybody is known to have heard it; STOP, until all have stopped."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fiber_bus_bridge.motion_monitor import MotionMonitor
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

__all__ = ["AT_REST", "Start", "StartStop"]

AT_REST = (RobotState.UNCONFIGURED, RobotState.STOPPED, RobotState.FAULT)
_LONGEST_S = 0.65  # what the field of the countdown carries
_SLACK_S = 10e-3  # for robots that have to be asked or told once more
_CALLS = 3  # times the call to STOP is sent
_STOPS = 3  # times STOP is tried on who does not stop


class Start(NamedTuple):
    """What came of a GO.

    Args:
        go_s: when the GO was complete [s].
        start_s: when the robots begin to move [s].
        watch: the watch over them; None when nobody moves, because all were called off.
        missing: for whom all were called off: who did not count down, shape (n,).
        late: whose bus the GO reached too late, or else they would be missing, shape (n,).
    """

    go_s: float
    start_s: float
    watch: MotionMonitor | None
    missing: np.ndarray
    late: np.ndarray


class StartStop:
    """Starts robots together and stops them.

    GO is never repeated blindly: only to a robot whose status says that it is loaded and
    has not started, and then with what is left of the countdown, so that it begins with all
    others. If anybody cannot be brought to count down in time, all are stopped before one has
    moved. Who cannot even be told that hears no HEARTBEAT any more, and does not start either.

    Args:
        link: the wire.
        silence_s: after how long without a HEARTBEAT robots stop themselves [s].
        period_s: shortest time between two looks at the robots [s].
        stretch_s: how much longer than usual a HEARTBEAT may take, as by MotionMonitor [s].
        skew_s: how much later than the first a bus may have heard the GO [s].
        listen: told of every status, as by MotionMonitor.
    """

    def __init__(
        self,
        link: Transactions,
        silence_s: float,
        period_s: float,
        stretch_s: float,
        skew_s: float,
        listen: Callable[[np.ndarray, Statuses, float], None],
    ):
        self.link, self.silence_s, self.period_s, self.listen = link, silence_s, period_s, listen
        self.stretch_s, self.skew_s = stretch_s, skew_s
        self._bus = link.at(link.addresses.bus)

    def go(self, rows, known, sequence, boot, look_s: float, t: float) -> Start:
        """Start robots that are loaded and verified.

        Args:
            rows: the robots, shape (r,).
            known: robots that can be commanded, shape (n,): a STOP reaches all of them.
            sequence: sequence number of each bus, shape (b,).
            boot: boot counters of all robots, shape (n,).
            look_s: how long it takes to look at all of them once [s].
            t: not before this time [s].
        """
        t = max(t, self.link.now_s)
        nobody = np.zeros(len(boot), dtype=bool)
        if len(rows) == 0:
            return Start(t, t, None, nobody, nobody)
        buses = np.unique(self._bus[rows])
        countdown_s = 1.2 * look_s + _SLACK_S + self.silence_s + 2.0 * self.period_s
        countdown_s = min(countdown_s, _LONGEST_S)
        units = round(countdown_s / COUNTDOWN_S)
        calls = encode_command(
            Opcode.GO, general_call(self.link.buses[buses]), sequence[buses], units
        )
        replies = self.link.call(calls, t)
        took_s = float((replies.end_s - replies.start_s).min())
        go_s = float(replies.start_s.min() + took_s)
        start_s = go_s + units * COUNTDOWN_S
        late, everyone = nobody.copy(), ~nobody
        late[rows] = (replies.end_s > go_s + self.skew_s)[np.searchsorted(buses, self._bus[rows])]
        watch = MotionMonitor(
            self.link, rows, boot, sequence, go_s,
            self.silence_s, self.period_s, self.stretch_s,
            look_s / np.bincount(self._bus[rows]).max(), self.listen,
        )  # fmt: skip
        if late.any():  # a clock held low made the GO late on their bus
            missing = self._call_off(rows, known, watch, everyone)
            return Start(go_s, start_s, None, missing, late & ~missing)
        # without a HEARTBEAT from then on nobody starts
        until_s = start_s - self.silence_s - self.period_s
        while not watch.seen[rows].all():
            watch.step(VERIFY_BYTES)
            over = watch.now_s >= until_s and not watch.seen[rows].all()
            if watch.freeze_s is not None or over:
                # stopped early, most of those not seen yet have only not been looked at
                heard = watch.seen if over else ~watch.failing
                missing = self._call_off(rows, known, watch, heard)
                return Start(go_s, start_s, None, missing, nobody)
            self._again(watch, sequence, took_s, start_s)
        watch.counting = False
        return Start(go_s, start_s, watch, nobody, nobody)

    def _again(self, watch, sequence, took_s, start_s):
        """GO to each robot that said it is loaded and has not heard it, for the same instant."""
        rows = np.flatnonzero(watch.deaf)
        if len(rows) == 0:
            return
        rows = rows[np.argsort(self._bus[rows], kind="stable")]
        bus = self._bus[rows]
        slot = np.arange(len(rows)) - np.searchsorted(bus, bus)
        # beats must not wait for them: the others are told after the next step
        soon = 1.5 * took_s * (slot + 1) <= 0.5 * self.period_s
        soon |= slot == 0
        rows, bus, slot = rows[soon], bus[soon], slot[soon]
        begin_s = np.maximum(watch.now_s, self.link.free_s[bus]) + 1.5 * took_s * slot
        left = np.rint((start_s - begin_s - took_s) / COUNTDOWN_S)
        frames = encode_command(
            Opcode.GO, self.link.addresses[rows], sequence[bus], np.maximum(left, 1)
        )
        self.link.transfer(frames, 0, begin_s)
        watch.deaf[rows] = False

    def _call_off(self, rows, known, watch, heard):
        """Stop and clear everybody before anyone moves; return who must be left out, (n,)."""
        everybody = np.flatnonzero(known)
        status = self.stop(everybody, watch.now_s)
        stopped = status.ok & (status.state == RobotState.STOPPED)
        self.link.command(Opcode.CLEAR, everybody[stopped], watch.now_s)
        stopped = np.isin(rows, everybody[stopped])
        missing = np.zeros(len(heard), dtype=bool)
        missing[rows] = ~stopped | ~heard[rows]
        # no HEARTBEAT gets through to them, whatever they answered before
        bus = self._bus[rows]
        missing[rows] |= watch.beat_s[bus] < watch.beat_s[bus].max() - 2 * self.period_s
        return missing

    def stop(self, rows, t: float) -> Statuses:
        """Stop robots by general call, then one by one who has not; return their statuses.

        The call is repeated at once, and no bus waits for another: a lost STOP costs less time
        than finding out.
        """
        calls = encode_command(Opcode.STOP, general_call(np.repeat(self.link.buses, _CALLS)))
        self.link.transfer(calls, 0, t)
        status = self.link.statuses(rows, t)
        for _ in range(_STOPS):
            going = rows[~(status.ok & np.isin(status.state, AT_REST))]
            if len(going) == 0:
                break
            self.link.command(Opcode.STOP, going, t)
            status = self.link.statuses(rows, t)
        self.listen(rows[status.ok], status.only(status.ok), self.link.now_s)
        return status

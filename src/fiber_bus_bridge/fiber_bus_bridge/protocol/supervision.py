# SPDX-License-Identifier: Apache-2.0
"""One step of the supervision of robots that count down or move: heartbeats, roll call, polls.

Each step sends heartbeats on all buses, calls the roll, reads the status of the next few robots of
each bus, sends heartbeats again, and reads the alert lines. An anomaly sets the time at which all
robots must stop. It is the present, when a robot has stopped by itself, does not answer or holds
the clock. When no heartbeat gets through to a bus, it is the time at which the robots of that bus
will stop by themselves, so that all robots stop together. No bus waits for a slow bus.

The traffic for recordings omits steps in which no robot arrives or fails and only robots are polled
that were polled a moment ago; a capture has all steps.
"""

import numpy as np

from fiber_bus_bridge.bus import Ack, Replies
from fiber_bus_bridge.poll_scheduler import PollScheduler
from fiber_bus_bridge.protocol.context import Context, Watch
from fiber_bus_bridge.protocol.decisions import (
    ABSENT,
    GARBLED,
    failing,
    record_heartbeats,
    silent_stop_s,
)
from fiber_bus_bridge.protocol.states import State
from fiber_bus_bridge.protocol.tables import begin_watch, running
from fiber_bus_bridge.wire import (
    STATUS_BYTES,
    VERIFY_BYTES,
    Frames,
    RobotState,
    decode_status,
    roll_call,
)
from fiber_core.array_types import Bools, Ints, Mask, Rows

__all__ = ["supervise", "watch_from"]

_POLLS = 3  # polls of a robot in one step, retries included
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


def watch_from(c: Context, go_s: float, verify_s: float) -> Watch:
    """Begin the supervision of the verified robots.

    Args:
        c: the controller.
        go_s: time at which the GO was complete [s].
        verify_s: time to read VERIFY_BYTES of one robot [s], 0 when unknown.
    """
    begin_watch(c.robots, c.buses, go_s)
    budget_s = (1.0 - _OVERRUN) * c.config.heartbeat_period_s
    schedulers = {
        VERIFY_BYTES: PollScheduler(c.bus, len(c.buses), budget_s, verify_s),
        STATUS_BYTES: PollScheduler(c.bus, len(c.buses), budget_s),
    }
    return Watch(go_s, schedulers, c.transactions.backend.alert_lines(go_s))


def supervise(c: Context, watch: Watch) -> None:
    """Send heartbeats, poll the next few robots, and decide whether all must stop."""
    t, active, transactions = watch.now_s, running(c.robots), c.transactions
    counting_down = c.state is State.COUNTDOWN
    width = VERIFY_BYTES if counting_down else STATUS_BYTES
    ready = c.buses_of(active) & _buses_ready(c, t)
    call = not counting_down and t < watch.ends_s
    wanted = active & ~c.robots["confirmed"] if counting_down else active
    read = watch.schedulers[width].next(wanted & ready[c.bus], call)
    called = np.flatnonzero(ready & call)
    buses = np.repeat(np.flatnonzero(ready), _HEARTBEATS)
    b, a, r = len(buses), len(called), len(read)
    frames = _frames(c, buses, called, read)
    read_bytes = np.zeros(len(frames), dtype=np.int64)
    calls, reads = slice(b, b + a), slice(b + a, b + a + r)
    read_bytes[calls], read_bytes[reads] = c.roll_call_bytes[called], width
    replies = transactions.transfer(frames, read_bytes, t, in_traffic=False)

    took_s = replies.end_s - replies.start_s
    for beats in (slice(0, b), slice(b + a + r, None)):
        record_heartbeats(
            c.buses, buses, replies.ack[beats], replies.end_s[beats], took_s[beats],
            c.silence_s or np.inf, c.config.stretch_s,
        )  # fmt: skip
    news = _handle_replies(c, t, read, replies, reads, width)
    news |= bool((replies.ack != _OK).any())
    absent = _handle_roll_call(c, active, called, replies, calls)
    watch.schedulers[width].observe(read, took_s[reads], called, took_s[calls])
    if news or (t - c.robots["in_traffic_s"][read] >= _TRAFFIC_S).any():
        transactions.add_traffic(frames, replies)
        c.robots["in_traffic_s"][read] = t
    _retry(c, np.concatenate([absent, read]), t, width)
    watch.now_s = t + c.config.heartbeat_period_s
    watch.stop_all_at_s = _when_to_stop(c, watch, active)


def _buses_ready(c: Context, t: float) -> Bools:
    """Buses on which the step that begins at time t [s] can send, shape (b,)."""
    free = c.transactions.free_s <= t + _OVERRUN * c.config.heartbeat_period_s
    return free & ~c.transactions.given_up & (c.buses["slow"] < _SLOW)


def _frames(c: Context, buses: Ints, called: Ints, read: Rows) -> Frames:
    """Heartbeats on some buses, roll calls, frames without data to robots, heartbeats again."""
    heartbeats = c.heartbeats(buses)
    polls = Frames.empty(c.transactions.addresses[read])
    if len(called):
        polls = roll_call(c.transactions.buses[called]).then(polls)
    return heartbeats.then(polls).then(heartbeats)


def _handle_roll_call(
    c: Context, active: Mask, called: Ints, replies: Replies, calls: slice
) -> Rows:
    """Count a missed reply for each running robot that is absent; return the rows of these."""
    if len(called) == 0:
        return called
    c.buses["called_before_s"] = c.buses["called_s"]
    c.buses["called_s"][called] = replies.start_s[calls]
    # a failure of the lines is not a missed reply of the robots
    valid = replies.ack[calls] < _LOST
    offsets = replies.offsets[calls.start : calls.stop + 1]
    first = np.full(len(c.buses), -1)
    first[called[valid]] = (offsets[:-1] - offsets[0])[valid]
    rows = np.flatnonzero(active & (first[c.bus] >= 0))
    bits = np.unpackbits(replies.data[offsets[0] : offsets[-1]])
    absent = rows[bits[8 * first[c.bus[rows]] + c.slot[rows]] == 1]
    c.robots["missed_replies"][absent] += ABSENT
    return absent


def _retry(c: Context, rows: Rows, t: float, width: int) -> None:
    """Poll again some of the robots that did not reply, as a robot must not be silent long."""
    missed_replies = c.robots["missed_replies"]
    rows = np.unique(rows[missed_replies[rows] > 0])
    if len(rows) == 0:
        return
    rows = rows[np.argsort(c.bus[rows], kind="stable")]
    bus = c.bus[rows]
    rows = rows[np.arange(len(rows)) - np.searchsorted(bus, bus) < _RETRIED]
    for _ in range(_POLLS - 1):
        missed = missed_replies[rows] > 0
        rows = rows[missed & ~c.transactions.given_up[c.bus[rows]]]
        if len(rows) == 0:
            return
        frames = Frames.empty(c.transactions.addresses[rows])
        replies = c.transactions.transfer(frames, width, t, in_traffic=False)
        news = _handle_replies(c, t, rows, replies, slice(None), width)
        if news or (replies.ack != _OK).any():
            c.transactions.add_traffic(frames, replies)


def _handle_replies(
    c: Context, t: float, rows: Rows, replies: Replies, reads: slice, width: int
) -> bool:
    """Handle the replies of polled robots; return whether one has arrived or does not execute."""
    if len(rows) == 0:
        return False
    robots = c.robots
    begin = replies.offsets[:-1][reads][0]
    data = replies.data[begin : begin + width * len(rows)].reshape(-1, width)
    status = decode_status(c.transactions.addresses[rows], data)
    valid = rows
    if not status.ok.all():
        # a failure of the lines is not a missed reply of the robot
        ack, missed = replies.ack[reads], rows[~status.ok]
        count = np.where(ack == _NO_ADDRESS, ABSENT, np.where(ack < _LOST, GARBLED, 0))
        robots["missed_replies"][missed] += count[~status.ok]
        valid, status = rows[status.ok], status.select(status.ok)
    robots["missed_replies"][valid] = 0
    same = status.boot == robots["boot"][valid]
    same &= status.sequence == c.buses["sequence"][c.bus[valid]]
    done = same & (status.state == _DONE)
    executing = done | (same & (status.state == _MOVING))
    missed_go = same & (status.state == _LOADED) & (c.state is State.COUNTDOWN)
    robots["confirmed"][valid] |= executing
    failed = ~executing & ~missed_go
    news = bool(((done & ~robots["arrived"][valid]) | failed).any())
    robots["arrived"][valid] |= done
    robots["missed_go"][valid] = missed_go
    robots["not_executing"][valid] |= failed
    if width == STATUS_BYTES and len(valid):
        c.observe(valid, status, t)
    return news


def _when_to_stop(c: Context, watch: Watch, active: Mask) -> float | None:
    """Return the time at which all robots must stop [s], None while all is well."""
    now_s, robots = watch.now_s, c.robots
    failed = np.flatnonzero(active & failing(robots))
    if len(failed):
        # known when the bus has finished the polls, which takes its time on a slow bus
        bus = c.bus[failed]
        at_s = c.transactions.free_s[bus]
        silent_s = np.maximum(at_s, silent_stop_s(c.buses, bus, c.silence_s))
        at_s = np.where(robots["not_executing"][failed], at_s, silent_s)
        if at_s.min() <= now_s:
            return float(at_s.min())
    low = c.transactions.backend.alert_lines(now_s)
    if len(low) and not np.isin(low, watch.low_lines).all():
        return now_s
    buses = c.buses_of(active & ~robots["arrived"])
    if c.silence_s > 0 and buses.any():
        last_s = c.buses["heartbeat_s"] + c.silence_s
        # time at which the success of the heartbeats of the next step is known
        period_s = c.config.heartbeat_period_s
        known_s = np.where(_buses_ready(c, now_s), _HEARTBEAT_KNOWN, 1.0) * period_s
        if (buses & (known_s + now_s >= last_s)).any():
            return float(max(last_s[buses].min(), now_s))
    return None

# SPDX-License-Identifier: Apache-2.0
"""Steps of a synchronised start: no robot moves until all have confirmed the GO.

GO is never repeated blindly. It is repeated only to a robot that reports LOADED, with the time left
of the countdown, so that this robot starts with all others. If a robot does not confirm the GO in
time, all robots are stopped before one has moved, and the other robots are loaded again without it.
A robot that cannot be told to stop also gets no heartbeat, so it does not start.
"""

import numpy as np

from fiber_bus_bridge.protocol.context import Context, Phase, Watch
from fiber_bus_bridge.protocol.decisions import (
    LONGEST_COUNTDOWN_S,
    countdown_s,
    failing,
    own_fault,
    unresponsive,
)
from fiber_bus_bridge.protocol.loading import commit
from fiber_bus_bridge.protocol.states import Event
from fiber_bus_bridge.protocol.stopping import stop_all
from fiber_bus_bridge.protocol.supervision import supervise, watch_from
from fiber_bus_bridge.protocol.turn_limits import limits_after_go
from fiber_bus_bridge.wire import COUNTDOWN_S, Opcode, RobotState, encode_command, general_call
from fiber_core.outcomes import Reason

__all__ = ["cancel", "count_down", "go"]

_GO_SPACING = 1.5  # of a GO to a single robot, in durations of a GO
_GO_SHARE = 0.5  # part of a step that GOs to single robots may take


def go(c: Context, phase: Phase) -> Event:
    """Ask whether to start, then start the verified robots of all buses with one GO."""
    phase.turn_limit = limits_after_go(c)
    if not c.may_go():
        return Event.REFUSED
    robots, transactions = c.robots, c.transactions
    if c.plan is not None and c.plan.to_stops:
        _forget_places(c)
    rows = np.flatnonzero(robots["verified"])
    t = max(phase.t, transactions.now_s)
    if len(rows) == 0:
        phase.go_s = phase.start_s = t
        commit(c, phase)
        return Event.NONE_LEFT
    buses = np.unique(c.bus[rows])
    lasts_s = countdown_s(phase.verify_s, c.silence_s, c.config.heartbeat_period_s)
    if c.start_at_s is not None:
        if c.start_at_s < t + lasts_s:
            return Event.REFUSED
        lasts_s = min(c.start_at_s - t, LONGEST_COUNTDOWN_S)
        t = c.start_at_s - lasts_s
    units = round(lasts_s / COUNTDOWN_S)
    sequence = c.buses["sequence"][buses]
    calls = encode_command(Opcode.GO, general_call(transactions.buses[buses]), sequence, units)
    replies = transactions.call(calls, t)
    phase.go_took_s = float((replies.end_s - replies.start_s).min())
    phase.go_s = float(replies.start_s.min() + phase.go_took_s)
    phase.start_s = phase.go_s + units * COUNTDOWN_S
    late = replies.end_s > phase.go_s + 0.25 * c.safety.start_skew_s
    phase.late = robots["verified"] & np.isin(c.bus, buses[late])
    phase.responding = np.ones(len(robots), dtype=bool)
    c.watch = watch_from(c, phase.go_s, phase.verify_s / np.bincount(c.bus[rows]).max())
    # a clock held low delayed the GO on a bus
    return Event.GO_LATE if late.any() else Event.GO_SENT


def _forget_places(c: Context) -> None:
    """Let the robots that get a GO be at unknown places: counters count on at a stop."""
    robots, starting = c.robots, c.robots["verified"]
    robots["seen"] &= ~starting
    robots["guessed"] |= starting
    robots["lost"] |= starting


def count_down(c: Context, phase: Phase, watch: Watch) -> Event:
    """Poll the robots that have not confirmed the GO, and send another GO where it was missed."""
    supervise(c, watch)
    robots = c.robots
    confirmed = robots["confirmed"]
    all_confirmed = not (robots["started"] & ~confirmed).any()
    # without a heartbeat after this time no robot starts
    until_s = phase.start_s - c.silence_s - c.config.heartbeat_period_s
    over = watch.now_s >= until_s and not all_confirmed
    if watch.stop_all_at_s is not None or over:
        # after an early cancel most robots without confirmation were not polled yet
        phase.responding = confirmed.copy() if over else ~failing(robots)
        return Event.UNCONFIRMED
    _repeat_go(c, phase, watch)
    if not all_confirmed:
        return Event.POLLED
    lasts_s = commit(c, phase).makespan_s + c.plane.drive.longest_ramp_s
    watch.ends_s = phase.start_s + lasts_s
    return Event.CONFIRMED


def _repeat_go(c: Context, phase: Phase, watch: Watch) -> None:
    """Send GO, for the same start, to each robot that reports LOADED after the first GO."""
    rows = np.flatnonzero(c.robots["missed_go"])
    if len(rows) == 0:
        return
    transactions, spacing_s = c.transactions, _GO_SPACING * phase.go_took_s
    rows = rows[np.argsort(c.bus[rows], kind="stable")]
    bus = c.bus[rows]
    slot = np.arange(len(rows)) - np.searchsorted(bus, bus)
    # heartbeats must not wait: the remaining robots get their GO after the next step
    soon = spacing_s * (slot + 1) <= _GO_SHARE * c.config.heartbeat_period_s
    soon |= slot == 0
    rows, bus, slot = rows[soon], bus[soon], slot[soon]
    begin_s = np.maximum(watch.now_s, transactions.free_s[bus]) + spacing_s * slot
    left = np.rint((phase.start_s - begin_s - phase.go_took_s) / COUNTDOWN_S)
    frames = encode_command(
        Opcode.GO, transactions.addresses[rows], c.buses["sequence"][bus], np.maximum(left, 1)
    )
    transactions.transfer(frames, 0, begin_s)
    c.robots["missed_go"][rows] = False


def cancel(c: Context, phase: Phase, watch: Watch) -> Event:
    """Stop and clear all robots before one moves, and leave out those that do not take part.

    No robot has moved: all robots that are loaded again have confirmed that. Left out are the
    others, and robots on a bus that received a GO too late for the second time.
    """
    robots, late, responding = c.robots, phase.late, phase.responding
    assert late is not None and responding is not None  # set by go()
    known = np.flatnonzero(robots["known"])
    status = stop_all(c, known, watch.now_s)
    rows = known[status.ok & (status.state == RobotState.STOPPED)]
    c.transactions.command(Opcode.CLEAR, rows, watch.now_s)
    stopped = np.zeros(len(robots), dtype=bool)
    stopped[rows] = True
    missing = unresponsive(
        robots, c.buses, c.bus, np.flatnonzero(robots["started"]), stopped, responding,
        c.config.heartbeat_period_s,
    )  # fmt: skip
    late_again = late & robots["late"]
    robots["late"] |= late & ~missing
    missing |= late_again
    fault = own_fault(robots, c.cut_off)
    fault[fault == Reason.OK] = Reason.NOT_ACKNOWLEDGED
    robots["reason"][missing] = fault[missing]
    robots["wanted"] &= ~missing
    robots["started"] = False
    c.buses["stale"] = True
    c.watch = None
    return Event.CANCELLED

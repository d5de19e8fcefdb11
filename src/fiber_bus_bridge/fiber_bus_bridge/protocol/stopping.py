# SPDX-License-Identifier: Apache-2.0
"""Steps that stop robots: all together after a failure, with a resume, or for good."""

from dataclasses import replace

import numpy as np

from fiber_bus_bridge.protocol.context import Context, Phase, Watch
from fiber_bus_bridge.protocol.decisions import able_to_resume, own_fault
from fiber_bus_bridge.protocol.ending import end_plan
from fiber_bus_bridge.protocol.loading import prepare
from fiber_bus_bridge.protocol.states import Event
from fiber_bus_bridge.protocol.tables import running
from fiber_bus_bridge.remaining_motion import remaining_motion
from fiber_bus_bridge.wire import Alert, Opcode, RobotState, Statuses, encode_command, general_call
from fiber_core.array_types import Codes, Mask, Rows
from fiber_core.outcomes import Reason

__all__ = ["halt", "judge_stopped", "resume", "resume_cleared", "stop", "stop_all"]

_AT_REST = (RobotState.UNCONFIGURED, RobotState.STOPPED, RobotState.FAULT)
_CALLS = 3  # repetitions of the general call STOP
_STOPS = 3  # attempts to stop a single robot


def stop_all(c: Context, rows: Rows, t: float) -> Statuses:
    """Stop robots by general call, then singly where needed; return their statuses.

    The call is repeated at once, because a lost STOP costs less time than finding out about it. No
    bus waits for another bus.

    Args:
        c: the controller.
        rows: robots to stop, shape (r,).
        t: earliest time [s].
    """
    transactions = c.transactions
    calls = general_call(np.repeat(transactions.buses, _CALLS))
    transactions.transfer(encode_command(Opcode.STOP, calls), 0, t)
    status = transactions.statuses(rows, t)
    for _ in range(_STOPS):
        moving = rows[~(status.ok & np.isin(status.state, _AT_REST))]
        if len(moving) == 0:
            break
        transactions.command(Opcode.STOP, moving, t)
        status = transactions.statuses(rows, t)
    c.robots["state"][rows] = status.state
    c.observe(rows, status, transactions.now_s)
    return status


def stop(c: Context, phase: Phase, watch: Watch) -> Event:
    """Stop all robots together, and find those that may resume."""
    assert watch.stop_all_at_s is not None  # set by supervise()
    robots = c.robots
    phase.stopped_at_s = watch.stop_all_at_s
    c.watch = None
    c.transactions.revive()
    moved, rows = running(robots), np.flatnonzero(robots["known"])
    status = stop_all(c, rows, phase.stopped_at_s)
    booted = np.zeros(len(robots), dtype=bool)
    booted[rows] = status.ok & (status.boot != robots["boot"][rows])
    return judge_stopped(c, moved, booted)


def judge_stopped(c: Context, moved: Mask, booted: Mask) -> Event:
    """Find the robots that may resume, of robots that were stopped and read.

    Args:
        c: the controller.
        moved: robots that were moving, shape (n,).
        booted: robots that have booted since, shape (n,).
    """
    robots = c.robots
    turns = c.plan is not None and not c.plan.resumes
    robots["able"] = able_to_resume(robots, c.bus, moved, turns) & ~booted
    failed = moved & ~robots["able"]
    robots["cause"][failed] = _cause(c, booted)[failed]
    c.t = c.transactions.now_s
    if len(c.loaded_plans) > c.config.resumes:
        c.stop_reason = Reason.OTHER_FAILED
        return Event.UNABLE
    if not c.may_go():
        return Event.UNABLE
    return Event.ABLE


def _cause(c: Context, booted: Mask) -> Codes:
    """Reason of each robot that has not stopped in order, shape (n,)."""
    robots = c.robots
    silent = robots["alerts"] & Alert.SILENT != 0
    stopped = np.where(silent, Reason.NO_HEARTBEAT, Reason.NOT_ACKNOWLEDGED)
    fault = np.where(booted, Reason.REBOOTED, own_fault(robots, c.cut_off))
    return np.where(fault == Reason.OK, stopped, fault)


def resume(c: Context, phase: Phase) -> Event:
    """Make orders for the remaining motion of the robots that may resume."""
    able = np.flatnonzero(c.robots["known"] & c.robots["able"])
    c.transactions.command(Opcode.CLEAR, able, c.transactions.now_s)
    return resume_cleared(c, phase)


def resume_cleared(c: Context, phase: Phase) -> Event:
    """Make orders for the remaining motion of robots whose orders are deleted."""
    before, plan, robots = c.loaded_plan, c.plan, c.robots
    assert before is not None and plan is not None  # robots were moving
    moved = running(robots)
    resuming = moved & robots["able"]
    elapsed_s = phase.stopped_at_s - before.start_s
    left = remaining_motion(before.motion, robots["counts"], elapsed_s, c.speed, resuming)
    c.plan = replace(plan, motion=left)
    wanted = resuming & c.plan.moves & ~c.plan.oversized
    if (
        not plan.resumes
    ):  # a test turn is counted anew, and no place is known after a turn to a stop
        wanted = np.zeros_like(wanted)
    phase = prepare(c, left, wanted, c.transactions.now_s)
    phase.before, phase.resumed, phase.oversized = before, moved, plan.oversized
    return Event.RESUMED


def halt(c: Context) -> Event:
    """Stop every robot and end the plan."""
    c.watch = None
    c.transactions.revive()
    stop_all(c, c.known_or_all, c.t)
    c.was_stopped = True
    end_plan(c)
    return Event.HALTED

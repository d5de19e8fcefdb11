# SPDX-License-Identifier: Apache-2.0
"""Steps at rest: configure, clear, and the end of a plan."""

import numpy as np

from fiber_bus_bridge.plan_result import PlanResult, Starting, evaluate
from fiber_bus_bridge.protocol.context import Context
from fiber_bus_bridge.protocol.decisions import own_fault, resting_cause
from fiber_bus_bridge.protocol.loading import not_started
from fiber_bus_bridge.protocol.states import Event
from fiber_bus_bridge.protocol.tables import begin_sequences
from fiber_bus_bridge.protocol.turn_limits import end_turn, learn_gaps
from fiber_bus_bridge.wire import (
    Configuration,
    Opcode,
    RobotState,
    config_crcs,
    encode_config,
    encode_place,
)
from fiber_core.array_types import Ints, Mask, Rows
from fiber_core.outcomes import Reason

__all__ = ["clear", "configure", "end", "end_plan", "find_causes", "look", "rests", "so_far"]

_PATIENCE = 2.0  # in durations without a heartbeat: in which a robot stops without one
_CONFIGS = 2  # attempts to configure a robot that reports a fault afterwards


def configure(c: Context) -> Event:
    """Identify the robots, and send units, limits, speeds, gears and lists of speeds to them."""
    transactions, robots, t = c.transactions, c.robots, c.t
    transactions.revive(power=True, t=t)
    rows = _identify(c)
    robots["known"] = False
    if c.note_ends is not None or not c.config.counters_kept:
        _find_causes(c, rows)
        rows = rows[robots["state"][rows] != 0]  # others would forget what they did not tell
    if not c.config.counters_kept:
        rows = _saved_at_rest(c, rows)
    if c.note_ends is not None:
        c.note_ends(rests(c))
    read_rows: list[Rows] = []
    sequences: list[Ints] = []
    for _ in range(_CONFIGS):
        todo = rows[~robots["known"][rows]]
        config = Configuration(
            c.units, c.limits[todo], c.speed[todo], c.config.watchdog_ms,
            c.config.silence_ms, c.slot[todo], None if c.gears is None else c.gears[todo],
            None if c.listed is None else c.listed[todo],
            None if c.ramps is None else c.ramps[todo],
        )  # fmt: skip
        frames = encode_config(config, transactions.addresses[todo])
        robots["config_crc"][todo] = config_crcs(frames)
        transactions.send(todo, frames, t)
        status = c.read(todo, t)
        # the fault may be of a frame for another robot, so the robot is configured once more
        configured = (status.state != RobotState.UNCONFIGURED) & (status.fault == 0)
        robots["known"][todo] = status.ok & configured
        robots["boot"][todo] = status.boot
        read_rows.append(todo[status.ok])
        sequences.append(status.sequence[status.ok])
    _place_unplaced(c, t)
    # where a robot is that was never read, and that nothing vouches for, is not known
    robots["lost"] |= ~robots["placed"]
    learn_gaps(c)
    begin_sequences(c.buses, c.bus[np.concatenate(read_rows)], np.concatenate(sequences))
    if c.note_ends is not None:  # some may have stopped meanwhile, and may be cleared now
        c.note_ends(rests(c))
    return _found(c)


def _identify(c: Context) -> Rows:
    identity = c.transactions.identities(np.arange(c.plane.n), c.t)
    return np.flatnonzero(identity.ok & (identity.serial == c.plane.ids))


def find_causes(c: Context, t: float) -> None:
    """Read why robots rest, from time t [s] on, and send nothing that lets them forget it."""
    c.t = t
    c.transactions.revive()
    _find_causes(c, _identify(c))


def _find_causes(c: Context, rows: Rows) -> None:
    """Read why robots rest, before their configuration deletes it.

    Robots that move hear no heartbeat: they are waited for as long as they go on without one.
    """
    robots = c.robots
    robots["state"] = 0
    status = c.read(rows, c.t)
    moving = np.flatnonzero(robots["state"] == RobotState.MOVING)
    if len(moving):
        c.read(moving, c.transactions.now_s + _PATIENCE * c.silence_s)
    booted, before = np.zeros(len(robots), dtype=bool), robots["boot"][rows]
    booted[rows] = status.ok & (before >= 0) & (status.boot != before)
    robots["rest_cause"] = resting_cause(robots, booted, c.cut_off)


def _saved_at_rest(c: Context, rows: Rows) -> Rows:
    """Save what was just read; return the robots that may forget why they rest.

    CONFIG and CLEAR delete the alert of a joint that did not follow, which alone tells that its
    counter is false. So a robot gets them after it was read at rest, and that is on disk.
    """
    state = c.robots["state"][rows]
    c.save()
    return rows[(state != 0) & (state != RobotState.MOVING)]


def rests(c: Context) -> Mask:
    """Robots that answered when they were read last, and rest where their encoders say, (n,)."""
    state = c.robots["state"]
    at_rest = (state != 0) & (state != RobotState.MOVING)
    return at_rest & ~c.robots["lost"] & ~c.robots["unplaced"]


def look(c: Context) -> Mask:
    """Read robots that moved when they were read last; return those that move still, (n,)."""
    robots = c.robots
    rows = np.flatnonzero(robots["state"] == RobotState.MOVING)
    if len(rows):
        c.read(rows, c.t)
        nothing = np.zeros(len(robots), dtype=bool)
        robots["rest_cause"][rows] = resting_cause(robots, nothing, c.cut_off)[rows]
    return robots["state"] == RobotState.MOVING


def _place_unplaced(c: Context, t: float) -> None:
    """Let encoders that tell nothing read where the robot rested before, which tells its turn.

    Without that they read the middle of the ranges, so that a test turn meets no limit.
    """
    robots = c.robots
    counts = np.where(robots["recalled"][:, None], robots["counts"], c.limits.sum(axis=2) // 2)
    rows = np.flatnonzero(robots["known"] & robots["unplaced"] & ~robots["seen"])
    if len(rows):
        place = encode_place(c.transactions.addresses[rows], counts[rows])
        c.transactions.send(rows, place, t)
        c.read(rows, t)
    robots["guessed"][rows] = ~robots["recalled"][rows]


def _found(c: Context) -> Event:
    """How the configured robots were found.

    A robot in FAULT stopped by itself: its controller died, or a joint did not follow. Its place
    was read, so that it may move again once all robots rest. A robot that was stopped waits for
    an operator, as one may have stopped it, unless the memory of the bridge tells that the STOP
    was its own. A robot that was in FAULT at the STOP, or lost its power since, does not tell of
    the STOP; the memory does.
    """
    state, known = c.robots["state"], c.robots["known"]
    alone = known & (state == RobotState.FAULT)
    stopped = known & (state == RobotState.STOPPED)
    if c.was_moving:
        alone, stopped = alone | stopped, np.zeros_like(stopped)
    if c.was_stopped or stopped.any() or (alone.any() and (state == RobotState.MOVING).any()):
        c.was_stopped, c.was_moving = True, False
        return Event.FOUND_STOPPED
    c.was_moving &= bool(alone.any())  # until they are cleared
    return Event.FOUND_ALONE if alone.any() else Event.CONFIGURED


def clear(c: Context) -> Event:
    """Delete orders and faults; robots stay where they are."""
    end_plan(c)
    c.transactions.revive()
    rows = c.known_or_all
    if not c.config.counters_kept:
        c.read(rows, c.t)
        rows = _saved_at_rest(c, rows)
    c.transactions.command(Opcode.CLEAR, rows, c.t)
    c.read(rows, c.t)
    c.was_stopped = c.was_moving = False
    return Event.CLEARED if c.robots["known"].any() else Event.NONE_KNOWN


def end(c: Context) -> Event:
    """Give every robot of the plan its outcome."""
    end_plan(c)
    return Event.ENDED


def end_plan(c: Context) -> PlanResult | None:
    """Evaluate the plan, if there is one; robots with a fault in a plan cut short have failed."""
    plan, robots, loaded_plan = c.plan, c.robots, c.loaded_plan
    c.plan = c.phase = c.watch = None
    if plan is None:
        return None
    if loaded_plan is not None:
        # the robot's own fault, as just read, says more than that it was late
        fault = own_fault(robots, c.cut_off)
        faulty = loaded_plan.started & ~robots["arrived"] & (fault != Reason.OK)
        faulty &= np.isin(robots["cause"], (Reason.OK, Reason.OVERDUE))
        robots["cause"] = np.where(faulty, fault, robots["cause"])
    c.result = evaluate(
        c.plane, plan, loaded_plan, robots["counts"], robots["known"],
        robots["arrived"], robots["cause"], c.stop_reason, c.config.tolerance_mm,
    )  # fmt: skip
    # what follows judges outlines: an error there must not lose the result
    if plan.within_mm is not None:
        end_turn(c)
    learn_gaps(c)
    return c.result


def so_far(c: Context) -> PlanResult:
    """Return the result of a plan as far as it is known when its verified robots get their GO."""
    plan, robots = c.plan, c.robots
    assert plan is not None and c.phase is not None  # orders are loaded
    starting = Starting(robots["verified"], not_started(robots, c.phase), plan.motion)
    return evaluate(
        c.plane, plan, starting, robots["counts"], robots["known"],
        robots["arrived"] & ~starting.started, robots["cause"], Reason.NO_HEARTBEAT,
        c.config.tolerance_mm,
    )  # fmt: skip

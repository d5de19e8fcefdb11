# SPDX-License-Identifier: Apache-2.0
"""Steps before the GO: only an order that was loaded, verified and certified can be started.

A GO reaches a whole bus and starts every order loaded there under its sequence number. So a robot
that must not move, but may hold such an order, forces its bus to a fresh sequence number: the robot
is not verified, or it is unsafe and could not be given an empty order. The other robots of the bus
are loaded again, and the GO has no effect on that robot.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.home import hold_beyond
from fiber_bus_bridge.plan_result import LoadedPlan
from fiber_bus_bridge.protocol.context import Context, Phase
from fiber_bus_bridge.protocol.decisions import neighbours_of, not_loaded
from fiber_bus_bridge.protocol.states import Event
from fiber_bus_bridge.protocol.tables import SEQUENCES, Robots, begin_phase
from fiber_bus_bridge.wire import (
    Frames,
    Opcode,
    RobotState,
    Speeds,
    decode_load,
    encode_load,
    place_crcs,
)
from fiber_core.array_types import Bools, Codes, Mask, Rows
from fiber_core.clearance import Certificate
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.turns_of_theta import BEYOND_RAD
from fiber_core.wire_units import WireMotion

__all__ = [
    "Delivery",
    "begin_plan",
    "certify",
    "commit",
    "deliver",
    "disarm",
    "drop",
    "load",
    "not_started",
    "prepare",
]

_ROUNDS = 6  # fresh sequence numbers tried before nothing is started
_TRIES = 2  # deliveries of an order under one sequence number


class Delivery(NamedTuple):
    """Result of LOAD and VERIFY for some robots, shape (r,) each.

    Args:
        verified: whether the order on the robot is the one sent.
        suspect: whether the robot may hold another order under the same sequence number.
        reason: Reason of robots that are not verified, else OK.
    """

    verified: Bools
    suspect: Bools
    reason: Codes


def begin_plan(c: Context, t: float, may_go: Callable[[], bool]) -> None:
    """Begin the first phase of the plan that waits; arguments as in Session.start."""
    plan = c.plan
    assert plan is not None  # orders wait
    c.transactions.revive()
    c.may_go, c.loaded_plans, c.stop_reason = may_go, [], Reason.STOPPED
    wanted = plan.moves & c.plane.enabled & ~plan.oversized & c.robots["known"]
    prepare(c, plan.motion, wanted, t)


def prepare(c: Context, motion: WireMotion, wanted: Mask, t: float) -> Phase:
    """Begin a phase: the wanted robots shall move, unless a lost robot is beside them.

    A robot at an unknown place moves in a test turn alone, or to its stops if a camera has told all
    but its turn of theta.

    Args:
        c: the controller.
        motion: orders of every robot, from the positions of the encoders.
        wanted: robots that shall move, shape (n,).
        t: earliest time of the first message [s].
    """
    lost, unplaced = c.robots["lost"], c.robots["unplaced"]
    if c.plan is not None and c.plan.within_mm is not None and c.plan.about is None:
        lost = unplaced = np.zeros_like(lost)
    if c.plan is not None and c.plan.to_stops:
        unplaced = unplaced & ~c.robots["seen"]
    blocked = wanted & (neighbours_of(lost, c.pairs) | lost | unplaced)
    begin_phase(c.robots, c.buses, wanted, blocked)
    c.phase = Phase(motion.only(wanted & ~blocked), t)
    return c.phase


def load(c: Context, phase: Phase) -> Event:
    """LOAD and VERIFY on buses that need a fresh sequence number."""
    if phase.rounds == _ROUNDS:
        return Event.EXHAUSTED
    phase.rounds += 1
    robots, buses = c.robots, c.buses
    stale = buses["stale"].copy()
    robots["verified"] &= ~stale[c.bus]
    buses["sequence"] = np.where(stale, buses["sequence"] % SEQUENCES + 1, buses["sequence"])
    todo = np.flatnonzero(robots["wanted"] & stale[c.bus])
    # for the other buses these are, byte for byte, the frames already verified there
    phase.frames = _encode(c, phase.motion)
    delivered = deliver(c, phase, todo, phase.frames[todo])
    robots["verified"][todo] = delivered.verified
    robots["reason"][todo] = delivered.reason
    robots["wanted"] &= robots["reason"] == Reason.OK
    # on a bus without GO it does not matter which orders are loaded
    buses["stale"] = c.buses_of(todo[delivered.suspect]) & c.buses_of(robots["wanted"])
    return Event.SUSPECT if buses["stale"].any() else Event.VERIFIED


def certify(c: Context, phase: Phase) -> Event:
    """Certify the verified orders with unsafe robots held."""
    robots = c.robots
    phase.loaded = _decode(c, phase, robots["verified"])
    motion, held, phase.certificate = _certified(c, phase.loaded.decoded())
    # two resting robots may be too close to each other; a moving robot may not be one of them
    certificate = phase.certificate
    wrong = certificate.unsafe_robots | certificate.limits_broken | certificate.moved_disabled
    if (wrong & (motion.counts > 0).any(axis=1)).any():
        held = np.ones(c.plane.n, dtype=bool)
    held = held & robots["verified"]
    if not held.any():
        return Event.CERTIFIED
    robots["reason"][held] = Reason.UNSAFE_AS_LOADED
    robots["wanted"] &= ~held
    return Event.UNSAFE


def _certified(c: Context, motion: SegmentMotion) -> tuple[SegmentMotion, Mask, Certificate]:
    if c.plan is None or c.plan.within_mm is None:
        return c.certify(_range_of(c), motion, c.safety)
    return hold_beyond(c.plane, motion, c.safety, c.plan.within_mm, c.plan.about)


def _range_of(c: Context) -> FocalPlane:
    """The plane, with ranges of theta in which arms may stand that turn away from a stop."""
    if c.plan is None or not c.plan.to_stops:
        return c.plane
    beyond = np.array([[-BEYOND_RAD, BEYOND_RAD], [0.0, 0.0]])
    return replace(c.plane, limits=c.plane.limits + beyond)


def disarm(c: Context, phase: Phase) -> Event:
    """Replace the orders of verified robots that are not wanted any more by empty ones."""
    robots, buses = c.robots, c.buses
    rows = np.flatnonzero(robots["verified"] & ~robots["wanted"])
    robots["verified"][rows] = False
    rest = WireMotion.at_rest(c.units, np.zeros((len(rows), 2), dtype=np.int64))
    sequence = buses["sequence"][c.bus[rows]]
    empty = encode_load(c.transactions.addresses[rows], sequence, rest, _listed(c, rows))
    armed = rows[deliver(c, phase, rows, empty).suspect]
    buses["stale"] = c.buses_of(armed) & c.buses_of(robots["wanted"])
    if buses["stale"].any():
        return Event.ARMED
    phase.loaded = _decode(c, phase, robots["verified"])
    return Event.CERTIFIED


def drop(c: Context, phase: Phase) -> Event:
    """CLEAR all loaded orders; no robot is started."""
    robots = c.robots
    robots["reason"][robots["wanted"]] = Reason.STOPPED
    rows = np.flatnonzero(robots["verified"])
    c.transactions.command(Opcode.CLEAR, rows, c.transactions.now_s)
    robots["verified"] = robots["started"] = False
    phase.loaded = _decode(c, phase, robots["verified"])
    _, _, phase.certificate = _certified(c, phase.loaded.decoded())
    phase.go_s = phase.start_s = c.transactions.now_s
    commit(c, phase)
    return Event.DROPPED


def commit(c: Context, phase: Phase) -> LoadedPlan:
    """Record and return the loaded plan of a phase: its verified robots were started."""
    robots = c.robots
    started = robots["verified"].copy()
    rows = np.flatnonzero(started)
    frames, loaded, certificate = phase.frames, phase.loaded, phase.certificate
    assert frames is not None and loaded is not None and certificate is not None
    loaded_plan = LoadedPlan(
        started, not_started(robots, phase), c.buses["sequence"][c.bus], frames[rows], loaded,
        certificate, phase.go_s, phase.start_s,
    )  # fmt: skip
    if started.any() and phase.turn_limit is not None:
        robots["turn_limit"] = np.minimum(robots["turn_limit"], phase.turn_limit)
    c.loaded_plan = loaded_plan
    c.loaded_plans.append(loaded_plan)
    robots["lost"] |= started
    return loaded_plan


def not_started(robots: Robots, phase: Phase) -> Codes:
    """Return the Reason of robots with orders that a phase does not start, else OK, shape (n,)."""
    started, reason = robots["verified"], robots["reason"].copy()
    if phase.before is not None and phase.resumed is not None:
        # a robot that was not started in an earlier phase keeps its reason
        stays = phase.resumed & ~started & (reason == Reason.OK)
        reason = np.where(reason == Reason.OK, phase.before.reason, reason)
        reason[phase.oversized] = Reason.TOO_MANY_SEGMENTS
        reason[stays] = Reason.STOPPED
    return reason


def _encode(c: Context, motion: WireMotion) -> Frames:
    return encode_load(c.transactions.addresses, c.buses["sequence"][c.bus], motion, c.listed)


def _listed(c: Context, rows: Rows) -> Speeds | None:
    """The lists of speeds of some robots."""
    return None if c.listed is None else c.listed[rows]


def _decode(c: Context, phase: Phase, chosen: Mask) -> WireMotion:
    """The motion in the frames of the chosen robots; all other robots rest."""
    assert phase.frames is not None  # set by load()
    orders = decode_load(c.units, phase.frames, c.listed)
    return orders.motion.starting_at(phase.motion.start).only(chosen)


def deliver(c: Context, phase: Phase, rows: Rows, frames: Frames) -> Delivery:
    """LOAD and VERIFY; both are repeated once for robots on which they failed by chance."""
    t, boot, transactions = phase.t, c.robots["boot"], c.transactions
    verified, suspect = np.zeros(len(rows), dtype=bool), np.ones(len(rows), dtype=bool)
    ack = np.full(len(rows), Ack.NO_ADDRESS, dtype=np.int64)
    replied, booted = np.zeros(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
    todo = np.arange(len(rows))
    for _ in range(_TRIES):
        new_ack = transactions.send(rows[todo], frames[todo], t)
        ack[todo] = np.where(new_ack == Ack.NO_ADDRESS, ack[todo], new_ack)
        begin_s = max(t, transactions.now_s)
        status = transactions.statuses(rows[todo], t, complete=False)
        phase.verify_s = max(phase.verify_s, transactions.now_s - begin_s)
        sent = decode_load(c.units, frames[todo], _listed(c, rows[todo]))
        loaded = (status.state == RobotState.LOADED) & (status.sequence == sent.sequence)
        # the order, what the robot was configured by, and where the order begins
        held = sent.crc ^ c.robots["config_crc"][rows[todo]]
        held ^= place_crcs(c.robots["counts"][rows[todo]])
        same = (status.order_crc == held) & (status.boot == boot[rows[todo]])
        verified[todo] = status.ok & loaded & same
        suspect[todo] = ~verified[todo] & (~status.ok | loaded)
        replied[todo] = status.ok
        booted[todo] = status.ok & (status.boot != boot[rows[todo]])
        # another boot, a repeated refusal and an absence are final
        final = booted[todo] | (new_ack == Ack.REFUSED)
        final |= (new_ack == Ack.NO_ADDRESS) & ~status.ok
        todo = todo[~verified[todo] & ~final]
    reason = not_loaded(verified, ack, replied, booted, c.cut_off[rows])
    return Delivery(verified, suspect, reason)

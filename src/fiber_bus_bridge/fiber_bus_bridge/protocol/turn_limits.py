# SPDX-License-Identifier: Apache-2.0
"""How far theta of a robot may still turn when its place becomes unknown, so that nothing touches.

Each robot has a limit down and a limit up, from where it is. A robot with both elbows in range
turns phi in place of theta, by as much as moves no point farther (`as_turned`). For every pair of
neighbours the turns within their limits use up less than the gap between them:

- both places known: half of the gap of the outlines, and at most half of the margin. The outlines
  hold what the drive and the last image leave unknown;
- a plan that is about to start: half of what a motion leaves that is broken off, if that is less;
- phi is about to turn by a code word: nothing, for its robot and the neighbours;
- a turn that is carried out, in part or as a whole, moves both limits; a turn of which the end is
  not known makes one smaller and leaves the other one as it was;
- a place that becomes known anew beside one that is not: the smaller of old and new;
- beside a joint that did not follow: nothing (`Context.observe`).

A robot of which nothing was ever known stopped under a certificate: half of the margin.
"""

from dataclasses import replace

import numpy as np

from fiber_bus_bridge.protocol.context import Context
from fiber_bus_bridge.protocol.decisions import neighbours_of, own_fault
from fiber_bus_bridge.wire import RobotState
from fiber_core.arm_bounds import joints_of_test_turns, turn_within
from fiber_core.array_types import Counts, Floats, Gaps, Ints, Mask, Pairs
from fiber_core.clearance import certify, gaps, levers_of, point_speeds
from fiber_core.drive import carried_out
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason

__all__ = [
    "as_theta",
    "as_turned",
    "end_turn",
    "full_turn",
    "half_gaps",
    "known_again",
    "learn_gaps",
    "limits_after_go",
    "turning",
]

_ROUNDING = 1e-6  # of a quantum, so that a turn of theta uses up itself


def full_turn(c: Context) -> Ints:
    """Return the turn of theta that moves no point by more than half of the margin, (n,)."""
    return _turn(c, c.safety.margin_mm)


def _turn(c: Context, gap_mm: Floats | float) -> Ints:
    return np.floor(turn_within(c.plane, gap_mm) / c.units.quantum_rad).astype(np.int64)


def _theta_over_turn(c: Context) -> Floats:
    """The turn of theta that moves points as far as one of the joint of test turns, (n,)."""
    levers = levers_of(c.plane)
    return levers[np.arange(c.plane.n), joints_of_test_turns(c.plane)] / levers[:, 0]


def as_theta(c: Context, turn: Ints) -> Ints:
    """Return the turn of theta that moves no point farther than some test turns of each robot.

    Args:
        c: the controller.
        turn: turns of the joint of test turns, at least 0 [quanta], shape (n, k).
    """
    return np.floor(turn * _theta_over_turn(c)[:, None]).astype(np.int64)


def as_turned(c: Context, theta: Ints) -> Ints:
    """Return the test turn of each robot that moves no point farther than a turn of theta.

    Args:
        c: the controller.
        theta: turns of theta, at least 0 [quanta], shape (n,).
    """
    return np.floor(theta / _theta_over_turn(c)).astype(np.int64)


def _turned(c: Context, quanta: Counts) -> Ints:
    """What test turns use up of the limits: turns of theta, upwards above 0 [quanta], (n,)."""
    turn = quanta[np.arange(c.plane.n), joints_of_test_turns(c.plane)]
    used = np.ceil(np.abs(turn) * _theta_over_turn(c) - _ROUNDING).astype(np.int64)
    return np.sign(turn) * used


def learn_gaps(c: Context) -> None:
    """Take over the gaps between robots at known places; only this makes limits larger."""
    if c.config.counters_kept:
        return
    robots = c.robots
    known = _known(c)
    pairs, others = _pairs_of(c, known)
    limit = np.minimum(_turn(c, _least_gap(c, pairs, _gaps(c, pairs))), full_turn(c))[:, None]
    beside = np.zeros(c.plane.n + c.plane.fixtures, dtype=bool)
    beside[others] = True
    before = robots["turn_limit"]
    limit = np.where(beside[: c.plane.n, None], np.minimum(before, limit), limit)
    robots["turn_limit"] = np.where(known[:, None], limit, before)


def half_gaps(c: Context) -> Floats:
    """Return half of the gap of each robot where it rests, at most half of the margin [mm], (n,).

    It is 0 for a robot at an unknown place, or beside one. Outlines hold what moves from there
    leave unknown, also if an image was taken since the last one.
    """
    known = _known(c)
    pairs, others = _pairs_of(c, known)
    grown = _grown(c, np.maximum(c.blind_mm, c.of_move_mm))
    half_mm = 0.5 * _least_gap(c, pairs, gaps(grown, pairs, c.units.to_angles(c.robots["counts"])))
    half_mm[others[others < c.plane.n]] = 0.0
    return np.where(known, half_mm, 0.0)


def known_again(c: Context, chosen: Mask) -> None:
    """Let robots whose places become known turn no farther than half of the margin either way."""
    limit = c.robots["turn_limit"]
    limit[chosen] = np.minimum(limit, full_turn(c)[:, None])[chosen]


def _known(c: Context) -> Mask:
    """Robots that rest at known places, shape (n,)."""
    robots = c.robots
    return robots["placed"] & ~robots["lost"] & (~robots["unplaced"] | robots["seen"])


def _pairs_of(c: Context, known: Mask) -> tuple[Pairs, Pairs]:
    """Pairs of bodies at known places, and the other pairs."""
    there = np.append(known, np.ones(c.plane.fixtures, dtype=bool))[c.pairs]
    both = there.all(axis=1)
    return c.pairs[both], c.pairs[~both]


def _gaps(c: Context, pairs: Pairs) -> Gaps:
    """Gaps of pairs where their counters put them, less what is not known of the arms [mm]."""
    return gaps(_grown(c, c.blind_mm), pairs, c.units.to_angles(c.robots["counts"]))


def _grown(c: Context, blind_mm: Floats) -> FocalPlane:
    """The plane with outlines that hold the arms, wherever they may be."""
    theta_mm, phi_mm = (c.exact_mm + np.hypot(c.known_mm, blind_mm)).T
    return replace(c.plane, theta_radius=theta_mm, phi_radius=phi_mm)


def _least_gap(c: Context, pairs: Pairs, gap_mm: Gaps) -> Floats:
    """Smallest of some gaps for each robot, at most the margin [mm], shape (n,)."""
    least = np.full(c.plane.n + c.plane.fixtures, c.safety.margin_mm)
    np.minimum.at(least, pairs, np.maximum(gap_mm, 0.0)[:, None])
    return least[: c.plane.n]


def limits_after_go(c: Context) -> Ints:
    """Return limits that hold wherever the motion that is about to start ends, shape (n, 2).

    A motion that is broken off leaves less than the margin: its robots stop up to h apart
    (`Safety.stop_skew_s`). It takes as long as a certificate, so no robot may move meanwhile.
    """
    limit, plan, chosen = c.robots["turn_limit"], c.plan, c.robots["verified"]
    assert plan is not None and c.phase is not None and c.phase.loaded is not None
    loaded = c.phase.loaded
    if plan.about is not None:  # phi uses up what theta might have turned, also of neighbours
        beside = chosen | neighbours_of(chosen, c.pairs)
        return limit if c.config.counters_kept else np.where(beside[:, None], 0, limit)
    if plan.within_mm is not None:
        return _turn_used_up(limit, _turned(c, loaded.end - loaded.start), chosen)
    if c.config.counters_kept or not chosen.any():
        return limit
    pairs, _ = _pairs_of(c, _known(c))
    moves = np.append(loaded.moves, np.zeros(c.plane.fixtures, dtype=bool))
    pairs = pairs[moves[pairs].any(axis=1)]
    left_mm = _left_mm(c, loaded.decoded(), pairs)
    return np.minimum(limit, _turn(c, _least_gap(c, pairs, left_mm))[:, None])


def _left_mm(c: Context, motion: SegmentMotion, pairs: Pairs) -> Gaps:
    """Gaps that a motion leaves wherever it is broken off [mm], shape (p,)."""
    plane, safety, s = _grown(c, c.blind_mm), c.safety, c.safety
    late = replace(
        safety,
        start_skew_s=s.start_skew_s + s.stop_skew_s, stop_skew_s=0.0,
        border_start_skew_s=s.border_start_skew_s + s.border_stop_skew_s,
        border_stop_skew_s=0.0,
    )  # fmt: skip
    true_motion = carried_out(plane.drive, motion)
    speeds = point_speeds(levers_of(plane), true_motion.fastest)
    # a pair at t_a and t_b, |t_a - t_b| <= 2 e T + s + h: min(V_a, V_b) |t_a - t_b| less
    asked_mm = late.required_at(speeds, true_motion.makespan_s, pairs, sector=plane.sector)
    least_mm = certify(plane, motion, late, pairs).gap_mm
    return least_mm - (asked_mm - safety.margin_mm)


def _turn_used_up(limit: Ints, turn: Ints, chosen: Mask) -> Ints:
    """Limits after turns [quanta] that were carried out, in part or not at all, shape (n, 2)."""
    turn = np.where(chosen, turn, 0)
    return np.maximum(limit - np.stack([np.maximum(-turn, 0), np.maximum(turn, 0)], axis=1), 0)


def turning(c: Context, starting: bool) -> Mask:
    """Return the robots that carry out a test turn, shape (n,).

    Args:
        c: the controller.
        starting: whether the verified robots are about to be sent a GO.
    """
    robots, turns = c.robots, np.zeros(c.plane.n, dtype=bool)
    if c.plan is None or c.plan.within_mm is None or c.phase is None:
        return turns
    for loaded_plan in c.loaded_plans:
        turns |= loaded_plan.started
    return turns | robots["started"] | (robots["verified"] if starting else False)


def end_turn(c: Context) -> None:
    """Give robots that were read at rest what they have not turned, and what they may turn back.

    Of the others neither the turn nor the place is known any more, nor does anything vouch for it.
    """
    if not c.loaded_plans:
        return
    robots, first = c.robots, c.loaded_plans[0]
    turn = _turned(c, first.motion.end - first.motion.start)
    read = np.isin(robots["state"], (RobotState.IDLE, RobotState.STOPPED, RobotState.FAULT))
    read &= own_fault(robots, c.cut_off) == Reason.OK
    made = np.where(robots["arrived"], turn, _turned(c, robots["counts"] - first.motion.start))
    within = (made * np.sign(turn) >= 0) & (np.abs(made) <= np.abs(turn))
    sure = first.started & (robots["arrived"] | read) & within
    # of one that was ordered to turn up: the rest of it up again, and what was made of it down
    back = np.stack([np.maximum(-turn, 0) + made, np.maximum(turn, 0) - made], axis=1)
    robots["turn_limit"] += np.where(sure[:, None], back, 0)
    unsure = first.started & ~sure
    robots["recalled"] &= ~unsure
    robots["guessed"] |= unsure & robots["unplaced"]

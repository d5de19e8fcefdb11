# SPDX-License-Identifier: Apache-2.0
"""How far theta of a robot may still turn when its place becomes unknown, so that nothing touches.

Each robot has a limit down and a limit up, from where it is. For every pair of neighbours the turns
within their limits use up less than the gap between them:

- both places known: half of the gap of the outlines, and at most half of the margin;
- a turn that is carried out moves both limits; a turn of which the end is not known makes one
  smaller and leaves the other one as it was;
- a place that becomes known anew beside one that is not: the smaller of old and new.

A robot of which nothing was ever known stopped under a certificate: half of the margin.
"""

import numpy as np

from fiber_bus_bridge.protocol.context import Context
from fiber_core.arm_bounds import turn_within
from fiber_core.array_types import Floats, Ints, Mask
from fiber_core.clearance import gaps
from fiber_core.focal_plane import FocalPlane

__all__ = [
    "end_turn",
    "full_turn",
    "known_again",
    "learn_gaps",
    "restore_turns",
    "turn_used_up",
    "use_up_turn",
]


def full_turn(c: Context) -> Ints:
    """Return the turn of theta that moves no point by more than half of the margin, (n,)."""
    return np.floor(turn_within(c.plane, c.safety.margin_mm) / c.units.quantum_rad).astype(np.int64)


def learn_gaps(c: Context, plane: FocalPlane) -> None:
    """Take over the gaps between robots at known places after an image.

    Args:
        c: the controller.
        plane: the plane with outlines that hold the arms wherever they may be.
    """
    if c.config.counters_kept:
        return
    known, beside, gap_mm = _gaps(c, plane)
    turn = turn_within(c.plane, gap_mm) / c.units.quantum_rad
    limit = np.repeat(np.floor(turn).astype(np.int64)[:, None], 2, axis=1)
    before = c.robots["turn_limit"]
    limit = np.where(beside[:, None], np.minimum(before, limit), limit)
    c.robots["turn_limit"] = np.where(known[:, None], limit, before)


def restore_turns(c: Context) -> None:
    """Let robots that keep the margin to all neighbours, at known places, turn as far as it allows.

    A certified motion brings no pair closer than the margin, or than it was: other limits hold on.
    """
    if c.config.counters_kept:
        return
    known, beside, gap_mm = _gaps(c, c.plane)
    apart = known & ~beside & (gap_mm >= c.safety.margin_mm)
    c.robots["turn_limit"][apart] = full_turn(c)[apart, None]


def known_again(c: Context, chosen: Mask) -> None:
    """Let robots whose places become known turn no farther than half of the margin either way."""
    limit = c.robots["turn_limit"]
    limit[chosen] = np.minimum(limit, full_turn(c)[:, None])[chosen]


def _gaps(c: Context, plane: FocalPlane) -> tuple[Mask, Mask, Floats]:
    """Robots at known places, those beside unknown places, and gaps up to the margin, (n,) each."""
    robots, n, all_bodies = c.robots, c.plane.n, c.plane.n + c.plane.fixtures
    known = robots["placed"] & ~robots["lost"] & (~robots["unplaced"] | robots["seen"])
    there = np.append(known, np.ones(c.plane.fixtures, dtype=bool))[c.pairs]
    both = there.all(axis=1)
    apart = gaps(plane, c.pairs[both], c.units.to_angles(robots["counts"]))
    gap_mm, beside = np.full(all_bodies, c.safety.margin_mm), np.zeros(all_bodies, dtype=bool)
    np.minimum.at(gap_mm, c.pairs[both], np.maximum(apart, 0.0)[:, None])
    beside[c.pairs[~both]] = True
    return known, beside[:n], gap_mm[:n]


def turn_used_up(limit: Ints, turn: Ints, chosen: Mask) -> Ints:
    """Return limits after turns that were carried out, in part or not at all, shape (n, 2).

    Args:
        limit: limits before, shape (n, 2).
        turn: ordered turns [quanta], shape (n,).
        chosen: robots that were told to turn, shape (n,).
    """
    turn = np.where(chosen, turn, 0)
    return np.maximum(limit - np.stack([np.maximum(-turn, 0), np.maximum(turn, 0)], axis=1), 0)


def use_up_turn(c: Context) -> None:
    """Take the turns of the robots that are about to be started from their limits."""
    robots = c.robots
    robots["turn_limit"] = turn_used_up(robots["turn_limit"], _turns(c), robots["verified"])


def end_turn(c: Context) -> None:
    """Give robots that have carried out their turns what they may turn back."""
    robots, loaded = c.robots, c.loaded_plan
    if loaded is None or len(c.loaded_plans) != 1:
        return
    motion = loaded.motion
    turn = np.where(loaded.started & robots["arrived"], (motion.end - motion.start)[:, 0], 0)
    back = np.stack([np.maximum(turn, 0), np.maximum(-turn, 0)], axis=1)
    robots["turn_limit"] += back


def _turns(c: Context) -> Ints:
    assert c.phase is not None and c.phase.loaded is not None  # orders are loaded
    loaded = c.phase.loaded
    return (loaded.end - loaded.start)[:, 0]

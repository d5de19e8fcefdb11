# SPDX-License-Identifier: Apache-2.0
"""Orders of robots from their moves and the first ticks of their legs."""

from dataclasses import dataclass

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Counts, Floats, Ints
from fiber_core.drive import CurveMotion, Drive, carried_out
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireUnits
from fiber_planner.scheduled.moves import Motors, moves_to, run_ticks
from fiber_planner.scheduled.timetable import APPROACHES, LEGS, RUNS, VIAS

__all__ = ["Legs", "curves_of", "legs_by_way_of", "sampled"]

_MOST = 7  # segments of one joint: four moves, and the waits before three of them


@dataclass(frozen=True, eq=False)
class Legs:
    """The moves of m robots, leg by leg as in Timetable.

    Args:
        ticks: ticks of the run of each leg, of an approach those back; shape (m, 6).
        velocity: their velocity [velocity units], shape (m, 6).
        forth: ticks of the second part of an approach, else 0, shape (m, 6).
        forth_velocity: its velocity, shape (m, 6).
        on: ticks that the motor is on, 0 without a leg, shape (m, 6).
        turn: how far theta and phi turn in all [quanta], shape (m, 2).
        possible: whether these moves stay inside the ranges of the joints, shape (m,); robots
            rest that have no such moves.
    """

    ticks: Ints
    velocity: Ints
    forth: Ints
    forth_velocity: Ints
    on: Ints
    turn: Ints
    possible: Bools

    def take(self, rows: Ints) -> "Legs":
        """Return the legs of some of these robots, shape (k,)."""
        return Legs(*(array[rows] for array in vars(self).values()))

    def joined(self, other: "Legs") -> "Legs":
        """Return the legs of these robots, then those of others."""
        both = zip(vars(self).values(), vars(other).values())
        return Legs(*(np.concatenate(arrays) for arrays in both))

    def with_rows(self, rows: Ints, other: "Legs") -> "Legs":
        """Return the legs with some robots, shape (k,), moving as in `other`, of k robots."""
        mine = [array.copy() for array in vars(self).values()]
        for array, theirs in zip(mine, vars(other).values()):
            array[rows] = theirs
        return Legs(*mine)


def legs_by_way_of(motors: Motors, rows: Ints, start: Counts, turn: Ints, via: Ints) -> Legs:
    """Return the legs of robots with joints that run to angles on the way first.

    Args:
        motors: what the motors can do.
        rows: rows of the robots, shape (m,).
        start: positions of their joints [quanta], shape (m, 2).
        turn: how far theta and phi are to turn [quanta], shape (m, 2).
        via: how far they turn first [quanta], 0 for none, shape (m, 2).
    """
    m = len(rows)
    via_ticks, via_velocity = run_ticks(motors, rows, via)
    # where nothing would be left to turn there would be no approach either
    via_ticks = np.where(via_ticks * via_velocity == turn, 0, via_ticks)
    by_way = via_ticks * via_velocity
    moves = moves_to(motors, rows, start + by_way, turn - by_way)
    via_ticks, by_way = (np.where(moves.possible[:, None], a, 0) for a in (via_ticks, by_way))
    ticks, velocity, forth, forth_velocity, on = np.zeros((5, m, LEGS), dtype=np.int64)
    sign, creep, joints = motors.sign, motors.creep[rows], np.arange(2)
    rising = (sign + 1) // 2
    ticks[:, VIAS], velocity[:, VIAS] = via_ticks, via_velocity
    ticks[:, RUNS], velocity[:, RUNS] = moves.run, moves.run_velocity
    ticks[:, APPROACHES], forth[:, APPROACHES] = moves.back, moves.forth
    velocity[:, APPROACHES] = -sign * creep[:, joints, 1 - rising]
    forth_velocity[:, APPROACHES] = sign * creep[:, joints, rising]
    on[:, VIAS] = np.where(via_ticks > 0, via_ticks + motors.ramp, 0)
    on[:, RUNS] = np.where(moves.run > 0, moves.run + motors.ramp, 0)
    on[:, APPROACHES] = moves.back + moves.forth
    return Legs(ticks, velocity, forth, forth_velocity, on, moves.turn + by_way, moves.possible)


def segments_of(legs: Legs, starts: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the offsets of 2 m profiles, and ticks and velocities of their segments.

    Args:
        legs: the legs of m robots.
        starts: first tick of each leg, shape (m, 6).
    """
    return _segments(legs.ticks, legs.velocity, legs.forth, legs.forth_velocity, starts)


def curves_of(
    drive: Drive, units: WireUnits, start: Counts, legs: Legs, starts: Ints
) -> CurveMotion:
    """Return the true curves of some robots.

    Args:
        drive: the drive of these m robots.
        units: size of tick and quantum.
        start: joint positions at time zero [quanta], shape (m, 2).
        legs: their legs.
        starts: first tick of each leg, shape (m, 6).
    """
    offsets, ticks, velocity = segments_of(legs, starts)
    motion = SegmentMotion.of_valid(
        units.to_angles(start), offsets, ticks * units.tick_s, velocity * units.velocity_rad_s
    )
    curves = carried_out(drive, motion)
    assert isinstance(curves, CurveMotion)
    return curves


def sampled(units: WireUnits, start: Counts, legs: Legs, starts: Ints) -> tuple[Floats, Floats]:
    """Return times [s], shape (t,), and ordered joint angles at them [rad], shape (m, 2, t)."""
    offsets, ticks, velocity = segments_of(legs, starts)
    parts = Parts(offsets)
    knots = np.unique(np.append(parts.running(ticks), [0, 1]))
    angles = np.empty((len(start), 2, len(knots)))
    _sample(offsets, ticks, velocity, start, knots, units.quantum_rad, angles)
    return knots * units.tick_s, angles


@nb.njit(cache=True)
def _segments(run, run_velocity, forth, forth_velocity, starts):
    m = len(run)
    offsets = np.zeros(2 * m + 1, dtype=np.int64)
    ticks, velocity = np.empty(2 * m * _MOST, np.int64), np.empty(2 * m * _MOST, np.int64)
    used = 0
    for i in range(m):
        for joint in range(2):
            now = 0
            for leg in range(joint * LEGS // 2, (joint + 1) * LEGS // 2):
                if run[i, leg] + forth[i, leg] == 0:
                    continue
                if starts[i, leg] > now:
                    ticks[used], velocity[used] = starts[i, leg] - now, 0
                    used += 1
                    now = starts[i, leg]
                for lasts, speed in (
                    (run[i, leg], run_velocity[i, leg]),
                    (forth[i, leg], forth_velocity[i, leg]),
                ):
                    if lasts > 0:
                        ticks[used], velocity[used] = lasts, speed
                        used += 1
                        now += lasts
            offsets[2 * i + joint + 1] = used
    return offsets, ticks[:used].copy(), velocity[:used].copy()


@nb.njit(cache=True)
def _sample(offsets, ticks, velocity, start, knots, quantum, angles):
    for i in range(len(start)):
        for joint in range(2):
            at, k, end = start[i, joint], offsets[2 * i + joint], offsets[2 * i + joint + 1]
            now, left = 0, 0
            for t in range(len(knots)):
                while k < end and now < knots[t]:
                    step = min(ticks[k] - left, knots[t] - now)
                    at += step * velocity[k]
                    now += step
                    left += step
                    if left == ticks[k]:
                        k, left = k + 1, 0
                now = knots[t]
                angles[i, joint, t] = at * quantum

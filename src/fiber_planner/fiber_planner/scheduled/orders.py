# SPDX-License-Identifier: Apache-2.0
"""Orders of robots from their moves and the first ticks of their legs."""

from dataclasses import dataclass

import numba as nb
import numpy as np

from fiber_core.array_types import Counts, Floats, Ints
from fiber_core.drive import CurveMotion, Drive, carried_out
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireUnits
from fiber_planner.scheduled.moves import Motors, moves_to, run_ticks
from fiber_planner.scheduled.timetable import LEGS

__all__ = ["Legs", "curves_of", "legs_by_way_of", "sampled"]

_MOST = 8  # segments of one joint: four moves, each with the wait before it


@dataclass(frozen=True, eq=False)
class Legs:
    """The moves of m robots, leg by leg as in Timetable.

    Args:
        ticks: ticks of the run of each leg, of an approach those back; shape (m, 5).
        velocity: their velocity [velocity units], shape (m, 5).
        forth: ticks of the second part of an approach, else 0, shape (m, 5).
        forth_velocity: its velocity, shape (m, 5).
        on: ticks that the motor is on, 0 without a leg, shape (m, 5).
        turn: how far theta and phi turn in all [quanta], shape (m, 2).
    """

    ticks: Ints
    velocity: Ints
    forth: Ints
    forth_velocity: Ints
    on: Ints
    turn: Ints

    def take(self, rows: Ints) -> "Legs":
        """Return the legs of some of these robots, shape (k,)."""
        return Legs(*(array[rows] for array in vars(self).values()))

    def with_rows(self, rows: Ints, other: "Legs") -> "Legs":
        """Return the legs with some robots, shape (k,), moving as in `other`, of k robots."""
        mine = [array.copy() for array in vars(self).values()]
        for array, theirs in zip(mine, vars(other).values()):
            array[rows] = theirs
        return Legs(*mine)


def legs_by_way_of(motors: Motors, rows: Ints, turn: Ints, via: Ints) -> Legs:
    """Return the legs of robots that turn phi to an angle on the way first.

    Args:
        motors: what the motors can do.
        rows: rows of the robots, shape (m,).
        turn: how far theta and phi are to turn [quanta], shape (m, 2).
        via: how far phi turns first [quanta], shape (m,); 0 for none.
    """
    m = len(rows)
    via_ticks, via_velocity = run_ticks(motors, rows, 1, via)
    rest = turn.copy()
    rest[:, 1] -= via_ticks * via_velocity
    moves = moves_to(motors, rows, rest)
    ticks, velocity, forth, forth_velocity, on = (np.zeros((m, LEGS), np.int64) for _ in range(5))
    ticks[:, 0], velocity[:, 0] = via_ticks, via_velocity
    rising, joints = (motors.sign + 1) // 2, np.arange(2)
    creep = motors.creep[rows]
    for joint in joints:
        run, approach = 1 + 2 * joint, 2 + 2 * joint
        ticks[:, run], velocity[:, run] = moves.run[:, joint], moves.run_velocity[:, joint]
        ticks[:, approach], forth[:, approach] = moves.back[:, joint], moves.forth[:, joint]
        sign, up = motors.sign[joint], rising[joint]
        velocity[:, approach] = -sign * creep[:, joint, 1 - up]
        forth_velocity[:, approach] = sign * creep[:, joint, up]
    for leg in (0, 1, 3):
        on[:, leg] = np.where(ticks[:, leg] > 0, ticks[:, leg] + motors.ramp, 0)
    for leg in (2, 4):
        on[:, leg] = ticks[:, leg] + forth[:, leg]
    total = moves.turn.copy()
    total[:, 1] += via_ticks * via_velocity
    return Legs(ticks, velocity, forth, forth_velocity, on, total)


def segments_of(legs: Legs, starts: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the offsets of 2 m profiles, and ticks and velocities of their segments.

    Args:
        legs: the legs of m robots.
        starts: first tick of each leg, shape (m, 5).
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
        starts: first tick of each leg, shape (m, 5).
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
            for leg in range(LEGS):
                if (leg == 1 or leg == 2) != (joint == 0):
                    continue
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

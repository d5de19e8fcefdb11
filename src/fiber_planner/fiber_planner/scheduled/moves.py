# SPDX-License-Identifier: Apache-2.0
"""Moves of joints whose motors have a list of speeds, in whole ticks and quanta.

A joint goes to its goal in a run at one speed and an *approach*: creep back, then creep forth. The
run ends within a tick of the goal, and the approach makes up for what is left. A run to an angle on
the way may come before; where a goal is nearer than the least run, two runs are sooner there than
creep.
"""

from dataclasses import dataclass

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Counts, Ints
from fiber_core.drive.listed_units import listed_units
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_planner.errors import PlannerError

__all__ = ["JointMoves", "Motors", "jogs", "motors_of_plane", "moves_to", "run_ticks"]


@dataclass(frozen=True, eq=False)
class Motors:
    """What the motors of a plane can do, in wire units.

    Args:
        run: velocity of the fastest speed of each joint, falling and rising, as unsigned
            velocity units, shape (n, 2, 2).
        creep: the same for the speed of the approach.
        least: least ticks of a run, shape (n, 2, 2).
        ramp: ticks of rest that a run needs behind it.
        back, forth: least ticks of either part of the approach, shape (n, 2).
        sign: direction of the approach of theta and phi, shape (2,).
        ranges: lowest and highest position of each joint [quanta], shape (n, 2, 2).
    """

    run: Ints
    creep: Ints
    least: Ints
    ramp: int
    back: Ints
    forth: Ints
    sign: Ints
    ranges: Counts


@dataclass(frozen=True, eq=False)
class JointMoves:
    """The moves of both joints of m robots; 0 ticks where a move is left out.

    Args:
        run: ticks at full speed, shape (m, 2).
        run_velocity: its velocity [velocity units], shape (m, 2).
        back, forth: ticks of both parts of the approach, shape (m, 2).
        turn: how far each joint turns [quanta], shape (m, 2).
        possible: whether moves inside the range of both joints were found, shape (m,); without
            them a robot rests.
    """

    run: Ints
    run_velocity: Ints
    back: Ints
    forth: Ints
    turn: Ints
    possible: Bools


def motors_of_plane(plane: FocalPlane, units: WireUnits) -> Motors:
    """Return the motors of a plane in wire units.

    Raises:
        PlannerError: the motors have no list of speeds, a speed is below one velocity unit, or an
            approach has a ramp or a least move that the planner does not allow for.
    """
    listed = plane.drive.listed
    if listed is None:
        raise PlannerError(
            f"the planner 'scheduled' is for motors with listed speeds, the drive of this plane is "
            f"{plane.drive.name!r}"
        )
    _check_approach(plane)
    try:
        table = listed_units(plane, units)
    except LayoutError as error:
        raise PlannerError(str(error)) from error
    run, creep = table.velocity[:, 0], table.velocity[:, listed.approach_speed]
    sign, ranges = listed.approach_sign.astype(np.int64), units.range_counts(plane)
    ramp = int(table.ramp[0])
    return Motors(run, creep, table.least[:, 0], ramp, table.back, table.forth, sign, ranges)


def _check_approach(plane: FocalPlane) -> None:
    # Both parts of an approach follow each other at once, and take up what a run leaves, however
    # little it is: the second part, and the first one if there is one.
    listed = plane.drive.listed
    assert listed is not None
    ramp_s, least = (values[listed.approach_speed] for values in (listed.ramp_s, listed.least_rad))
    if ramp_s > 0.0:
        raise PlannerError(
            f"the planner 'scheduled' is for approaches without a ramp, that of this plane has one "
            f"of {ramp_s:.4g} s"
        )
    parts = listed.approach_rad if listed.returns else np.zeros(2)
    needs = least * plane.drive.scale.max(axis=(0, 2), initial=0.0)
    joint = int(np.argmin(parts - needs))
    name = ("theta", "phi")[joint]
    if parts[joint] < needs[joint]:
        raise PlannerError(
            f"the planner 'scheduled' ends each joint with back and forth, and {name} "
            f"may move as little as {np.rad2deg(parts[joint]):.4g} deg then: the least move of its "
            f"motor at that speed is {np.rad2deg(least):.4g} deg"
        )


def moves_to(motors: Motors, rows: Ints, start: Counts, turn: Ints) -> JointMoves:
    """Return the quickest moves that turn the joints of some robots.

    Args:
        motors: what the motors can do.
        rows: rows of the robots, shape (m,).
        start: positions of their joints [quanta], shape (m, 2).
        turn: how far each joint is to turn [quanta], shape (m, 2).

    Returns:
        The moves; their turn differs from the one asked for by half a tick of creep at most.
    """
    return JointMoves(
        *_moves(
            turn, motors.run[rows], motors.creep[rows], motors.least[rows], motors.ramp,
            motors.back[rows], motors.forth[rows], motors.sign, start, motors.ranges[rows],
        )
    )  # fmt: skip


def run_ticks(motors: Motors, rows: Ints, turn: Ints) -> tuple[Ints, Ints]:
    """Return ticks and velocity of runs that turn joints by about some angles.

    Args:
        motors: what the motors can do.
        rows: rows of the robots, shape (m,).
        turn: how far theta and phi are to turn [quanta], shape (m, 2).

    Returns:
        Ticks, 0 where the turn is shorter than the least run, and velocities, both shape (m, 2).
    """
    speed, least = _one_way(motors, rows, turn > 0)
    ticks = np.abs(turn) // speed
    return np.where(ticks < least, 0, ticks), np.where(turn > 0, speed, -speed)


def jogs(motors: Motors, rows: Ints, turn: Ints) -> Ints:
    """Return how far joints run beyond a near goal first, to run back to it [quanta], shape (m, 2).

    Args:
        motors: what the motors can do.
        rows: rows of the robots, shape (m,).
        turn: how far theta and phi are to turn [quanta], shape (m, 2).

    Returns:
        Turns from the start; 0 where one run or creep is sooner at the goal.
    """
    speed, least = _one_way(motors, rows, turn > 0)
    speed_back, least_back = _one_way(motors, rows, turn <= 0)
    creep = motors.creep[rows].max(axis=2)
    far = np.abs(turn)
    takes = least + least_back + 2 * motors.ramp + 1
    near = (far > takes * creep) & (far < least * speed)
    beyond = np.maximum(far + least_back * speed_back, least * speed) + speed
    return np.where(near, np.sign(turn) * beyond, 0)


def _one_way(motors: Motors, rows: Ints, rising: Bools) -> tuple[Ints, Ints]:
    # speed and least ticks of runs in one direction of each joint, shape (m, 2)
    at = rows[:, None], np.arange(2), rising.astype(np.int64)
    return motors.run[at], motors.least[at]


@nb.njit(cache=True)
def _moves(turn, run, creep, least, ramp, back, forth, sign, start, ranges):
    m = len(turn)
    out, possible = np.zeros((5, m, 2), dtype=np.int64), np.ones(m, dtype=np.bool_)
    for i in range(m):
        for joint in range(2):
            if turn[i, joint] != 0:
                possible[i] &= _best_move(
                    turn[i, joint], run[i, joint], creep[i, joint], least[i, joint], ramp,
                    back[i, joint], forth[i, joint], sign[joint], start[i, joint],
                    ranges[i, joint], out[:, i, joint],
                )  # fmt: skip
        if not possible[i]:
            out[:, i] = 0
    return out[0], out[1], out[2], out[3], out[4], possible


@nb.njit(cache=True)
def _best_move(wanted, run, creep, least, ramp, back, forth, sign, start, allowed, out):
    # the quickest move of one joint, in the order of JointMoves; returns whether there is one
    ahead, behind = creep[(sign + 1) // 2], creep[(1 - sign) // 2]
    # the approach without a run before it goes this far
    goes = ahead * forth - behind * back
    best = np.int64(1) << 40
    longest = best
    for way in (1, -1):
        speed, fewest = run[(way + 1) // 2], least[(way + 1) // 2]
        near = (wanted - sign * goes) * way // speed
        for choice in range(4):
            ticks = 0 if choice == 3 else max(near + choice - 1, fewest)
            ran = way * ticks * speed
            left = (wanted - ran) * sign - goes
            b, f = back, forth
            if left >= 0:
                f += (2 * left + ahead) // (2 * ahead)
            else:
                b += (-2 * left + behind) // (2 * behind)
            takes = b + f + (ticks + ramp if ticks else 0)
            turning = ran - sign * behind * b
            end = turning + sign * ahead * f
            low = start + min(min(0, ran), min(turning, end))
            high = start + max(max(0, ran), max(turning, end))
            if takes < best and low >= allowed[0] and high <= allowed[1]:
                best = takes
                out[0], out[1], out[2], out[3], out[4] = ticks, way * speed, b, f, end
    return best < longest

# SPDX-License-Identifier: Apache-2.0
"""Moves of joints whose motors have a list of speeds, in whole ticks and quanta.

A joint goes to its goal in a run at one speed and an *approach*: creep back, then creep forth. The
run ends within a tick of the goal, and the approach makes up for what is left.
"""

from dataclasses import dataclass

import numba as nb
import numpy as np

from fiber_core.array_types import Ints
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_planner.errors import PlannerError

__all__ = ["JointMoves", "Motors", "moves_to", "motors_of_plane", "run_ticks"]


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
    """

    run: Ints
    creep: Ints
    least: Ints
    ramp: int
    back: Ints
    forth: Ints
    sign: Ints


@dataclass(frozen=True, eq=False)
class JointMoves:
    """The moves of both joints of m robots; 0 ticks where a move is left out.

    Args:
        run: ticks at full speed, shape (m, 2).
        run_velocity: its velocity [velocity units], shape (m, 2).
        back, forth: ticks of both parts of the approach, shape (m, 2).
        turn: how far each joint turns [quanta], shape (m, 2).
    """

    run: Ints
    run_velocity: Ints
    back: Ints
    forth: Ints
    turn: Ints


def motors_of_plane(plane: FocalPlane, units: WireUnits) -> Motors:
    """Return the motors of a plane in wire units.

    Raises:
        PlannerError: the motors have no list of speeds, or a speed is below one velocity unit.
    """
    listed = plane.drive.listed
    if listed is None:
        raise PlannerError(
            f"the planner 'scheduled' is for motors with listed speeds, the drive of this plane is "
            f"{plane.drive.name!r}"
        )
    scale, unit = plane.drive.scale, units.velocity_rad_s
    approach = listed.approach_speed
    run = np.floor(listed.speeds_rad_s[0] * scale / unit + 1e-9).astype(np.int64)
    creep = np.rint(listed.speeds_rad_s[approach] * scale / unit).astype(np.int64)
    slow = (creep < 1).any(axis=(1, 2))
    if slow.any():
        row = int(np.argmax(slow))
        raise PlannerError(
            f"robot {plane.ids[row]}: its creep of {listed.speeds_rad_s[approach]:.3g} rad/s times "
            f"{scale[row].min():.3g} is below one velocity unit, {unit:.3g} rad/s"
        )
    least = np.ceil(listed.least_rad[0] * scale / units.quantum_rad / run - 1e-9).astype(np.int64)
    sign = listed.approach_sign.astype(np.int64)
    rising, joints = (sign + 1) // 2, np.arange(2)
    quanta = np.ceil(listed.approach_rad / units.quantum_rad).astype(np.int64)
    forth = -(-quanta // creep[:, joints, rising])
    back = -(-quanta // creep[:, joints, 1 - rising]) if listed.returns else np.zeros_like(forth)
    ramp = int(np.ceil(listed.ramp_s[0] / units.tick_s - 1e-9))
    return Motors(run, creep, np.maximum(least, 1), ramp, back, forth, sign)


def moves_to(motors: Motors, rows: Ints, turn: Ints) -> JointMoves:
    """Return the quickest moves that turn the joints of some robots.

    Args:
        motors: what the motors can do.
        rows: rows of the robots, shape (m,).
        turn: how far each joint is to turn [quanta], shape (m, 2).

    Returns:
        The moves; their turn differs from the one asked for by half a tick of creep at most.
    """
    return JointMoves(
        *_moves(
            turn, motors.run[rows], motors.creep[rows], motors.least[rows], motors.ramp,
            motors.back[rows], motors.forth[rows], motors.sign,
        )
    )  # fmt: skip


def run_ticks(motors: Motors, rows: Ints, joint: int, turn: Ints) -> tuple[Ints, Ints]:
    """Return ticks and velocity of runs that turn one joint by about some angles.

    Args:
        motors: what the motors can do.
        rows: rows of the robots, shape (m,).
        joint: 0 theta, 1 phi.
        turn: how far the joint is to turn [quanta], shape (m,).

    Returns:
        Ticks, 0 where the turn is shorter than the least run, and velocities, both shape (m,).
    """
    rising = (turn > 0).astype(np.int64)
    speed = motors.run[rows, joint, rising]
    ticks = np.abs(turn) // speed
    ticks = np.where(ticks < motors.least[rows, joint, rising], 0, ticks)
    return ticks, np.where(turn > 0, speed, -speed)


@nb.njit(cache=True)
def _moves(turn, run, creep, least, ramp, back, forth, sign):
    m = len(turn)
    out = np.zeros((5, m, 2), dtype=np.int64)
    for i in range(m):
        for joint in range(2):
            wanted = turn[i, joint]
            if wanted == 0:
                continue
            s = sign[joint]
            ahead, behind = creep[i, joint, (s + 1) // 2], creep[i, joint, (1 - s) // 2]
            # the approach without a run before it goes this far
            goes = ahead * forth[i, joint] - behind * back[i, joint]
            best = np.int64(1) << 40
            for way in (1, -1):
                speed, fewest = run[i, joint, (way + 1) // 2], least[i, joint, (way + 1) // 2]
                near = (wanted - s * goes) * way // speed
                for choice in range(4):
                    ticks = 0 if choice == 3 else max(near + choice - 1, fewest)
                    left = (wanted - way * ticks * speed) * s - goes
                    b, f = back[i, joint], forth[i, joint]
                    if left >= 0:
                        f += (2 * left + ahead) // (2 * ahead)
                    else:
                        b += (-2 * left + behind) // (2 * behind)
                    takes = b + f + (ticks + ramp if ticks else 0)
                    if takes < best:
                        best = takes
                        out[0, i, joint], out[1, i, joint] = ticks, way * speed
                        out[2, i, joint], out[3, i, joint] = b, f
                        out[4, i, joint] = way * ticks * speed + s * (ahead * f - behind * b)
    return out[0], out[1], out[2], out[3], out[4]

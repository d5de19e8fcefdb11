# SPDX-License-Identifier: Apache-2.0
"""True arms: the motion of the arms that a motion of the counters makes, with mechanical errors.

`arms_motion` is a function of the counters' motion alone: the arms never act on the counters. A
motion that is broken off has moved the arms as the whole one did until then.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.simulation.mechanics import Mechanics
from fiber_core.array_types import Angles, Floats, Ints
from fiber_core.drive.curves import CurveMotion, spread_out
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts

__all__ = ["ArmState", "arms_at", "arms_motion", "true_angles"]

# Straight pieces of a motion along the sines: with an amplitude of 1 mrad and three periods a turn
# a piece of 0.1 rad leaves the curve by 1e-5 rad, and ends on it.
_PIECE_RAD = 0.1
_MASK = np.uint64(0xFFFFFFFFFFFFFFFF)


class ArmState(NamedTuple):
    """Where arms are between two movements.

    Args:
        gear: angle behind the backlash, before the non-linearity [rad], shape (n, 2).
        slack: the part of the backlash that a motion towards higher angles has taken up [rad],
            shape (n, 2).
        movements: number of movements that each robot has begun, shape (n,).
    """

    gear: Angles
    slack: Angles
    movements: Ints


def arms_at(mechanics: Mechanics, angles: ArrayLike) -> ArmState:
    """Return the state of arms that stand at some angles and have not moved yet.

    Args:
        mechanics: the errors of n robots.
        angles: true joint angles [rad], shape (n, 2).
    """
    angles = np.array(angles, dtype=np.float64)
    if angles.shape != (mechanics.n, 2):
        raise BridgeError(f"angles have shape {angles.shape}, expected ({mechanics.n}, 2)")
    gear = angles.copy()
    for _ in range(60):  # a contraction: the slope of the sines is below 1
        gear = angles - _waves(mechanics, gear)
    return ArmState(gear, mechanics.slack_rad.copy(), np.zeros(mechanics.n, dtype=np.int64))


def true_angles(mechanics: Mechanics, state: ArmState) -> Angles:
    """Return the joint angles of the true arms [rad], shape (n, 2)."""
    return state.gear + _waves(mechanics, state.gear)


def arms_motion(
    mechanics: Mechanics,
    state: ArmState,
    motion: SegmentMotion,
    movement: Ints | None = None,
    ramp_s: Floats | None = None,
) -> tuple[SegmentMotion | CurveMotion, ArmState]:
    """Return the motion of the true arms that a motion of the counters makes, and their end.

    Without errors and ramps it is the same motion, to the byte, from where the arms are. A ramp
    spreads whatever a segment turns the arm: the arms rest when a ramp has passed after it.

    Args:
        mechanics: the errors of n robots.
        state: the arms before the motion.
        motion: the motion of the counters; its start does not matter.
        movement: for each segment of the motion, which movement of its robot it belongs to, from 0
            for the first in this motion, -1 for a wait between two, shape (m,); by default all
            are one movement.
        ramp_s: the time over which the motor spreads each segment [s], shape (m,); by default 0.

    Raises:
        BridgeError: the motion has another number of robots.
    """
    if motion.n != mechanics.n:
        raise BridgeError(f"a motion of {motion.n} robots for mechanics of {mechanics.n}")
    m = len(motion.duration_s)
    movement = np.zeros(m, dtype=np.int64) if movement is None else np.asarray(movement)
    travel = np.abs(motion.duration_s * motion.velocity_rad_s)
    waves = bool(mechanics.wave_rad.any())
    # at most: the backlash, the pieces of the way at twice the travel, the rest at a stop
    most = np.full(m, 3, dtype=np.int64)
    if waves:
        fastest = float(mechanics.scale.max(initial=1.0)) * 3.0  # speed noise included
        most += np.ceil(travel * fastest / _PIECE_RAD).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(most)])
    duration, velocity = np.empty(first[-1]), np.empty(first[-1])
    gear, slack = state.gear.copy(), state.slack.copy()
    counts = _follow(
        motion.offsets, motion.duration_s, motion.velocity_rad_s, movement, state.movements,
        mechanics.scale, mechanics.backlash_rad, mechanics.wave_rad, mechanics.phase_rad,
        mechanics.still_in, mechanics.stuck_from, mechanics.slip, mechanics.speed_noise,
        mechanics.stops_rad, np.uint64(mechanics.seed), waves, first, gear, slack,
        duration, velocity,
    )  # fmt: skip
    used = np.arange(first[-1]) - np.repeat(first[:-1], most) < np.repeat(counts, most)
    offsets = Parts.from_counts(Parts(motion.offsets).sums(counts)).offsets
    begun = np.zeros(motion.n, dtype=np.int64)
    owner = np.repeat(np.arange(2 * motion.n) // 2, np.diff(motion.offsets))
    np.maximum.at(begun, owner, movement + 1)
    start = true_angles(mechanics, state)
    made = SegmentMotion.of_valid(start, offsets, duration[used], velocity[used])
    if ramp_s is not None:
        made = spread_out(made, np.repeat(ramp_s, counts))
    return made, ArmState(gear, slack, state.movements + begun)


def _waves(mechanics: Mechanics, gear: Floats) -> Floats:
    periods = 1.0 + np.arange(mechanics.wave_rad.shape[2])
    return (mechanics.wave_rad * np.sin(periods * gear[..., None] + mechanics.phase_rad)).sum(-1)


@njit(cache=True)
def _wave(y, wave, phase):
    total = 0.0
    for k in range(len(wave)):
        total += wave[k] * math.sin((k + 1) * y + phase[k])
    return total


@njit(cache=True)
def _uniform(seed, a, b, c):
    """A number in 0..1 that depends on its arguments alone (splitmix64)."""
    z = seed
    for part in (a, b, c):
        z = (z + np.uint64(part + 1) * np.uint64(0x9E3779B97F4A7C15)) & _MASK
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) / 9007199254740992.0


@njit(cache=True)
def _factor(seed, profile, number, segment, slip, noise):
    """How much of a segment the gear makes, by slip and speed noise."""
    factor = 1.0
    if slip > 0.0:
        factor *= 1.0 - slip * _uniform(seed, profile, number, -1)
    if noise > 0.0:
        # the sum of four uniform numbers: near a normal one, and bounded by 3.5 sigma
        total = 0.0
        for k in range(4):
            total += _uniform(seed, profile, number, 4 * segment + k) - 0.5
        factor *= 1.0 + noise * total * math.sqrt(3.0)
    return factor


@njit(cache=True)
def _go(v, left, y, low, high, wave, phase, waves, at, out_s, out_rad_s):
    """Write the pieces of a gear that turns; return the next piece and where the gear is."""
    ahead = high - y if v > 0.0 else y - low
    goes = min(left, max(ahead, 0.0) / abs(v)) if v != 0.0 else left
    if goes > 0.0 and not waves:
        out_s[at], out_rad_s[at] = goes, v
        at += 1
        y += v * goes
    elif goes > 0.0:
        pieces = max(1, int(math.ceil(abs(v) * goes / _PIECE_RAD)))
        step, first = goes / pieces, y
        before = y + _wave(y, wave, phase)
        for p in range(pieces):
            y = first + v * goes * ((p + 1) / pieces)
            after = y + _wave(y, wave, phase)
            out_s[at], out_rad_s[at] = step, (after - before) / step
            at += 1
            before = after
    if left > goes:
        out_s[at], out_rad_s[at] = left - goes, 0.0  # against the stop
        at += 1
    return at, y


@njit(cache=True)
def _follow(
    offsets, durations, velocities, movement, begun, scale, backlash, wave, phase, still_in,
    stuck_from, slip, noise, stops, seed, waves, first, gear, slack, out_s, out_rad_s,
):  # fmt: skip
    """Write the pieces of each segment from out[first[k]] on; return their numbers, shape (m,)."""
    counts = np.zeros(len(durations), dtype=np.int64)
    for profile in range(len(offsets) - 1):
        i, joint = profile // 2, profile % 2
        y, s, segment, last = gear[i, joint], slack[i, joint], 0, -1
        low, high = stops[i, joint]
        for k in range(offsets[profile], offsets[profile + 1]):
            number = begun[i] + max(movement[k], 0)
            segment = segment + 1 if movement[k] == last else 0
            last = movement[k]
            still = number == still_in[i, joint] or number >= stuck_from[i, joint]
            v, left, at = velocities[k], durations[k], first[k]
            if v == 0.0 or movement[k] < 0 or still:
                out_s[at], out_rad_s[at] = left, 0.0
                counts[k] = 1
                continue
            up = v > 0.0
            v *= scale[i, joint, 1 if up else 0]
            v *= _factor(seed, profile, number, segment, slip[i, joint], noise[i, joint])
            free = backlash[i, joint] - s if up else s
            takes = min(left, free / abs(v)) if v != 0.0 else 0.0
            if takes > 0.0:
                s += v * takes
                out_s[at], out_rad_s[at] = takes, 0.0
                at += 1
            if left > takes:
                at, y = _go(
                    v, left - takes, y, low, high, wave[i, joint], phase[i, joint], waves,
                    at, out_s, out_rad_s,
                )  # fmt: skip
            counts[k] = at - first[k]
        gear[i, joint], slack[i, joint] = y, s
    return counts

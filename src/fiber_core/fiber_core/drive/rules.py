# SPDX-License-Identifier: Apache-2.0
"""Rules of motors with listed speeds: which orders they can carry out."""

import numba as nb
import numpy as np

from fiber_core.array_types import Floats, Ints, Offsets
from fiber_core.drive.breaches import Breaches, MotorRule
from fiber_core.drive.drive import Drive
from fiber_core.motion import SegmentMotion

__all__ = ["ramps_of", "rules_broken"]

_SPEED, _LEAST = int(MotorRule.LISTED_SPEED), int(MotorRule.LEAST_MOVE)
_RAMP, _APPROACH = int(MotorRule.RAMP), int(MotorRule.APPROACH)
_REST_RAD_S = 1e-12
_ROUNDING = 1e-9


def ramps_of(drive: Drive, motion: SegmentMotion) -> Floats:
    """Return the ramp of the listed speed next to that of each segment [s], shape (m,)."""
    listed = drive.listed
    assert listed is not None
    speed = np.abs(_of_motors(drive, motion))
    # the first half way between two speeds that is below the speed of the segment
    middle = 0.5 * (listed.speeds_rad_s[1:] + listed.speeds_rad_s[:-1])
    nearest = len(middle) - np.searchsorted(middle[::-1], speed)
    return listed.ramp_s[nearest]


def rules_broken(drive: Drive, motion: SegmentMotion) -> Breaches:
    """Return the joints with an order that their motors cannot carry out, and the values.

    Without listed speeds, none.

    Args:
        drive: how the motors carry out orders.
        motion: the ordered segments, decoded from the bytes.
    """
    if drive.listed is None:
        return Breaches.none()
    rule, value, allowed = (column.reshape(-1, 2) for column in _broken(drive, motion))
    no_interval, falling = rule == MotorRule.LISTED_SPEED, allowed < 0.0
    least = np.where(falling, -np.inf, allowed)
    most = np.where(falling, allowed, np.inf)
    least[no_interval] = most[no_interval] = np.nan
    return Breaches.of(rule, rule > 0, value, least, most)


def _of_motors(drive: Drive, motion: SegmentMotion) -> Floats:
    # velocity of the motor in each segment [rad/s]
    joint = motion.parts.owner
    rising = (motion.velocity_rad_s > 0.0).astype(np.int64)
    return motion.velocity_rad_s / drive.scale.reshape(-1, 2)[joint, rising]


def _broken(drive: Drive, motion: SegmentMotion) -> tuple[Ints, Floats, Floats]:
    listed = drive.listed
    assert listed is not None
    return _joints_broken(
        motion.offsets, motion.duration_s, _of_motors(drive, motion), motion.velocity_rad_s,
        listed.speeds_rad_s, listed.ramp_s, listed.least_rad, listed.tolerance_rad_s,
        drive.scale.reshape(-1, 2),
        listed.approach_rad, listed.approach_sign, listed.approach_speed, listed.returns,
    )  # fmt: skip


@nb.njit(cache=True)
def _joints_broken(
    offsets: Offsets,
    duration_s: Floats,
    of_motor: Floats,
    velocity: Floats,
    speeds: Floats,
    ramp_s: Floats,
    least: Floats,
    tolerance: float,
    scale: Floats,
    approach: Floats,
    sign: Floats,
    approach_speed: int,
    returns: bool,
) -> tuple[Ints, Floats, Floats]:
    # the first rule that each joint breaks, 0 for none; the value, and the one next to it that is
    # allowed: larger ones are too, of a move that must fall lower ones
    profiles = len(offsets) - 1
    broken = np.zeros(profiles, dtype=np.int64)
    value, allowed = np.zeros(profiles), np.zeros(profiles)
    for profile in range(profiles):
        joint = profile % 2
        last_turn, last_speed = 0.0, -1
        turn_before, speed_before, rested = 0.0, -1, np.inf
        k, end = offsets[profile], offsets[profile + 1]
        while k < end and broken[profile] == 0:
            if abs(velocity[k]) < _REST_RAD_S:
                rested += duration_s[k]
                k += 1
                continue
            # a run of one velocity is one move; a segment cannot last longer than its field allows
            turn, v = 0.0, velocity[k]
            motor, gear = of_motor[k], scale[profile, int(v > 0.0)]
            while k < end and velocity[k] == v:
                turn += v * duration_s[k]
                k += 1
            which = -1
            for s in range(len(speeds)):
                if abs(abs(motor) - speeds[s]) * gear <= tolerance * (1.0 + _ROUNDING):
                    which = s
            if which < 0:
                broken[profile], value[profile] = _SPEED, abs(motor)
            elif abs(turn) < least[which] * gear * (1.0 - _ROUNDING):
                broken[profile], value[profile] = _LEAST, abs(turn) / gear
                allowed[profile] = least[which]
            elif last_speed >= 0 and rested < ramp_s[last_speed] * (1.0 - _ROUNDING):
                broken[profile], value[profile] = _RAMP, rested
                allowed[profile] = ramp_s[last_speed]
            rested = 0.0
            turn_before, speed_before = last_turn, last_speed
            last_turn, last_speed = turn, which
        if broken[profile] > 0 or last_speed < 0 or approach[joint] == 0.0:
            continue
        enough = approach[joint] * (1.0 - _ROUNDING)
        ahead = sign[joint]
        wrong = last_speed != approach_speed or last_turn * ahead < enough
        if returns and not wrong:
            ahead = -ahead
            wrong = speed_before != approach_speed or turn_before * ahead < enough
            last_turn = turn_before
        if wrong:
            broken[profile], value[profile] = _APPROACH, last_turn
            allowed[profile] = ahead * approach[joint]
    return broken, value, allowed

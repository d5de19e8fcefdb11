# SPDX-License-Identifier: Apache-2.0
"""Rules of motors with listed speeds: which orders they can carry out."""

import numba as nb
import numpy as np

from fiber_core.array_types import Floats, Ints, Mask, Offsets
from fiber_core.drive.drive import Drive
from fiber_core.motion import SegmentMotion

__all__ = ["ramps_of", "rules_broken", "why_broken"]

_REST_RAD_S = 1e-12
_ROUNDING = 1e-9
_SPEED, _LEAST, _APPROACH, _BACK, _REST = 1, 2, 3, 4, 5  # the rule that a joint breaks


def ramps_of(drive: Drive, motion: SegmentMotion) -> Floats:
    """Return the ramp of the listed speed next to that of each segment [s], shape (m,)."""
    listed = drive.listed
    assert listed is not None
    speed = np.abs(_of_motors(drive, motion))
    # the first half way between two speeds that is below the speed of the segment
    middle = 0.5 * (listed.speeds_rad_s[1:] + listed.speeds_rad_s[:-1])
    nearest = len(middle) - np.searchsorted(middle[::-1], speed)
    return listed.ramp_s[nearest]


def rules_broken(drive: Drive, motion: SegmentMotion) -> Mask:
    """Return the robots with an order that their motors cannot carry out, shape (n,).

    Without listed speeds, none.

    Args:
        drive: how the motors carry out orders.
        motion: the ordered segments, decoded from the bytes.
    """
    if drive.listed is None:
        return np.zeros(motion.n, dtype=np.bool_)
    broken: Mask = np.any((_broken(drive, motion)[0] > 0).reshape(-1, 2), axis=1)
    return broken


def why_broken(drive: Drive, motion: SegmentMotion, row: int) -> str:
    """Return why the motors of a robot cannot carry out its order, with the value.

    Args:
        drive: how the motors carry out orders.
        motion: the ordered segments.
        row: row of a robot that breaks a rule.
    """
    listed = drive.listed
    assert listed is not None
    codes, values = _broken(drive, motion)
    joint = int(codes[2 * row] == 0)
    code, value = int(codes[2 * row + joint]), float(np.rad2deg(values[2 * row + joint]))
    name = ("theta", "phi")[joint]
    if code == _SPEED:
        known = ", ".join(f"{speed:.4g}" for speed in np.rad2deg(listed.speeds_rad_s))
        return (
            f"{name} is ordered to turn at {value:.4g} deg/s of its motor, its speeds are {known}"
        )
    if code == _REST:
        return f"{name} rests for {values[2 * row + joint]:.4g} s, less than the ramp before it"
    if code == _LEAST:
        return f"{name} is ordered to turn by {value:.4g} deg, less than its least move"
    wanted = np.rad2deg(listed.approach_rad[joint])
    sign = "+" if listed.approach_sign[joint] > 0 else "-"
    if code == _APPROACH:
        return f"{name} ends with {value:.4g} deg of approach, expected {sign}{wanted:.4g} deg"
    return f"{name} goes {value:.4g} deg back before its approach, expected {wanted:.4g} deg"


def _of_motors(drive: Drive, motion: SegmentMotion) -> Floats:
    # velocity of the motor in each segment [rad/s]
    joint = motion.parts.owner
    rising = (motion.velocity_rad_s > 0.0).astype(np.int64)
    return motion.velocity_rad_s / drive.scale.reshape(-1, 2)[joint, rising]


def _broken(drive: Drive, motion: SegmentMotion) -> tuple[Ints, Floats]:
    listed = drive.listed
    assert listed is not None
    return _codes(
        motion.offsets, motion.duration_s, _of_motors(drive, motion), motion.velocity_rad_s,
        listed.speeds_rad_s, listed.ramp_s, listed.least_rad, listed.tolerance_rad_s,
        drive.scale.reshape(-1, 2),
        listed.approach_rad, listed.approach_sign, listed.approach_speed, listed.returns,
    )  # fmt: skip


@nb.njit(cache=True)
def _codes(
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
) -> tuple[Ints, Floats]:
    # the rule that each joint breaks, 0 for none, and the speed or the turn that breaks it
    profiles = len(offsets) - 1
    code, value = np.zeros(profiles, dtype=np.int64), np.zeros(profiles)
    for profile in range(profiles):
        joint = profile % 2
        last_turn, last_speed = 0.0, -1
        turn_before, speed_before, rested = 0.0, -1, np.inf
        k, end = offsets[profile], offsets[profile + 1]
        while k < end and code[profile] == 0:
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
                code[profile], value[profile] = _SPEED, motor
            elif abs(turn) < least[which] * gear * (1.0 - _ROUNDING):
                code[profile], value[profile] = _LEAST, turn
            elif last_speed >= 0 and rested < ramp_s[last_speed] * (1.0 - _ROUNDING):
                code[profile], value[profile] = _REST, rested
            rested = 0.0
            turn_before, speed_before = last_turn, last_speed
            last_turn, last_speed = turn, which
        if code[profile] or last_speed < 0 or approach[joint] == 0.0:
            continue
        enough = approach[joint] * (1.0 - _ROUNDING)
        if last_speed != approach_speed or last_turn * sign[joint] < enough:
            code[profile], value[profile] = _APPROACH, last_turn
        elif returns and (speed_before != approach_speed or -turn_before * sign[joint] < enough):
            code[profile], value[profile] = _BACK, turn_before
    return code, value

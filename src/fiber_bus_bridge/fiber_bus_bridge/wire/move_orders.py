# SPDX-License-Identifier: Apache-2.0
"""Orders of motors with listed speeds as bytes: each move names its speed by number.

A MOVES frame is ``opcode 4 bits | sequence 4 | theta moves 4 | phi moves 4``, the moves of theta,
those of phi, and a CRC-16 as of a LOAD. A move is ``code 4 bits | ticks 12``. Code 0 is a rest; 1
to 6 are the listed speeds 0 to 5 falling, 9 to 14 the same rising; 7 and 8 are the approach, whose
way back, or forth, is `ticks` longer than the least one. Before the next move a motor rests for the
ramp of its move, which takes no bytes.
"""

import numpy as np
from numba import njit

from fiber_bus_bridge.wire.codes import MAX_SEGMENTS, Fault, Opcode
from fiber_bus_bridge.wire.fields import Bytes, Whole
from fiber_bus_bridge.wire.frames import frame_crc
from fiber_bus_bridge.wire.speed_block import (
    approach_ticks,
    approaches_rising,
    listed_velocity,
    number_of,
    ramp_ticks,
)
from fiber_core.array_types import Ints

__all__ = ["MOVE_BYTES", "read_moves", "write_moves"]

MOVE_BYTES = 2
_MOVES = int(Opcode.MOVES)
_NONE, _BAD_LENGTH, _BAD_CRC = int(Fault.NONE), int(Fault.BAD_LENGTH), int(Fault.BAD_CRC)
_BAD_DURATION, _UNLISTED = int(Fault.BAD_DURATION), int(Fault.UNLISTED_SPEED)
_REST, _BACK, _FORTH, _RISING = 0, 7, 8, 8  # codes; the last is added to that of a speed
_MOST_TICKS = 2**12 - 1


@njit(cache=True)
def read_moves(
    address: Whole,
    ten_bit: bool,
    data: Bytes,
    first: Whole,
    last: Whole,
    speeds: Bytes,
    at: Whole,
    longest: Whole,
    counts: Ints,
    ticks: Ints,
    velocity: Ints,
) -> int:
    """Return the Fault of data[first:last] as a MOVES frame to this address, or NONE.

    Args:
        address, ten_bit: the robot.
        data, first, last: the frame.
        speeds: bytes that hold the list of the robot at `at`; -1 where it has none.
        at: place of that list.
        longest: ticks of the longest segment.
        counts: filled with the number of segments of both joints, shape (2,).
        ticks, velocity: filled with the segments, shape (2, MAX_SEGMENTS).
    """
    if at < 0:
        return _UNLISTED
    if last - first < 4:
        return _BAD_LENGTH
    moves = np.int64(data[first + 1])
    if last - first != 4 + MOVE_BYTES * ((moves >> 4) + (moves & 15)):
        return _BAD_LENGTH
    crc = (np.int64(data[last - 2]) << 8) | np.int64(data[last - 1])
    if frame_crc(address, ten_bit, data, first, last - 2) != crc:
        return _BAD_CRC
    place = first + 2
    for joint in range(2):
        number = moves >> 4 if joint == 0 else moves & 15
        found = _read_joint(
            data, place, number, speeds, at, joint, longest, ticks[joint], velocity[joint]
        )
        if found < 0:
            return -found
        counts[joint] = found
        place += MOVE_BYTES * number
    return _NONE


@njit(cache=True)
def _read_joint(data, place, number, speeds, at, joint, longest, ticks, velocity):
    """Return the number of segments of the moves of a joint, or a Fault below zero."""
    used, owed, known = 0, 0, np.int64(speeds[at])
    for k in range(number):
        word = np.int64(data[place + 2 * k]) << 8 | np.int64(data[place + 2 * k + 1])
        code, lasts = word >> 12, word & _MOST_TICKS
        if code == _BACK or code == _FORTH:
            back, forth = approach_ticks(speeds, at, joint)
            if forth == 0 or (code == _BACK and back == 0):
                return -_UNLISTED
            speed, rising = np.int64(speeds[at + 1]) & 7, approaches_rising(speeds, at, joint)
            back, forth = (
                back + (lasts if code == _BACK else 0),
                forth + (lasts if code == _FORTH else 0),
            )
            slow = listed_velocity(speeds, at, speed, joint, 1 - rising)
            fast = listed_velocity(speeds, at, speed, joint, rising)
            sign = 2 * rising - 1
            used = _put(owed, 0, longest, used, ticks, velocity)
            used = _put(back, -sign * slow, longest, used, ticks, velocity)
            owed = ramp_ticks(speeds, at, speed)
            used = _put(owed if back > 0 else 0, 0, longest, used, ticks, velocity)
            used = _put(forth, sign * fast, longest, used, ticks, velocity)
        elif lasts == 0:
            return -_BAD_DURATION
        elif code == _REST:
            used = _put(owed + lasts, 0, longest, used, ticks, velocity)
            owed = 0
        else:
            rising, speed = code >> 3, (code & 7) - 1
            if speed < 0 or speed >= known:
                return -_UNLISTED
            way = listed_velocity(speeds, at, speed, joint, rising) * (2 * rising - 1)
            used = _put(owed, 0, longest, used, ticks, velocity)
            used = _put(lasts, way, longest, used, ticks, velocity)
            owed = ramp_ticks(speeds, at, speed)
        if used > MAX_SEGMENTS:
            return -_BAD_LENGTH
    return used


@njit(cache=True)
def _put(lasts, way, longest, used, ticks, velocity):
    """Write segments of one velocity; return how many there are, more than fit if they do not."""
    while lasts > 0:
        if used >= MAX_SEGMENTS:
            return MAX_SEGMENTS + 1
        ticks[used], velocity[used] = min(lasts, longest), way
        lasts -= ticks[used]
        used += 1
    return used


@njit(cache=True)
def write_moves(
    sequence: Whole, offsets: Ints, ticks: Ints, velocity: Ints, speeds: Bytes, out: Bytes
) -> int:
    """Write the moves of one robot without checksum; return the bytes, 0 if it is no such order.

    Args:
        sequence: sequence number of the order.
        offsets: first segments of theta, of phi, and the end, shape (3,).
        ticks, velocity: segments of all robots.
        speeds: the list of the robot.
        out: filled, at least 2 + 30 moves long.
    """
    place, both = 2, 0
    for joint in range(2):
        moves = _write_joint(
            offsets[joint], offsets[joint + 1], ticks, velocity, speeds, joint, out, place
        )
        if moves < 0 or moves > MAX_SEGMENTS:
            return 0
        both = both << 4 | moves
        place += MOVE_BYTES * moves
    out[0], out[1] = _MOVES << 4 | sequence, both
    return place


@njit(cache=True)
def _write_joint(first, last, ticks, velocity, speeds, joint, out, place):
    """Write the moves of a joint from out[place] on; return their number, -1 if it has no such."""
    lasts, way = np.empty(last - first, np.int64), np.empty(last - first, np.int64)
    runs = 0
    for k in range(first, last):  # segments of one velocity are one move
        if runs and way[runs - 1] == velocity[k]:
            lasts[runs - 1] += ticks[k]
            continue
        lasts[runs], way[runs] = ticks[k], velocity[k]
        runs += 1
    code, more, ends = _approach(runs, lasts, way, speeds, joint)
    moves, owed = 0, 0
    for run in range(runs - ends):
        if way[run] == 0:
            rest, owed = lasts[run] - owed, 0
            if rest < 0 or (rest == 0 and run == runs - 1):
                return -1
            if rest > 0:
                moves = _word(_REST, rest, out, place, moves)
        else:
            speed = number_of(speeds, 0, way[run], joint)
            if speed < 0 or owed > 0:
                return -1
            owed = ramp_ticks(speeds, 0, speed)
            rising = _RISING if way[run] > 0 else 0
            moves = _word(1 + speed + rising, lasts[run], out, place, moves)
        if moves < 0:
            return -1
    if ends > 0:
        if owed > 0:
            return -1
        moves = _word(code, more, out, place, moves)
    return moves


@njit(cache=True)
def _approach(runs, lasts, way, speeds, joint):
    """Return the code of the approach that ends these runs, its ticks, and how many runs it is."""
    back, forth = approach_ticks(speeds, 0, joint)
    speed, rising = np.int64(speeds[1]) & 7, approaches_rising(speeds, 0, joint)
    parts = 2 if back > 0 else 1
    if forth == 0 or runs < parts or ramp_ticks(speeds, 0, speed) > 0:
        return 0, 0, 0
    sign = 2 * rising - 1
    longer = lasts[runs - 1] - forth
    if way[runs - 1] != sign * listed_velocity(speeds, 0, speed, joint, rising) or longer < 0:
        return 0, 0, 0
    if parts == 1:
        return _FORTH, longer, 1
    behind = lasts[runs - 2] - back
    slow = listed_velocity(speeds, 0, speed, joint, 1 - rising)
    if way[runs - 2] != -sign * slow or behind < 0 or (behind > 0 and longer > 0):
        return 0, 0, 0
    return (_BACK, behind, 2) if behind > 0 else (_FORTH, longer, 2)


@njit(cache=True)
def _word(code, lasts, out, place, moves):
    """Write a move; return how many there are, -1 if it does not fit."""
    if moves < 0 or moves == MAX_SEGMENTS or lasts > _MOST_TICKS:
        return -1
    at = place + MOVE_BYTES * moves
    out[at], out[at + 1] = code << 4 | lasts >> 8, lasts & 0xFF
    return moves + 1

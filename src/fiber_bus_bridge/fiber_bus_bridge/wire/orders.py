# SPDX-License-Identifier: Apache-2.0
"""Orders as bytes: the motion of one robot, stored until a GO starts it.

Robots with listed speeds get MOVES frames, see `move_orders`, where their order consists of such
moves. To all others, and for every other order, goes a LOAD.

A LOAD frame is ``opcode 4 bits | sequence 4 | theta segments 4 | phi segments 4``,
the segments of theta, those of phi, and a CRC-16 over the address bytes and all
bytes before it. A segment is a big-endian whole number of bytes that holds the signed velocity
above the unsigned duration; with 14 + 10 bits it is three bytes.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.codes import MAX_SEGMENTS, Fault, Opcode
from fiber_bus_bridge.wire.fields import Bytes, Whole
from fiber_bus_bridge.wire.frames import Addresses, Frames, frame_crc
from fiber_bus_bridge.wire.move_orders import MOVE_BYTES, read_moves, write_moves
from fiber_bus_bridge.wire.speed_block import Speeds
from fiber_core.array_types import Bools, Codes, Ints
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["ORDER_OPCODES", "Orders", "decode_load", "encode_load", "read_order"]

ORDER_OPCODES = (Opcode.LOAD, Opcode.MOVES)

_LOAD, _MOVES = int(Opcode.LOAD), int(Opcode.MOVES)
_NONE = int(Fault.NONE)
_BAD_LENGTH = int(Fault.BAD_LENGTH)
_BAD_OPCODE = int(Fault.BAD_OPCODE)
_BAD_CRC = int(Fault.BAD_CRC)
_BAD_DURATION = int(Fault.BAD_DURATION)
_BAD_VELOCITY = int(Fault.BAD_VELOCITY)
_BAD_PADDING = int(Fault.BAD_PADDING)


@dataclass(frozen=True, eq=False)
class Orders:
    """Orders decoded from bytes; a frame with a fault gives no segments.

    Args:
        fault: Fault of each frame, shape (f,).
        sequence: sequence number of each order, shape (f,).
        crc: checksum at the end of each frame, shape (f,).
        motion: the motion of f robots, from position zero.
    """

    fault: Codes
    sequence: Ints
    crc: Ints
    motion: WireMotion

    @property
    def ok(self) -> Bools:
        """Frames that are valid orders, shape (f,)."""
        return self.fault == Fault.NONE


def encode_load(
    to: Addresses, sequence: ArrayLike, motion: WireMotion, listed: Speeds | None = None
) -> Frames:
    """Encode orders as LOAD or MOVES frames, one for each target.

    Args:
        to: the robots addressed, f rows.
        sequence: sequence number of each order, 0..15, one number or shape (f,).
        motion: the motion of these robots; a frame does not say where it starts.
        listed: lists of speeds of these robots, as in their CONFIG; None for motors of any speed.

    Raises:
        WireError: a number does not fit its field, or there are more robots than orders or fewer;
            names the row.
    """
    units, counts = motion.units, motion.counts
    _check_widths(units)
    if motion.n != len(to):
        raise WireError(f"orders for {motion.n} robots do not fit {len(to)} addresses")
    sequence = np.broadcast_to(np.asarray(sequence, dtype=np.int64), (len(to),))
    moves = np.zeros(
        (len(to), 0 if listed is None else 2 + MOVE_BYTES * 2 * MAX_SEGMENTS), np.uint8
    )
    used = np.zeros(len(to), dtype=np.int64)
    if listed is not None:
        _fill_moves(
            sequence, motion.offsets, motion.ticks, motion.velocity, listed.content, moves, used
        )
    for name, wrong, value in (
        ("segments", (counts > MAX_SEGMENTS) & (used == 0)[:, None], counts),
        ("sequence", (sequence < 0) | (sequence > 15), sequence),
    ):
        if wrong.any():
            at = int(np.argwhere(wrong)[0][0])
            raise WireError(f"row {at}: {value[at].tolist()} {name} do not fit four bits")
    lengths = np.where(used > 0, used + 2, 4 + units.segment_bytes * counts.sum(axis=1))
    starts = Parts.from_counts(lengths).offsets
    data = np.empty(starts[-1], dtype=np.uint8)
    _fill(
        to.address, to.ten_bit, sequence, motion.offsets, motion.ticks, motion.velocity,
        units.velocity_bits, units.duration_bits, starts, data, moves, used,
    )  # fmt: skip
    return Frames(to, starts, data)


def decode_load(units: WireUnits, frames: Frames, listed: Speeds | None = None) -> Orders:
    """Decode LOAD and MOVES frames; a malformed frame gets a fault, never an error.

    Args:
        units: widths of the two fields of a segment.
        frames: any bytes.
        listed: lists of speeds of their robots, as in their CONFIG; None for motors of any speed.

    Raises:
        WireError: a frame cannot carry fields of these widths.
    """
    _check_widths(units)
    f = len(frames)
    fault, sequence, crc = (np.zeros(f, dtype=np.int64) for _ in range(3))
    counts = np.zeros((f, 2), dtype=np.int64)
    widths = units.velocity_bits, units.duration_bits
    to = frames.to
    # both joints of a frame in a row of MAX_SEGMENTS each
    ticks, velocity = np.empty((2, f, 2, MAX_SEGMENTS), dtype=np.int64)
    content = np.zeros((f, 0), dtype=np.uint8) if listed is None else listed.content
    _scan(
        to.address, to.ten_bit, frames.offsets, frames.data, *widths, content,
        fault, sequence, crc, counts, ticks, velocity,
    )  # fmt: skip
    used = np.arange(MAX_SEGMENTS) < counts[:, :, None]
    offsets = Parts.from_counts(counts).offsets
    motion = WireMotion.from_zero(units, offsets, ticks[used], velocity[used])
    return Orders(fault, sequence, crc, motion)


def _check_widths(units: WireUnits) -> None:
    if not (2 <= units.velocity_bits <= 16 and 1 <= units.duration_bits <= 16):
        raise WireError(
            f"{units.velocity_bits} velocity bits and {units.duration_bits} duration bits: "
            "a segment carries 2..16 velocity bits and 1..16 duration bits"
        )


@njit(cache=True)
def read_order(
    address: Whole,
    ten_bit: bool,
    data: Bytes,
    first: Whole,
    last: Whole,
    velocity_bits: Whole,
    duration_bits: Whole,
    listed: Bytes,
    at: Whole,
    counts: Ints,
    ticks: Ints,
    velocity: Ints,
) -> int:
    """Return the Fault of data[first:last] as an order to this address, or NONE.

    Args:
        address, ten_bit: the robot.
        data, first, last: the frame.
        velocity_bits, duration_bits: widths of the fields of a segment.
        listed: bytes that hold the list of speeds of the robot at `at`, -1 where it has none.
        at: place of that list.
        counts: filled with the number of segments of both joints, shape (2,).
        ticks, velocity: filled with the segments, shape (2, MAX_SEGMENTS).
    """
    counts[:] = 0
    if last > first and data[first] >> 4 == _MOVES:
        longest = (1 << duration_bits) - 1
        fault = read_moves(
            address, ten_bit, data, first, last, listed, at, longest, counts, ticks, velocity
        )
        if fault != _NONE:
            counts[:] = 0
        return fault
    fault = _load_fault(address, ten_bit, data, first, last, velocity_bits, duration_bits)
    if fault != _NONE:
        return fault
    size = (velocity_bits + duration_bits + 7) // 8
    counts[0], counts[1] = _segment_counts(data, first)
    place = first + 2
    for joint in range(2):
        for k in range(counts[joint]):
            ticks[joint, k], velocity[joint, k], _padding = _read_segment(
                data, place, velocity_bits, duration_bits
            )
            place += size
    return _NONE


@njit(cache=True)
def _segment_counts(data: Bytes, first: Whole) -> tuple[Whole, Whole]:
    """Return the numbers of theta and phi segments of the LOAD frame at data[first]."""
    both = np.int64(data[first + 1])
    return both >> 4, both & 15


@njit(cache=True)
def _read_segment(
    data: Bytes, at: Whole, velocity_bits: Whole, duration_bits: Whole
) -> tuple[Whole, Whole, Whole]:
    """Return ticks, velocity and padding bits of the segment that begins at data[at]."""
    bits = velocity_bits + duration_bits
    raw = 0
    for i in range((bits + 7) // 8):
        raw = (raw << 8) | np.int64(data[at + i])
    ticks = raw & ((1 << duration_bits) - 1)
    velocity = (raw >> duration_bits) & ((1 << velocity_bits) - 1)
    if velocity >> (velocity_bits - 1):
        velocity -= 1 << velocity_bits
    return ticks, velocity, raw >> bits


@njit(cache=True)
def _load_fault(
    address: Whole,
    ten_bit: bool,
    data: Bytes,
    first: Whole,
    last: Whole,
    velocity_bits: Whole,
    duration_bits: Whole,
) -> int:
    """Return the Fault of data[first:last] as a LOAD frame to this address, NONE without."""
    if last - first < 4:
        return _BAD_LENGTH
    if data[first] >> 4 != _LOAD:
        return _BAD_OPCODE
    size = (velocity_bits + duration_bits + 7) // 8
    theta, phi = _segment_counts(data, first)
    segments = theta + phi
    if last - first != 4 + size * segments:
        return _BAD_LENGTH
    crc = (np.int64(data[last - 2]) << 8) | np.int64(data[last - 1])
    if frame_crc(address, ten_bit, data, first, last - 2) != crc:
        return _BAD_CRC
    for k in range(segments):
        ticks, velocity, padding = _read_segment(
            data, first + 2 + size * k, velocity_bits, duration_bits
        )
        if padding != 0:
            return _BAD_PADDING
        if ticks == 0:
            return _BAD_DURATION
        if velocity == -(1 << (velocity_bits - 1)):
            return _BAD_VELOCITY
    return _NONE


@njit(cache=True)
def _fill_moves(sequence, offsets, ticks, velocity, listed, moves, used):
    """Write the orders that consist of listed moves, and how many bytes each has; 0 of others."""
    for f in range(len(used)):
        if offsets[2 * f + 2] > offsets[2 * f]:
            own = offsets[2 * f : 2 * f + 3]
            used[f] = write_moves(sequence[f], own, ticks, velocity, listed[f], moves[f])


@njit(cache=True)
def _fill(
    address, ten_bit, sequence, offsets, ticks, velocity, velocity_bits, duration_bits,
    starts, data, moves, used,
):  # fmt: skip
    size = (velocity_bits + duration_bits + 7) // 8
    mask = (1 << velocity_bits) - 1
    for f in range(len(address)):
        at = starts[f]
        if used[f] > 0:
            data[at : at + used[f]] = moves[f, : used[f]]
            at += used[f]
        else:
            theta, phi, end = offsets[2 * f], offsets[2 * f + 1], offsets[2 * f + 2]
            data[at] = (_LOAD << 4) | sequence[f]
            data[at + 1] = ((phi - theta) << 4) | (end - phi)
            at += 2
            for m in range(theta, end):
                raw = ((velocity[m] & mask) << duration_bits) | ticks[m]
                for i in range(size):
                    data[at + i] = (raw >> (8 * (size - 1 - i))) & 0xFF
                at += size
        crc = frame_crc(address[f], ten_bit[f], data, starts[f], at)
        data[at] = crc >> 8
        data[at + 1] = crc & 0xFF


@njit(cache=True)
def _scan(
    address, ten_bit, starts, data, velocity_bits, duration_bits, listed,
    fault, sequence, crc, counts, ticks, velocity,
):  # fmt: skip
    at = 0 if listed.shape[1] else -1
    for f in range(len(address)):
        first, last = starts[f], starts[f + 1]
        fault[f] = read_order(
            address[f], ten_bit[f], data, first, last, velocity_bits, duration_bits,
            listed[f], at, counts[f], ticks[f], velocity[f],
        )  # fmt: skip
        if fault[f] == _NONE:
            sequence[f] = data[first] & 15
            crc[f] = (np.int64(data[last - 2]) << 8) | np.int64(data[last - 1])

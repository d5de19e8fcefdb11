# SPDX-License-Identifier: Apache-2.0
"""Commands and configuration as bytes: every frame to a robot except LOAD."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.codes import CALL_PREFIX, VERSION, Fault, Opcode
from fiber_bus_bridge.wire.config_blocks import (
    GEARS_FIELDS,
    Block,
    Gears,
    block_at,
    block_of,
    blocks_fault,
)
from fiber_bus_bridge.wire.crc import CRC16_INIT, crc16
from fiber_bus_bridge.wire.fields import Bytes, Whole, field_offset, filled, number
from fiber_bus_bridge.wire.frames import Addresses, Frames, frame_crc, frame_pec
from fiber_bus_bridge.wire.ramp_block import Ramps
from fiber_bus_bridge.wire.roll_call import NO_SLOT
from fiber_bus_bridge.wire.speed_block import Speeds
from fiber_core.array_types import Ints
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireUnits

__all__ = [
    "ADDRESS_BYTES",
    "ADDRESS_FIELDS",
    "CONFIG_BYTES",
    "CONFIG_FIELDS",
    "CRC_BYTES",
    "GO_BYTES",
    "GO_FIELDS",
    "PLACE_BYTES",
    "PLACE_FIELDS",
    "Configuration",
    "command_fault",
    "config_crc",
    "config_crcs",
    "place_crcs",
    "decode_command",
    "decode_config",
    "encode_address",
    "encode_command",
    "encode_config",
    "encode_place",
]

_GO, _CONFIG, _ADDRESS = int(Opcode.GO), int(Opcode.CONFIG), int(Opcode.ADDRESS)
_PLACE = int(Opcode.PLACE)
_SHORT = tuple(
    int(o) for o in (Opcode.STOP, Opcode.CLEAR, Opcode.RESET, Opcode.IDENTIFY, Opcode.HEARTBEAT)
)
_NONE = int(Fault.NONE)
_BAD_LENGTH = int(Fault.BAD_LENGTH)
_BAD_OPCODE = int(Fault.BAD_OPCODE)
_BAD_CRC = int(Fault.BAD_CRC)

CONFIG_FIELDS = np.dtype(
    [
        ("opcode_version", "u1"),
        ("velocity_bits", "u1"),
        ("duration_bits", "u1"),
        ("tick_us", ">u4"),
        ("quantum_prad", ">u4"),
        ("limits", ">i4", (2, 2)),  # joint (theta, phi), (low, high)
        ("speed", ">u2", (2,)),
        ("watchdog_ms", ">u2"),
        ("silence_ms", ">u2"),
        ("slot", ">u2"),  # of the robot in the roll call of its bus
    ]
)
CONFIG_BYTES = CONFIG_FIELDS.itemsize  # before the blocks
CRC_BYTES = 2
GO_FIELDS = np.dtype([("opcode_sequence", "u1"), ("countdown", ">u2"), ("crc", ">u2")])
GO_BYTES = GO_FIELDS.itemsize
ADDRESS_FIELDS = np.dtype(
    [
        ("opcode", "u1"),
        ("serial", ">u4"),
        ("form_address", ">u2"),  # bit 15: ten-bit form
        ("crc", ">u2"),
    ]
)
ADDRESS_BYTES = ADDRESS_FIELDS.itemsize
PLACE_FIELDS = np.dtype([("opcode", "u1"), ("position", ">i4", (2,)), ("crc", ">u2")])
PLACE_BYTES = PLACE_FIELDS.itemsize


@dataclass(frozen=True, eq=False)
class Configuration:
    """The values that robots need before they take orders.

    Args:
        units: tick, quantum and widths of the segment fields.
        limits: joint ranges [quanta], shape (f, 2, 2): robot, joint, (low, high).
        speed: highest joint speeds [velocity units], shape (f, 2).
        watchdog_ms: longest time that an order may wait for its GO [ms], 0 = no limit.
        silence_ms: longest time that a robot moves without a HEARTBEAT [ms], 0 = no limit.
        slot: slot of each robot in the roll call of its bus, one number or shape (f,).
        gears: how gears couple motors and joints, f rows; None of robots with independent joints.
        listed: lists of speeds, f rows; None of motors of any speed.
        ramps: ramps of the motors, f rows; None of motors without.
    """

    units: WireUnits
    limits: Ints
    speed: Ints
    watchdog_ms: int
    silence_ms: int = 0
    slot: Ints | int = NO_SLOT
    gears: Gears | None = None
    listed: Speeds | None = None
    ramps: Ramps | None = None


def encode_command(
    opcode: Opcode, to: Addresses, sequence: ArrayLike = 0, countdown: ArrayLike = 0
) -> Frames:
    """Encode the same command for each target: GO, STOP, CLEAR, RESET, IDENTIFY or HEARTBEAT.

    GO makes robots move and ends with a CRC-16, the others with a packet error code.
    To address 0, the general call, the frame begins with CALL_PREFIX.

    Args:
        opcode: the command.
        to: the robots or general calls addressed, f rows.
        sequence: sequence number of the order to start, 0..15, one number or shape (f,); GO only.
        countdown: time from GO to the start of the motion [units of COUNTDOWN_S]; likewise.

    Raises:
        WireError: not one of these commands, or a number that does not fit its field.
    """
    if opcode != Opcode.GO and opcode not in _SHORT:
        raise WireError(f"{opcode!r} is neither GO nor a short command")
    sequence, countdown = (np.asarray(x, dtype=np.int64) for x in (sequence, countdown))
    if opcode != Opcode.GO:
        if sequence.any() or countdown.any():
            raise WireError(f"{Opcode(opcode).name} cannot carry sequence or countdown")
        return _sealed(to, np.full((len(to), 1), int(opcode) << 4, dtype=np.uint8), check=1)
    if np.any((sequence < 0) | (sequence > 15)):
        raise WireError(f"GO cannot carry sequence {sequence.tolist()}")
    values = {"opcode_sequence": (_GO << 4) | sequence, "countdown": countdown}
    return _sealed(to, filled(len(to), GO_FIELDS, values)[:, :-CRC_BYTES])


def encode_address(to: Addresses, serial: ArrayLike, new: Addresses) -> Frames:
    """Encode ADDRESS, f rows: the robot with this serial number takes another address.

    Args:
        to: present address of each robot, or the general call, which can single out one of two
            robots at the same address.
        serial: serial number of each robot, shape (f,).
        new: new address of each robot, f rows.

    Raises:
        WireError: a serial number does not fit its field.
    """
    form = new.ten_bit.astype(np.int64) << 15
    values = {"opcode": _ADDRESS << 4, "serial": serial, "form_address": form | new.address}
    return _sealed(to, filled(len(to), ADDRESS_FIELDS, values)[:, :-CRC_BYTES])


def encode_place(to: Addresses, position: ArrayLike) -> Frames:
    """Encode PLACE, f rows: the encoders of each robot read these positions from now on.

    Args:
        to: the robots.
        position: encoders theta, phi [quanta], shape (f, 2).

    Raises:
        WireError: a position does not fit its field.
    """
    values = {"opcode": _PLACE << 4, "position": position}
    return _sealed(to, filled(len(to), PLACE_FIELDS, values)[:, :-CRC_BYTES])


def encode_config(config: Configuration, to: Addresses) -> Frames:
    """Encode one CONFIG frame for each robot, f rows.

    Raises:
        WireError: a value does not fit its field; names the field and the value.
    """
    units = config.units
    values = {
        "opcode_version": (_CONFIG << 4) | VERSION,
        "velocity_bits": units.velocity_bits,
        "duration_bits": units.duration_bits,
        "tick_us": units.tick_us,
        "quantum_prad": units.quantum_prad,
        "limits": config.limits,
        "speed": config.speed,
        "watchdog_ms": config.watchdog_ms,
        "silence_ms": config.silence_ms,
        "slot": config.slot,
    }
    body = filled(len(to), CONFIG_FIELDS, values)
    if config.gears is not None:
        body = np.concatenate([body, config.gears.block()], axis=1)
    if config.listed is not None:
        body = np.concatenate([body, block_of(Block.SPEEDS, config.listed.content)], axis=1)
    if config.ramps is not None:
        body = np.concatenate([body, block_of(Block.RAMPS, config.ramps.content)], axis=1)
    return _sealed(to, body)


def config_crcs(frames: Frames) -> Ints:
    """Return the checksum over the content of each CONFIG frame to a robot, shape (f,).

    The address is not part of it, as a robot may take another one.
    """
    crcs = np.empty(len(frames), dtype=np.int64)
    for f in range(len(frames)):
        crcs[f] = config_crc(frames.data, frames.offsets[f], frames.offsets[f + 1] - CRC_BYTES)
    return crcs


@njit(cache=True)
def config_crc(data: Bytes, first: Whole, last: Whole) -> Whole:
    """Return the CRC-16 over data[first:last], a CONFIG without checksum."""
    crc = CRC16_INIT
    for i in range(first, last):
        crc = crc16(crc, data[i])
    return crc


def place_crcs(position: ArrayLike) -> Ints:
    """Return the checksum over two encoders as in a PLACE, without the rest of it, shape (f,).

    Args:
        position: encoders theta, phi [quanta], shape (f, 2).

    Raises:
        WireError: a position does not fit its field.
    """
    position = np.asarray(position)
    rows = filled(len(position), PLACE_FIELDS, {"position": position})
    first = field_offset(PLACE_FIELDS, "position")
    return _row_crcs(rows[:, first : field_offset(PLACE_FIELDS, "crc")])


@njit(cache=True)
def _row_crcs(rows):
    crcs = np.empty(len(rows), dtype=np.int64)
    for f in range(len(rows)):
        crcs[f] = config_crc(rows[f], 0, rows.shape[1])
    return crcs


def decode_command(payload: bytes, address: int, ten_bit: bool) -> tuple[Opcode, int]:
    """Return the opcode and the low four bits of a single frame that is not a LOAD.

    Raises:
        WireError: length, opcode or checksum is wrong; carries the Fault.
    """
    data = np.frombuffer(payload, dtype=np.uint8)
    fault, head = command_fault(address, ten_bit, data, 0, len(data))
    if fault != _NONE:
        raise WireError(f"{payload.hex()} to {address}: {Fault(fault).name}", Fault(fault))
    return Opcode(int(head >> 4)), int(head & 15)


def decode_config(payload: bytes, address: int, ten_bit: bool) -> Configuration:
    """Return the configuration in a single CONFIG frame, arrays with one row.

    Raises:
        WireError: the frame is malformed, another command, or another version.
    """
    opcode, version = decode_command(payload, address, ten_bit)
    if opcode != Opcode.CONFIG:
        raise WireError(f"{opcode.name} is not CONFIG", Fault.BAD_OPCODE)
    if version != VERSION:
        raise WireError(f"version {version}, expected {VERSION}", Fault.BAD_VERSION)
    data = np.frombuffer(payload, dtype=np.uint8)
    end = len(data) - CRC_BYTES
    tick_us = number(data, field_offset(CONFIG_FIELDS, "tick_us"), 4)
    fault = blocks_fault(data, CONFIG_BYTES, end, tick_us)
    if fault != _NONE:
        raise WireError(f"blocks of CONFIG: {Fault(fault).name}", Fault(fault))
    row = np.frombuffer(payload, dtype=CONFIG_FIELDS, count=1)
    units = WireUnits(
        *(int(row[n][0]) for n in ("tick_us", "quantum_prad", "velocity_bits", "duration_bits"))
    )
    limits, speed = row["limits"].astype(np.int64), row["speed"].astype(np.int64)
    watchdog_ms, silence_ms = (int(row[name][0]) for name in ("watchdog_ms", "silence_ms"))
    slot = row["slot"].astype(np.int64)
    gears, at = None, block_at(data, CONFIG_BYTES, end, Block.GEARS)
    if at >= 0:
        block = np.frombuffer(payload, GEARS_FIELDS, 1, int(at))
        gears = Gears(*(block[name].astype(np.int64) for name in GEARS_FIELDS.names or ()))
    listed, at = None, block_at(data, CONFIG_BYTES, end, Block.SPEEDS)
    if at >= 0:
        listed = Speeds(data[None, at : at + int(data[at - 1])])
    ramps, at = None, block_at(data, CONFIG_BYTES, end, Block.RAMPS)
    if at >= 0:
        ramps = Ramps(data[None, at : at + int(data[at - 1])])
    return Configuration(units, limits, speed, watchdog_ms, silence_ms, slot, gears, listed, ramps)


@njit(cache=True)
def command_fault(
    address: Whole, ten_bit: bool, data: Bytes, first: Whole, last: Whole
) -> tuple[int, Whole]:
    """Return the Fault of a frame other than LOAD, and its opcode byte."""
    at = first
    if address == 0 and not ten_bit:
        if last == first or data[first] != CALL_PREFIX:
            return _BAD_OPCODE, 0
        at += 1
    if at == last:
        return _BAD_LENGTH, 0
    head = np.int64(data[at])
    if head >> 4 in _SHORT:
        if last - at != 2:
            return _BAD_LENGTH, head
        if frame_pec(address, ten_bit, data, first, last - 1) != data[last - 1]:
            return _BAD_CRC, head
        # the low bits of a short command are unused and must be zero
        return (_NONE if head & 15 == 0 else _BAD_OPCODE), head
    if head >> 4 == _GO:
        length = GO_BYTES
    elif head >> 4 == _CONFIG:
        length = max(CONFIG_BYTES + CRC_BYTES, last - at)
    elif head >> 4 == _ADDRESS:
        length = ADDRESS_BYTES
    elif head >> 4 == _PLACE:
        length = PLACE_BYTES
    else:
        return _BAD_OPCODE, head
    if last - at != length:
        return _BAD_LENGTH, head
    crc = (np.int64(data[last - 2]) << 8) | np.int64(data[last - 1])
    if frame_crc(address, ten_bit, data, first, last - 2) != crc:
        return _BAD_CRC, head
    if head >> 4 in (_ADDRESS, _PLACE) and head & 15 != 0:
        return _BAD_OPCODE, head
    return _NONE, head


def _sealed(to: Addresses, body: Bytes, check: int = CRC_BYTES) -> Frames:
    """Return rows of bytes as frames, with prefix for a general call and checksum.

    Args:
        to: the targets, f rows.
        body: the bytes of each frame without checksum, shape (f, bytes).
        check: bytes of the checksum, 2 for the CRC-16, 1 for a packet error code.
    """
    called = (to.address == 0) & ~to.ten_bit
    offsets = Parts.from_counts(body.shape[1] + check + called).offsets
    data = np.empty(offsets[-1], dtype=np.uint8)
    data[offsets[:-1][called]] = CALL_PREFIX
    first = offsets[:-1] + called
    data[first[:, None] + np.arange(body.shape[1])] = body
    _seal(to.address, to.ten_bit, offsets, data, check)
    return Frames(to, offsets, data)


@njit(cache=True)
def _seal(address, ten_bit, offsets, data, check):
    for f in range(len(address)):
        last = offsets[f + 1]
        if check == 1:
            data[last - 1] = frame_pec(address[f], ten_bit[f], data, offsets[f], last - 1)
        else:
            crc = frame_crc(address[f], ten_bit[f], data, offsets[f], last - 2)
            data[last - 2] = crc >> 8
            data[last - 1] = crc & 0xFF

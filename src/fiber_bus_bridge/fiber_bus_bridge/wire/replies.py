# SPDX-License-Identifier: Apache-2.0
"""Replies of robots as bytes: the status and the identity.

A robot answers a plain read with its status. The first five bytes, closed by a packet
error code, hold all that VERIFY needs, so a controller that only verifies stops
reading there; the rest holds fault, alerts and encoders and is closed by a CRC-16.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.codes import VERSION, Opcode, RobotState
from fiber_bus_bridge.wire.crc import CRC8_INIT, CRC16_INIT, crc8, crc16
from fiber_bus_bridge.wire.fields import Bytes, Whole, field_offset
from fiber_bus_bridge.wire.frames import Addresses, frame_crc, frame_pec, read_address
from fiber_core.array_types import Bools, Codes, Counts, Ints

__all__ = [
    "IDENTITY_BYTES",
    "IDENTITY_FIELDS",
    "STATUS_BYTES",
    "STATUS_FIELDS",
    "VERIFY_BYTES",
    "Identities",
    "Statuses",
    "decode_identity",
    "decode_status",
    "encode_identity",
    "encode_status",
    "write_identity",
    "write_status",
]

STATUS_FIELDS = np.dtype(
    [
        ("state_sequence", "u1"),
        ("order_crc", ">u2"),
        ("boot", "u1"),
        ("pec", "u1"),
        ("fault", "u1"),
        ("alerts", "u1"),
        ("position", ">i4", (2,)),
        ("crc", ">u2"),
    ]
)
STATUS_BYTES = STATUS_FIELDS.itemsize
VERIFY_BYTES = field_offset(STATUS_FIELDS, "fault")

IDENTITY_FIELDS = np.dtype(
    [
        ("opcode_version", "u1"),
        ("serial", ">u4"),
        ("form_address", ">u2"),  # bit 15: ten-bit form
        ("boot", "u1"),
        ("pec", "u1"),
    ]
)
IDENTITY_BYTES = IDENTITY_FIELDS.itemsize
_FIRST_STATE, _LAST_STATE = int(min(RobotState)), int(max(RobotState))
_IDENTIFY = int(Opcode.IDENTIFY)
_IDENTITY_HEAD = (_IDENTIFY << 4) | VERSION


@dataclass(frozen=True, eq=False)
class Statuses:
    """Decoded status replies, one row each; rows that are not ok hold zeros.

    Args:
        ok: whether checksums and state are valid, shape (f,).
        state: RobotState, shape (f,).
        sequence: sequence number of the last accepted order, shape (f,).
        order_crc: CRC-16 that the robot computes over its stored order, 0 without one, shape (f,).
        boot: number of boots, modulo 256, shape (f,).
        fault: Fault, shape (f,); zero when only the first five bytes were read.
        alerts: Alert flags, shape (f,); zero when only the first five bytes were read.
        position: encoders theta, phi [quanta], shape (f, 2); zero when only the first five bytes
            were read.
    """

    ok: Bools
    state: Codes
    sequence: Ints
    order_crc: Ints
    boot: Ints
    fault: Codes
    alerts: Ints
    position: Counts

    def select(self, rows: Ints | Bools) -> "Statuses":
        """Return the rows chosen by an index or mask array."""
        return Statuses(*(column[rows] for column in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Identities:
    """Decoded identity replies, one row each; rows that are not ok hold zeros.

    Args:
        ok: whether version, checksum and address are right, shape (f,).
        serial: serial number of the robot, shape (f,).
        address: address of the robot, shape (f,).
        ten_bit: whether the address has the ten-bit form, shape (f,).
        boot: number of boots, modulo 256, shape (f,).
    """

    ok: Bools
    serial: Ints
    address: Ints
    ten_bit: Bools
    boot: Ints


def encode_status(
    to: Addresses,
    state: ArrayLike,
    sequence: ArrayLike,
    order_crc: ArrayLike,
    boot: ArrayLike,
    fault: ArrayLike,
    alerts: ArrayLike,
    position: ArrayLike,
) -> Bytes:
    """Encode status replies of robots at some addresses, fields as in Statuses.

    Returns:
        The bytes, shape (f, STATUS_BYTES), uint8.
    """
    data = np.empty((len(to), STATUS_BYTES), dtype=np.uint8)
    columns = np.broadcast_arrays(state, sequence, order_crc, boot, fault, alerts)
    columns = [np.broadcast_to(c, (len(to),)) for c in columns]
    position = np.broadcast_to(np.asarray(position, dtype=np.int64), (len(to), 2))
    for f in range(len(to)):
        numbers = [int(column[f]) for column in columns]
        write_status(to.address[f], to.ten_bit[f], *numbers, position=position[f], out=data[f])
    return data


def encode_identity(to: Addresses, serial: ArrayLike, boot: ArrayLike) -> Bytes:
    """Encode identity replies of robots at some addresses: bytes, shape (f, IDENTITY_BYTES)."""
    data = np.empty((len(to), IDENTITY_BYTES), dtype=np.uint8)
    serial, boot = (np.broadcast_to(c, (len(to),)) for c in (serial, boot))
    for f in range(len(to)):
        write_identity(to.address[f], to.ten_bit[f], int(serial[f]), int(boot[f]), data[f])
    return data


def decode_status(to: Addresses, data: ArrayLike) -> Statuses:
    """Decode status replies, complete or only their first five bytes.

    Args:
        to: robot from which each reply was read, f rows.
        data: the bytes, shape (f, STATUS_BYTES) or (f, VERIFY_BYTES), uint8.

    Raises:
        WireError: the table has neither width.
    """
    data = np.ascontiguousarray(data, dtype=np.uint8)
    if data.shape not in ((len(to), STATUS_BYTES), (len(to), VERIFY_BYTES)):
        raise WireError(f"status replies of {len(to)} robots have shape {data.shape}")
    ok = np.zeros(len(to), dtype=bool)
    _check_status(to.address, to.ten_bit, data, ok)
    numbers = np.zeros((8, len(to)), dtype=np.int64)
    _read_status(data, ok, numbers)
    state, sequence, order_crc, boot, fault, alerts = numbers[:6]
    return Statuses(ok, state, sequence, order_crc, boot, fault, alerts, numbers[6:].T)


def decode_identity(to: Addresses, data: ArrayLike) -> Identities:
    """Decode identity replies.

    Args:
        to: robot from which each reply was read, f rows.
        data: the bytes, shape (f, IDENTITY_BYTES), uint8.

    Raises:
        WireError: the table has another shape.
    """
    data = np.ascontiguousarray(data, dtype=np.uint8)
    if data.shape != (len(to), IDENTITY_BYTES):
        raise WireError(f"identity replies of {len(to)} robots have shape {data.shape}")
    ok = np.zeros(len(to), dtype=bool)
    _check_identity(to.address, to.ten_bit, data, ok)
    table = np.where(ok[:, None], data, np.uint8(0)).view(IDENTITY_FIELDS)[:, 0]
    form = table["form_address"].astype(np.int64)
    serial, boot = table["serial"].astype(np.int64), table["boot"].astype(np.int64)
    return Identities(ok, serial, form & 0x7FFF, form >> 15 == 1, boot)


# In ten-bit form a read carries the address twice: as a write, then 11110 A9 A8 1.


@njit(cache=True)
def _status_pec(address, ten_bit, data):
    empty = data[:0]
    pec = frame_pec(address, ten_bit, empty, 0, 0) if ten_bit else CRC8_INIT
    pec = crc8(pec, read_address(address, ten_bit))
    for i in range(VERIFY_BYTES - 1):
        pec = crc8(pec, data[i])
    return pec


@njit(cache=True)
def _status_crc(address, ten_bit, data):
    empty = data[:0]
    crc = frame_crc(address, ten_bit, empty, 0, 0) if ten_bit else CRC16_INIT
    crc = crc16(crc, read_address(address, ten_bit))
    for i in range(STATUS_BYTES - 2):
        crc = crc16(crc, data[i])
    return crc


@njit(cache=True)
def _identity_pec(address, ten_bit, data):
    # the identity is read in the same message that asks for it
    asked = np.empty(2, dtype=np.uint8)
    asked[0] = _IDENTIFY << 4
    asked[1] = frame_pec(address, ten_bit, asked, 0, 1)
    pec = frame_pec(address, ten_bit, asked, 0, 2)
    pec = crc8(pec, read_address(address, ten_bit))
    for i in range(IDENTITY_BYTES - 1):
        pec = crc8(pec, data[i])
    return pec


@njit(cache=True)
def write_status(
    address: Whole,
    ten_bit: bool,
    state: Whole,
    sequence: Whole,
    order_crc: Whole,
    boot: Whole,
    fault: Whole,
    alerts: Whole,
    position: Ints | tuple[Whole, Whole],
    out: Bytes,
) -> None:
    """Write one status reply into out[:STATUS_BYTES], fields as in Statuses."""
    out[0] = (state << 4) | sequence
    out[1], out[2] = order_crc >> 8, order_crc & 0xFF
    out[3] = boot
    out[4] = _status_pec(address, ten_bit, out)
    out[5], out[6] = fault, alerts
    for joint in range(2):
        for i in range(4):
            out[7 + 4 * joint + i] = (position[joint] >> (8 * (3 - i))) & 0xFF
    crc = _status_crc(address, ten_bit, out)
    out[15], out[16] = crc >> 8, crc & 0xFF


@njit(cache=True)
def write_identity(address: Whole, ten_bit: bool, serial: Whole, boot: Whole, out: Bytes) -> None:
    """Write one identity reply into out[:IDENTITY_BYTES]."""
    out[0] = _IDENTITY_HEAD
    for i in range(4):
        out[1 + i] = (serial >> (8 * (3 - i))) & 0xFF
    out[5] = (address >> 8) | (0x80 if ten_bit else 0)
    out[6] = address & 0xFF
    out[7] = boot
    out[8] = _identity_pec(address, ten_bit, out)


@njit(cache=True)
def _check_status(address, ten_bit, data, ok):
    for f in range(len(address)):
        known = _FIRST_STATE <= data[f, 0] >> 4 <= _LAST_STATE
        pec = _status_pec(address[f], ten_bit[f], data[f])
        ok[f] = known and pec == data[f, VERIFY_BYTES - 1]
        if ok[f] and data.shape[1] == STATUS_BYTES:
            crc = (np.int64(data[f, 15]) << 8) | np.int64(data[f, 16])
            ok[f] = _status_crc(address[f], ten_bit[f], data[f]) == crc


@njit(cache=True)
def _read_status(data, ok, out):
    # rows of out: state, sequence, order_crc, boot, fault, alerts, theta, phi
    for f in range(len(ok)):
        if not ok[f]:
            continue
        row = data[f]
        out[0, f], out[1, f] = row[0] >> 4, row[0] & 15
        out[2, f] = (np.int64(row[1]) << 8) | row[2]
        out[3, f] = row[3]
        if len(row) < STATUS_BYTES:
            continue
        out[4, f], out[5, f] = row[5], row[6]
        for joint in range(2):
            value = np.int64(0)
            for k in range(4):
                value = (value << 8) | np.int64(row[7 + 4 * joint + k])
            out[6 + joint, f] = value - (value >> 31 << 32)


@njit(cache=True)
def _check_identity(address, ten_bit, data, ok):
    for f in range(len(address)):
        pec = _identity_pec(address[f], ten_bit[f], data[f])
        ok[f] = pec == data[f, IDENTITY_BYTES - 1] and data[f, 0] == _IDENTITY_HEAD
        # a reply that names another address comes from another robot
        form = (np.int64(data[f, 5]) << 8) | np.int64(data[f, 6])
        ok[f] &= form == (address[f] | (0x8000 if ten_bit[f] else 0))

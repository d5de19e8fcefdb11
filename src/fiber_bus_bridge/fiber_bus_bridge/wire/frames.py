# SPDX-License-Identifier: Apache-2.0
"""Frames as one table: the target of each frame, and the bytes of all frames end to end."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.crc import CRC8_INIT, CRC16_INIT, crc8, crc16
from fiber_bus_bridge.wire.fields import Bytes, Whole
from fiber_core.array_types import Bools, Ints, Offsets
from fiber_core.ragged import Parts

__all__ = [
    "Addresses",
    "Frames",
    "frame_crc",
    "frame_pec",
    "general_call",
    "read_address",
]

_Table = TypeVar("_Table")


@dataclass(frozen=True, eq=False)
class Addresses:
    """I2C targets, one row each: bus and address.

    Args:
        bus: bus number, shape (f,).
        address: I2C address, 0..127, or 0..1023 in ten-bit form, shape (f,).
        ten_bit: whether the address has the ten-bit form, shape (f,).

    Raises:
        WireError: shapes differ or an address does not fit its form.
    """

    bus: Ints
    address: Ints
    ten_bit: Bools

    def __post_init__(self) -> None:
        shape = np.shape(self.bus)
        for name, dtype in (("bus", np.int64), ("address", np.int64), ("ten_bit", bool)):
            value = np.array(getattr(self, name), dtype=dtype)
            if value.ndim != 1 or value.shape != shape:
                raise WireError(f"{name} has shape {value.shape}, expected {shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        wrong = (self.address < 0) | (self.address > np.where(self.ten_bit, 1023, 127))
        if wrong.any():
            at = int(np.argmax(wrong))
            form = "ten-bit" if self.ten_bit[at] else "seven-bit"
            raise WireError(f"row {at}: {self.address[at]} is no {form} address")

    def __len__(self) -> int:
        return len(self.bus)

    def __getitem__(self, rows: Ints | Bools | slice) -> "Addresses":
        """Return the rows chosen by an index or mask array, in that order."""
        return Addresses.unchecked(self.bus[rows], self.address[rows], self.ten_bit[rows])

    @classmethod
    def unchecked(cls, bus: Ints, address: Ints, ten_bit: Bools) -> "Addresses":
        """Make a table of columns that are known to be valid: parts of a checked table."""
        return _assemble(cls, bus=bus, address=address, ten_bit=ten_bit)


def general_call(buses: ArrayLike) -> Addresses:
    """Return the address of all robots of each of some buses, shape (b,)."""
    buses = np.array(buses, dtype=np.int64, ndmin=1)
    return Addresses.unchecked(buses, np.zeros_like(buses), np.zeros(buses.shape, dtype=bool))


@dataclass(frozen=True, eq=False)
class Frames:
    """Messages to targets: frame i carries data[offsets[i] : offsets[i + 1]].

    The address bytes are not among the data: the bus puts them in front.

    Args:
        to: target of each frame, f rows.
        offsets: first byte of each frame, shape (f + 1,), rising from 0.
        data: all bytes, shape (offsets[-1],), uint8.

    Raises:
        WireError: offsets do not describe the data.
    """

    to: Addresses
    offsets: Offsets
    data: Bytes

    def __post_init__(self) -> None:
        offsets = np.array(self.offsets, dtype=np.int64)
        data = np.array(self.data, dtype=np.uint8)
        if data.ndim != 1 or not Parts(offsets).cover(len(self.to), data.size):
            raise WireError(f"offsets do not cut {data.size} bytes into {len(self.to)} frames")
        for name, value in (("offsets", offsets), ("data", data)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.to)

    def __getitem__(self, rows: Ints | Bools | slice) -> "Frames":
        """Return the frames chosen by an index or mask array, in that order."""
        rows = np.arange(len(self))[rows]
        parts, source = Parts(self.offsets).select(rows)
        return Frames(self.to[rows], parts.offsets, self.data[source])

    def then(self, more: "Frames") -> "Frames":
        """Return these frames, followed by more frames."""
        mine, others = self.to, more.to
        both = Addresses.unchecked(
            np.concatenate([mine.bus, others.bus]),
            np.concatenate([mine.address, others.address]),
            np.concatenate([mine.ten_bit, others.ten_bit]),
        )
        offsets = np.concatenate([self.offsets, self.offsets[-1] + more.offsets[1:]])
        data = np.concatenate([self.data, more.data])
        return _assemble(Frames, to=both, offsets=offsets, data=data)

    @cached_property
    def lengths(self) -> Ints:
        """Data bytes of each frame, shape (f,)."""
        return Parts(self.offsets).counts

    def payload(self, row: int) -> bytes:
        """Return the data bytes of one frame."""
        return self.data[Parts(self.offsets).slice(row)].tobytes()

    @classmethod
    def empty(cls, to: Addresses) -> "Frames":
        """Make frames without data: plain reads, or tests for the presence of a robot."""
        offsets = np.zeros(len(to) + 1, dtype=np.int64)
        return _assemble(cls, to=to, offsets=offsets, data=np.zeros(0, dtype=np.uint8))

    @classmethod
    def equal_length(cls, to: Addresses, data: ArrayLike) -> "Frames":
        """Make frames of equal length from a byte table, shape (f, k)."""
        data = np.asarray(data, dtype=np.uint8)
        offsets = data.shape[1] * np.arange(len(to) + 1)
        return cls(to, offsets, data.reshape(-1))

    @classmethod
    def from_bytes(cls, to: Addresses, payloads: Sequence[bytes]) -> "Frames":
        """Make frames from a sequence of bytes objects, one per target."""
        offsets = Parts.from_counts([len(p) for p in payloads]).offsets
        return cls(to, offsets, np.frombuffer(b"".join(payloads), dtype=np.uint8))


def _assemble(cls: type[_Table], **columns: object) -> _Table:
    """Make a table without the checks of its constructor, of columns known to be valid."""
    table = object.__new__(cls)
    for column in columns.values():
        if isinstance(column, np.ndarray):
            column.setflags(write=False)
    vars(table).update(columns)
    return table


@njit(cache=True)
def _write_address(address: Whole, ten_bit: bool) -> Whole:
    """First address byte of a write; ten-bit addresses are 11110 A9 A8 0, then A7..A0."""
    return 0xF0 | ((address >> 8) << 1) if ten_bit else address << 1


@njit(cache=True)
def read_address(address: Whole, ten_bit: bool) -> Whole:
    """Return the address byte that precedes the bytes of a read."""
    return _write_address(address, ten_bit) | 1


@njit(cache=True)
def frame_crc(address: Whole, ten_bit: bool, data: Bytes, first: Whole, last: Whole) -> Whole:
    """Return the CRC-16 over the address bytes of a write and data[first:last]."""
    crc = crc16(CRC16_INIT, _write_address(address, ten_bit))
    if ten_bit:
        crc = crc16(crc, address & 0xFF)
    for i in range(first, last):
        crc = crc16(crc, data[i])
    return crc


@njit(cache=True)
def frame_pec(address: Whole, ten_bit: bool, data: Bytes, first: Whole, last: Whole) -> Whole:
    """Return the packet error code over the address bytes of a write and data[first:last]."""
    pec = crc8(CRC8_INIT, _write_address(address, ten_bit))
    if ten_bit:
        pec = crc8(pec, address & 0xFF)
    for i in range(first, last):
        pec = crc8(pec, data[i])
    return pec

"""Frames on the bus as one table: to whom each goes, and its bytes end to end."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.crc import CRC8_INIT, CRC16_INIT, crc8, crc16

__all__ = ["Addresses", "Frames", "frame_crc", "frame_pec", "general_call", "read_address"]


@dataclass(frozen=True, eq=False)
class Addresses:
    """I2C targets, one row each: on which bus, at which address.

    Args:
        bus: bus number, shape (f,).
        address: I2C address, 0..127, or 0..1023 in ten-bit form, shape (f,).
        ten_bit: whether the ten-bit form is used, shape (f,).

    Raises:
        WireError: shapes differ or an address does not fit its form.
    """

    bus: np.ndarray
    address: np.ndarray
    ten_bit: np.ndarray

    def __post_init__(self):
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

    def __getitem__(self, rows) -> "Addresses":
        """Return the rows chosen by an index or mask array, in that order."""
        return _made(Addresses, self.bus[rows], self.address[rows], self.ten_bit[rows])


def general_call(buses) -> Addresses:
    """Address everybody on each of some buses, shape (b,)."""
    buses = np.array(buses, dtype=np.int64, ndmin=1)
    return _made(Addresses, buses, np.zeros_like(buses), np.zeros(buses.shape, dtype=bool))


@dataclass(frozen=True, eq=False)
class Frames:
    """Messages to targets: frame i carries data[offsets[i] : offsets[i + 1]].

    The address bytes are not among the data: the bus puts them in front.

    Args:
        to: whom each frame is for, f rows.
        offsets: first byte of each frame, shape (f + 1,), rising from 0.
        data: all bytes, shape (offsets[-1],), uint8.

    Raises:
        WireError: offsets do not describe the data.
    """

    to: Addresses
    offsets: np.ndarray
    data: np.ndarray

    def __post_init__(self):
        offsets = np.array(self.offsets, dtype=np.int64)
        data = np.array(self.data, dtype=np.uint8)
        if (
            offsets.shape != (len(self.to) + 1,)
            or data.shape != (offsets[-1],)
            or offsets[0] != 0
            or np.any(np.diff(offsets) < 0)
        ):
            raise WireError(f"offsets do not cut {data.size} bytes into {len(self.to)} frames")
        for name, value in (("offsets", offsets), ("data", data)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.to)

    def __getitem__(self, rows) -> "Frames":
        """Return the frames chosen by an index or mask array, in that order."""
        rows = np.arange(len(self))[rows]
        lengths = self.lengths[rows]
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        source = np.repeat(self.offsets[rows] - offsets[:-1], lengths) + np.arange(offsets[-1])
        return Frames(self.to[rows], offsets, self.data[source])

    def then(self, more: "Frames") -> "Frames":
        """Return these frames and after them some more."""
        pairs = zip(vars(self.to).values(), vars(more.to).values())
        both = _made(Addresses, *(np.concatenate(pair) for pair in pairs))
        offsets = np.concatenate([self.offsets, self.offsets[-1] + more.offsets[1:]])
        return _made(Frames, both, offsets, np.concatenate([self.data, more.data]))

    @cached_property
    def lengths(self) -> np.ndarray:
        """Data bytes of each frame, shape (f,)."""
        return np.diff(self.offsets)

    def payload(self, row: int) -> bytes:
        """Return the data bytes of one frame."""
        return self.data[self.offsets[row] : self.offsets[row + 1]].tobytes()

    @classmethod
    def empty(cls, to: Addresses) -> "Frames":
        """Make frames without data, which only read, or ask whether somebody is there."""
        return _made(cls, to, np.zeros(len(to) + 1, dtype=np.int64), np.zeros(0, dtype=np.uint8))

    @classmethod
    def equal_length(cls, to: Addresses, data) -> "Frames":
        """Make frames of equal length from a byte table, shape (f, k)."""
        data = np.asarray(data, dtype=np.uint8)
        offsets = data.shape[1] * np.arange(len(to) + 1)
        return cls(to, offsets, data.reshape(-1))

    @classmethod
    def from_bytes(cls, to: Addresses, payloads) -> "Frames":
        """Make frames from a sequence of bytes objects, one per target."""
        offsets = np.concatenate([[0], np.cumsum([len(p) for p in payloads])])
        return cls(to, offsets, np.frombuffer(b"".join(payloads), dtype=np.uint8))


def _made(cls, *columns):
    """A table of columns that are known to be sound: parts of one that was checked."""
    made = object.__new__(cls)
    for column in columns:
        if isinstance(column, np.ndarray):
            column.setflags(write=False)
    vars(made).update(zip(cls.__dataclass_fields__, columns))
    return made


@njit(cache=True)
def _write_address(address, ten_bit):
    """First address byte of a write; ten-bit addresses are 11110 A9 A8 0, then A7..A0."""
    return 0xF0 | ((address >> 8) << 1) if ten_bit else address << 1


@njit(cache=True)
def read_address(address, ten_bit):
    """Return the address byte in front of bytes that are read."""
    return _write_address(address, ten_bit) | 1


@njit(cache=True)
def frame_crc(address, ten_bit, data, first, last):
    """CRC-16 over the address bytes of a write and data[first:last]."""
    crc = crc16(CRC16_INIT, _write_address(address, ten_bit))
    if ten_bit:
        crc = crc16(crc, address & 0xFF)
    for i in range(first, last):
        crc = crc16(crc, data[i])
    return crc


@njit(cache=True)
def frame_pec(address, ten_bit, data, first, last):
    """Packet error code over the address bytes of a write and data[first:last]."""
    pec = crc8(CRC8_INIT, _write_address(address, ten_bit))
    if ten_bit:
        pec = crc8(pec, address & 0xFF)
    for i in range(first, last):
        pec = crc8(pec, data[i])
    return pec

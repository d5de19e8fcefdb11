# SPDX-License-Identifier: Apache-2.0
"""Messages between a bridge and a plant: a kind, and columns of plain numbers.

A message is a header (mark, kind, number of columns), the number of bytes of each column, and the
columns end to end. The columns of each kind are in `REQUESTS` and `ANSWERS`; an answer has the
kind of its request, or REFUSED.
"""

import struct
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_bus_bridge.errors import BridgeError

__all__ = ["ANSWERS", "REQUESTS", "Columns", "Kind", "PlantError", "Unpacker", "pack", "refusal"]

Columns: TypeAlias = dict[str, NDArray]
_Schema: TypeAlias = Mapping[int, Mapping[str, str]]

_MARK = b"FPL1"
_HEADER = struct.Struct("<4sHH")
_LENGTH = np.dtype("<u4")
_MOST_BYTES = 2**28  # of one message; a batch for 5000 robots has 0.4 MB


class PlantError(BridgeError):
    """The plant cannot be reached, refuses a request, or received no message of this format."""


class Kind(IntEnum):
    """The kinds of messages."""

    OPEN = 1  # a bridge takes the buses
    TRANSFER = 2  # one batch of messages on the buses
    RECOVER = 3
    ALERTS = 4
    TRUTH = 5  # read-only: movements since a number
    REFUSED = 6


REQUESTS: _Schema = {
    Kind.OPEN: {"ids": "<i8", "bus": "<i8", "address": "<i8", "ten_bit": "?", "clock_hz": "<f8"},
    Kind.TRANSFER: {
        "bus": "<i8", "address": "<i8", "ten_bit": "?", "offsets": "<i8", "data": "u1",
        "read_bytes": "<i8", "not_before_s": "<f8",
    },
    Kind.RECOVER: {"bus": "<i8", "recovery": "<i8", "t": "<f8"},
    Kind.ALERTS: {"t": "<f8"},
    Kind.TRUTH: {"since": "<i8"},
}  # fmt: skip
ANSWERS: _Schema = {
    Kind.OPEN: {"now_s": "<f8"},
    Kind.TRANSFER: {
        "ack": "<i8", "start_s": "<f8", "end_s": "<f8", "offsets": "<i8", "data": "u1"
    },
    Kind.RECOVER: {"end_s": "<f8", "free": "?"},
    Kind.ALERTS: {"bus": "<i8"},
    Kind.TRUTH: {
        "now_s": "<f8", "bridge": "<i8", "first": "<i8", "quantum_rad": "<f8", "start": "<i8",
        "position": "<i8", "state": "<i8", "row": "<i8", "started_s": "<f8",
        "ended_s": "<f8", "tick_s": "<f8", "counts": "<i8", "ticks": "<i8",
        "velocity": "<i8", "ramp_us": "<i8", "controller": "<i8", "verified": "?",
    },
    Kind.REFUSED: {"text": "u1"},
}  # fmt: skip


def pack(schema: _Schema, kind: Kind, **columns: ArrayLike) -> bytes:
    """Return the bytes of a message.

    Args:
        schema: REQUESTS or ANSWERS.
        kind: the kind of the message.
        columns: a value for each column of this kind: one number, or any shape, in C order.
    """
    parts = [
        np.ascontiguousarray(columns[name], dtype=dtype).tobytes()
        for name, dtype in schema[kind].items()
    ]
    lengths = np.array([len(part) for part in parts], dtype=_LENGTH)
    return b"".join([_HEADER.pack(_MARK, kind, len(parts)), lengths.tobytes(), *parts])


def refusal(text: str) -> bytes:
    """Return the bytes of the answer that refuses a request."""
    return pack(ANSWERS, Kind.REFUSED, text=np.frombuffer(text.encode(), dtype=np.uint8))


class Unpacker:
    """Cuts a stream of bytes into messages.

    Args:
        schema: REQUESTS or ANSWERS: the messages that are expected.
    """

    def __init__(self, schema: _Schema):
        self._schema = schema
        self._bytes = bytearray()

    def feed(self, data: bytes) -> None:
        """Add received bytes."""
        self._bytes += data

    def take(self) -> tuple[Kind, Columns] | None:
        """Return the next message, None while it is incomplete; columns are writable and flat.

        Raises:
            PlantError: the bytes are no message of the expected kinds.
        """
        if len(self._bytes) < _HEADER.size:
            return None
        mark, kind, count = _HEADER.unpack_from(self._bytes)
        names = self._schema.get(kind)
        if mark != _MARK or names is None or count != len(names):
            raise PlantError(f"kind {kind} with {count} columns after {mark!r} is no message")
        begin = _HEADER.size + count * _LENGTH.itemsize
        if len(self._bytes) < begin:
            return None
        lengths = np.frombuffer(bytes(self._bytes[_HEADER.size : begin]), _LENGTH).tolist()
        end = begin + sum(lengths)
        if end > _MOST_BYTES:
            raise PlantError(f"a message of {end} bytes is too long")
        if len(self._bytes) < end:
            return None
        taken, self._bytes = self._bytes[:end], self._bytes[end:]
        return Kind(kind), _columns(taken, begin, lengths, names)


def _columns(
    data: bytearray, begin: int, lengths: Sequence[int], names: Mapping[str, str]
) -> Columns:
    columns: Columns = {}
    for length, (name, dtype) in zip(lengths, names.items()):
        size = np.dtype(dtype).itemsize
        if length % size:
            raise PlantError(f"column {name} has {length} bytes, no multiple of {size}")
        columns[name] = np.frombuffer(data, dtype, length // size, begin).copy()
        begin += length
    return columns

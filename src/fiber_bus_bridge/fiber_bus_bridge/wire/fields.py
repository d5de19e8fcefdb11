# SPDX-License-Identifier: Apache-2.0
"""Types of bytes and whole numbers on the wire, and places of the fields of a record."""

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from fiber_bus_bridge.errors import WireError

__all__ = ["Bytes", "Whole", "field_offset", "filled", "number", "signed"]

Bytes: TypeAlias = NDArray[np.uint8]
Whole: TypeAlias = int | np.int64  # compiled functions take and return both


def field_offset(record: "np.dtype[np.void]", name: str) -> int:
    """Return the byte at which a field of a structured type begins.

    Raises:
        KeyError: the type has no such field.
    """
    places = {str(key): int(value[1]) for key, value in (record.fields or {}).items()}
    return places[name]


def filled(rows: int, record: "np.dtype[np.void]", values: Mapping[str, ArrayLike]) -> Bytes:
    """Return records with some fields filled, the others 0, as bytes of shape (rows, bytes).

    Raises:
        WireError: a value does not fit its field; names the field and the value.
    """
    table = np.zeros(rows, dtype=record)
    for name, value in values.items():
        value = np.asarray(value, dtype=np.int64)
        field = np.iinfo(table.dtype[name].base)
        wrong = (value < field.min) | (value > field.max)
        if wrong.any():
            raise WireError(f"{name} {value[wrong].flat[0]} is outside {field.min}..{field.max}")
        table[name] = value
    return table.view(np.uint8).reshape(rows, record.itemsize)


@njit(cache=True)
def signed(data: Bytes, at: Whole) -> Whole:
    """Return the signed number of four bytes at data[at:]."""
    value = number(data, at, 4)
    return value - (value >> 31 << 32)


@njit(cache=True)
def number(data: Bytes, at: Whole, size: int) -> Whole:
    """Return the unsigned number of some bytes at data[at:]."""
    value = 0
    for i in range(size):
        value = (value << 8) | np.int64(data[at + i])
    return value

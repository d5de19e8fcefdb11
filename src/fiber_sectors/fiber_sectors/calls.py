# SPDX-License-Identifier: Apache-2.0
"""Calls of the coordinator to one sector, and their answers: columns of numbers by name."""

import io
import struct
import zipfile
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fiber_sectors.errors import SectorError

__all__ = ["CALL", "MOST_NUMBER", "Call", "Columns", "Kind", "column", "decode_call", "encode_call",
           "number_of", "text_columns"]  # fmt: skip

Columns: TypeAlias = dict[str, NDArray]
CALL = b"FSC1"  # the first bytes of a call and of its answer
MOST_NUMBER = 2**62  # of calls and runs; nanoseconds reach it in 2116
_HEAD = struct.Struct("<4sHHq")


class Kind(IntEnum):
    """What is called for; an answer has the kind of its call."""

    CONFIGURE = 1  # ask and configure the robots
    PREPARE = 2  # load and verify orders, as the first part of a run
    TABLE = 3  # tell how the robots are; also sent unasked while they move
    CLEAR = 4
    STOP = 5
    REFUSED = 6
    VOUCH = 7  # robots that do not answer rest where they were read last
    LOOK = 8  # tell why the robots rest, before they are configured and forget it


class Call(NamedTuple):
    """A call, or an answer.

    Args:
        sector: number of the sector that is called, or answers.
        kind: what is called for.
        number: of the call, which rises; 0 of a table that was not asked for.
        columns: the content.
    """

    sector: int
    kind: Kind
    number: int
    columns: Columns

    @property
    def refusal(self) -> str:
        """The text of an answer that refuses its call, else empty."""
        if self.kind is not Kind.REFUSED:
            return ""
        text = self.columns.get("text", np.zeros(0, dtype=np.uint8))
        return text.tobytes().decode(errors="replace") or "refused"


def text_columns(text: str) -> Columns:
    """Return the columns of an answer that refuses its call."""
    return {"text": np.frombuffer(text.encode(), dtype=np.uint8)}


def encode_call(sector: int, kind: Kind, number: int, columns: Mapping[str, NDArray]) -> bytes:
    """Return the bytes of a call or an answer."""
    body = io.BytesIO()
    arrays: dict[str, Any] = dict(columns)
    np.savez(body, **arrays)
    return _HEAD.pack(CALL, sector, kind, number) + body.getvalue()


def decode_call(data: bytes) -> Call:
    """Return the call or answer in some bytes.

    Raises:
        SectorError: the bytes are no call.
    """
    try:
        mark, sector, kind, number = _HEAD.unpack_from(data)
        if mark != CALL or not 0 <= number <= MOST_NUMBER:
            raise ValueError(f"they begin with {mark!r}, and the number {number}")
        body = io.BytesIO(data[_HEAD.size :])
        with zipfile.ZipFile(body) as packed:  # a few bytes must not become many
            if any(each.compress_type != zipfile.ZIP_STORED for each in packed.infolist()):
                raise ValueError("they are compressed")
        with np.load(body, allow_pickle=False) as file:
            return Call(sector, Kind(kind), number, {name: file[name] for name in file.files})
    except Exception as error:  # numpy and zipfile have no common error
        raise SectorError(f"{len(data)} bytes are no call: {error}") from error


def column(
    columns: Columns,
    name: str,
    dtype: str,
    shape: Sequence[int | None],
    low: float = -np.inf,
    high: float = np.inf,
) -> NDArray:
    """Return a column of a call, checked.

    Args:
        columns: the columns.
        name: of the column.
        dtype: type of its values.
        shape: its shape; None for any length.
        low, high: the range of the values, which are finite.

    Raises:
        SectorError: there is no such column, or it holds something else; names it.
    """
    values = columns.get(name)
    if values is None or values.dtype != np.dtype(dtype) or len(values.shape) != len(shape):
        found = "missing" if values is None else f"{values.dtype} of shape {values.shape}"
        raise SectorError(f"the column {name} is {found}, expected {dtype} of shape {shape}")
    if any(wanted not in (None, has) for wanted, has in zip(shape, values.shape)):
        raise SectorError(f"the column {name} has shape {values.shape}, expected {shape}")
    wrong = ~(np.isfinite(values) & (values >= low) & (values <= high))
    if wrong.any():
        raise SectorError(f"the column {name} has {values[wrong][0]}, expected {low:g}..{high:g}")
    return values


def number_of(
    columns: Columns, name: str, dtype: str, low: float = -np.inf, high: float = np.inf
) -> Any:
    """Return the one number in a column.

    Raises:
        SectorError: as of column.
    """
    return column(columns, name, dtype, (), low, high).item()

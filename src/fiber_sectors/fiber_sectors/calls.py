# SPDX-License-Identifier: Apache-2.0
"""Calls of the coordinator to one sector, and their answers: columns of numbers by name."""

import io
import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fiber_sectors.errors import SectorError

__all__ = ["CALL", "Call", "Columns", "Kind", "decode_call", "encode_call"]

Columns: TypeAlias = dict[str, NDArray]
CALL = b"FSC1"  # the first bytes of a call and of its answer
_HEAD = struct.Struct("<4sHHq")


class Kind(IntEnum):
    """What is called for; an answer has the kind of its call."""

    CONFIGURE = 1  # ask and configure the robots
    PREPARE = 2  # load and verify orders, as the first part of a run
    TABLE = 3  # tell how the robots are; also sent unasked while they move
    CLEAR = 4
    STOP = 5
    REFUSED = 6


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
        return self.columns["text"].astype(np.uint8).tobytes().decode(errors="replace")


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
        if mark != CALL:
            raise ValueError(f"they begin with {mark!r}")
        with np.load(io.BytesIO(data[_HEAD.size :]), allow_pickle=False) as file:
            return Call(sector, Kind(kind), number, {name: file[name] for name in file.files})
    except Exception as error:  # numpy and zipfile have no common error
        raise SectorError(f"{len(data)} bytes are no call: {error}") from error

# SPDX-License-Identifier: Apache-2.0
"""A log of the frames on the buses: the table that is published, recorded and replayed."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from fiber_core.array_types import Bools, Ints, Offsets, Times
from fiber_core.ragged import Parts

__all__ = ["FrameLog"]


@dataclass(frozen=True, eq=False)
class FrameLog:
    """Frames on one or many buses: frame i is data[offsets[i] : offsets[i + 1]].

    Args:
        time_s: time of the START of each frame on its bus [s], shape (f,).
        bus: bus number of each frame, shape (f,).
        address: I2C address, shape (f,).
        ten_bit: whether the address is in ten-bit form, shape (f,).
        read: whether the bytes came from the robot, shape (f,).
        ack: code of how the frame ended, 0 = acknowledged, shape (f,).
        offsets: first byte of each frame, shape (f + 1,), rising from 0.
        data: all bytes after the addresses, shape (offsets[-1],), uint8.
    """

    time_s: Times
    bus: Ints
    address: Ints
    ten_bit: Bools
    read: Bools
    ack: Ints
    offsets: Offsets
    data: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.bus)

    @property
    def lengths(self) -> Ints:
        """Number of bytes of each frame, shape (f,)."""
        return Parts(self.offsets).counts

    @classmethod
    def joined(cls, logs: Iterable["FrameLog"]) -> "FrameLog":
        """Return the frames of several logs as one log, in the order of the logs."""
        logs = list(logs)

        def column(name: str, dtype: DTypeLike) -> NDArray[Any]:
            return np.concatenate([np.zeros(0, dtype), *(getattr(log, name) for log in logs)])

        return cls(
            time_s=column("time_s", float),
            bus=column("bus", np.int64),
            address=column("address", np.int64),
            ten_bit=column("ten_bit", bool),
            read=column("read", bool),
            ack=column("ack", np.int64),
            offsets=Parts.concatenate([Parts(log.offsets) for log in logs]).offsets,
            data=column("data", np.uint8),
        )

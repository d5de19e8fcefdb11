# SPDX-License-Identifier: Apache-2.0
"""The interface of a set of buses, simulated or real."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire import Bytes, Frames
from fiber_core.array_types import Codes, Floats, Ints, Offsets
from fiber_core.ragged import Parts

__all__ = ["Ack", "BusBackend", "Exchange", "Replies"]


class Ack(IntEnum):
    """How a message ended on the wire."""

    OK = 0
    NO_ADDRESS = 1  # no target acknowledged the address
    REFUSED = 2  # the target did not acknowledge a written byte
    LOST = 3  # arbitration lost to another talker
    STUCK = 4  # SDA is held low: no START can be made
    TIMED_OUT = 5  # SCL was held low for longer than SMBus allows
    NOT_SENT = 6  # the bus failed earlier in the batch


@dataclass(frozen=True, eq=False)
class Replies:
    """Results of a batch, one for each frame.

    Args:
        ack: Ack of each frame, shape (f,).
        start_s: time of the START of each frame [s], shape (f,).
        end_s: time at which the bus was free after each frame [s], shape (f,).
        offsets: first byte of the reply to each frame, shape (f + 1,).
        data: bytes of all replies, shape (offsets[-1],), uint8.
    """

    ack: Codes
    start_s: Floats
    end_s: Floats
    offsets: Offsets
    data: Bytes

    @property
    def lengths(self) -> Ints:
        """Number of bytes of the reply to each frame, shape (f,)."""
        return Parts(self.offsets).counts

    def table(self, width: int) -> Bytes:
        """Return the replies as a table, shape (f, width).

        Raises:
            WireError: a reply has another number of bytes.
        """
        lengths = self.lengths
        if np.any(lengths != width):
            at = int(np.argmax(lengths != width))
            raise WireError(f"reply {at} has {lengths[at]} bytes, expected {width}")
        return self.data.reshape(-1, width)


@dataclass(frozen=True, eq=False)
class Exchange:
    """One batch on the buses: the frames sent and their replies."""

    frames: Frames
    replies: Replies


class BusBackend(Protocol):
    """A set of buses that carry batches of messages; buses do not wait for each other."""

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Send each frame, then read from its target in the same message.

        The frames of one bus are sent in the given order. When the lines of a bus fail, the
        remaining frames of that bus are not sent.

        Args:
            frames: frames to write; a frame without data is a plain read.
            read_bytes: number of bytes to read after each frame, one number or shape (f,).
            not_before_s: earliest start of each frame [s], one number or shape (f,).

        Returns:
            One reply for each frame. A frame that fails is a reply with its Ack, not an error;
            bytes that no target drives read as 0xFF.
        """
        ...

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus, not before time t [s].

        Returns:
            The time at which the attempt is over [s], and whether the lines are free.
        """
        ...

    def alert_lines(self, t: float) -> Ints:
        """Return the numbers of the buses with a low alert line at time t [s], shape (k,).

        A bus without an alert line is never among them.
        """
        ...

"""What a set of buses can do, whatever it is made of."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire import Frames

__all__ = ["Ack", "BusBackend", "Exchange", "Replies"]


class Ack(IntEnum):
    """How a message ended on the wire."""

    OK = 0
    NO_ADDRESS = 1  # nobody acknowledged the address
    REFUSED = 2  # the target did not acknowledge a byte written
    LOST = 3  # arbitration lost to somebody else who talks
    STUCK = 4  # SDA is held low: no START can be made
    TIMED_OUT = 5  # SCL was held low for longer than SMBus allows
    NOT_SENT = 6  # the bus failed before this message of the batch had its turn


@dataclass(frozen=True, eq=False)
class Replies:
    """What came back for each frame of a batch.

    Args:
        ack: Ack of each frame, shape (f,).
        start_s: when its START was on the bus [s], shape (f,).
        end_s: when the bus was free again after it [s], shape (f,).
        offsets: first byte read of each frame, shape (f + 1,).
        data: all bytes read, shape (offsets[-1],), uint8.
    """

    ack: np.ndarray
    start_s: np.ndarray
    end_s: np.ndarray
    offsets: np.ndarray
    data: np.ndarray

    def table(self, width: int) -> np.ndarray:
        """Return the bytes read as a table, shape (f, width).

        Raises:
            WireError: not every frame read so many bytes.
        """
        if np.any(np.diff(self.offsets) != width):
            raise WireError(f"not every reply has {width} bytes")
        return self.data.reshape(-1, width)


@dataclass(frozen=True, eq=False)
class Exchange:
    """One batch as it went over the buses: what was sent and what came back."""

    frames: Frames
    replies: Replies


class BusBackend(Protocol):
    """A set of buses that carry batches of messages, each bus at its own pace."""

    def transfer(self, frames: Frames, read_bytes, not_before_s) -> Replies:
        """Send each frame, then read from its target in the same message.

        Frames of one bus go in the order given; buses do not wait for each other. When the
        lines of a bus fail the rest of its frames are not sent.

        Args:
            frames: what to write; a frame without data is a plain read.
            read_bytes: bytes to read after each frame, one number or shape (f,).
            not_before_s: earliest start of each frame [s], one number or shape (f,).

        Returns:
            One reply per frame. A frame that fails is a reply with its Ack, not an error;
            bytes nobody drives read as 0xFF.
        """
        ...

    def recover(self, bus: int, cure: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus, not before time t [s].

        Returns:
            When the attempt is over [s], and whether the lines are free.
        """
        ...

    def alert_lines(self, t: float) -> np.ndarray:
        """Return the buses whose alert line is low at time t [s]; none where there is no line."""
        ...

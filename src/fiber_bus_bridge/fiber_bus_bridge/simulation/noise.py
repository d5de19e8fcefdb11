# SPDX-License-Identifier: Apache-2.0
"""Bit errors: a batch as the robots receive it on a noisy wire, and errors in the replies."""

from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.wire import Bytes, Frames
from fiber_core.array_types import Bools, Floats, Ints, Offsets
from fiber_core.ragged import Parts

__all__ = ["Received", "add_noise"]

_BITS = 9  # of a byte with its acknowledge


@dataclass(frozen=True, eq=False)
class Received:
    """A batch as the robots receive it: frame i brings data[first[i] : last[i]] to an address.

    Args:
        address: received address, shape (f,).
        ten_bit: whether the address has the ten-bit form, shape (f,).
        lost: no robot recognises the address, shape (f,).
        first: first byte that arrives, shape (f,).
        last: end of the bytes that arrive, shape (f,).
        data: all bytes as they arrive.
        reads: whether the read after the write takes place, shape (f,).
        ack_flipped: the last acknowledge of a write is read wrong, shape (f,).
        cut_short: the controller gives up before the end of the write, shape (f,).
        reply_errors: wrong bits in each byte that is read back, shape (k,); 0xFF after a byte
            that was lost.
    """

    address: Ints
    ten_bit: Bools
    lost: Bools
    first: Ints
    last: Ints
    data: Bytes
    reads: Bools
    ack_flipped: Bools
    cut_short: Bools
    reply_errors: Bytes

    @classmethod
    def without_errors(cls, frames: Frames, offsets: Offsets) -> "Received":
        """Return a batch on a quiet wire: exactly the frames sent. `offsets` as in Replies."""
        f = len(frames)
        return cls(
            frames.to.address.copy(), frames.to.ten_bit, np.zeros(f, dtype=bool),
            frames.offsets[:-1].copy(), frames.offsets[1:].copy(), frames.data.copy(),
            Parts(offsets).counts > 0, np.zeros(f, dtype=bool), np.zeros(f, dtype=bool),
            np.zeros(offsets[-1], dtype=np.uint8),
        )  # fmt: skip


def add_noise(
    received: Received, frames: Frames, offsets: Offsets, rate: Floats, rng: np.random.Generator
) -> None:
    """Flip bits of a batch, in place.

    Errors of START and STOP are not modelled, and all targets on the wire read the same bits.

    Args:
        received: the batch as on a quiet wire.
        frames: frames sent.
        offsets: first byte of each reply, shape (f + 1,), as in Replies.
        rate: probability that a bit is read wrong during each frame, shape (f,).
        rng: source of randomness.
    """
    read = Parts(offsets).counts
    head = np.where(frames.to.ten_bit, 2, 1)
    restarts = (read > 0) & ((frames.lengths > 0) | frames.to.ten_bit)
    total = head + frames.lengths + restarts + read
    errors = rng.binomial(_BITS * total, rate)
    for f in np.flatnonzero(errors):
        places = np.sort(rng.choice(_BITS * total[f], errors[f], replace=False))
        for place in places:
            byte, bit = divmod(int(place), _BITS)
            sizes = int(head[f]), int(restarts[f])
            if not _flip(received, frames, offsets, int(f), byte, bit, *sizes):
                break


def _flip(
    received: Received,
    frames: Frames,
    offsets: Offsets,
    f: int,
    byte: int,
    bit: int,
    head: int,
    restarts: int,
) -> bool:
    """Flip one bit of frame f; return whether the message continues after it."""
    mask, acknowledge = 0x80 >> bit if bit < 8 else 0, bit == 8
    if byte < head:
        recognised = (bit < 7) if head == 1 else (byte == 1 or bit in (5, 6))
        if acknowledge or not recognised:
            received.lost[f] = True
            return False
        if head == 1:
            received.address[f] ^= mask >> 1
        else:
            received.address[f] ^= mask if byte == 1 else (mask >> 1) << 8
        return True
    byte -= head
    written = frames.lengths[f]
    if byte < written:
        if not acknowledge:
            received.data[frames.offsets[f] + byte] ^= mask
            return True
        if byte == written - 1:
            received.ack_flipped[f] = True
            return False
        received.last[f] = received.first[f] + byte + 1
        received.cut_short[f] = True
        return False
    byte -= written
    if restarts and byte == 0:
        received.reads[f] = False
        return False
    byte -= restarts
    at = offsets[f] + byte
    if not acknowledge:
        received.reply_errors[at] ^= mask
        return True
    received.reply_errors[at + 1 : offsets[f + 1]] = 0xFF
    return False

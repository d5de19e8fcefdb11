"""Bits read wrong: what arrives at robots when the wire is noisy, and what comes back."""

from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.wire import Frames

__all__ = ["Heard", "add_noise"]

_BITS = 9  # of a byte with its acknowledge


@dataclass(frozen=True, eq=False)
class Heard:
    """A batch as it arrives: frame i brings data[first[i] : last[i]] to an address.

    Args:
        address: address that is heard, shape (f,).
        ten_bit: whether it has the ten-bit form, shape (f,).
        lost: no robot recognises the address, shape (f,).
        first: first byte that arrives, shape (f,).
        last: the one after the last, shape (f,).
        data: all bytes as they arrive.
        reads: whether the read that follows is made, shape (f,).
        turned: the last acknowledge of a write is read wrong, shape (f,).
        cut: the controller gives up before the end of the write, shape (f,).
        wrong: bits wrong in what is read back, shape (k,) of bytes, 0xFF after a lost one.
    """

    address: np.ndarray
    ten_bit: np.ndarray
    lost: np.ndarray
    first: np.ndarray
    last: np.ndarray
    data: np.ndarray
    reads: np.ndarray
    turned: np.ndarray
    cut: np.ndarray
    wrong: np.ndarray

    @classmethod
    def clean(cls, frames: Frames, offsets) -> "Heard":
        """What arrives on a quiet wire: what was sent. `offsets` as in Replies."""
        f = len(frames)
        return cls(
            frames.to.address.copy(), frames.to.ten_bit, np.zeros(f, dtype=bool),
            frames.offsets[:-1].copy(), frames.offsets[1:].copy(), frames.data.copy(),
            np.diff(offsets) > 0, np.zeros(f, dtype=bool), np.zeros(f, dtype=bool),
            np.zeros(offsets[-1], dtype=np.uint8),
        )  # fmt: skip


def add_noise(heard: Heard, frames: Frames, offsets, rate, rng: np.random.Generator) -> None:
    """Turn bits of a batch over, in place.

    Errors of START and STOP are not modelled, and all on the wire read the same bits.

    Args:
        heard: the batch as on a quiet wire.
        frames: what is sent.
        offsets: bytes read back, shape (f + 1,), as in Replies.
        rate: chance that a bit is read wrong during each frame, shape (f,).
        rng: where chance comes from.
    """
    read = np.diff(offsets)
    head = np.where(frames.to.ten_bit, 2, 1)
    turns = (read > 0) & ((frames.lengths > 0) | frames.to.ten_bit)
    total = head + frames.lengths + turns + read
    errors = rng.binomial(_BITS * total, rate)
    for f in np.flatnonzero(errors):
        places = np.sort(rng.choice(_BITS * total[f], errors[f], replace=False))
        for place in places:
            byte, bit = divmod(int(place), _BITS)
            if not _turn(heard, frames, offsets, f, byte, bit, int(head[f]), int(turns[f])):
                break


def _turn(heard, frames, offsets, f, byte, bit, head, turns):
    """Turn one bit of frame f; return whether the message goes on after it."""
    mask, acknowledge = 0x80 >> bit if bit < 8 else 0, bit == 8
    if byte < head:
        known = (bit < 7) if head == 1 else (byte == 1 or bit in (5, 6))
        if acknowledge or not known:
            heard.lost[f] = True
            return False
        if head == 1:
            heard.address[f] ^= mask >> 1
        else:
            heard.address[f] ^= mask if byte == 1 else (mask >> 1) << 8
        return True
    byte -= head
    written = frames.lengths[f]
    if byte < written:
        if not acknowledge:
            heard.data[frames.offsets[f] + byte] ^= mask
            return True
        if byte == written - 1:
            heard.turned[f] = True
            return False
        heard.last[f] = heard.first[f] + byte + 1
        heard.cut[f] = True
        return False
    byte -= written
    if turns and byte == 0:
        heard.reads[f] = False
        return False
    byte -= turns
    at = offsets[f] + byte
    if not acknowledge:
        heard.wrong[at] ^= mask
        return True
    heard.wrong[at + 1 : offsets[f + 1]] = 0xFF
    return False

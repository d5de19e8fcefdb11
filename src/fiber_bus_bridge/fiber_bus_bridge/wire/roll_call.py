# SPDX-License-Identifier: Apache-2.0
"""The roll call: one read that every robot of a bus answers with a bit of its own.

A robot pulls SDA low only to send a 0, so what several robots send at once arrives as the AND
of it. At the roll-call address all robots of a bus answer together: the robot in slot k sends
ones except for bit k, which it sends as 0 while it carries out its order. A bit that stays 1
belongs to a robot without power, or to one that stopped or does not listen. For n robots on a
bus the read takes 9 (3 + ceil(n / 8)) clocks besides START, repeated START and STOP: 0.6 ms for
500 robots at 1 MHz.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.wire.fields import Bytes, Whole
from fiber_bus_bridge.wire.frames import Addresses, Frames
from fiber_core.array_types import Ints

__all__ = ["NO_SLOT", "ROLL_CALL_ADDRESS", "roll_call", "roll_call_bytes", "roll_call_slots"]

ROLL_CALL_ADDRESS = 1023  # in ten-bit form, on every bus; no robot has it for itself
NO_SLOT = 0xFFFF  # a robot that has no slot does not answer


def roll_call(buses: ArrayLike) -> Frames:
    """Return a roll call on each of some buses: frames without data, to be read.

    Args:
        buses: bus numbers, shape (b,).
    """
    buses = np.array(buses, dtype=np.int64, ndmin=1)
    address = np.full(buses.shape, ROLL_CALL_ADDRESS)
    return Frames.empty(Addresses(buses, address, np.ones(buses.shape, dtype=bool)))


def roll_call_slots(addresses: Addresses) -> Ints:
    """Return the slot of each robot in the roll call of its bus: its rank by address, (n,)."""
    order = np.lexsort([addresses.address, addresses.bus])
    bus = addresses.bus[order]
    slots = np.empty(len(order), dtype=np.int64)
    slots[order] = np.arange(len(order)) - np.searchsorted(bus, bus)
    return slots


def roll_call_bytes(robots: ArrayLike) -> Ints:
    """Return the number of bytes that the roll call of a bus reads.

    Args:
        robots: number of robots on each bus, shape (b,).
    """
    return (np.asarray(robots, dtype=np.int64) + 7) // 8


@njit(cache=True)
def write_present(slot: Whole, out: Bytes) -> None:
    """Pull the bit of a slot low in the bytes of a roll call, in place."""
    if slot >> 3 < len(out):
        out[slot >> 3] &= 0xFF ^ (0x80 >> (slot & 7))

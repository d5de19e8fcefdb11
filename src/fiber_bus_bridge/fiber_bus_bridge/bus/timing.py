# SPDX-License-Identifier: Apache-2.0
"""Duration of a message on an I2C bus, by the figures of the standard."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import TopologyError
from fiber_core.array_types import Floats

__all__ = ["BUS_TIMINGS", "BusTiming", "bus_timing"]

_BITS_PER_BYTE = 9  # eight data bits and the acknowledge
_HS_ENTRY_S = 0.6e-6 + 1.3e-6 + 9 / 400e3  # tHD;STA, tLOW and 00001xxx with its not-acknowledge


@dataclass(frozen=True)
class BusTiming:
    """Clock of a bus and the least times around START and STOP (NXP UM10204, tables 10 and 11).

    Args:
        clock_hz: bits per second [Hz].
        start_hold_s: tHD;STA, from START to the first clock [s].
        low_s: tLOW, clock low before the first bit [s].
        restart_setup_s: tSU;STA, before a repeated START [s].
        stop_setup_s: tSU;STO, before STOP [s].
        free_s: tBUF, from STOP to the next START [s]; none in High-speed mode.
        entry_s: START and master code at Fast-mode speed at the beginning of each batch in
            High-speed mode [s]; the messages of the batch are joined by repeated START.
    """

    clock_hz: float
    start_hold_s: float
    low_s: float
    restart_setup_s: float
    stop_setup_s: float
    free_s: float
    entry_s: float = 0.0

    def message_s(self, written: ArrayLike, read: ArrayLike, ten_bit: ArrayLike) -> Floats:
        """Return the time from START until the bus is free again [s], shape (f,).

        9 (data + address bytes) / clock + tHD;STA + tLOW + tSU;STO + tBUF. A message that
        writes and then reads repeats START and the address. A read of a ten-bit target always
        repeats them: the address is written first, then its head is sent again for the read.

        Args:
            written: number of data bytes written, shape (f,) or one number.
            read: number of data bytes read, shape (f,) or one number.
            ten_bit: whether the address has the ten-bit form, shape (f,) or one value.
        """
        written, read, ten_bit = np.asarray(written), np.asarray(read), np.asarray(ten_bit)
        restarts = (read > 0) & ((written > 0) | ten_bit)
        address = np.where(ten_bit, 2, 1) + restarts
        ends = self.start_hold_s + self.low_s + self.stop_setup_s + self.free_s
        restart_s = self.restart_setup_s + self.start_hold_s + self.low_s
        return (
            _BITS_PER_BYTE * (written + read + address) / self.clock_hz
            + ends
            + restarts * restart_s
        )

    def unanswered_s(self, ten_bit: ArrayLike) -> Floats:
        """Return the time spent on an address that no target acknowledges [s], as ten_bit."""
        return self.message_s(0, 0, ten_bit)


BUS_TIMINGS = {
    "100k": BusTiming(100e3, 4.0e-6, 4.7e-6, 4.7e-6, 4.0e-6, 4.7e-6),
    "400k": BusTiming(400e3, 0.6e-6, 1.3e-6, 0.6e-6, 0.6e-6, 1.3e-6),
    "1M": BusTiming(1e6, 0.26e-6, 0.5e-6, 0.26e-6, 0.26e-6, 0.5e-6),
    "1.7M": BusTiming(1.7e6, 160e-9, 320e-9, 160e-9, 160e-9, 0.0, _HS_ENTRY_S),
    "3.4M": BusTiming(3.4e6, 160e-9, 160e-9, 160e-9, 160e-9, 0.0, _HS_ENTRY_S),
}


def bus_timing(mode: str) -> BusTiming:
    """Return the timing of a bus mode: 100k, 400k, 1M, 1.7M or 3.4M.

    Raises:
        TopologyError: the mode does not exist.
    """
    if mode not in BUS_TIMINGS:
        raise TopologyError(f"bus mode {mode!r} does not exist, expected {', '.join(BUS_TIMINGS)}")
    return BUS_TIMINGS[mode]

# SPDX-License-Identifier: Apache-2.0
"""Checksums of the wire format, one byte at a time, compiled.

CRC-16-CCITT (polynomial 0x1021, initial value 0xFFFF) guards every frame that makes a
robot move or configures it, and the long replies; the SMBus packet error code (CRC-8,
polynomial 0x07, initial value 0) guards frames of at most 119 bits, up to which it
detects every error of three bits or less.
"""

import numpy as np
from numba import njit

from fiber_bus_bridge.wire.fields import Whole
from fiber_core.array_types import Ints

__all__ = ["CRC16_INIT", "CRC8_INIT", "crc8", "crc16"]

CRC16_INIT = 0xFFFF
CRC8_INIT = 0


def _table(polynomial: int, width: int) -> Ints:
    top, mask = 1 << (width - 1), (1 << width) - 1
    table = np.zeros(256, dtype=np.int64)
    for byte in range(256):
        crc = byte << (width - 8)
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc & top else crc << 1) & mask
        table[byte] = crc
    return table


_CRC16 = _table(0x1021, 16)
_CRC8 = _table(0x07, 8)


@njit(cache=True)
def crc16(crc: Whole, byte: Whole) -> Whole:
    """Return a CRC-16-CCITT continued over one more byte."""
    return ((crc << 8) & 0xFFFF) ^ _CRC16[(crc >> 8) ^ byte]


@njit(cache=True)
def crc8(crc: Whole, byte: Whole) -> Whole:
    """Return an SMBus packet error code continued over one more byte."""
    return _CRC8[crc ^ byte]

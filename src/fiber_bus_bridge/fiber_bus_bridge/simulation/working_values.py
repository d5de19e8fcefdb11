# SPDX-License-Identifier: Apache-2.0
"""The values by which a simulated positioner works, as checksums that a VERIFY tells."""

import numpy as np
from numba import njit

from fiber_bus_bridge.simulation.memory import Robot
from fiber_bus_bridge.wire.codes import VERSION, Opcode
from fiber_bus_bridge.wire.config_blocks import GEARS_FIELDS, Block
from fiber_bus_bridge.wire.crc import CRC16_INIT, crc16
from fiber_bus_bridge.wire.fields import Whole

__all__ = ["place_crc", "working_crc"]

_HEAD = int(Opcode.CONFIG) << 4 | VERSION
_GEARS, _GEARS_BYTES = int(Block.GEARS), GEARS_FIELDS.itemsize
_SPEEDS, _RAMPS = int(Block.SPEEDS), int(Block.RAMPS)
_LONGEST_S = 65.6  # more than two bytes hold in milliseconds


@njit(cache=True)
def working_crc(r: Robot) -> Whole:
    """Return the checksum over the CONFIG that would tell a robot the values it works by now.

    It is that of the CONFIG that the robot took, unless one of the values has changed since.
    """
    crc = _unsigned(CRC16_INIT, _HEAD, 1)
    crc = _unsigned(crc, r.velocity_bits, 1)
    crc = _unsigned(crc, r.duration_bits, 1)
    crc = _unsigned(crc, r.tick_us, 4)
    crc = _unsigned(crc, r.quantum_prad, 4)
    crc = _table(crc, r.limits)
    crc = _unsigned(crc, r.speed[0], 2)
    crc = _unsigned(crc, r.speed[1], 2)
    crc = _unsigned(crc, _milliseconds(r.watchdog_s), 2)
    crc = _unsigned(crc, _milliseconds(r.silence_s), 2)
    crc = _unsigned(crc, r.slot, 2)
    if r.coupling.any():
        crc = _unsigned(crc, _GEARS, 1)
        crc = _unsigned(crc, _GEARS_BYTES, 1)
        crc = _table(crc, r.coupling)
        crc = _table(crc, r.motor_limits)
        crc = _unsigned(crc, r.motor_speed[0], 4)
        crc = _unsigned(crc, r.motor_speed[1], 4)
    crc = _block(crc, _SPEEDS, r.listed_bytes, r.listed)
    return _block(crc, _RAMPS, r.ramp_bytes, r.ramps)


@njit(cache=True)
def place_crc(r: Robot) -> Whole:
    """Return the checksum over the counters of a robot where it rests, or where it began to move.

    An order is a way from there.
    """
    return _signed(_signed(CRC16_INIT, r.position[0]), r.position[1])


@njit(cache=True)
def _block(crc, tag, size, content):
    """Continue a checksum over a block with some bytes of content, or over none."""
    if size == 0:
        return crc
    crc = _unsigned(_unsigned(crc, tag, 1), size, 1)
    for i in range(min(max(size, 0), len(content))):
        crc = crc16(crc, content[i])
    return crc


@njit(cache=True)
def _unsigned(crc, value, size):
    """Continue a checksum over a number of some bytes."""
    if value >> (8 * size) != 0:
        crc ^= 0xFFFF  # a value that does not fit its field has the checksum of no CONFIG
    for i in range(size - 1, -1, -1):
        crc = crc16(crc, (value >> (8 * i)) & 0xFF)
    return crc


@njit(cache=True)
def _signed(crc, value):
    """Continue a checksum over a signed number of four bytes."""
    if value < -(1 << 31) or value >= 1 << 31:
        crc ^= 0xFFFF
    return _unsigned(crc, value & 0xFFFFFFFF, 4)


@njit(cache=True)
def _table(crc, values):
    """Continue a checksum over 2 x 2 signed numbers."""
    for row in range(2):
        for column in range(2):
            crc = _signed(crc, values[row, column])
    return crc


@njit(cache=True)
def _milliseconds(s):
    """Return a time in milliseconds, -1 if it is not one that a CONFIG can tell."""
    if not 0.0 <= s < _LONGEST_S:
        return np.int64(-1)
    ms = np.int64(np.rint(1e3 * s))
    return ms if 1e-3 * ms == s else np.int64(-1)

# SPDX-License-Identifier: Apache-2.0
"""The blocks at the end of a CONFIG: tag, number of bytes, content; tags rise from block to block.

A robot that does not know a block refuses the CONFIG, so that nothing is ignored.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.codes import Fault
from fiber_bus_bridge.wire.fields import Bytes, Whole, filled, number, signed
from fiber_bus_bridge.wire.ramp_block import ramps_fault
from fiber_bus_bridge.wire.speed_block import speeds_fault
from fiber_core.array_types import Floats, Ints
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits

__all__ = [
    "BLOCK_HEAD",
    "GEARS_FIELDS",
    "GEAR_UNIT",
    "MOTOR_SPEED_UNIT",
    "Block",
    "Gears",
    "block_at",
    "block_of",
    "blocks_fault",
    "gear_counts",
    "read_gears",
]


class Block(IntEnum):
    """What a block tells."""

    GEARS = 1  # how gears couple motors and joints, and limits of the motors
    SPEEDS = 2  # the listed speeds of the motors
    RAMPS = 3  # over how long the motors spread changes of velocity


GEAR_UNIT = 2.0**-22  # of the numbers of a coupling: at most 512, with an error of 1.2e-7
MOTOR_SPEED_UNIT = 2.0**-8  # of the speed of a motor [velocity units]
GEARS_FIELDS = np.dtype(
    [
        ("coupling", ">i4", (2, 2)),  # motor, joint (theta, phi)
        ("motor_limits", ">i4", (2, 2)),  # motor, (low, high)
        ("motor_speed", ">u4", (2,)),
    ]
)
BLOCK_HEAD = 2  # bytes before the content

_SAME_RAD = 1e-6  # a motor this far beyond its range is at its end, as for the certificate
_MOST, _MOST_SPEED = 2**31 - 1, 2**32 - 1
_GEARS, _GEARS_BYTES = int(Block.GEARS), GEARS_FIELDS.itemsize
_SPEEDS, _RAMPS = int(Block.SPEEDS), int(Block.RAMPS)
_NONE, _BAD_LENGTH, _BAD_VALUE = int(Fault.NONE), int(Fault.BAD_LENGTH), int(Fault.BAD_VALUE)


@dataclass(frozen=True, eq=False)
class Gears:
    """How gears couple motors and joints: motors = coupling x joints.

    Args:
        coupling: by motor and joint [GEAR_UNIT], shape (f, 2, 2).
        motor_limits: ranges of the motors [quanta], shape (f, 2, 2): robot, motor, (low, high).
        motor_speed: highest speeds of the motors [MOTOR_SPEED_UNIT], shape (f, 2).
    """

    coupling: Ints
    motor_limits: Ints
    motor_speed: Ints

    @classmethod
    def of(cls, plane: FocalPlane, units: WireUnits) -> "Gears | None":
        """Return the gears of all robots of a plane, None without coupled joints.

        Ranges and speeds are rounded outwards by what the rounding of the coupling can do, so that
        robots accept every order that the certificate passes.

        Args:
            plane: the focal plane.
            units: size of tick and quantum.

        Raises:
            WireError: a coupling does not fit its field.
        """
        if not plane.coupling.shape[1]:
            return None
        coupling = gear_counts(plane)
        error = GEAR_UNIT * 0.5
        joints = np.abs(plane.limits).max(axis=2).sum(axis=1)
        slack_rad = _SAME_RAD * np.abs(plane.coupling).sum(axis=2) + error * joints[:, None]
        low, high = np.moveaxis(plane.motor_limits, -1, 0)
        motor_limits = np.stack([low - slack_rad, high + slack_rad], axis=-1) / units.quantum_rad
        motor_limits += (-1.0, 1.0)
        speed = plane.motor_speeds * (1.0 + 1e-9) + error * plane.speeds.sum(axis=1)[:, None]
        speed = np.ceil(speed / units.velocity_rad_s / MOTOR_SPEED_UNIT)
        return cls(
            coupling,
            np.rint(np.clip(motor_limits, -_MOST, _MOST)).astype(np.int64),
            np.clip(speed, 0, _MOST_SPEED).astype(np.int64),
        )

    def __getitem__(self, rows: Ints | slice) -> "Gears":
        """Return the gears of some robots."""
        return Gears(self.coupling[rows], self.motor_limits[rows], self.motor_speed[rows])

    def block(self) -> Bytes:
        """Return the block of each robot, shape (f, bytes).

        Raises:
            WireError: a value does not fit its field; names the field and the value.
        """
        values = {name: getattr(self, name) for name in ("coupling", "motor_limits", "motor_speed")}
        return block_of(Block.GEARS, filled(len(self.coupling), GEARS_FIELDS, values))


def block_of(tag: Block, content: Bytes) -> Bytes:
    """Return the block with this content of each robot, shape (f, bytes).

    Args:
        tag: what the block tells.
        content: its content, shape (f, bytes - 2).
    """
    head = np.array([tag, content.shape[1]], dtype=np.uint8)
    return np.concatenate([np.tile(head, (len(content), 1)), content], axis=1)


def gear_counts(plane: FocalPlane) -> Ints:
    """Return the coupling of each robot [GEAR_UNIT], shape (n, 2, 2); of independent joints zeros.

    Raises:
        WireError: a coupling does not fit its field.
    """
    if not plane.coupling.shape[1]:
        return np.zeros((plane.n, 2, 2), dtype=np.int64)
    coupling: Floats = np.rint(plane.coupling / GEAR_UNIT)
    wrong = np.abs(coupling) > _MOST
    if wrong.any():
        robot = int(np.argmax(wrong.any(axis=(1, 2))))
        most = float(np.abs(plane.coupling[robot]).max())
        raise WireError(f"robot {plane.ids[robot]}: a coupling of {most:g} does not fit CONFIG")
    return coupling.astype(np.int64)


@njit(cache=True)
def blocks_fault(data: Bytes, first: Whole, last: Whole, tick_us: Whole) -> int:
    """Return the Fault of the blocks in data[first:last] of a CONFIG with this tick, or NONE."""
    before, listed_at = 0, -1
    while first < last:
        if last - first < BLOCK_HEAD:
            return _BAD_LENGTH
        tag, size = np.int64(data[first]), np.int64(data[first + 1])
        known = tag == _GEARS and size == _GEARS_BYTES or tag == _SPEEDS or tag == _RAMPS
        if tag <= before or not known:
            return _BAD_VALUE
        first += BLOCK_HEAD + size
        if first > last:
            return _BAD_LENGTH
        fault = _NONE
        if tag == _SPEEDS:
            listed_at = first - size
            fault = speeds_fault(data, listed_at, size)
        elif tag == _RAMPS:
            fault = ramps_fault(data, first - size, size, listed_at, tick_us)
        if fault != _NONE:
            return fault
        before = tag
    return _NONE


@njit(cache=True)
def block_at(data: Bytes, first: Whole, last: Whole, tag: int) -> Whole:
    """Return where the content of a block begins in data[first:last], -1 without such a block."""
    while first < last:
        if data[first] == tag:
            return first + BLOCK_HEAD
        first += BLOCK_HEAD + np.int64(data[first + 1])
    return -1


@njit(cache=True)
def read_gears(data: Bytes, at: Whole, coupling: Ints, limits: Ints, speed: Ints) -> None:
    """Read the content of a block of gears at data[at:] into arrays of one robot."""
    for motor in range(2):
        for k in range(2):
            coupling[motor, k] = signed(data, at + 8 * motor + 4 * k)
            limits[motor, k] = signed(data, at + 16 + 8 * motor + 4 * k)
        speed[motor] = number(data, at + 32 + 4 * motor, 4)

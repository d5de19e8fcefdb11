# SPDX-License-Identifier: Apache-2.0
"""The block SPEEDS of a CONFIG: the speeds of motors that have only a few, with their rules.

Its content is ``number of speeds k u8 | approach u8 | approach 4 x u16 | k speeds``. The low three
bits of `approach` are the number of its speed, bits 3 and 4 whether theta and phi end it rising.
The four numbers are ticks: theta back, forth, phi back, forth. A speed is ``velocity 4 x u16 | ramp
u16 | least 4 x u16``, by theta falling, theta rising, phi falling, phi rising.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.codes import Fault
from fiber_bus_bridge.wire.fields import Bytes, Whole, number
from fiber_core.array_types import Ids, Ints
from fiber_core.drive.listed_units import listed_units
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits

__all__ = [
    "MOST_LISTED_BYTES",
    "MOST_SPEEDS",
    "Speeds",
    "approach_ticks",
    "approaches_rising",
    "least_ticks",
    "listed_velocity",
    "number_of",
    "ramp_ticks",
    "speeds_fault",
]

MOST_SPEEDS = 6  # that a move of an order can name
_HEAD, _SPEED = 10, 18  # bytes before the speeds, and of each
MOST_LISTED_BYTES = _HEAD + _SPEED * MOST_SPEEDS
_MOST = 2**16 - 1
_NONE, _BAD_LENGTH, _BAD_VALUE = int(Fault.NONE), int(Fault.BAD_LENGTH), int(Fault.BAD_VALUE)


@dataclass(frozen=True, eq=False)
class Speeds:
    """The listed speeds of f robots, as their CONFIG tells them.

    Args:
        content: content of the block of each robot, shape (f, bytes).
    """

    content: Bytes

    @classmethod
    def of(cls, plane: FocalPlane, units: WireUnits) -> "Speeds | None":
        """Return the lists of all robots of a plane, None for motors of any speed.

        Args:
            plane: the focal plane.
            units: size of tick and quantum.

        Raises:
            WireError: a value does not fit its field; names the robot and the value.
        """
        listed = plane.drive.listed
        if listed is None:
            return None
        table = listed_units(plane, units)
        rising = (listed.approach_sign > 0.0).astype(np.int64)
        k, n = len(listed.speeds_rad_s), plane.n
        approach = np.stack([table.back, table.forth], axis=2).reshape(n, 4)
        ramp = np.broadcast_to(table.ramp[:, None], (n, k, 1))
        of_speed = [table.velocity.reshape(n, k, 4), ramp, table.least.reshape(n, k, 4)]
        words = np.concatenate([approach, np.concatenate(of_speed, axis=2).reshape(n, -1)], axis=1)
        _check(words, plane.ids)
        head = (k, listed.approach_speed | int(rising[0]) << 3 | int(rising[1]) << 4)
        content = np.ascontiguousarray(words.astype(">u2")).view(np.uint8)
        first = np.tile(np.array(head, dtype=np.uint8), (n, 1))
        return cls(np.concatenate([first, content], axis=1))

    def __getitem__(self, rows: Ints | slice) -> "Speeds":
        """Return the lists of some robots."""
        return Speeds(self.content[rows])


def _check(words: Ints, ids: Ids) -> None:
    wrong = words > _MOST
    if wrong.any():
        row, at = np.argwhere(wrong)[0]
        raise WireError(
            f"robot {ids[row]}: {words[row, at]} ticks or velocity units of its list of speeds do "
            f"not fit CONFIG"
        )


@njit(cache=True)
def speeds_fault(data: Bytes, at: Whole, size: Whole) -> int:
    """Return the Fault of the content of a block of speeds in data[at:at + size], or NONE."""
    if size < _HEAD + _SPEED:
        return _BAD_LENGTH
    k = np.int64(data[at])
    if k < 1 or k > MOST_SPEEDS or size != _HEAD + _SPEED * k:
        return _BAD_LENGTH
    if data[at + 1] & 7 >= k or data[at + 1] >> 5 != 0:
        return _BAD_VALUE
    for joint in range(2):
        for rising in range(2):
            before = 1 << 16
            for speed in range(k):
                velocity = listed_velocity(data, at, speed, joint, rising)
                if velocity == 0 or velocity >= before:
                    return _BAD_VALUE  # speeds fall
                before = velocity
    return _NONE


@njit(cache=True)
def number_of(data: Bytes, at: Whole, velocity: Whole, joint: int) -> Whole:
    """Return the number of the listed speed of a signed velocity [velocity units], -1 if none."""
    rising = 1 if velocity > 0 else 0
    for speed in range(np.int64(data[at])):
        if listed_velocity(data, at, speed, joint, rising) == abs(velocity):
            return speed
    return -1


@njit(cache=True)
def listed_velocity(data: Bytes, at: Whole, speed: Whole, joint: int, rising: Whole) -> Whole:
    """Return a listed velocity without sign [velocity units]."""
    return number(data, at + _HEAD + _SPEED * speed + 4 * joint + 2 * rising, 2)


@njit(cache=True)
def ramp_ticks(data: Bytes, at: Whole, speed: Whole) -> Whole:
    """Return the ticks of rest that a move at a listed speed needs behind it."""
    return number(data, at + _HEAD + _SPEED * speed + 8, 2)


@njit(cache=True)
def least_ticks(data: Bytes, at: Whole, speed: Whole, joint: int, rising: Whole) -> Whole:
    """Return the ticks of the least move at a listed speed."""
    return number(data, at + _HEAD + _SPEED * speed + 10 + 4 * joint + 2 * rising, 2)


@njit(cache=True)
def approach_ticks(data: Bytes, at: Whole, joint: int) -> tuple[Whole, Whole]:
    """Return the ticks of the approach of a joint, back and forth; 0 for none."""
    return number(data, at + 2 + 4 * joint, 2), number(data, at + 4 + 4 * joint, 2)


@njit(cache=True)
def approaches_rising(data: Bytes, at: Whole, joint: int) -> Whole:
    """Return 1 if a joint ends its approach at a rising angle, else 0."""
    return np.int64(data[at + 1]) >> (3 + joint) & 1

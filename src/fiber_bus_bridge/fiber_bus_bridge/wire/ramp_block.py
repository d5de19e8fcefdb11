# SPDX-License-Identifier: Apache-2.0
"""The block RAMPS of a CONFIG: the time over which motors spread each change of velocity.

Its content is ``ramp u32`` in microseconds: one for motors of any speed; of motors with a list of
speeds one for each of them, in the order of the list.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire.codes import Fault
from fiber_bus_bridge.wire.fields import Bytes, Whole, number
from fiber_bus_bridge.wire.speed_block import MOST_SPEEDS, ramp_ticks
from fiber_core.array_types import Ints
from fiber_core.focal_plane import FocalPlane

__all__ = ["MOST_RAMP_BYTES", "Ramps", "ramps_fault"]

MOST_RAMP_BYTES = 4 * MOST_SPEEDS
_WHOLE_US = 1e-3  # what a ramp may be off a whole number of microseconds
_NONE, _BAD_LENGTH, _BAD_VALUE = int(Fault.NONE), int(Fault.BAD_LENGTH), int(Fault.BAD_VALUE)


@dataclass(frozen=True, eq=False)
class Ramps:
    """The ramps of f robots, as their CONFIG tells them.

    Args:
        content: content of the block of each robot, shape (f, bytes).
    """

    content: Bytes

    @classmethod
    def of(cls, plane: FocalPlane) -> "Ramps | None":
        """Return the ramps of all robots of a plane, None where no motor has one.

        Raises:
            WireError: a ramp is no whole number of microseconds; tells it.
        """
        drive = plane.drive
        if drive.longest_ramp_s == 0.0:
            return None
        ramp_s = np.array([drive.ramp_s]) if drive.listed is None else drive.listed.ramp_s
        whole = np.rint(1e6 * ramp_s)
        wrong = np.abs(1e6 * ramp_s - whole) > _WHOLE_US
        if wrong.any():
            raise WireError(
                f"the drive {drive.name!r} has a ramp of {ramp_s[wrong][0]:.9g} s, which is no "
                f"whole number of microseconds"
            )
        row = whole.astype(">u4").view(np.uint8)
        return cls(np.tile(row, (plane.n, 1)))

    def __getitem__(self, rows: Ints | slice) -> "Ramps":
        """Return the ramps of some robots."""
        return Ramps(self.content[rows])


@njit(cache=True)
def ramps_fault(data: Bytes, at: Whole, size: Whole, listed_at: Whole, tick_us: Whole) -> int:
    """Return the Fault of the content of a block of ramps in data[at:at + size], or NONE.

    Args:
        data: the CONFIG.
        at, size: place and bytes of the content.
        listed_at: place of the content of the block of speeds, -1 without one.
        tick_us: length of a tick [us].
    """
    k = np.int64(data[listed_at]) if listed_at >= 0 else 1
    if size != 4 * k:
        return _BAD_LENGTH
    longest = 0
    for speed in range(k):
        ramp_us = number(data, at + 4 * speed, 4)
        # the next move begins when the ramp of the one before has ended
        if listed_at >= 0 and ramp_us > ramp_ticks(data, listed_at, speed) * tick_us:
            return _BAD_VALUE
        longest = max(longest, ramp_us)
    return _NONE if longest > 0 else _BAD_VALUE

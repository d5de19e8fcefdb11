# SPDX-License-Identifier: Apache-2.0
"""Watch over loaded orders: which controller loaded each one, and whether it read it back."""

import numpy as np

from fiber_bus_bridge.bus import Ack, Replies
from fiber_bus_bridge.simulation import Positioners
from fiber_bus_bridge.wire import VERIFY_BYTES, Frames, RobotState
from fiber_core.array_types import Bools, Ints, Rows

__all__ = ["OrderWatch"]

_FORMS, _PER_BUS = 1024, 2048  # addresses of one form, and of both


class OrderWatch:
    """For each robot, whether the present controller has verified the order that is loaded.

    An order counts as verified when the controller that loaded it has read the robot's status
    between LOAD and GO.

    `unread` tells whether orders are loaded that were not read.

    Args:
        robots: the robots, at the addresses by which they are read.
    """

    def __init__(self, robots: Positioners):
        self._robots = robots
        self._loaded_s = robots.memory["loaded_s"].copy()
        self._loaded_by = np.full(robots.n, -1)
        self._read = np.zeros(robots.n, dtype=bool)
        self.unread = False
        self._keys = _keys(robots.bus, robots.memory["address"], robots.memory["ten_bit"])
        self._order = np.argsort(self._keys)

    def observe(self, controller: int, frames: Frames, read_bytes: Ints, replies: Replies) -> None:
        """Take note of the orders loaded and read in one batch.

        Args:
            controller: number of the controller that sent the batch.
            frames: the frames, f rows.
            read_bytes: number of bytes read after each frame, shape (f,).
            replies: their replies.
        """
        memory = self._robots.memory
        new = memory["loaded_s"] != self._loaded_s
        if new.any():
            self._loaded_s[new] = memory["loaded_s"][new]
            self._loaded_by[new], self._read[new] = controller, False
        self.unread = bool(((memory["state"] == RobotState.LOADED) & ~self._read).any())
        if not self.unread:
            return
        at = np.flatnonzero((read_bytes >= VERIFY_BYTES) & (replies.ack == Ack.OK))
        rows = self._rows(frames, at)
        known = (rows >= 0) & (replies.end_s[at] > self._loaded_s[rows])
        own = rows[known & (self._loaded_by[rows] == controller)]
        self._read[own] = True

    def verified(self, controller: int, rows: Rows) -> Bools:
        """Return whether a controller loaded and read the last order of some robots, (r,)."""
        return (self._loaded_by[rows] == controller) & self._read[rows]

    def _rows(self, frames: Frames, at: Ints) -> Rows:
        """Robots that the frames at some places are for, -1 without one."""
        to = frames.to
        keys = _keys(to.bus[at], to.address[at], to.ten_bit[at])
        place = np.searchsorted(self._keys, keys, sorter=self._order)
        rows = self._order[np.minimum(place, len(self._order) - 1)]
        return np.where(self._keys[rows] == keys, rows, -1)


def _keys(bus: Ints, address: Ints, ten_bit: Bools) -> Ints:
    return bus * _PER_BUS + ten_bit * _FORMS + address

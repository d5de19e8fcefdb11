# SPDX-License-Identifier: Apache-2.0
"""Reads the status replies of robots back from the frames of a plan."""

import numpy as np

from fiber_bus_bridge.wire import STATUS_BYTES, VERIFY_BYTES, Addresses, decode_status
from fiber_core.array_types import Bools, Rows
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog

__all__ = ["StatusReplies", "rows_of_frames"]


def rows_of_frames(plane: FocalPlane, log: FrameLog) -> Rows:
    """Return the row of the robot that each frame is for, -1 for a general call, shape (f,).

    Args:
        plane: the focal plane, with bus and address of every robot.
        log: the frames.
    """
    row_at = {at: row for row, at in enumerate(zip(plane.bus.tolist(), plane.address.tolist()))}
    places, inverse = np.unique(np.stack([log.bus, log.address]), axis=1, return_inverse=True)
    rows = np.array([row_at.get(at, -1) for at in map(tuple, places.T.tolist())], dtype=np.int64)
    return rows[inverse.ravel()] if len(rows) else np.zeros(0, dtype=np.int64)


class StatusReplies:
    """The status replies among some frames, complete or only their first five bytes.

    Args:
        log: the frames.
        row: row of the robot of each frame, from rows_of_frames, shape (f,).

    Attributes:
        frame: index of the frame of each reply, shape (s,).
        row: row of the robot of each reply, shape (s,).
        ok: whether its checksum is right, shape (s,).
        full: whether it is complete, shape (s,); only a complete reply has a position.
        state, boot, fault, alerts: its contents, 0 where the reply lacks them, shape (s,).
        position: encoders [quanta], shape (s, 2).
    """

    def __init__(self, log: FrameLog, row: Rows):
        length = log.lengths
        received = log.read & (log.ack == 0) & (row >= 0)
        self.frame = np.flatnonzero(received & np.isin(length, (VERIFY_BYTES, STATUS_BYTES)))
        self.row = row[self.frame]
        data = np.zeros((len(self.frame), STATUS_BYTES), dtype=np.uint8)
        width = np.arange(STATUS_BYTES)
        has = width < length[self.frame, None]
        data[has] = log.data[(log.offsets[self.frame, None] + width)[has]]
        self.full = length[self.frame] == STATUS_BYTES
        self.ok = np.zeros(len(self.frame), dtype=bool)
        self.state, self.boot, self.fault, self.alerts = np.zeros(
            (4, len(self.frame)), dtype=np.int64
        )
        self.position = np.zeros((len(self.frame), 2), dtype=np.int64)
        for full, size in ((True, STATUS_BYTES), (False, VERIFY_BYTES)):
            chosen = self.full == full
            at = self.frame[chosen]
            addresses = Addresses(log.bus[at], log.address[at], log.ten_bit[at])
            status = decode_status(addresses, data[chosen, :size])
            self.ok[chosen], self.state[chosen] = status.ok, status.state
            self.boot[chosen] = status.boot
            if full:
                self.fault[chosen], self.alerts[chosen] = status.fault, status.alerts
                self.position[chosen] = status.position

    @property
    def placed(self) -> Bools:
        """Replies with a valid position, shape (s,)."""
        return self.ok & self.full

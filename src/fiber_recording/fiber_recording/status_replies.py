"""What robots said about themselves, read back from the frames of a plan."""

import numpy as np

from fiber_bus_bridge.wire import STATUS_BYTES, VERIFY_BYTES, Addresses, decode_status
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog

__all__ = ["StatusReplies", "rows_of_frames"]


def rows_of_frames(plane: FocalPlane, log: FrameLog) -> np.ndarray:
    """Return the robot of each frame, row of the plane, -1 for all of a bus, shape (f,)."""
    of = {hung: row for row, hung in enumerate(zip(plane.bus.tolist(), plane.address.tolist()))}
    hung, inverse = np.unique(np.stack([log.bus, log.address]), axis=1, return_inverse=True)
    rows = np.array([of.get(pair, -1) for pair in map(tuple, hung.T.tolist())], dtype=np.int64)
    return rows[inverse.ravel()] if len(rows) else np.zeros(0, dtype=np.int64)


class StatusReplies:
    """Status replies among frames, whole or only their first five bytes.

    Args:
        log: the frames.
        row: robot of each, from rows_of_frames.

    Attributes:
        frame: which frames they are, shape (s,).
        row: robot of each, shape (s,).
        ok: whether the checksum is right, shape (s,).
        full: whether the reply is whole, shape (s,); else there is no position.
        state, fault, alerts: what it says, 0 where it does not, shape (s,).
        position: encoders [quanta], shape (s, 2).
    """

    def __init__(self, log: FrameLog, row: np.ndarray):
        length = np.diff(log.offsets)
        whole = log.read & (log.ack == 0) & (row >= 0)
        self.frame = np.flatnonzero(whole & np.isin(length, (VERIFY_BYTES, STATUS_BYTES)))
        self.row = row[self.frame]
        data = np.zeros((len(self.frame), STATUS_BYTES), dtype=np.uint8)
        width = np.arange(STATUS_BYTES)
        has = width < length[self.frame, None]
        data[has] = log.data[(log.offsets[self.frame, None] + width)[has]]
        self.full = length[self.frame] == STATUS_BYTES
        self.ok = np.zeros(len(self.frame), dtype=bool)
        self.state, self.fault, self.alerts = np.zeros((3, len(self.frame)), dtype=np.int64)
        self.position = np.zeros((len(self.frame), 2), dtype=np.int64)
        for full, size in ((True, STATUS_BYTES), (False, VERIFY_BYTES)):
            chosen = self.full == full
            at = self.frame[chosen]
            to = Addresses(log.bus[at], log.address[at], log.ten_bit[at])
            said = decode_status(to, data[chosen, :size])
            self.ok[chosen], self.state[chosen] = said.ok, said.state
            if full:
                self.fault[chosen], self.alerts[chosen] = said.fault, said.alerts
                self.position[chosen] = said.position

    @property
    def placed(self) -> np.ndarray:
        """Those that say where the encoders are, shape (s,)."""
        return self.ok & self.full

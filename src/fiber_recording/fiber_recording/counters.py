# SPDX-License-Identifier: Apache-2.0
"""Follows the counters of robots through the frames of a plan: readings, settings, losses of power.

A counter changes by motion, or by a PLACE, with which a controller sets it to what a camera saw, or
by a loss of power. Only the first is a motion of the arm.
"""

import numpy as np

from fiber_bus_bridge.wire import PLACE_BYTES, PLACE_FIELDS, Opcode
from fiber_core.array_types import Codes, Counts, Ints, Rows, Times
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_recording.status_replies import StatusReplies, rows_of_frames

__all__ = ["Counters"]


class Counters:
    """Readings of the counters of all robots, sorted by robot and time, and what has set them.

    Args:
        plane: the focal plane, with bus and address of every robot.
        log: all frames of a plan.

    Attributes:
        time_s: times of the frames that carried the readings [s], shape (r,).
        position: the readings [quanta], shape (r, 2).
        state: RobotState of each, shape (r,).
        boot: boots of the robot at each, modulo 256, shape (r,).
    """

    def __init__(self, plane: FocalPlane, log: FrameLog):
        row_of_frame = rows_of_frames(plane, log)
        replies = StatusReplies(log, row_of_frame)
        time_s, kept = log.time_s[replies.frame], np.flatnonzero(replies.placed)
        kept = kept[np.lexsort([time_s[kept], replies.row[kept]])]
        self.time_s: Times = time_s[kept]
        self.position: Counts = replies.position[kept]
        self.state: Codes = replies.state[kept]
        self.boot: Ints = replies.boot[kept]
        self._row = replies.row[kept]
        self._first = np.searchsorted(self._row, np.arange(plane.n + 1))
        # short replies, as to a VERIFY, tell of boots too
        valid = np.flatnonzero(replies.ok)
        valid = valid[np.lexsort([time_s[valid], replies.row[valid]])]
        self._boots = replies.row[valid], time_s[valid], replies.boot[valid]
        self._set_row, self._set_s, self._set = _settings(log, row_of_frame)

    def rows_since(self, time_s: float) -> Rows:
        """Return the robots with a reading at or after a time."""
        return np.unique(self._row[self.time_s >= time_s])

    def last(self, row: int, since_s: float, until_s: float) -> int | None:
        """Return the last reading of a robot between two times, None without one."""
        part = slice(self._first[row], self._first[row + 1])
        at = int(self._first[row] + np.searchsorted(self.time_s[part], until_s)) - 1
        return at if at >= self._first[row] and self.time_s[at] > since_s else None

    def last_of_boot(self, row: int, boot: int, since_s: float, until_s: float) -> int | None:
        """Return the last reading before a robot booted anew, between two times; None without."""
        part = slice(self._first[row], self._first[row + 1])
        good = (self.boot[part] == boot) & (self.time_s[part] > since_s)
        good &= self.time_s[part] < until_s
        return int(self._first[row] + np.flatnonzero(good)[-1]) if good.any() else None

    def boot_at(self, row: int, time_s: float) -> int | None:
        """Return the boots of a robot by its last reply before a time [s], None without one."""
        rows, times_s, boots = self._boots
        part = slice(*np.searchsorted(rows, [row, row + 1]))
        at = int(np.searchsorted(times_s[part], time_s)) - 1
        return int(boots[part][at]) if at >= 0 else None

    def set_after(self, row: int, time_s: float) -> float:
        """Return when the counters of a robot were next set after a time [s], inf if never."""
        later = self._set_s[(self._set_row == row) & (self._set_s > time_s)]
        return float(later.min(initial=np.inf))

    def with_settings(self, counts: Counts, since_s: float, until_s: float) -> Counts:
        """Return counters after the settings between two times [quanta], shape (n, 2).

        Args:
            counts: the counters before them [quanta], shape (n, 2).
            since_s, until_s: the times [s].
        """
        between = np.flatnonzero((self._set_s > since_s) & (self._set_s <= until_s))
        after = np.array(counts)
        after[self._set_row[between]] = self._set[between]  # in the order of time: the last counts
        return after


def _settings(log: FrameLog, row: Rows) -> tuple[Rows, Times, Counts]:
    """Rows, times and positions of all PLACEs that robots took, in the order of time."""
    taken = np.flatnonzero(~log.read & (log.ack == 0) & (row >= 0) & (log.lengths == PLACE_BYTES))
    taken = taken[log.data[log.offsets[taken]] >> 4 == Opcode.PLACE]
    taken = taken[np.argsort(log.time_s[taken], kind="stable")]
    data = log.data[log.offsets[taken, None] + np.arange(PLACE_BYTES)]
    position = np.ascontiguousarray(data).view(PLACE_FIELDS)["position"].reshape(-1, 2)
    return row[taken], log.time_s[taken], position.astype(np.int64)

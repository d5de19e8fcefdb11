"""Which orders robots were started with and when they were stopped, from the frames of a plan."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fiber_bus_bridge.wire import CALL_PREFIX, COUNTDOWN_S, Opcode
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog

__all__ = ["Runs", "follow"]

_TOLD = (Opcode.LOAD, Opcode.CLEAR, Opcode.GO, Opcode.STOP, Opcode.RESET)


class Runs(NamedTuple):
    """Orders that were told to go, in the order in which they were.

    Args:
        row: robot, row of the plane, shape (r,).
        frame: the LOAD that brought the order, shape (r,).
        go_s: when its GO began, in the time of the frames [s], shape (r,).
        begin_s: when its countdown was over [s], shape (r,).
        stop_s: when a STOP for it began [s], inf without one, shape (r,).
        off: whether that was before the countdown was over, so that nothing began, shape (r,).
        load_s: when the first LOAD of all began [s], nan without one.
    """

    row: np.ndarray
    frame: np.ndarray
    go_s: np.ndarray
    begin_s: np.ndarray
    stop_s: np.ndarray
    off: np.ndarray
    load_s: float

    def only(self, chosen) -> "Runs":
        """Return some of them, by index or flag."""
        return Runs(*(column[chosen] for column in self[:-1]), self.load_s)


def follow(plane: FocalPlane, log: FrameLog) -> Runs:
    """Follow frames as the robots do: store, forget, count down, start, stop.

    An acknowledged LOAD replaces what a robot had stored, a CLEAR forgets it, and a GO lets
    every robot it reaches that stores an order of its sequence number start after a
    countdown. A STOP or RESET before that calls the start off.
    """
    rows_of = {
        (bus, address): np.array([row])
        for row, (bus, address) in enumerate(zip(plane.bus.tolist(), plane.address.tolist()))
    }
    rows_on = {bus: np.flatnonzero(plane.bus == bus) for bus in np.unique(plane.bus).tolist()}
    stored, sequence, current = np.full((3, plane.n), -1)
    started, stops, off = [], [], []  # of each run: row, frame, GO, begin; STOP; called off
    load_s = np.nan
    for frame, opcode, number, countdown_s, called in _orders(log):
        bus, time_s = int(log.bus[frame]), float(log.time_s[frame])
        rows = rows_on[bus] if called else rows_of.get((bus, int(log.address[frame])), [])
        if opcode == Opcode.LOAD:
            stored[rows], sequence[rows] = frame, number
            load_s = np.fmin(load_s, time_s)
        elif opcode == Opcode.CLEAR:
            stored[rows] = -1
        elif opcode == Opcode.GO:
            rows = rows[(stored[rows] >= 0) & (sequence[rows] == number)]
            current[rows] = len(started) + np.arange(len(rows))
            begin_s = time_s + countdown_s
            started += [(row, stored[row], time_s, begin_s) for row in rows.tolist()]
            stops += [np.inf] * len(rows)
            off += [False] * len(rows)
            stored[rows] = -1
        else:
            for run in current[rows][current[rows] >= 0].tolist():
                stops[run], off[run] = time_s, started[run][3] > time_s
            stored[rows] = current[rows] = -1
    columns = np.array(started).reshape(-1, 4).T
    return Runs(
        columns[0].astype(np.int64), columns[1].astype(np.int64), columns[2], columns[3],
        np.array(stops), np.array(off, dtype=bool), float(load_s),
    )  # fmt: skip


def _orders(log) -> Iterator[tuple]:
    # What makes robots store, forget, start or stop: frame, opcode, sequence number, countdown
    # of a GO [s], and whether it is a general call, which has a prefix.
    written = np.flatnonzero(~log.read & (log.ack == 0) & (np.diff(log.offsets) > 0))
    called = (log.address[written] == 0) & ~log.ten_bit[written]
    first = log.offsets[written] + called * (log.data[log.offsets[written]] == CALL_PREFIX)
    opcode, number = log.data[first] >> 4, log.data[first] & 15
    for at in np.flatnonzero(np.isin(opcode, _TOLD)):
        countdown_s = 0.0
        if opcode[at] == Opcode.GO:
            countdown_s = (
                int.from_bytes(log.data[first[at] + 1 : first[at] + 3].tobytes()) * COUNTDOWN_S
            )
        yield written[at], opcode[at], number[at], countdown_s, called[at]

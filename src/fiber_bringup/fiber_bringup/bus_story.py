"""What the frames of a plan tell beside its orders: readings, load, and what went wrong."""

from collections.abc import Sequence

import numpy as np

from fiber_bus_bridge.wire import (
    CALL_PREFIX,
    STATUS_BYTES,
    VERIFY_BYTES,
    Addresses,
    Opcode,
    decode_status,
)
from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py import FrameLog
from fiber_viewer import BusLoad, EventKind, Events, Measured

__all__ = ["bus_story"]

_BINS = 400  # of the bus load over a plan, at most
_FINEST_S = 0.005
_FAILED = {1: EventKind.NO_ADDRESS, 2: EventKind.REFUSED}  # by how a frame ended
_CALLS = {Opcode.GO: EventKind.GO, Opcode.STOP: EventKind.STOP}


def bus_story(
    plane: FocalPlane, logs: Sequence[FrameLog], start_s: float
) -> tuple[Measured, BusLoad, Events]:
    """Read the frames of a plan.

    Args:
        plane: the focal plane.
        logs: its frames, in the order they were published.
        start_s: when robots began to move, in the time of the frames [s]; with nan times
            count from the first frame.
    """
    log = FrameLog.joined(logs)
    if not np.isfinite(start_s):
        start_s = log.time_s.min(initial=np.inf) if len(log) else 0.0
    time_s = log.time_s - start_s
    row = _rows(plane, log)
    status = _Statuses(log, row)
    return (
        _measured(status, time_s, row),
        _load(plane, log, time_s),
        _events(status, log, time_s, row),
    )


class _Statuses:
    # status replies among the frames: which frames, and what they say

    def __init__(self, log, row):
        length = np.diff(log.offsets)
        whole = log.read & (log.ack == 0) & (row >= 0)
        self.frame = np.flatnonzero(whole & np.isin(length, (VERIFY_BYTES, STATUS_BYTES)))
        data = np.zeros((len(self.frame), STATUS_BYTES), dtype=np.uint8)
        width = np.arange(STATUS_BYTES)
        has = width < length[self.frame, None]
        data[has] = log.data[(log.offsets[self.frame, None] + width)[has]]
        self.full = length[self.frame] == STATUS_BYTES
        self.ok = np.zeros(len(self.frame), dtype=bool)
        self.fault, self.alerts = np.zeros((2, len(self.frame)), dtype=np.int64)
        self.position = np.zeros((len(self.frame), 2), dtype=np.int64)
        for full, size in ((True, STATUS_BYTES), (False, VERIFY_BYTES)):
            chosen = self.full == full
            at = self.frame[chosen]
            to = Addresses(log.bus[at], log.address[at], log.ten_bit[at])
            said = decode_status(to, data[chosen, :size])
            self.ok[chosen] = said.ok
            if full:
                self.fault[chosen], self.alerts[chosen] = said.fault, said.alerts
                self.position[chosen] = said.position


def _measured(status, time_s, row):
    good = status.ok & status.full
    frame = status.frame[good]
    time_us = np.rint(time_s[frame] * 1e6).astype(np.int64)
    return Measured(row[frame], time_us, status.position[good])


def _load(plane, log, time_s):
    buses = np.unique(plane.bus)
    if not len(log):
        return BusLoad(buses, 0.0, _FINEST_S, *np.zeros((2, len(buses), 1)))
    begin, end = time_s.min(), time_s.max()
    bin_s = max(_FINEST_S, (end - begin) / (_BINS - 1))
    begin = np.floor(begin / bin_s) * bin_s  # so that the GO is at the edge of a bin
    count = int((end - begin) / bin_s) + 1
    at = np.searchsorted(buses, log.bus) * count + ((time_s - begin) / bin_s).astype(int)
    shape = (len(buses), count)
    frames = np.bincount(at, minlength=shape[0] * count).reshape(shape)
    size = np.bincount(at, np.diff(log.offsets), minlength=shape[0] * count).reshape(shape)
    return BusLoad(buses, float(begin), float(bin_s), frames, size)


def _events(status, log, time_s, row):
    found = []  # frame, kind, detail

    def add(frames, kind, detail=0):
        found.append(np.broadcast_arrays(frames, int(kind), detail))

    for ack, kind in _FAILED.items():
        add(np.flatnonzero(log.ack == ack), kind)
    calls = np.flatnonzero((log.address == 0) & ~log.ten_bit & (np.diff(log.offsets) > 1))
    calls = calls[log.data[log.offsets[calls]] == CALL_PREFIX]
    opcode = log.data[log.offsets[calls] + 1] >> 4
    for code, kind in _CALLS.items():
        add(calls[opcode == code], kind)
    add(status.frame[~status.ok], EventKind.BAD_REPLY)
    for said, kind in ((status.fault, EventKind.FAULT), (status.alerts, EventKind.ALERT)):
        new = _first(row[status.frame], said)
        add(status.frame[new], kind, said[new])
    frame, kind, detail = (np.concatenate(column) for column in zip(*found))
    order = np.lexsort([frame, time_s[frame]])
    frame = frame[order]
    rows = np.where(row[frame] >= 0, row[frame], -1)
    return Events(time_s[frame], kind[order], log.bus[frame], rows, detail[order])


def _first(row, said):
    # where a robot says something that it did not say before
    told = np.flatnonzero(said != 0)
    _, first = np.unique(np.stack([row[told], said[told]]), axis=1, return_index=True)
    return told[first]


def _rows(plane, log):
    """The robot of each frame, -1 for all of a bus."""
    of = {hung: row for row, hung in enumerate(zip(plane.bus.tolist(), plane.address.tolist()))}
    hung, inverse = np.unique(np.stack([log.bus, log.address]), axis=1, return_inverse=True)
    rows = np.array([of.get(pair, -1) for pair in map(tuple, hung.T.tolist())], dtype=np.int64)
    return rows[inverse.ravel()] if len(rows) else np.zeros(0, dtype=np.int64)

"""What the frames of a plan tell beside its orders: readings, load, and what went wrong."""

from collections.abc import Sequence

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.wire import CALL_PREFIX, Opcode
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_recording.recording import BusLoad, EventKind, Events, Measured
from fiber_recording.status_replies import StatusReplies, rows_of_frames

__all__ = ["bus_events"]

_BINS = 400  # of the bus load over a plan, at most
_FINEST_S = 0.005
_FAILED = {Ack.NO_ADDRESS: EventKind.NO_ADDRESS, Ack.REFUSED: EventKind.REFUSED}
_SENT = (Ack.OK, Ack.NO_ADDRESS, Ack.REFUSED)  # others never got onto the wire as a whole
_LINES = (Ack.LOST, Ack.STUCK, Ack.TIMED_OUT)
_BURST_S = 0.05  # failures of the lines of a bus that follow each other faster are one
_CALLS = {Opcode.GO: EventKind.GO, Opcode.STOP: EventKind.STOP}


def bus_events(
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
    row = rows_of_frames(plane, log)
    status = StatusReplies(log, row)
    return (
        _measured(status, time_s),
        _load(plane, log, time_s),
        _events(status, log, time_s, row),
    )


def _measured(status, time_s):
    placed = status.placed
    time_us = np.rint(time_s[status.frame[placed]] * 1e6).astype(np.int64)
    return Measured(status.row[placed], time_us, status.position[placed])


def _load(plane, log, time_s):
    buses = np.unique(plane.bus)
    if not len(log):
        return BusLoad(buses, 0.0, _FINEST_S, *np.zeros((2, len(buses), 1)))
    begin, end = time_s.min(), time_s.max()
    bin_s = max(_FINEST_S, (end - begin) / (_BINS - 1))
    begin = np.floor(begin / bin_s) * bin_s  # so that the GO is at the edge of a bin
    count = int((end - begin) / bin_s) + 1
    sent = np.isin(log.ack, _SENT)
    bus, passed_s, size = log.bus[sent], (time_s - begin)[sent], np.diff(log.offsets)[sent]
    at = np.searchsorted(buses, bus) * count + (passed_s / bin_s).astype(int)
    shape = (len(buses), count)
    frames = np.bincount(at, minlength=shape[0] * count).reshape(shape)
    size = np.bincount(at, size, minlength=shape[0] * count).reshape(shape)
    return BusLoad(buses, float(begin), float(bin_s), frames, size)


def _events(status, log, time_s, row):
    found = []  # frame, kind, detail

    def add(frames, kind, detail=0):
        found.append(np.broadcast_arrays(frames, int(kind), detail))

    for ack, kind in _FAILED.items():
        add(np.flatnonzero(log.ack == ack), kind)
    failed = np.flatnonzero(np.isin(log.ack, _LINES))
    for bus in np.unique(log.bus[failed]):
        mine = failed[log.bus[failed] == bus]
        mine = mine[np.argsort(time_s[mine], kind="stable")]
        begins = mine[np.diff(time_s[mine], prepend=-np.inf) > _BURST_S]
        add(begins, EventKind.LINE, log.ack[begins])
    calls = np.flatnonzero((log.address == 0) & ~log.ten_bit & (np.diff(log.offsets) > 1))
    calls = calls[log.data[log.offsets[calls]] == CALL_PREFIX]
    opcode = log.data[log.offsets[calls] + 1] >> 4
    for code, kind in _CALLS.items():
        add(calls[opcode == code], kind)
    add(status.frame[~status.ok], EventKind.BAD_REPLY)
    for said, kind in ((status.fault, EventKind.FAULT), (status.alerts, EventKind.ALERT)):
        new = _first(status.row, said)
        add(status.frame[new], kind, said[new])
    frame, kind, detail = (np.concatenate(column) for column in zip(*found))
    order = np.lexsort([frame, time_s[frame]])
    frame = frame[order]
    kind = kind[order]
    rows = np.where((row[frame] >= 0) & (kind != EventKind.LINE), row[frame], -1)
    return Events(time_s[frame], kind, log.bus[frame], rows, detail[order])


def _first(row, said):
    # where a robot says something that it did not say before
    told = np.flatnonzero(said != 0)
    _, first = np.unique(np.stack([row[told], said[told]]), axis=1, return_index=True)
    return told[first]

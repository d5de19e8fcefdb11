# SPDX-License-Identifier: Apache-2.0
"""Reads encoder readings, bus load and faults from the frames of a plan."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.wire import CALL_PREFIX, Alert, Fault, Opcode
from fiber_core.array_types import Floats, Ints, Rows
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_recording.phases import Phase
from fiber_recording.recording import BusLoad, EventKind, Events, Measured
from fiber_recording.status_replies import StatusReplies, rows_of_frames

__all__ = ["at_own_stops", "bus_events"]

_MOST_BINS = 400  # of the bus load
_SHORTEST_BIN_S = 0.005
_NOT_ACKNOWLEDGED = {Ack.NO_ADDRESS: EventKind.NO_ADDRESS, Ack.REFUSED: EventKind.REFUSED}
_CARRIED = (Ack.OK, Ack.NO_ADDRESS, Ack.REFUSED)  # frames with another end did not occupy the bus
_LINE_FAILURES = (Ack.LOST, Ack.STUCK, Ack.TIMED_OUT)
_BURST_S = 0.05  # line failures of a bus with a shorter time between them are one event
_GENERAL_CALLS = {Opcode.GO: EventKind.GO, Opcode.STOP: EventKind.STOP}


def bus_events(
    plane: FocalPlane, logs: Sequence[FrameLog], start_s: float
) -> tuple[Measured, BusLoad, Events]:
    """Return the encoder readings, the bus load and the events in the frames of a plan.

    Args:
        plane: the focal plane.
        logs: the frames of the plan, in the order in which the buses carried them.
        start_s: begin of the motion, in the time of the frames [s]; nan if there was none: then
            times count from the first frame.
    """
    log = FrameLog.joined(logs)
    if not np.isfinite(start_s):
        start_s = float(log.time_s.min()) if len(log) else 0.0
    time_s = log.time_s - start_s
    row = rows_of_frames(plane, log)
    status = StatusReplies(log, row)
    return (
        _measured(status, time_s),
        _load(plane, log, time_s),
        _events(status, log, time_s, row),
    )


def _measured(status: StatusReplies, time_s: Floats) -> Measured:
    placed = status.placed
    time_us = np.rint(time_s[status.frame[placed]] * 1e6).astype(np.int64)
    return Measured(status.row[placed], time_us, status.position[placed])


def _load(plane: FocalPlane, log: FrameLog, time_s: Floats) -> BusLoad:
    buses = np.unique(plane.bus)
    if not len(log):
        nothing = np.zeros((len(buses), 1), dtype=np.int64)
        return BusLoad(buses, 0.0, _SHORTEST_BIN_S, nothing, nothing)
    begin, end = time_s.min(), time_s.max()
    bin_s = max(_SHORTEST_BIN_S, (end - begin) / (_MOST_BINS - 1))
    begin = np.floor(begin / bin_s) * bin_s  # so that the GO is at the edge of a bin
    count = int((end - begin) / bin_s) + 1
    carried = np.isin(log.ack, _CARRIED)
    bus, passed_s = log.bus[carried], (time_s - begin)[carried]
    size = log.lengths[carried]
    at = np.searchsorted(buses, bus) * count + (passed_s / bin_s).astype(int)
    shape = (len(buses), count)
    frames = np.bincount(at, minlength=shape[0] * count).reshape(shape)
    size = np.bincount(at, size, minlength=shape[0] * count).reshape(shape).astype(np.int64)
    return BusLoad(buses, float(begin), float(bin_s), frames, size)


def _events(status: StatusReplies, log: FrameLog, time_s: Floats, row: Rows) -> Events:
    found = []  # frame, kind, detail

    def add(frames: Ints, kind: EventKind, detail: ArrayLike = 0) -> None:
        found.append(np.broadcast_arrays(frames, int(kind), detail))

    for ack, kind in _NOT_ACKNOWLEDGED.items():
        add(np.flatnonzero(log.ack == ack), kind)
    failed = np.flatnonzero(np.isin(log.ack, _LINE_FAILURES))
    for bus in np.unique(log.bus[failed]):
        on_bus = failed[log.bus[failed] == bus]
        on_bus = on_bus[np.argsort(time_s[on_bus], kind="stable")]
        bursts = on_bus[np.diff(time_s[on_bus], prepend=-np.inf) > _BURST_S]
        add(bursts, EventKind.LINE, log.ack[bursts])
    calls = np.flatnonzero((log.address == 0) & ~log.ten_bit & (log.lengths > 1))
    calls = calls[log.data[log.offsets[calls]] == CALL_PREFIX]
    opcode = log.data[log.offsets[calls] + 1] >> 4
    for code, kind in _GENERAL_CALLS.items():
        add(calls[opcode == code], kind)
    add(status.frame[~status.ok], EventKind.BAD_REPLY)
    for reported, kind in ((status.fault, EventKind.FAULT), (status.alerts, EventKind.ALERT)):
        new = _first_reports(status.row, reported)
        add(status.frame[new], kind, reported[new])
    frame, kind, detail = (np.concatenate(column) for column in zip(*found))
    order = np.lexsort([frame, time_s[frame]])
    frame = frame[order]
    kind = kind[order]
    rows = np.where((row[frame] >= 0) & (kind != EventKind.LINE), row[frame], -1)
    return Events(time_s[frame], kind, log.bus[frame], rows, detail[order])


def at_own_stops(events: Events, phases: Sequence[Phase]) -> Events:
    """Return the same events with each stall at the time at which its robot stopped by itself.

    A robot tells of its stall when it is read, which is after the stop of all where it pulled the
    alert line of its bus: the cause would come after its effect.

    Args:
        events: the events of a plan, in order of time.
        phases: the phases of the plan, in order.
    """
    kind, detail, row = events.kind, events.detail, events.row
    stall = (kind == EventKind.FAULT) & (detail == Fault.STALL)
    stall |= (kind == EventKind.ALERT) & (detail & Alert.STALLED != 0)
    at = np.flatnonzero(stall & (row >= 0))
    time_s = events.time_s.copy()
    for phase in phases:
        stop_s = np.where(phase.stopped, 1e-6 * phase.stop_us, np.inf)[row[at]]
        time_s[at] = np.where(stop_s <= events.time_s[at], stop_s, time_s[at])
    order = np.argsort(time_s, kind="stable")
    return Events(time_s[order], kind[order], events.bus[order], row[order], detail[order])


def _first_reports(row: Rows, value: Ints) -> Ints:
    """Return the replies in which a robot reports a value other than 0 for the first time."""
    reports = np.flatnonzero(value != 0)
    _, first = np.unique(np.stack([row[reports], value[reports]]), axis=1, return_index=True)
    return reports[first]

# SPDX-License-Identifier: Apache-2.0
"""Finds the orders that robots started, and when they were stopped, in the frames of a plan."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fiber_bus_bridge.wire import CALL_PREFIX, COUNTDOWN_S, ORDER_OPCODES, Opcode
from fiber_core.array_types import Bools, Ints, Rows, Times
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog

__all__ = ["StartedOrders", "started_orders"]

_FOLLOWED = (*ORDER_OPCODES, Opcode.CLEAR, Opcode.GO, Opcode.STOP, Opcode.RESET)


class StartedOrders(NamedTuple):
    """Orders that received a GO, in the order of the GOs; times are those of the frames.

    Args:
        row: row of the robot in the plane, shape (r,).
        frame: index of the LOAD frame that carried the order, shape (r,).
        go_s: begin of its GO [s], shape (r,).
        begin_s: end of its countdown [s], shape (r,).
        stop_s: begin of the STOP that ended it [s], inf without one, shape (r,).
        cancelled: whether the STOP came during the countdown, so that the robot never moved,
            shape (r,).
        load_s: begin of the first LOAD of the plan [s], nan without one.
    """

    row: Rows
    frame: Ints
    go_s: Times
    begin_s: Times
    stop_s: Times
    cancelled: Bools
    load_s: float

    def only(self, chosen: Ints | Bools) -> "StartedOrders":
        """Return some of the orders, chosen by an index or mask array."""
        return StartedOrders(
            row=self.row[chosen],
            frame=self.frame[chosen],
            go_s=self.go_s[chosen],
            begin_s=self.begin_s[chosen],
            stop_s=self.stop_s[chosen],
            cancelled=self.cancelled[chosen],
            load_s=self.load_s,
        )


def started_orders(plane: FocalPlane, log: FrameLog) -> StartedOrders:
    """Follow the frames as robots do, and return the orders that robots started.

    An acknowledged LOAD replaces the order that a robot stores, a CLEAR deletes it. A GO starts
    every robot of its bus that stores an order with the sequence number of the GO, after a
    countdown. A STOP or RESET before the end of the countdown cancels the start.

    Args:
        plane: the focal plane, with bus and address of every robot.
        log: the frames of a plan.
    """
    rows_at = {
        (bus, address): np.array([row])
        for row, (bus, address) in enumerate(zip(plane.bus.tolist(), plane.address.tolist()))
    }
    rows_on = {bus: np.flatnonzero(plane.bus == bus) for bus in np.unique(plane.bus).tolist()}
    nothing = np.zeros(0, dtype=np.int64)
    stored, sequence, current = np.full((3, plane.n), -1)
    started: list[tuple[int, int, float, float]] = []  # row, LOAD, GO, end of the countdown
    stops: list[float] = []
    cancelled: list[bool] = []
    load_s = np.nan
    for command in _commands(log):
        bus, time_s = int(log.bus[command.frame]), float(log.time_s[command.frame])
        if command.general_call:
            rows = rows_on[bus]
        else:
            rows = rows_at.get((bus, int(log.address[command.frame])), nothing)
        if command.opcode in ORDER_OPCODES:
            stored[rows], sequence[rows] = command.frame, command.sequence
            load_s = np.fmin(load_s, time_s)
        elif command.opcode == Opcode.CLEAR:
            stored[rows] = -1
        elif command.opcode == Opcode.GO:
            rows = rows[(stored[rows] >= 0) & (sequence[rows] == command.sequence)]
            current[rows] = len(started) + np.arange(len(rows))
            begin_s = time_s + command.countdown_s
            started += [(row, int(stored[row]), time_s, begin_s) for row in rows.tolist()]
            stops += [np.inf] * len(rows)
            cancelled += [False] * len(rows)
            stored[rows] = -1
        else:
            for k in current[rows][current[rows] >= 0].tolist():
                stops[k], cancelled[k] = time_s, started[k][3] > time_s
            stored[rows] = current[rows] = -1
    row, frame, go_s, begin_s = np.array(started).reshape(-1, 4).T
    return StartedOrders(
        row.astype(np.int64), frame.astype(np.int64), go_s, begin_s,
        np.array(stops), np.array(cancelled, dtype=bool), float(load_s),
    )  # fmt: skip


class _Command(NamedTuple):
    """A command that makes robots store, delete, start or stop."""

    frame: int
    opcode: int
    sequence: int
    countdown_s: float  # of a GO
    general_call: bool


def _commands(log: FrameLog) -> Iterator[_Command]:
    written = np.flatnonzero(~log.read & (log.ack == 0) & (log.lengths > 0))
    general = (log.address[written] == 0) & ~log.ten_bit[written]
    # the bytes of a general call begin with a prefix
    first = log.offsets[written] + general * (log.data[log.offsets[written]] == CALL_PREFIX)
    opcode, sequence = log.data[first] >> 4, log.data[first] & 15
    for at in np.flatnonzero(np.isin(opcode, _FOLLOWED)):
        countdown_s = 0.0
        if opcode[at] == Opcode.GO:
            units = log.data[first[at] + 1 : first[at] + 3].tobytes()
            countdown_s = int.from_bytes(units) * COUNTDOWN_S
        yield _Command(
            int(written[at]), int(opcode[at]), int(sequence[at]), countdown_s, bool(general[at])
        )

# SPDX-License-Identifier: Apache-2.0
"""Events that happen to positioners: power cuts, deafness, damaged memory, jams."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Protocol, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from fiber_bus_bridge.simulation.drive import advance_robot, halt, reboot
from fiber_bus_bridge.simulation.memory import Robot
from fiber_bus_bridge.wire.codes import RobotState
from fiber_core.array_types import Ints, Offsets

__all__ = ["BOOT_S", "EVENT", "Event", "Events", "apply_events", "events_in_order", "set_power"]

_UNCONFIGURED = int(RobotState.UNCONFIGURED)
# During the boot a robot does not acknowledge, so that even a short power cut is noticed.
BOOT_S = 5e-3


class Event(IntEnum):
    """What can happen to a robot; `value` is a column of the event table."""

    POWER = 1  # value 0: the robot loses power; 1: it boots, unconfigured
    DEAF = 2  # value 1: it receives and answers nothing, but keeps moving; 0: it recovers
    CALL_DEAF = 3  # value 1: it receives no general call; 0: it recovers
    BUSY = 4  # value 1: it refuses every frame; 0: it recovers
    FLIP = 5  # a bit of the stored order flips; value: bit number, modulo the length
    MOVE_ADDRESS = 6  # value: its address from now on
    JAM_THETA = 7  # the joint is jammed from now on
    JAM_PHI = 8


Events: TypeAlias = NDArray[np.void]  # records of EVENT
EVENT = np.dtype([("row", "i8"), ("t", "f8"), ("event", "i8"), ("value", "i8")])

_POWER, _DEAF, _CALL_DEAF = int(Event.POWER), int(Event.DEAF), int(Event.CALL_DEAF)
_BUSY, _FLIP, _MOVE = int(Event.BUSY), int(Event.FLIP), int(Event.MOVE_ADDRESS)
_JAM_THETA, _JAM_PHI = int(Event.JAM_THETA), int(Event.JAM_PHI)


class EventRecord(Protocol):
    """One record of EVENT, as compiled functions read it: fields are attributes."""

    row: int
    t: float
    event: int
    value: int


def events_in_order(events: ArrayLike, n: int) -> tuple[Events, Offsets]:
    """Sort events by robot and time; return them and the first of each robot, shape (n + 1,)."""
    table = np.asarray(events, dtype=EVENT)
    table = table[np.lexsort([table["t"], table["row"]])]
    return table, np.searchsorted(table["row"], np.arange(n + 1))


@njit(cache=True)
def set_power(r: Robot, on: bool, t: float) -> None:
    """Switch the power of a robot at time t [s]."""
    advance_robot(r, t)
    if on and not r.powered:
        reboot(r, t)
        r.boots_until_s = t + BOOT_S
    elif not on and r.powered:
        halt(r, t)
        r.state = _UNCONFIGURED  # the boot deletes the rest
    r.powered = on


@njit(cache=True)
def apply_events(
    m: Sequence[Robot],
    events: Sequence[EventRecord],
    next_event: Ints,
    last_event: Ints,
    row: int,
    t: float,
) -> None:
    """Apply the events of one robot until time t [s] and advance the robot to that time.

    Args:
        m: memory of all robots.
        events: all events, sorted by robot and time.
        next_event: next event of each robot, shape (n,), advanced in place.
        last_event: end of the events of each robot, shape (n,).
        row: the robot.
        t: the time [s].
    """
    r = m[row]
    while next_event[row] < last_event[row]:
        e = events[int(next_event[row])]
        if e.t > t:
            break
        advance_robot(r, e.t)
        _apply(r, e)
        next_event[row] += 1
    advance_robot(r, t)


@njit(cache=True)
def _apply(r, e):
    if e.event == _POWER:
        set_power(r, e.value != 0, e.t)
    elif e.event == _DEAF:
        r.deaf = e.value != 0
    elif e.event == _CALL_DEAF:
        r.call_deaf = e.value != 0
    elif e.event == _BUSY:
        r.busy = e.value != 0
    elif e.event == _FLIP:
        if r.order_length > 0:
            bit = e.value % (8 * r.order_length)
            r.order[bit >> 3] ^= np.uint8(1 << (bit & 7))
    elif e.event == _MOVE:
        r.address = e.value
    elif e.event == _JAM_THETA:
        r.jam_s[0] = min(r.jam_s[0], e.t)
    elif e.event == _JAM_PHI:
        r.jam_s[1] = min(r.jam_s[1], e.t)

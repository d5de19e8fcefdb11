"""What befalls positioners and when: power cuts, deafness, damaged memory, jams."""

from enum import IntEnum

import numpy as np
from numba import njit

from fiber_bus_bridge.simulation.drive import halt, reboot, settle
from fiber_bus_bridge.wire.codes import RobotState

__all__ = ["BOOT_S", "EVENT", "Event", "bring_up", "events_in_order", "switch"]

_UNCONFIGURED = int(RobotState.UNCONFIGURED)
# A robot that loses power for an instant is missed when it is next asked whether it is there.
BOOT_S = 5e-3


class Event(IntEnum):
    """What can befall a robot; `value` is what the event table holds beside it."""

    POWER = 1  # value 0: it loses power; 1: it boots, unconfigured
    DEAF = 2  # value 1: hears nothing and answers nothing, though it goes on; 0: no more
    CALL_DEAF = 3  # value 1: hears no general call; 0: no more
    BUSY = 4  # value 1: refuses whatever it is sent; 0: no more
    FLIP = 5  # a bit of the stored order turns over: bit number, modulo its length
    MOVE_ADDRESS = 6  # it listens at this address from now on
    JAM_THETA = 7  # the joint does not turn any more
    JAM_PHI = 8


EVENT = np.dtype([("row", "i8"), ("t", "f8"), ("event", "i8"), ("value", "i8")])

_POWER, _DEAF, _CALL_DEAF = int(Event.POWER), int(Event.DEAF), int(Event.CALL_DEAF)
_BUSY, _FLIP, _MOVE = int(Event.BUSY), int(Event.FLIP), int(Event.MOVE_ADDRESS)
_JAM_THETA, _JAM_PHI = int(Event.JAM_THETA), int(Event.JAM_PHI)


def events_in_order(events, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Sort events by robot and time; return them and the first of each robot, shape (n + 1,)."""
    events = np.asarray(events, dtype=EVENT)
    events = events[np.lexsort([events["t"], events["row"]])]
    return events, np.searchsorted(events["row"], np.arange(n + 1))


@njit(cache=True)
def switch(r, on, t):
    """Cut or give power to a robot at time t [s]."""
    settle(r, t)
    if on and not r.powered:
        reboot(r, t)
        r.boots_until_s = t + BOOT_S
    elif not on and r.powered:
        halt(r, t)
        r.state = _UNCONFIGURED  # the rest it forgets when it boots
    r.powered = on


@njit(cache=True)
def bring_up(m, events, next_event, last_event, row, t):
    """Let everything happen to one robot that has happened until time t."""
    r = m[row]
    while next_event[row] < last_event[row] and events[next_event[row]].t <= t:
        e = events[next_event[row]]
        settle(r, e.t)
        if e.event == _POWER:
            switch(r, e.value != 0, e.t)
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
        next_event[row] += 1
    settle(r, t)

# SPDX-License-Identifier: Apache-2.0
"""Decisions of the protocol as functions of the tables; none of them uses a bus."""

import numpy as np
from numba import njit

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.protocol.tables import Buses, Robots
from fiber_bus_bridge.wire import Alert, RobotState
from fiber_core.array_types import Bools, Codes, Floats, Ints, Mask, Pairs, Rows
from fiber_core.outcomes import Reason

__all__ = [
    "able_to_resume",
    "countdown_s",
    "failing",
    "neighbours_of",
    "not_loaded",
    "own_fault",
    "record_heartbeats",
    "resting_cause",
    "silent_stop_s",
    "unresponsive",
]

LOST_REPLIES = 6  # missed replies in a row after which a robot counts as lost
ABSENT, GARBLED = 2, 1  # missed replies counted for no acknowledge, and for an invalid reply
LONGEST_COUNTDOWN_S = 0.65  # largest countdown that its field can carry
_SLACK_S = 10e-3  # for robots that need another poll or another GO
_OK = int(Ack.OK)


def neighbours_of(lost: Mask, pairs: Pairs) -> Mask:
    """Return the robots in a pair with a lost one, shape (n,)."""
    pairs = pairs[(pairs < len(lost)).all(axis=1)]
    neighbours = np.zeros(len(lost), dtype=bool)
    neighbours[pairs[lost[pairs[:, 1]], 0]] = True
    neighbours[pairs[lost[pairs[:, 0]], 1]] = True
    return neighbours


def not_loaded(verified: Bools, ack: Codes, replied: Bools, booted: Bools, cut_off: Bools) -> Codes:
    """Return the Reason of robots that were sent an order, OK for verified ones, shape (r,).

    Args:
        verified: whether a robot holds the order, shape (r,).
        ack: Ack of the order, shape (r,).
        replied: whether its last status was valid, shape (r,).
        booted: whether this status is of another boot than the configuration, shape (r,).
        cut_off: whether its bus was given up, shape (r,).
    """
    reason = np.where(ack == Ack.REFUSED, Reason.REFUSED, Reason.NOT_VERIFIED)
    absent = ack == Ack.NO_ADDRESS
    reason[absent] = np.where(replied, Reason.NOT_ACKNOWLEDGED, Reason.NO_REPLY)[absent]
    reason[booted] = Reason.REBOOTED
    reason[cut_off & ~replied] = Reason.BUS_FAILED
    return np.where(verified, Reason.OK, reason)


def own_fault(robots: Robots, cut_off: Mask) -> Codes:
    """Return the Reason of robots with a fault of their own, by their last status, else OK, (n,).

    Args:
        robots: the robots, as read just now.
        cut_off: robots on buses that were given up, shape (n,).
    """
    state, alerts = robots["state"], robots["alerts"]
    booted = (state == RobotState.UNCONFIGURED) | (alerts & Alert.REBOOTED != 0)
    faults = {
        Reason.BUS_FAILED: (state == 0) & cut_off,
        Reason.NO_REPLY: state == 0,
        Reason.REBOOTED: booted,
        Reason.STALLED: alerts & Alert.STALLED != 0,
    }
    return np.select(list(faults.values()), [int(reason) for reason in faults], int(Reason.OK))


def resting_cause(robots: Robots, booted: Mask, cut_off: Mask) -> Codes:
    """Return the Reason for which robots rest that no controller watched, OK at their end, (n,).

    Args:
        robots: the robots, as read just now.
        booted: robots that have booted since they were started, shape (n,).
        cut_off: robots on buses that were given up, shape (n,).
    """
    state, cause = robots["state"], own_fault(robots, cut_off)
    causes = {
        Reason.REBOOTED: (cause == Reason.OK) & booted,
        Reason.NO_HEARTBEAT: np.isin(state, (RobotState.FAULT, RobotState.MOVING)),
        Reason.STOPPED: state != RobotState.DONE,
    }
    why = np.select(list(causes.values()), [int(each) for each in causes], int(Reason.OK))
    return np.where(cause == Reason.OK, why, cause)


def countdown_s(verify_s: float, silence_s: float, period_s: float) -> float:
    """Return the time from GO to the motion [s]: long enough to poll all robots once.

    Args:
        verify_s: time to VERIFY all robots once [s].
        silence_s: time without a heartbeat after which robots stop by themselves [s].
        period_s: time between two steps [s].
    """
    return min(1.2 * verify_s + _SLACK_S + silence_s + 2.0 * period_s, LONGEST_COUNTDOWN_S)


def unresponsive(
    robots: Robots, buses: Buses, bus: Ints, rows: Rows, stopped: Mask, responding: Mask,
    period_s: float,
) -> Mask:  # fmt: skip
    """Return the robots because of which a start was cancelled, shape (n,).

    Args:
        robots: the robots.
        buses: the buses.
        bus: place of the bus of each robot, shape (n,).
        rows: robots that were sent the GO, shape (r,).
        stopped: robots that have confirmed that they are stopped, shape (n,).
        responding: robots that had not failed before, shape (n,).
        period_s: time between two steps [s].
    """
    missing = np.zeros(len(robots), dtype=bool)
    missing[rows] = ~stopped[rows] | ~responding[rows]
    # a bus without heartbeats is out, even if its robots have answered before
    last_s = buses["heartbeat_s"]
    missing[rows] |= (last_s < last_s.max() - 2 * period_s)[bus[rows]]
    return missing


def failing(robots: Robots) -> Mask:
    """Return the robots that do not execute their order or miss replies in a row, shape (n,)."""
    return robots["not_executing"] | (robots["missed_replies"] >= LOST_REPLIES)


def silent_stop_s(buses: Buses, bus: Ints, silence_s: float) -> Floats:
    """Return the time at which to stop all for a silent robot of each of some buses [s].

    A robot that lost power stopped after the roll call before, at the earliest. A robot that
    receives nothing stops silence_s after the last heartbeat before this roll call, at the
    latest. The time half way between is least far from both.
    """
    return 0.5 * (buses["called_before_s"][bus] + buses["called_s"][bus] + silence_s)


def able_to_resume(robots: Robots, bus: Ints, moved: Mask, turns: bool = False) -> Mask:
    """Return the robots that have stopped in order, by state and alerts, shape (n,).

    Args:
        robots: the robots, as read after the stop.
        bus: place of the bus of each robot, shape (n,).
        moved: robots that were moving before the stop, shape (n,).
        turns: whether it was a test turn of robots at unknown places, which is ended then.
    """
    # faults may be of frames garbled in the meantime; alerts stay
    state, alerts = robots["state"], robots["alerts"]
    silent = (state == RobotState.FAULT) & (alerts & Alert.SILENT != 0)
    able = (state == RobotState.STOPPED) | silent
    able &= alerts & (Alert.STALLED | Alert.REBOOTED) == 0
    able &= ~robots["lost"] | (turns & robots["unplaced"])
    # a robot without heartbeats on a bus with heartbeats would miss the next ones too
    with_heartbeats = np.unique(bus[moved & (state == RobotState.STOPPED)])
    return able & ~(silent & np.isin(bus, with_heartbeats))


@njit(cache=True)
def record_heartbeats(buses, at, ack, end_s, took_s, silence_s, stretch_s):
    """Record the time of each heartbeat that got through, and count slow ones in a row.

    Args:
        buses: the buses, records of BUS, changed in place.
        at: place of the bus of each heartbeat, shape (f,).
        ack: Ack of each heartbeat, shape (f,).
        end_s: end of each heartbeat [s], shape (f,).
        took_s: duration of each heartbeat [s], shape (f,).
        silence_s: time without a heartbeat after which robots stop by themselves [s].
        stretch_s: how much longer than the shortest a heartbeat may take [s].
    """
    for i in range(len(at)):
        b = buses[at[i]]
        # robots that missed heartbeats for too long have stopped and do not begin again
        if ack[i] != _OK or end_s[i] > b.heartbeat_s + silence_s:
            continue
        b.heartbeat_s = end_s[i]
        b.shortest_s = min(b.shortest_s, took_s[i])
        b.slow = b.slow + 1 if took_s[i] > b.shortest_s + stretch_s else 0

# SPDX-License-Identifier: Apache-2.0
"""The tables of a controller: a row for each robot, and a row for each bus."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fiber_bus_bridge.wire import Alert, RobotState, Statuses
from fiber_core.array_types import Counts, Ints, Mask, Rows
from fiber_core.outcomes import Reason

__all__ = [
    "BUS",
    "ROBOT",
    "Buses",
    "Robots",
    "SEQUENCES",
    "begin_phase",
    "begin_sequences",
    "begin_watch",
    "new_buses",
    "new_robots",
    "observe",
    "running",
]

Robots: TypeAlias = NDArray[np.void]  # records of ROBOT, n rows
Buses: TypeAlias = NDArray[np.void]  # records of BUS, b rows

ROBOT = np.dtype(
    [
        # as the robot was read last
        ("known", "?"),  # found and configured: it can be commanded
        ("boot", "i8"),  # boot counter at configuration, -1 before
        ("config_crc", "i8"),  # of the configuration that it was sent
        ("counts", "i8", (2,)),  # encoders [quanta]
        ("unplaced", "?"),  # its counters tell nothing: its place is unknown until it is told
        ("recalled", "?"),  # unplaced, and its counts are those at which it rested before
        ("seen", "?"),  # unplaced, and a camera has told all but the turn of theta
        ("guessed", "?"),  # unplaced, and its counts are those to which the bridge has set them
        ("turn_limit", "i8", (2,)),  # how far theta may turn down and up while unplaced [quanta]
        ("lost", "?"),  # moved at its last status, was started since, or is unplaced and not seen
        ("placed", "?"),  # its place was read, or is vouched for
        ("state", "i8"),  # RobotState, 0 without a reply
        ("fault", "i8"),
        ("alerts", "i8"),
        ("read_s", "f8"),  # time of the last status [s]
        ("velocity", "f8", (2,)),  # mean joint speeds between the last two statuses [rad/s]
        ("rest_cause", "i8"),  # Reason for which it rested, of a plan of an earlier session, or OK
        # of a plan
        ("cause", "i8"),  # Reason for which it failed although it was started, else OK
        # of a phase
        ("wanted", "?"),  # shall move and can still be started
        ("verified", "?"),  # holds the order that was sent
        ("reason", "i8"),  # Reason for which it is not started, else OK
        ("late", "?"),  # its bus has received a GO too late
        ("able", "?"),  # has stopped in order and may resume
        # since the GO
        ("started", "?"),  # was sent the GO
        ("confirmed", "?"),  # counts down, or has begun
        ("missed_go", "?"),  # still LOADED after the GO: gets a GO of its own
        ("not_executing", "?"),  # answers, and does not carry out its order
        ("missed_replies", "i8"),  # in a row
        ("arrived", "?"),
        ("in_traffic_s", "f8"),  # time of its last poll in the traffic [s]
    ],
    align=True,
)
SEQUENCES = 15  # sequence numbers are 1..15

BUS = np.dtype(
    [
        ("sequence", "i8"),  # of the orders loaded last, 1..15, 0 before
        # of a phase
        ("stale", "?"),  # needs a fresh sequence number
        # since the GO
        ("heartbeat_s", "f8"),  # end of the last heartbeat that got through [s]
        ("shortest_s", "f8"),  # shortest duration of a heartbeat [s]
        ("slow", "i8"),  # slow heartbeats in a row
        ("called_s", "f8"),  # last roll call [s]
        ("called_before_s", "f8"),  # the roll call before that [s]
    ],
    align=True,
)


def new_robots(counts: Counts) -> Robots:
    """Return a table of robots that have never answered; counts are assumed, shape (n, 2)."""
    robots = np.zeros(len(counts), dtype=ROBOT)
    robots["counts"] = counts
    robots["boot"] = -1
    robots["read_s"] = -np.inf
    return robots


def new_buses(number: int) -> Buses:
    """Return a table of buses without traffic."""
    return np.zeros(number, dtype=BUS)


def begin_sequences(buses: Buses, bus: Ints, sequence: Ints) -> None:
    """Let buses without orders of this controller begin after the numbers that their robots hold.

    A robot refuses the sequence number of the order that it executed last.

    Args:
        buses: the buses.
        bus: bus of each robot that was read, shape (r,).
        sequence: sequence number of the order that it accepted last, 0 for none, shape (r,).
    """
    for place in np.flatnonzero(buses["sequence"] == 0):
        held = np.unique(sequence[bus == place])
        after = (held.max(initial=0) + np.arange(SEQUENCES)) % SEQUENCES
        free = ~np.isin(after + 1, held)
        buses["sequence"][place] = after[int(np.argmax(free))]


def begin_phase(robots: Robots, buses: Buses, wanted: Mask, blocked: Mask) -> None:
    """Reset the columns of a phase.

    Args:
        robots: the robots.
        buses: the buses.
        wanted: robots that shall move, shape (n,).
        blocked: those that cannot, because a lost robot is beside them, shape (n,).
    """
    robots["wanted"] = wanted & ~blocked
    robots["reason"] = np.where(blocked, Reason.PLACE_UNKNOWN, Reason.OK)
    robots["verified"] = robots["late"] = robots["started"] = False
    buses["stale"] = True


def begin_watch(robots: Robots, buses: Buses, go_s: float) -> None:
    """Reset the columns of a motion, for the verified robots, at the time of their GO [s]."""
    robots["started"] = robots["verified"]
    for column in ("confirmed", "missed_go", "not_executing", "arrived"):
        robots[column] = False
    robots["missed_replies"] = 0
    robots["in_traffic_s"] = -np.inf
    buses["heartbeat_s"] = buses["called_s"] = buses["called_before_s"] = go_s
    buses["shortest_s"] = np.inf
    buses["slow"] = 0


def running(robots: Robots) -> Mask:
    """Return the robots that were started and have not arrived, shape (n,)."""
    return robots["started"] & ~robots["arrived"]


def observe(
    robots: Robots,
    rows: Rows,
    status: Statuses,
    t: float,
    quantum_rad: float,
    counters_kept: bool = True,
) -> None:
    """Take over valid statuses.

    Args:
        robots: the robots.
        rows: robots that were read, shape (r,).
        status: their statuses, complete, r rows.
        t: time of the statuses [s].
        quantum_rad: one quantum of joint angle [rad].
        counters_kept: as of SessionConfig. Else a robot of another boot keeps the counts that it
            had, and is unplaced.
    """
    fresh, before = np.zeros(len(rows), dtype=bool), robots["unplaced"][rows].copy()
    if not counters_kept:
        fresh = status.boot != robots["boot"][rows]
        robots["unplaced"][rows] |= fresh | (status.alerts & Alert.STALLED != 0)
    distance = (status.position - robots["counts"][rows]) * quantum_rad
    elapsed_s = np.maximum(t - robots["read_s"][rows], 1e-9)[:, None]
    moves = status.state == RobotState.MOVING
    robots["velocity"][rows] = np.where(moves[:, None], distance / elapsed_s, 0.0)
    robots["read_s"][rows] = t
    kept = fresh & robots["placed"][rows]
    # a turn of theta that was guessed for a robot at an unknown place is no memory
    robots["recalled"][rows] |= kept & ~robots["lost"][rows] & ~before
    robots["counts"][rows] = np.where(kept[:, None], robots["counts"][rows], status.position)
    robots["state"][rows] = status.state
    robots["fault"][rows] = status.fault
    robots["alerts"][rows] = status.alerts
    robots["seen"][rows] &= ~fresh
    robots["lost"][rows] = moves | (robots["unplaced"][rows] & ~robots["seen"][rows])
    robots["placed"][rows] = True

# SPDX-License-Identifier: Apache-2.0
"""What a sector tells of its robots and buses, and how the coordinator takes it over."""

import json
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fiber_bus_bridge.protocol import Context
from fiber_bus_bridge.session import Session
from fiber_core.array_types import Ints, Rows
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_sectors.calls import Columns, column, number_of
from fiber_sectors.errors import SectorError

__all__ = [
    "COUNTERS", "Loaded", "loaded_of", "motion_columns", "motion_of", "place_columns",
    "take_places", "take_table", "table_of",
]  # fmt: skip

COUNTERS = (
    "frames", "bytes", "no_address", "refused", "line_errors", "retries", "bad_replies",
    "recoveries", "busy_s",
)  # fmt: skip
_COUNTS = 2**31  # of an encoder, either side of zero
_NUMBER = 2**32
_MOST_S = 1e3
_REASONS = (min(Reason), max(Reason))
# columns of a robot's row that the coordinator takes over: type, shape and range
_ALWAYS = {
    "known": ("?", (), 0, 1),
    "boot": ("i8", (), -1, _NUMBER),
    "counts": ("i8", (2,), -_COUNTS, _COUNTS),
    "lost": ("?", (), 0, 1),
    "placed": ("?", (), 0, 1),
    "state": ("i8", (), 0, 255),
    "fault": ("i8", (), 0, 255),
    "alerts": ("i8", (), 0, 255),
    "velocity": ("f8", (2,), -1e15, 1e15),
    "rest_cause": ("i8", (), *_REASONS),
}
# taken over where the run is at that point
_OF_RUN = {
    "cause": ("i8", (), *_REASONS),
    "verified": ("?", (), 0, 1),
    "reason": ("i8", (), *_REASONS),
    "arrived": ("?", (), 0, 1),
}
_OF_ROBOTS = _ALWAYS | _OF_RUN
_MOTION = {"start": (None, 2), "offsets": (None,), "ticks": (None,), "velocity": (None,)}


def table_of(session: Session) -> Columns:
    """Return the columns that tell how robots and buses are."""
    columns = {f"robot_{name}": session.robots[name] for name in _OF_ROBOTS}
    transactions = session.transactions
    counters = json.dumps(transactions.counters.table()).encode()
    return columns | {
        "ids": session.plane.ids,
        "sequence": session.buses["sequence"],
        "given_up": transactions.given_up,
        "failures": transactions.failures,
        "stopped": np.array(session.state.name == "STOPPED"),
        "counters": np.frombuffer(counters, dtype=np.uint8),
    }


def take_table(
    c: Context, rows: Rows, buses: Ints, columns: Columns, of_run: Sequence[str] = ()
) -> dict[int, dict[str, float]]:
    """Take over the table of a sector; return the counters of its buses.

    Args:
        c: the controller of the plane.
        rows: rows of the robots of the sector, shape (m,).
        buses: places of its buses, shape (b,).
        columns: from table_of.
        of_run: columns of the run that are taken over.

    Raises:
        SectorError: the sector has other robots, or a column is malformed; nothing is taken over.
    """
    if not np.array_equal(column(columns, "ids", "i8", (None,)), c.plane.ids[rows]):
        raise SectorError("a sector has other robots than its share of this plane")
    m, b = len(rows), len(buses)
    robots: dict[str, NDArray] = {}
    for name in (*_ALWAYS, *of_run):
        dtype, shape, low, high = _OF_ROBOTS[name]
        robots[name] = column(columns, f"robot_{name}", dtype, (m, *shape), low, high)
    sequence = column(columns, "sequence", "i8", (b,), 0, 15)
    given_up = column(columns, "given_up", "?", (b,))
    failures = column(columns, "failures", "i8", (m,), 0)
    number_of(columns, "stopped", "?")
    counters = _counters(columns, c.transactions.buses[buses])
    for name, values in robots.items():
        c.robots[name][rows] = values
    c.buses["sequence"][buses] = sequence
    c.transactions.given_up[buses] = given_up
    c.transactions.failures[rows] = failures
    return counters


def _counters(columns: Columns, buses: Ints) -> dict[int, dict[str, float]]:
    text = column(columns, "counters", "u1", (None,)).tobytes()
    try:
        told = json.loads(text)
        found = {bus: {name: told[str(bus)][name] for name in COUNTERS} for bus in buses.tolist()}
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise SectorError(f"counters without those of a bus: {error!r}") from error
    for bus, figures in found.items():
        for name, figure in figures.items():
            if type(figure) not in (int, float) or not math.isfinite(figure):
                raise SectorError(f"counters of bus {bus}: {name} is {figure!r}")
    return found


def place_columns(c: Context, rows: Rows) -> Columns:
    """Return the columns that tell where robots rest, as far as it is known.

    Args:
        c: the controller of the plane.
        rows: rows of the robots of a sector, shape (m,).
    """
    robots = c.robots[rows]
    return {"placed": robots["placed"] & ~robots["lost"], "counts": robots["counts"]}


def take_places(session: Session, columns: Columns, rows: Rows) -> None:
    """Believe the coordinator where robots rest that do not answer.

    Args:
        session: the session of the sector.
        columns: from place_columns.
        rows: rows of the robots about which it is believed.

    Raises:
        SectorError: a column is malformed.
    """
    n, robots = session.plane.n, session.robots
    placed = column(columns, "placed", "?", (n,))
    counts = column(columns, "counts", "i8", (n, 2), -_COUNTS, _COUNTS)
    rows = rows[placed[rows]]
    robots["counts"][rows] = counts[rows]
    robots["placed"][rows], robots["lost"][rows] = True, False


class Loaded(NamedTuple):
    """What a sector tells when it has loaded and verified orders.

    Args:
        crc: checksum of its LOAD frames.
        terms: the terms under which it moves.
        in_real_time: whether its time is that of its host.
        lasts_s: time that its countdown takes [s].
        ahead_s: time before the start after which a STOP may come too late for it [s].
    """

    crc: int
    terms: NDArray
    in_real_time: bool
    lasts_s: float
    ahead_s: float


def loaded_of(columns: Columns) -> Loaded:
    """Return what a sector tells that has loaded orders.

    Raises:
        SectorError: a column is missing or malformed.
    """
    return Loaded(
        number_of(columns, "crc", "i8", 0, _NUMBER),
        column(columns, "terms", "f8", (None,)),
        number_of(columns, "in_real_time", "?"),
        number_of(columns, "lasts_s", "f8", 0.0, _MOST_S),
        number_of(columns, "ahead_s", "f8", 0.0, _MOST_S),
    )


def motion_columns(motion: WireMotion) -> Columns:
    """Return the columns of a motion."""
    return {name: np.asarray(getattr(motion, name)) for name in _MOTION}


def motion_of(units: WireUnits, columns: Columns) -> WireMotion:
    """Return the motion in some columns.

    Raises:
        MotionError: it is malformed.
        SectorError: a column is missing or malformed.
    """
    taken = {
        name: column(columns, name, "i8", shape, -_NUMBER, _NUMBER)
        for name, shape in _MOTION.items()
    }
    return WireMotion(units, **taken)

# SPDX-License-Identifier: Apache-2.0
"""What a sector tells of its robots and buses, and how the coordinator takes it over."""

import json
from collections.abc import Sequence

import numpy as np

from fiber_bus_bridge.protocol import Context
from fiber_bus_bridge.session import Session
from fiber_core.array_types import Ints, Rows
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_sectors.calls import Columns
from fiber_sectors.errors import SectorError

__all__ = ["motion_columns", "motion_of", "take_table", "table_of"]

# columns of a robot's row that the coordinator takes over
_ALWAYS = (
    "known", "boot", "counts", "lost", "placed", "state", "fault", "alerts", "velocity"
)  # fmt: skip
_OF_RUN = ("cause", "verified", "reason", "arrived")  # taken over where the run is at that point
_MOTION = ("start", "offsets", "ticks", "velocity")


def table_of(session: Session) -> Columns:
    """Return the columns that tell how robots and buses are."""
    columns = {f"robot_{name}": session.robots[name] for name in (*_ALWAYS, *_OF_RUN)}
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
) -> dict[int, dict]:
    """Take over the table of a sector; return the counters of its buses.

    Args:
        c: the controller of the plane.
        rows: rows of the robots of the sector, shape (m,).
        buses: places of its buses, shape (b,).
        columns: from table_of.
        of_run: columns of the run that are taken over.

    Raises:
        SectorError: the sector has other robots.
    """
    ids = columns.get("ids")
    if ids is None or not np.array_equal(ids, c.plane.ids[rows]):
        raise SectorError("a sector has other robots than its share of this plane")
    for name in (*_ALWAYS, *of_run):
        c.robots[name][rows] = columns[f"robot_{name}"]
    c.buses["sequence"][buses] = columns["sequence"]
    c.transactions.given_up[buses] = columns["given_up"]
    c.transactions.failures[rows] = columns["failures"]
    counters = json.loads(columns["counters"].tobytes())
    return {int(bus): figures for bus, figures in counters.items()}


def motion_columns(motion: WireMotion) -> Columns:
    """Return the columns of a motion."""
    return {name: np.asarray(getattr(motion, name)) for name in _MOTION}


def motion_of(units: WireUnits, columns: Columns) -> WireMotion:
    """Return the motion in some columns.

    Raises:
        MotionError: it is malformed.
        SectorError: a column is missing.
    """
    if missing := [name for name in _MOTION if name not in columns]:
        raise SectorError(f"a motion without {missing}")
    return WireMotion(units, *(columns[name] for name in _MOTION))

# SPDX-License-Identifier: Apache-2.0
"""Turns: which way phi of each robot shall turn from where it rested, as a code word tells.

A table without rows means a test turn of theta of all robots at unknown places. A table of the ways
TO_UPPER_STOP and TO_LOWER_STOP alone means turns of theta to a stop, of robots that a camera has
seen without their turn. The stamp names the
motion: the bridge answers to it on `progress`, and the outcome has it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Codes, Ids
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["TO_LOWER_STOP", "TO_UPPER_STOP", "Turns", "decode", "encode"]

TO_LOWER_STOP, TO_UPPER_STOP = -2, 2

_NAME = "turns"
_COLUMNS = {"id": "<u4", "way": "<i1"}


class Turns(NamedTuple):
    """Which way robots turn.

    Args:
        ids: robot ids, shape (k,); the other robots rest.
        way: 1 up, -1 down, 0 back to where phi rested before the first turn, or of all robots
            TO_UPPER_STOP or TO_LOWER_STOP, shape (k,).
    """

    ids: Ids
    way: Codes


def encode(
    ids: ArrayLike, way: ArrayLike, stamp: PlanStamp, session: str | None = None
) -> PointCloud2:
    """Return turns as a message.

    Args:
        ids, way: as of Turns.
        stamp: names the message.
        session: id of the session of the layout that the robots are of.

    Raises:
        MessageError: an id is out of range or appears twice, a way is none, robots turn phi and
            others to a stop, or shapes differ.
    """
    ids, way = checked_ids(ids, _NAME), np.asarray(way)
    if way.shape != ids.shape:
        raise MessageError(
            _NAME, f"does not fit {len(ids)} robots", field="shape of way", value=way.shape
        )
    _check(ids, way)
    rows = np.empty(len(ids), dtype=list(_COLUMNS.items()))
    rows["id"], rows["way"] = ids, way
    return encode_table(rows, stamp, session)


def decode(message: PointCloud2) -> Turns:
    """Return turns from a message.

    Raises:
        MessageError: malformed table, an id appears twice, a way is none, or robots turn phi and
            others to a stop.
    """
    rows = decode_table(message, _NAME, _COLUMNS)
    ids = checked_ids(rows["id"], _NAME)
    _check(ids, rows["way"])
    return Turns(ids, rows["way"].astype(np.int64))


def _check(ids: Ids, way: ArrayLike) -> None:
    way, to_stop = np.asarray(way), np.isin(way, (TO_LOWER_STOP, TO_UPPER_STOP))
    of_phi = np.isin(way, (-1, 0, 1))
    refuse(~of_phi & ~to_stop, _NAME, "way", ids, way, "is not -1, 0 or 1, nor -2 or 2")
    why = "is of a turn to a stop, and other robots turn phi"
    refuse(to_stop & of_phi.any(), _NAME, "way", ids, way, why)

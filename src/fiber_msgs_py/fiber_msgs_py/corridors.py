# SPDX-License-Identifier: Apache-2.0
"""Corridors: how far each joint could turn while all others move as ordered.

For viewers; no node acts on them.
"""

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Ids
from fiber_core.corridor import JointCorridors
from fiber_core.errors import MotionError
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import column_names, decode_table, encode_table

__all__ = ["decode", "encode"]

_COLUMNS = {"id": "<u4", "lasts": "<f4"}
_BOUNDS = ("theta_low", "theta_high", "phi_low", "phi_high")


def encode(ids: ArrayLike, corridors: JointCorridors, stamp: PlanStamp) -> PointCloud2:
    """Return corridors as a message: a row for each robot, bounds at equally spaced instants.

    Args:
        ids: robot ids, shape (k,).
        corridors: corridors of these k robots; sent in single precision.
        stamp: names the plan.

    Raises:
        MessageError: an id is out of range or appears twice, or ids and corridors differ in number.
    """
    ids = checked_ids(ids, "corridors")
    if len(corridors) != len(ids):
        raise MessageError("corridors", f"robots, but {len(ids)} ids", value=len(corridors))
    instants = corridors.low.shape[2]
    rows = np.empty(
        len(ids), [*_COLUMNS.items(), *((name, "<f4", (instants,)) for name in _BOUNDS)]
    )
    rows["id"], rows["lasts"] = ids, corridors.lasts_s
    for k, name in enumerate(_BOUNDS):
        rows[name] = (corridors.low, corridors.high)[k % 2][:, k // 2]
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> tuple[Ids, JointCorridors]:
    """Return robot ids, shape (k,), and their corridors.

    Raises:
        MessageError: malformed table, a robot twice, bounds of different lengths, or values that
            are not corridors.
    """
    rows = decode_table(message, "corridors", _COLUMNS, dict.fromkeys(_BOUNDS, "<f4"))
    ids = checked_ids(rows["id"].astype(np.int64), "corridors")
    missing = [name for name in _BOUNDS if name not in column_names(rows)]
    if missing:
        raise MessageError("corridors", "is missing", field="field", value=missing[0])
    lengths = {rows[name].shape[1] for name in _BOUNDS}
    if len(lengths) > 1:
        raise MessageError("corridors", "instants differ", field="bounds of", value=sorted(lengths))
    low, high = (np.stack([rows[_BOUNDS[w]], rows[_BOUNDS[w + 2]]], axis=1) for w in (0, 1))
    try:
        with np.errstate(invalid="ignore"):  # a signalling nan; it is refused
            return ids, JointCorridors(rows["lasts"], low, high)
    except MotionError as error:
        raise MessageError("corridors", f"values are not corridors: {error}") from None

"""Margins: how far each joint may turn either way beside all that is sent; for looking at."""

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_core.corridor import JointCorridors
from fiber_core.errors import MotionError
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["decode", "encode"]

_COLUMNS = {"id": "<u4", "lasts": "<f4"}
_WALLS = ("theta_low", "theta_high", "phi_low", "phi_high")


def encode(ids, corridors: JointCorridors, stamp: PlanStamp) -> PointCloud2:
    """Return corridors as one row a robot, walls as lists of equally spaced instants.

    Args:
        ids: robot ids, shape (k,).
        corridors: theirs, k robots; single precision travels.
        stamp: plan it belongs to.

    Raises:
        MessageError: an id is out of range or there twice, or ids and corridors differ in number.
    """
    ids = checked_ids(ids, "corridors")
    if len(corridors) != len(ids):
        raise MessageError("corridors", f"robots, {len(ids)} have ids", value=len(corridors))
    instants = corridors.low.shape[2]
    rows = np.empty(len(ids), [*_COLUMNS.items(), *((name, "<f4", (instants,)) for name in _WALLS)])
    rows["id"], rows["lasts"] = ids, corridors.lasts_s
    for at, name in enumerate(_WALLS):
        rows[name] = (corridors.low, corridors.high)[at % 2][:, at // 2]
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> tuple[np.ndarray, JointCorridors]:
    """Return robot ids, shape (k,), and their corridors.

    Raises:
        MessageError: malformed table, an id twice, walls of different lengths, or values that
            are no corridors.
    """
    rows = decode_table(message, "corridors", _COLUMNS, dict.fromkeys(_WALLS, "<f4"))
    ids = checked_ids(rows["id"].astype(np.int64), "corridors")
    missing = [name for name in _WALLS if name not in rows.dtype.names]
    if missing:
        raise MessageError("corridors", "is missing", field="field", value=missing[0])
    lengths = {rows[name].shape[1] for name in _WALLS}
    if len(lengths) > 1:
        raise MessageError("corridors", "instants differ", field="walls of", value=sorted(lengths))
    low, high = (np.stack([rows[_WALLS[w]], rows[_WALLS[w + 2]]], axis=1) for w in (0, 1))
    try:
        return ids, JointCorridors(rows["lasts"], low, high)
    except MotionError as reason:
        raise MessageError("corridors", f"are none: {reason}") from None

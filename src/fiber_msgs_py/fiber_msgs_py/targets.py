"""Targets: where the fibre of each robot asked should go.

When a plan is tried again, what the nodes last heard of the plane may be older than what made
it necessary. Its targets say in every row since when layout and joint states must be.
"""

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["decode", "encode", "since"]

_COLUMNS = {"id": "<u4", "x": "<f8", "y": "<f8"}
_SINCE = {"since_s": "<u4", "since_ns": "<u4"}
_SECOND = 1_000_000_000


def encode(ids, xy_mm, stamp: PlanStamp, since_ns: int | None = None) -> PointCloud2:
    """Ask robots to bring their fibres somewhere.

    Args:
        ids: robot ids, shape (n,).
        xy_mm: targets in the focal plane [mm], shape (n, 2).
        stamp: name of the plan this asks for.
        since_ns: time of the oldest layout and joint states to plan with [ns]; None for any.

    Raises:
        MessageError: an id is out of range or there twice, a target is not finite, or
            shapes differ.
    """
    ids = checked_ids(ids, "targets")
    xy_mm = np.asarray(xy_mm, dtype=float)
    if xy_mm.shape != (len(ids), 2):
        raise MessageError(
            "targets", f"does not fit {len(ids)} ids", field="shape of xy_mm", value=xy_mm.shape
        )
    refuse(~np.isfinite(xy_mm), "targets", "x, y [mm]", ids, xy_mm, "is not finite")
    columns = _COLUMNS | (_SINCE if since_ns is not None else {})
    rows = np.empty(len(ids), dtype=list(columns.items()))
    rows["id"] = ids
    rows["x"], rows["y"] = xy_mm.T / 1e3
    if since_ns is not None:
        rows["since_s"], rows["since_ns"] = divmod(since_ns, _SECOND)
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> tuple[np.ndarray, np.ndarray]:
    """Return robot ids, shape (n,), and targets [mm], shape (n, 2), in the order sent.

    Raises:
        MessageError: malformed table, a robot twice, or a target that is not finite.
    """
    rows = decode_table(message, "targets", _COLUMNS)
    ids = checked_ids(rows["id"], "targets")
    for axis in ("x", "y"):
        refuse(~np.isfinite(rows[axis]), "targets", axis, ids, rows[axis], "is not finite")
    return ids, np.stack([rows["x"], rows["y"]], axis=1) * 1e3


def since(message: PointCloud2) -> int | None:
    """Return since when layout and joint states must be [ns], None where it does not matter.

    Raises:
        MessageError: malformed table.
    """
    if not any(field.name in _SINCE for field in message.fields) or not message.width:
        return None
    row = decode_table(message, "targets", _SINCE)[0]
    return int(row["since_s"]) * _SECOND + int(row["since_ns"])

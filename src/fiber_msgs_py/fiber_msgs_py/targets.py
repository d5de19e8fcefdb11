# SPDX-License-Identifier: Apache-2.0
"""Targets: where the fibre of each robot should go.

A plan that is tried again, around robots that could not be commanded, gets targets with a stamp of
their own. Each of their rows names the plan, the number of the attempt, and the time of the oldest
layout and joint states to plan with: what a node received before may be older than the failure that
made the attempt necessary.
"""

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Ids, Points
from fiber_msgs_py.attempts import Attempt
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["decode", "decode_attempt", "encode", "encode_attempt"]

_COLUMNS = {"id": "<u4", "x": "<f8", "y": "<f8"}
_ATTEMPT = {"attempt": "<u4", "plan_sec": "<u4", "plan_nanosec": "<u4"}
_SINCE = {"since_sec": "<u4", "since_nanosec": "<u4"}
_SECOND = 1_000_000_000


def encode(
    ids: ArrayLike, xy_mm: ArrayLike, stamp: PlanStamp, session: str | None = None
) -> PointCloud2:
    """Return the targets of a new plan as a message.

    Args:
        ids: robot ids, shape (n,).
        xy_mm: targets in the focal plane [mm], shape (n, 2).
        stamp: names the plan.
        session: id of the session of the layout that the targets are for.

    Raises:
        MessageError: an id is out of range or appears twice, a target is not finite, or
            shapes differ.
    """
    return encode_table(_rows(ids, xy_mm, _COLUMNS), stamp, session)


def encode_attempt(
    ids: ArrayLike, xy_mm: ArrayLike, attempt: Attempt, session: str | None = None
) -> PointCloud2:
    """Return the targets of a later attempt of a plan as a message.

    Args:
        ids: robot ids, shape (n,), at least one: the rows tell which attempt it is.
        xy_mm: targets in the focal plane [mm], shape (n, 2).
        attempt: the attempt, with the time of the oldest layout and joint states to plan with.
        session: id of the session.

    Raises:
        MessageError: as for encode, or there is no robot.
    """
    since = {} if attempt.since_ns is None else _SINCE
    rows = _rows(ids, xy_mm, _COLUMNS | _ATTEMPT | since)
    if not len(rows):
        raise MessageError("targets", f"for attempt {attempt.number}", field="has", value="no rows")
    rows["attempt"] = attempt.number
    rows["plan_sec"], rows["plan_nanosec"] = divmod(attempt.plan.ns, _SECOND)
    if attempt.since_ns is not None:
        rows["since_sec"], rows["since_nanosec"] = divmod(attempt.since_ns, _SECOND)
    return encode_table(rows, attempt.stamp, session)


def _rows(ids: ArrayLike, xy_mm: ArrayLike, columns: dict[str, str]) -> np.ndarray:
    ids = checked_ids(ids, "targets")
    xy_mm = np.asarray(xy_mm, dtype=float)
    if xy_mm.shape != (len(ids), 2):
        raise MessageError(
            "targets", f"does not fit {len(ids)} ids", field="shape of xy_mm", value=xy_mm.shape
        )
    refuse(~np.isfinite(xy_mm), "targets", "x, y [mm]", ids, xy_mm, "is not finite")
    rows = np.empty(len(ids), dtype=list(columns.items()))
    rows["id"] = ids
    rows["x"], rows["y"] = xy_mm.T / 1e3
    return rows


def decode(message: PointCloud2) -> tuple[Ids, Points]:
    """Return robot ids, shape (n,), and targets [mm], shape (n, 2), in the order of the rows.

    Raises:
        MessageError: malformed table, a robot twice, or a target that is not finite.
    """
    rows = decode_table(message, "targets", _COLUMNS)
    ids = checked_ids(rows["id"], "targets")
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite in mm is refused
        xy_mm = np.stack([rows["x"], rows["y"]], axis=1) * 1e3
    for axis, values in zip(("x", "y"), xy_mm.T):
        refuse(~np.isfinite(values), "targets", axis, ids, rows[axis], "is not finite")
    return ids, xy_mm


def decode_attempt(message: PointCloud2) -> Attempt:
    """Return which attempt of which plan a table of targets asks for.

    Raises:
        MessageError: malformed table, or its stamps do not fit an attempt of a plan.
    """
    stamp = PlanStamp.of(message)
    names = {field.name for field in message.fields}
    if names.isdisjoint(_ATTEMPT) or not message.width:
        return Attempt.first(stamp)
    has_since = not names.isdisjoint(_SINCE)
    row = decode_table(message, "targets", _ATTEMPT | (_SINCE if has_since else {}))[0]
    plan = PlanStamp(_nanoseconds(row, "plan"))
    since_ns = _nanoseconds(row, "since") if has_since else None
    return Attempt(stamp, plan, int(row["attempt"]), since_ns)


def _nanoseconds(row: np.void, name: str) -> int:
    return int(row[f"{name}_sec"]) * _SECOND + int(row[f"{name}_nanosec"])

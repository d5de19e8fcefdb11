# SPDX-License-Identifier: Apache-2.0
"""Targets: where the fibre of each robot should go.

A plan that is tried again, around robots that could not be commanded, gets targets with a stamp of
their own. Each of their rows names the plan, the number of the attempt, and the time of the oldest
layout and joint states to plan with: what a node received before may be older than the failure that
made the attempt necessary.

A plane can have several fibres a robot. A table whose targets name theirs has a column `fibre` with
its number, -1 where any of the robot may be on the target; without the column any may.

Targets of a correction have a column `straight` that is not 0: every robot goes straight to the
elbow and turn next to it, or is held.
"""

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Ids, Ints, Points
from fiber_core.fibres import ANY_FIBRE, MOST_FIBRES
from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py.attempts import Attempt
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = [
    "decode",
    "decode_attempt",
    "decode_fibre",
    "decode_straight",
    "encode",
    "encode_attempt",
    "plane_for",
]

_COLUMNS = {"id": "<u4", "x": "<f8", "y": "<f8"}
_ATTEMPT = {"attempt": "<u4", "plan_sec": "<u4", "plan_nanosec": "<u4"}
_SINCE = {"since_sec": "<u4", "since_nanosec": "<u4"}
_FIBRE = {"fibre": "<i1"}
_STRAIGHT = {"straight": "<u1"}
_SECOND = 1_000_000_000


def encode(
    ids: ArrayLike,
    xy_mm: ArrayLike,
    stamp: PlanStamp,
    session: str | None = None,
    fibre: ArrayLike | None = None,
    straight: bool = False,
) -> PointCloud2:
    """Return the targets of a new plan as a message.

    Args:
        ids: robot ids, shape (n,).
        xy_mm: targets in the focal plane [mm], shape (n, 2).
        stamp: names the plan.
        session: id of the session of the layout that the targets are for.
        fibre: number of the fibre that each target is for, -1 for any, shape (n,); by default any.
        straight: whether this is a correction, on which no robot gives way.

    Raises:
        MessageError: an id is out of range or appears twice, a target is not finite, or
            shapes differ.
    """
    columns = _COLUMNS | (_STRAIGHT if straight else {})
    return encode_table(_rows(ids, xy_mm, columns, fibre), stamp, session)


def encode_attempt(
    ids: ArrayLike,
    xy_mm: ArrayLike,
    attempt: Attempt,
    session: str | None = None,
    fibre: ArrayLike | None = None,
    straight: bool = False,
) -> PointCloud2:
    """Return the targets of a later attempt of a plan as a message.

    Args:
        ids: robot ids, shape (n,), at least one: the rows tell which attempt it is.
        xy_mm: targets in the focal plane [mm], shape (n, 2).
        attempt: the attempt, with the time of the oldest layout and joint states to plan with.
        session: id of the session.
        fibre, straight: as for encode.

    Raises:
        MessageError: as for encode, or there is no robot.
    """
    since = {} if attempt.since_ns is None else _SINCE
    columns = _COLUMNS | _ATTEMPT | since | (_STRAIGHT if straight else {})
    rows = _rows(ids, xy_mm, columns, fibre)
    if not len(rows):
        raise MessageError("targets", f"for attempt {attempt.number}", field="has", value="no rows")
    rows["attempt"] = attempt.number
    rows["plan_sec"], rows["plan_nanosec"] = divmod(attempt.plan.ns, _SECOND)
    if attempt.since_ns is not None:
        rows["since_sec"], rows["since_nanosec"] = divmod(attempt.since_ns, _SECOND)
    return encode_table(rows, attempt.stamp, session)


def _rows(
    ids: ArrayLike, xy_mm: ArrayLike, columns: dict[str, str], fibre: ArrayLike | None
) -> np.ndarray:
    ids = checked_ids(ids, "targets")
    xy_mm = np.asarray(xy_mm, dtype=float)
    if xy_mm.shape != (len(ids), 2):
        raise MessageError(
            "targets", f"does not fit {len(ids)} ids", field="shape of xy_mm", value=xy_mm.shape
        )
    refuse(~np.isfinite(xy_mm), "targets", "x, y [mm]", ids, xy_mm, "is not finite")
    chosen = np.broadcast_to(ANY_FIBRE if fibre is None else np.asarray(fibre), len(ids))
    named = _FIBRE if (chosen != ANY_FIBRE).any() else {}
    rows = np.empty(len(ids), dtype=list((columns | named).items()))
    if named:
        bad = (chosen < ANY_FIBRE) | (chosen >= MOST_FIBRES)
        refuse(bad, "targets", "fibre", ids, chosen, f"is not -1 to {MOST_FIBRES - 1}")
        rows["fibre"] = chosen
    if "straight" in columns:
        rows["straight"] = 1
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


def decode_fibre(message: PointCloud2) -> Ints:
    """Return the number of the fibre that each target is for, -1 for any, shape (n,).

    Raises:
        MessageError: malformed table, or no fibre can have such a number.
    """
    if all(field.name != "fibre" for field in message.fields):
        return np.full(message.width * message.height, ANY_FIBRE, dtype=np.int64)
    rows = decode_table(message, "targets", _COLUMNS | _FIBRE)
    bad = (rows["fibre"] < ANY_FIBRE) | (rows["fibre"] >= MOST_FIBRES)
    refuse(bad, "targets", "fibre", rows["id"], rows["fibre"], f"is not -1 to {MOST_FIBRES - 1}")
    return rows["fibre"].astype(np.int64)


def decode_straight(message: PointCloud2) -> bool:
    """Return whether a table of targets is that of a correction, on which no robot gives way.

    Raises:
        MessageError: malformed table.
    """
    if all(field.name != "straight" for field in message.fields):
        return False
    return bool(decode_table(message, "targets", _COLUMNS | _STRAIGHT)["straight"].any())


def plane_for(plane: FocalPlane, message: PointCloud2) -> FocalPlane:
    """Return a plane with the fibre that each target of a message is for, in place of its own.

    Rows of robots that the plane lacks are left out.

    Raises:
        MessageError: malformed table.
        LayoutError: a robot has no such fibre; names it.
    """
    rows, fibre = plane.index_of(decode(message)[0]), np.full(plane.n, ANY_FIBRE)
    fibre[rows[rows >= 0]] = decode_fibre(message)[rows >= 0]
    return plane.with_fibre(fibre)


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

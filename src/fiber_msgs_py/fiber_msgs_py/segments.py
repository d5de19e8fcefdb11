# SPDX-License-Identifier: Apache-2.0
"""Segments: the orders of a plan in whole wire units, as the bus bridge loads them.

Each row says where its segment begins, so orders that were made for other positions of the joints
are found, and a row that is lost or changed is, too.
"""

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Ids, Ints
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["decode", "encode"]

_COLUMNS = {"id": "<u4", "joint": "<u1", "duration": "<u4", "velocity": "<i4", "start": "<i4"}


def encode(
    ids: ArrayLike, motion: WireMotion, stamp: PlanStamp, session: str | None = None
) -> PointCloud2:
    """Return a motion as a message: rows by robot, theta before phi, in the order of time.

    A joint that rests is one row of duration 0, so that every robot of the plan has rows
    for both joints, and a lost row cannot be mistaken for a rest.

    Args:
        ids: robot ids, increasing, shape (n,).
        motion: their motion, n robots.
        stamp: names the plan.
        session: id of the session.

    Raises:
        MessageError: ids do not increase, are out of range, or differ in number from the
            robots that move, or a position does not fit its column.
    """
    ids = checked_ids(ids, "segments")
    if len(ids) != len(motion.start):
        raise MessageError("segments", f"robots, but {len(ids)} ids", value=len(motion.start))
    back = np.concatenate([[False], np.diff(ids) <= 0])
    refuse(back, "segments", "id", ids, ids, "does not increase")
    counts = motion.parts.counts
    table = Parts.from_counts(np.maximum(counts, 1))
    _, place = Parts.gather(table.first, counts)
    profile = table.owner
    rows = np.zeros(table.total, dtype=list(_COLUMNS.items()))
    rows["id"] = ids[profile // 2]
    rows["joint"] = profile % 2
    rows["duration"][place] = motion.ticks
    rows["velocity"][place] = motion.velocity
    moved = np.zeros(table.total, dtype=np.int64)
    moved[place] = motion.ticks * motion.velocity
    start = _starts(table, motion.start.ravel(), moved)
    rows["start"] = start
    refuse(rows["start"] != start, "segments", "start", rows["id"], start, "does not fit")
    return encode_table(rows, stamp, session)


def decode(message: PointCloud2, units: WireUnits) -> tuple[Ids, WireMotion]:
    """Return the segments of a plan.

    Args:
        message: the segments.
        units: size of tick and quantum, widths of the fields.

    Returns:
        Robots of the plan, increasing, shape (n,), and their motion.

    Raises:
        MessageError: malformed table, rows out of order, a robot with one joint only, a rest
            that is not the only row of its joint, a segment that begins elsewhere than the one
            before it ends, or a number that does not fit its field in these units; names the
            robot and the value.
    """
    rows = decode_table(message, "segments", _COLUMNS)
    ids = rows["id"].astype(np.int64)
    joint, duration, velocity = rows["joint"], rows["duration"], rows["velocity"]
    refuse(joint > 1, "segments", "joint", ids, joint, "is neither 0 (theta) nor 1 (phi)")
    keys = 2 * ids + joint
    back = np.concatenate([[False], np.diff(keys) < 0])[: len(keys)]
    refuse(back, "segments", "joint", ids, joint, "is out of order")
    profiles, profile, lengths = np.unique(keys, return_inverse=True, return_counts=True)
    robots, joints = np.unique(profiles // 2, return_counts=True)
    refuse(joints < 2, "segments", "joints", robots, joints, "of 2 are present")
    rest = duration == 0
    refuse(rest & (velocity != 0), "segments", "velocity", ids, velocity, "has the duration 0")
    mixed = rest & (lengths[profile] > 1)
    refuse(mixed, "segments", "duration", ids, duration, "is not the only row of its joint")
    ticks, speed = duration.astype(np.int64), velocity.astype(np.int64)
    long, fast = ticks > units.max_ticks, np.abs(speed) > units.max_velocity
    refuse(long, "segments", "duration", ids, ticks, f"is more than {units.max_ticks} ticks")
    refuse(fast, "segments", "velocity", ids, speed, f"is beyond {units.max_velocity} either way")
    table, begins = Parts.from_counts(lengths), rows["start"].astype(np.int64)
    start = begins[table.first]
    apart = begins != _starts(table, start, ticks * speed)
    refuse(apart, "segments", "start", ids, begins, "is not the end of the segment before")
    counts = np.bincount(profile[~rest], minlength=len(profiles))
    offsets = Parts.from_counts(counts).offsets
    start = start.reshape(-1, 2)
    return robots, WireMotion(units, start, offsets, ticks[~rest], speed[~rest])


def _starts(table: Parts, start: Ints, moved: Ints) -> Ints:
    # where each row begins [quanta], from the starts of the profiles and the turn in each row
    return start[table.owner] + table.before(moved)

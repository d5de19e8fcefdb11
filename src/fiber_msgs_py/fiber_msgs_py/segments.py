"""Segments: the orders of a plan in whole wire units, as the bus bridge loads them.

Each row says where its segment begins, so orders that were made for other positions of the joints
are found, and a row that is lost or changed is, too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Counts, Ids, Ints, Offsets
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["SegmentTable", "decode", "encode"]

_COLUMNS = {"id": "<u4", "joint": "<u1", "duration": "<u4", "velocity": "<i4", "start": "<i4"}


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """The segments of a message.

    Args:
        ids: robots of the plan, increasing, shape (n,).
        offsets: first segment of each profile, shape (2 n + 1,), as in WireMotion.
        ticks: duration of each segment [ticks], shape (m,).
        velocity: joint speed in each segment [velocity units], shape (m,).
        start: where each profile begins [quanta], shape (n, 2).
    """

    ids: Ids
    offsets: Offsets
    ticks: Ints
    velocity: Ints
    start: Counts

    @property
    def counts(self) -> Ints:
        """Number of segments of each profile, shape (n, 2)."""
        return Parts(self.offsets).counts.reshape(-1, 2)

    def motion(self, units: WireUnits) -> WireMotion:
        """Return the motion of these segments.

        Args:
            units: size of tick and quantum, widths of the fields.

        Raises:
            MotionError: a number does not fit its field in these units.
        """
        return WireMotion(units, self.start, self.offsets, self.ticks, self.velocity)


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


def decode(message: PointCloud2) -> SegmentTable:
    """Return the segments of a plan.

    Raises:
        MessageError: malformed table, rows out of order, a robot with one joint only, or a
            rest that is not the only row of its joint, or a segment that begins elsewhere than
            the one before it ends; names the robot and the value.
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
    table, begins = Parts.from_counts(lengths), rows["start"].astype(np.int64)
    start = begins[table.first]
    apart = begins != _starts(table, start, ticks * speed)
    refuse(apart, "segments", "start", ids, begins, "is not the end of the segment before")
    counts = np.bincount(profile[~rest], minlength=len(profiles))
    offsets = Parts.from_counts(counts).offsets
    return SegmentTable(robots, offsets, ticks[~rest], speed[~rest], start.reshape(-1, 2))


def _starts(table: Parts, start: Ints, moved: Ints) -> Ints:
    # where each row begins [quanta], from the starts of the profiles and the turn in each row
    before = np.cumsum(moved) - moved
    return start[table.owner] + before - before[table.first][table.owner]

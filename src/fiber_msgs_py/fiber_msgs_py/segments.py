"""Segments: the orders of a plan in whole wire units, as the bus bridge loads them."""

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

_COLUMNS = {"id": "<u4", "joint": "<u1", "duration": "<u4", "velocity": "<i4"}


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """The segments of a message; the start angles are those of the encoders.

    Args:
        ids: robots of the plan, increasing, shape (n,).
        offsets: first segment of each profile, shape (2 n + 1,), as in WireMotion.
        ticks: duration of each segment [ticks], shape (m,).
        velocity: joint speed in each segment [velocity units], shape (m,).
    """

    ids: Ids
    offsets: Offsets
    ticks: Ints
    velocity: Ints

    @property
    def counts(self) -> Ints:
        """Number of segments of each profile, shape (n, 2)."""
        return Parts(self.offsets).counts.reshape(-1, 2)

    def motion(self, units: WireUnits, start: Counts) -> WireMotion:
        """Return the motion of these segments.

        Args:
            units: size of tick and quantum, widths of the fields.
            start: encoder counts at the start [quanta], shape (n, 2).

        Raises:
            MotionError: a number does not fit its field in these units.
        """
        return WireMotion(units, start, self.offsets, self.ticks, self.velocity)


def encode(ids: ArrayLike, motion: WireMotion, stamp: PlanStamp) -> PointCloud2:
    """Return a motion as a message: rows by robot, theta before phi, in the order of time.

    A joint that rests is one row of duration 0, so that every robot of the plan has rows
    for both joints, and a lost row cannot be mistaken for a rest.

    Args:
        ids: robot ids, increasing, shape (n,).
        motion: their motion, n robots.
        stamp: names the plan.

    Raises:
        MessageError: ids do not increase, are out of range, or differ in number from the
            robots that move.
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
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> SegmentTable:
    """Return the segments of a plan.

    Raises:
        MessageError: malformed table, rows out of order, a robot with one joint only, or a
            rest that is not the only row of its joint; names the robot and the value.
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
    counts = np.bincount(profile[~rest], minlength=len(profiles))
    offsets = Parts.from_counts(counts).offsets
    return SegmentTable(
        robots, offsets, duration[~rest].astype(np.int64), velocity[~rest].astype(np.int64)
    )

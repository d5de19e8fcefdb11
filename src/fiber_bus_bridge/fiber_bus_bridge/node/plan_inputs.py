"""Messages of other stages about a plan: its targets, and the robots that the stages hold."""

from typing import Any

import numpy as np

from fiber_core.array_types import Codes, Counts, Ids, Points, Rows
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason, first_reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import MessageError, PlanStamp, held, segments, targets

__all__ = ["PlanInputs"]

_PLANS_KEPT = 8


class PlanInputs:
    """Decodes messages about plans and keeps the content of the last few plans by stamp.

    Args:
        plane: the focal plane, in the order of whose rows the content is kept.
    """

    def __init__(self, plane: FocalPlane):
        self._plane = plane
        self._targets: dict[PlanStamp, Points] = {}
        self._reasons: dict[PlanStamp, Codes] = {}

    def targets(self, stamp: PlanStamp) -> Points | None:
        """Return the targets of a plan [mm], shape (n, 2), nan = no target; None if unknown."""
        return self._targets.get(stamp)

    @property
    def newest(self) -> PlanStamp | None:
        """The newest stamp of targets that were received."""
        return max(list(self._targets), default=None)  # callbacks add to it meanwhile

    def free_stamp_after(self, stamp: PlanStamp) -> PlanStamp | None:
        """Return the earliest stamp after another that no received targets have, None at the end.

        An attempt with this stamp sorts before every plan that is newer than its own plan.
        """
        ns = stamp.ns + 1
        while PlanStamp.fits(ns) and PlanStamp(ns) in self._targets:
            ns += 1
        return PlanStamp(ns) if PlanStamp.fits(ns) else None

    def reasons(self, stamp: PlanStamp) -> Codes:
        """Return the first reason to hold each robot of a plan, OK without a reason, shape (n,)."""
        return self._reasons.get(stamp, np.full(self._plane.n, Reason.OK, dtype=np.int64))

    def add_targets(self, message: Any) -> None:
        """Add the targets of a plan; the planner refuses robots that do not exist.

        Raises:
            MessageError: the table is malformed.
        """
        ids, xy_mm = targets.decode(message)
        rows = self._plane.index_of(ids)
        xy = np.full((self._plane.n, 2), np.nan)
        xy[rows[rows >= 0]] = xy_mm[rows >= 0]
        _keep(self._targets, PlanStamp.of(message), xy)

    def add_held(self, message: Any) -> None:
        """Add the robots that a stage holds; the first reason received for a robot is kept.

        Raises:
            MessageError: the table is malformed, or names a robot that does not exist.
        """
        ids, reason, _ = held.decode(message)
        stamp, rows = PlanStamp.of(message), self._rows(ids, "held")
        new = np.full(self._plane.n, Reason.OK, dtype=np.int64)
        new[rows] = reason
        _keep(self._reasons, stamp, first_reason(self.reasons(stamp), new))

    def motion(self, message: Any, units: WireUnits, counts: Counts) -> WireMotion:
        """Return the orders in a segments message; robots without segments rest.

        Args:
            message: the segments.
            units: tick, quantum and widths.
            counts: encoders now [quanta], shape (n, 2).

        Raises:
            MessageError: the table is malformed, or names a robot that does not exist.
            MotionError: a number does not fit its field.
        """
        table = segments.decode(message)
        rows = self._rows(table.ids, "segments")
        return WireMotion.moving(units, counts, rows, table.offsets, table.ticks, table.velocity)

    def _rows(self, ids: Ids, name: str) -> Rows:
        rows = self._plane.index_of(ids)
        if (rows < 0).any():
            raise MessageError(name, "is not of this plane", robot=int(ids[rows < 0][0]))
        return rows


def _keep(table: dict[PlanStamp, Any], stamp: PlanStamp, value: Any) -> None:
    table[stamp] = value
    for old in sorted(table)[:-_PLANS_KEPT]:
        del table[old]

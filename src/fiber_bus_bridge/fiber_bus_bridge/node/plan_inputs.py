"""What the other stages said of a plan: what was asked, whom they hold and why."""

import numpy as np

from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import MessageError, PlanStamp, SegmentTable, held, segments, targets

__all__ = ["PlanInputs"]

_PLANS_KEPT = 8


class PlanInputs:
    """Reads what is said of plans, each by its stamp, and keeps the last few.

    Args:
        plane: the focal plane, whose rows everything is put in.
    """

    def __init__(self, plane: FocalPlane):
        self._plane = plane
        self._asked: dict[PlanStamp, np.ndarray] = {}
        self._reasons: dict[PlanStamp, np.ndarray] = {}

    def asked(self, stamp: PlanStamp) -> np.ndarray | None:
        """Return the targets of a plan [mm], shape (n, 2), nan = nothing asked; None if unheard."""
        return self._asked.get(stamp)

    def free_stamp_after(self, stamp: PlanStamp) -> PlanStamp | None:
        """Return the earliest stamp after another that no targets received have, None at the end.

        An attempt with this stamp sorts before every plan that is newer than its own plan.
        """
        ns = stamp.ns + 1
        while PlanStamp.fits(ns) and PlanStamp(ns) in self._asked:
            ns += 1
        return PlanStamp(ns) if PlanStamp.fits(ns) else None

    def reasons(self, stamp: PlanStamp) -> np.ndarray:
        """Return the first reason given to hold each robot of a plan, else OK, shape (n,)."""
        return self._reasons.get(stamp, np.full(self._plane.n, Reason.OK, dtype=np.int64))

    def hear_targets(self, message) -> None:
        """Note what is asked; robots that do not exist are the planner's to refuse.

        Raises:
            MessageError: the table is malformed.
        """
        ids, xy_mm = targets.decode(message)
        rows = self._plane.index_of(ids)
        asked = np.full((self._plane.n, 2), np.nan)
        asked[rows[rows >= 0]] = xy_mm[rows >= 0]
        _keep(self._asked, PlanStamp.of(message), asked)

    def hear_held(self, message) -> None:
        """Note whom a stage holds; whoever spoke first is believed.

        Raises:
            MessageError: the table is malformed, or names a robot that does not exist.
        """
        ids, reason, _ = held.decode(message)
        stamp, rows = PlanStamp.of(message), self._rows(ids, "held")
        known = self.reasons(stamp)
        known[rows] = np.where(known[rows] == Reason.OK, reason, known[rows])
        _keep(self._reasons, stamp, known)

    def motion(self, message, units: WireUnits, counts) -> WireMotion:
        """Return the orders in a segments message; robots it does not mention rest.

        Args:
            message: the segments.
            units: tick, quantum and widths.
            counts: where the encoders are [quanta], shape (n, 2).

        Raises:
            MessageError: the table is malformed, or names a robot that does not exist.
            MotionError: a number does not fit its field.
        """
        table = segments.decode(message)
        lengths = np.zeros((self._plane.n, 2), dtype=np.int64)
        lengths[self._rows(table.ids, "segments")] = np.diff(table.offsets).reshape(-1, 2)
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        whole = SegmentTable(self._plane.ids, offsets, table.ticks, table.velocity)
        return whole.motion(units, counts)

    def _rows(self, ids, name):
        rows = self._plane.index_of(ids)
        if (rows < 0).any():
            raise MessageError(name, "is not of this plane", robot=int(ids[rows < 0][0]))
        return rows


def _keep(table, stamp, value):
    table[stamp] = value
    for old in sorted(table)[:-_PLANS_KEPT]:
        del table[old]

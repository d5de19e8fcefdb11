# SPDX-License-Identifier: Apache-2.0
"""The plans that the bridge has accepted: their targets, and the robots that the stages hold."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fiber_bus_bridge.errors import BridgeError
from fiber_core.array_types import Codes, Counts, Ids, Ints, Points, Rows
from fiber_core.errors import TargetsError
from fiber_core.fibres import ANY_FIBRE
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason, first_reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import MessageError, PlanStamp, held, segments, session_of, targets

__all__ = ["PlanInputs"]

_KEPT = 64
_AHEAD_S = 60.0  # clocks of two machines may differ by less


@dataclass
class _Inputs:
    goals: Points
    fibre: Ints
    straight: bool
    reasons: Codes = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


class PlanInputs:
    """Decides whether a plan is accepted, and keeps what the other stages say about it.

    The last 64 plans and attempts are kept, in the order in which they came. Stamps order plans
    of one clock; a clock that was wrong is left behind with `forget`.

    Args:
        plane: the focal plane, in the order of whose rows the content is kept.
        session: id of the session of this bridge.
    """

    def __init__(self, plane: FocalPlane, session: str):
        self._plane, self._session = plane, session
        self._kept: dict[PlanStamp, _Inputs] = {}
        self.newest: PlanStamp | None = None  # the newest stamp of accepted plans

    def knows(self, stamp: PlanStamp) -> bool:
        """Return whether a stamp is that of a kept plan or attempt."""
        return stamp in self._kept

    def check_session(self, message: Any, name: str) -> None:
        """Refuse a message that is not of the session of this bridge.

        Raises:
            BridgeError: the message is of another session or of none; names both.
        """
        session = session_of(message)
        if session != self._session:
            of = "no session" if session is None else session
            raise BridgeError(f"{name}: of {of}, the bridge has opened {self._session}")

    def check_stamp(self, stamp: PlanStamp, now_ns: int) -> None:
        """Refuse a plan that is not newer than the last one, or from the future.

        Args:
            stamp: names the plan.
            now_ns: present time [ns].

        Raises:
            BridgeError: names the difference, or the newer plan.
        """
        ahead_s = (stamp.ns - now_ns) * 1e-9
        if ahead_s > _AHEAD_S:
            raise BridgeError(
                f"its stamp is {ahead_s:.0f} s ahead of the bridge's clock, at most {_AHEAD_S:.0f}"
            )
        if self.newest is not None and stamp <= self.newest:
            raise BridgeError(
                f"plan {self.newest} is not older; after a change of the clock call clear"
            )

    def goals(self, message: Any) -> Points:
        """Return the targets in a message [mm], shape (n, 2), nan = no target.

        Raises:
            MessageError: the table is malformed.
            TargetsError: a robot does not exist; names the robot and its target.
        """
        ids, xy_mm = targets.decode(message)
        rows = self._plane.index_of(ids)
        if (rows < 0).any():
            at = int(np.argmax(rows < 0))
            text = f"robot {ids[at]}: no such robot, target {xy_mm[at].tolist()}"
            raise TargetsError(text, ids[rows < 0], np.full((rows < 0).sum(), Reason.UNKNOWN_ROBOT))
        xy = np.full((self._plane.n, 2), np.nan)
        xy[rows] = xy_mm
        return xy

    def chosen_fibre(self, message: Any) -> Ints:
        """Return the fibre that each target in a message is for, -1 for any, shape (n,).

        Raises:
            MessageError: the table is malformed.
            LayoutError: a robot has no such fibre; names it.
        """
        return targets.plane_for(self._plane, message).fibre

    def add(self, stamp: PlanStamp, goals: Points, fibre: Ints, straight: bool = False) -> None:
        """Add an accepted plan, or a later attempt of one; `straight` for a correction."""
        none = np.full(self._plane.n, Reason.OK, dtype=np.int64)
        self._kept[stamp] = _Inputs(goals, fibre, straight, none)
        for old in list(self._kept)[:-_KEPT]:
            del self._kept[old]
        self.newest = stamp if self.newest is None else max(stamp, self.newest)

    def forget(self) -> None:
        """Forget which plan is the newest: the next may have any stamp."""
        self.newest = None

    def targets(self, stamp: PlanStamp) -> Points | None:
        """Return the targets of a plan [mm], shape (n, 2), nan = no target; None if unknown."""
        return self._kept[stamp].goals if stamp in self._kept else None

    def fibre(self, stamp: PlanStamp) -> Ints:
        """Return the fibre that each target of a plan is for, -1 for any or unknown, shape (n,)."""
        if stamp in self._kept:
            return self._kept[stamp].fibre
        return np.full(self._plane.n, ANY_FIBRE)

    def straight(self, stamp: PlanStamp) -> bool:
        """Return whether a plan is a correction, on which no robot gives way; False if unknown."""
        return stamp in self._kept and self._kept[stamp].straight

    def free_stamp_after(self, stamp: PlanStamp) -> PlanStamp | None:
        """Return the earliest stamp after another that no kept plan has, None at the end.

        An attempt with this stamp sorts before every plan that is newer than its own plan.
        """
        ns = stamp.ns + 1
        while PlanStamp.fits(ns) and PlanStamp(ns) in self._kept:
            ns += 1
        return PlanStamp(ns) if PlanStamp.fits(ns) else None

    def reasons(self, stamp: PlanStamp) -> Codes:
        """Return the first reason to hold each robot of a plan, OK without a reason, shape (n,)."""
        if stamp in self._kept:
            return self._kept[stamp].reasons
        return np.full(self._plane.n, Reason.OK, dtype=np.int64)

    def add_held(self, message: Any) -> None:
        """Add the robots that a stage holds; the first reason received for a robot is kept.

        Raises:
            MessageError: the table is malformed, or names a robot that does not exist.
            BridgeError: no plan with its stamp was accepted.
        """
        ids, reason, _ = held.decode(message)
        stamp, rows = PlanStamp.of(message), self._rows(ids, "held")
        if stamp not in self._kept:
            raise BridgeError(f"no plan {stamp} was accepted")
        new = np.full(self._plane.n, Reason.OK, dtype=np.int64)
        new[rows] = reason
        self._kept[stamp].reasons = first_reason(self.reasons(stamp), new)

    def motion(self, message: Any, units: WireUnits, counts: Counts) -> WireMotion:
        """Return the orders in a segments message; robots without segments rest.

        Args:
            message: the segments.
            units: tick, quantum and widths.
            counts: encoders now [quanta], shape (n, 2): the start of the robots that rest.

        Raises:
            MessageError: the table is malformed, or names a robot that does not exist.
        """
        ids, motion = segments.decode(message, units)
        rows = self._rows(ids, "segments")
        start = np.array(counts)
        start[rows] = motion.start
        return WireMotion.at_rest(units, start).with_robots(rows, motion)

    def _rows(self, ids: Ids, name: str) -> Rows:
        rows = self._plane.index_of(ids)
        if (rows < 0).any():
            raise MessageError(name, "is not of this plane", robot=int(ids[rows < 0][0]))
        return rows

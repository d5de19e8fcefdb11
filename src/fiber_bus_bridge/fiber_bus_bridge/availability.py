"""Who of a plane can be commanded, and why the others cannot."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fiber_bus_bridge.disabled_list import read_disabled, write_disabled
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.plan_result import PlanResult
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason

__all__ = ["Availability"]

# what a robot itself did not do; whoever is held for another robot is none the worse
_ITS_OWN = (Reason.NOT_ACKNOWLEDGED, Reason.NOT_VERIFIED, Reason.REFUSED)


class Availability:
    """Keeps apart the robots that may be planned for and those that are obstacles.

    Out of plans are: robots disabled where the plane is described, robots that operators have
    taken out, for which there is a list that outlives the bridge, and robots that failed a
    plan, until `take_back`.

    Args:
        plane: the focal plane as it is described.
        path: file of the operators' list; None to keep it in memory only.

    Raises:
        BridgeError: the list cannot be read, or names a robot that the plane does not have.
    """

    def __init__(self, plane: FocalPlane, path: Path | None = None):
        self._plane, self._path = plane, path
        self.disabled: dict[int, str] = read_disabled(path) if path else {}
        self.failed = np.zeros(plane.n, dtype=np.int64)  # Reason of each robot, else OK
        self._rows(self.disabled)

    @property
    def enabled(self) -> np.ndarray:
        """Robots disabled neither by the plane's description nor by operators, shape (n,)."""
        enabled = self._plane.enabled.copy()
        enabled[self._rows(self.disabled)] = False
        return enabled

    def commandable(self, known) -> np.ndarray:
        """Robots that may be planned for, of those that configuration found, shape (n,)."""
        return self.enabled & known & (self.failed == Reason.OK)

    def disable(self, ids: Iterable[int], why: str = "") -> None:
        """Make this the operators' list; who is on it already keeps the reason given then.

        Args:
            ids: all robots that shall be on it.
            why: why those that are new are taken out.

        Raises:
            BridgeError: there is no such robot, or the list cannot be written; nothing changes.
        """
        table = {int(robot): self.disabled.get(int(robot), why) for robot in ids}
        self._rows(table)
        if self._path:
            write_disabled(self._path, table)
        self.disabled = table

    def leave_out(self, result: PlanResult, known) -> None:
        """Take out the robots that failed a plan, or could not be told to take part in it.

        Args:
            result: what came of the plan.
            known: robots that configuration found, shape (n,); the others are out anyway.
        """
        own = (result.outcome == Outcome.FAILED) | np.isin(result.reason, _ITS_OWN)
        self.failed = np.where(own & known, result.reason, self.failed)

    def take_back(self) -> None:
        """Plan again for those that failed."""
        self.failed[:] = Reason.OK

    def explain(self, result: PlanResult) -> PlanResult:
        """Return a result that says of robots left out for a failure what that was."""
        out = (self.failed != Reason.OK) & (result.reason == Reason.DISABLED) & self.enabled
        return replace(result, reason=np.where(out, self.failed, result.reason))

    def _rows(self, ids):
        ids = np.fromiter(ids, dtype=np.int64)
        rows = self._plane.index_of(ids)
        if (rows < 0).any():
            raise BridgeError(f"robot {ids[rows < 0][0]}: no such robot, it cannot be disabled")
        return rows

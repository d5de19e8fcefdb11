# SPDX-License-Identifier: Apache-2.0
"""Availability of the robots of a plane: which can be commanded, and why the others cannot."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fiber_bus_bridge.disabled_list import read_disabled, write_disabled
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.plan_result import PlanResult
from fiber_core.array_types import Codes, Mask, Rows
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason

__all__ = ["Availability"]

# reasons of a robot's own; a robot that is held because of another robot stays available
_OWN_REASONS = (Reason.NOT_ACKNOWLEDGED, Reason.NOT_VERIFIED, Reason.REFUSED, Reason.NO_REPLY)
_OWN_REASONS += (Reason.BUS_FAILED, Reason.REBOOTED, Reason.STALLED)


class Availability:
    """Separates the robots that may be planned for from the robots that are obstacles.

    Excluded from plans are robots disabled in the description of the plane, robots that operators
    have disabled, in a list that outlives the bridge, and robots that failed a plan, until
    `restore`.

    Args:
        plane: the focal plane as described.
        path: file of the operators' list; None to keep the list in memory only.

    Raises:
        BridgeError: the list cannot be read, or names a robot that the plane does not have.
    """

    def __init__(self, plane: FocalPlane, path: Path | None = None):
        self._plane, self._path = plane, path
        self.disabled: dict[int, str] = read_disabled(path) if path else {}
        self.failed: Codes = np.zeros(plane.n, dtype=np.int64)  # Reason of each robot, else OK
        self._rows(self.disabled)

    @property
    def enabled(self) -> Mask:
        """Robots disabled neither by the description of the plane nor by operators, shape (n,)."""
        enabled = self._plane.enabled.copy()
        enabled[self._rows(self.disabled)] = False
        return enabled

    def commandable(self, known: Mask) -> Mask:
        """Return the robots that may be planned for, shape (n,).

        Args:
            known: robots found at configuration, shape (n,).
        """
        return self.enabled & known & (self.failed == Reason.OK)

    def disable(self, ids: Iterable[int], reason: str = "") -> None:
        """Replace the operators' list; a robot that stays on the list keeps its reason.

        Args:
            ids: ids of all robots on the new list.
            reason: reason of the robots that are new on the list.

        Raises:
            BridgeError: a robot does not exist, or the list cannot be written; nothing changes.
        """
        table = {int(robot): self.disabled.get(int(robot), reason) for robot in ids}
        self._rows(table)
        if self._path:
            write_disabled(self._path, table)
        self.disabled = table

    def exclude_failed(self, result: PlanResult, known: Mask) -> None:
        """Exclude the robots that failed a plan, or could not be commanded in it.

        Args:
            result: the result of the plan.
            known: robots found at configuration, shape (n,); the others are excluded anyway.
        """
        own = (result.outcome == Outcome.FAILED) | np.isin(result.reason, _OWN_REASONS)
        self.failed = np.where(own & known, result.reason, self.failed)

    def restore(self) -> None:
        """Make the robots that failed a plan available again."""
        self.failed[:] = Reason.OK

    def explain(self, result: PlanResult) -> PlanResult:
        """Return a result that names, for each robot excluded for a failure, that failure."""
        excluded = (self.failed != Reason.OK) & (result.reason == Reason.DISABLED) & self.enabled
        return replace(result, reason=np.where(excluded, self.failed, result.reason))

    def _rows(self, ids: Iterable[int]) -> Rows:
        wanted = np.fromiter(ids, dtype=np.int64)
        rows = self._plane.index_of(wanted)
        if (rows < 0).any():
            raise BridgeError(
                f"robot {wanted[rows < 0][0]} cannot be disabled: the plane has no such robot"
            )
        return rows

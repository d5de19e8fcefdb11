# SPDX-License-Identifier: Apache-2.0
"""A plan under way, as its bridge leaves it to the next one if it dies: in a file on disk.

The file is JSON as that of the robots' memory: `stamp` [ns], and columns in the order of the rows
of the plane: targets `x` and `y` [mm] (null for none), `fibre`, `started` (sent a GO), and the
`outcome`, `reason` and `error` [mm] that are known; `ended` tells whether these are the last word.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fiber_bus_bridge.checked_file import float_column, int_column, read_checked, write_checked
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.robot_memory import fingerprint
from fiber_core import kinematics
from fiber_core.array_types import Angles, Codes, Floats, Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason

__all__ = ["LeftPlan", "load_left_plan", "save_left_plan"]

_NAME, _FORMAT = "plan under way", "plan under way of fiber_bus_bridge, 1"
_FAULTS = (Reason.NO_REPLY, Reason.BUS_FAILED, Reason.REBOOTED, Reason.STALLED)


@dataclass(frozen=True, eq=False)
class LeftPlan:
    """A plan that was accepted, or of which robots move or have moved, and what is known of it.

    Args:
        stamp_ns: names the plan [ns].
        goals: target of each fibre [mm], shape (n, 2), nan = no target.
        fibre: number of the fibre that each target is for, -1 for any, shape (n,).
        started: robots that were sent a GO, and whose result is not known, shape (n,).
        result: the result, of started robots only once the plan has ended.
        ended: whether the plan has ended.
    """

    stamp_ns: int
    goals: Points
    fibre: Ints
    started: Mask
    result: PlanResult
    ended: bool = False

    def found(
        self,
        plane: FocalPlane,
        angles: Angles,
        sure: Mask,
        cause: Codes,
        tolerance_mm: float,
    ) -> "LeftPlan":
        """Return the plan with the result of robots that were read after their bridge had died.

        A robot has reached its target if it answers, rests, and its encoders say so. What was
        known of a robot that was not started stays.

        Args:
            plane: the focal plane.
            angles: joint angles by the encoders [rad], shape (n, 2).
            sure: robots that answer, and rest where their encoders say, shape (n,).
            cause: Reason for which each robot rests, OK if it carried out its orders, shape (n,).
            tolerance_mm: distance from its target within which a tip has reached it [mm].
        """
        error = kinematics.on_target(plane.with_fibre(self.fibre), angles, self.goals).error_mm
        asked, before = np.all(np.isfinite(self.goals), axis=1), self.result
        now = self.started | (before.outcome == Outcome.REACHED)  # only a reading tells of these
        failed = (before.outcome == Outcome.FAILED) | (now & np.isin(cause, _FAULTS))
        reached = asked & sure & ~failed & (error <= tolerance_mm)
        off = np.where(asked, Reason.OFF_TARGET, Reason.NO_TARGET)
        reason = np.where(now, np.where(cause == Reason.OK, off, cause), before.reason)
        outcome = np.where(now, np.where(failed, Outcome.FAILED, Outcome.HELD), before.outcome)
        outcome[reached], reason[reached] = Outcome.REACHED, Reason.OK
        return replace(self, result=PlanResult(outcome, reason, error), ended=True)

    def noted(
        self, plane: FocalPlane, angles: Angles, at_rest: Mask, cause: Codes, tolerance_mm: float
    ) -> "LeftPlan":
        """Return the plan, not ended, with the result of the robots that were read at rest.

        It is no news any more when such a robot forgets why it rests.

        Args:
            plane: the focal plane.
            angles: joint angles by the encoders [rad], shape (n, 2).
            at_rest: robots that were read at rest, where their encoders say, shape (n,).
            cause: as for `found`.
            tolerance_mm: as for `found`.
        """
        told = self.found(plane, angles, at_rest, cause, tolerance_mm)
        known, before, after = self.started & at_rest, self.result, told.result
        result = PlanResult(
            np.where(known, after.outcome, before.outcome),
            np.where(known, after.reason, before.reason),
            np.where(known, after.error_mm, before.error_mm),
        )
        return replace(self, started=self.started & ~known, result=result)


def save_left_plan(path: Path, plan: LeftPlan, plane: FocalPlane, synced: bool = True) -> None:
    """Replace the file as a whole.

    Args:
        path: the file.
        plan: the plan.
        plane: the focal plane.
        synced: whether it is on disk on return, as it must be before a GO.

    Raises:
        BridgeError: the file cannot be written.
    """
    result = plan.result
    content: dict[str, object] = {
        "format": _FORMAT,
        "plane": fingerprint(plane),
        "stamp": str(plan.stamp_ns),
        "ended": int(plan.ended),
        "x": _numbers(plan.goals[:, 0]),
        "y": _numbers(plan.goals[:, 1]),
        "fibre": plan.fibre.tolist(),
        "started": plan.started.astype(int).tolist(),
        "outcome": result.outcome.tolist(),
        "reason": result.reason.tolist(),
        "error": _numbers(result.error_mm),
    }
    write_checked(path, content, _NAME, synced)


def _numbers(values: Floats) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values.tolist()]


def load_left_plan(path: Path, plane: FocalPlane) -> LeftPlan | None:
    """Return the plan in a file, None if there is no file.

    Raises:
        BridgeError: the file is damaged, or of another plane; names what is wrong.
    """
    try:
        content = read_checked(path, _FORMAT)
        return None if content is None else _plan(content, plane)
    except BridgeError as error:
        raise BridgeError(f"{_NAME} {path}: {error}") from error


def _plan(content: dict[str, object], plane: FocalPlane) -> LeftPlan:
    if content.get("plane") != fingerprint(plane):
        raise BridgeError("it is of another plane")
    stamp = content.get("stamp")
    if not isinstance(stamp, str) or not stamp.isdecimal() or len(stamp) > 19:
        raise BridgeError(f"stamp is {stamp!r}")
    n = plane.n
    x, y, error = (float_column(content, name, n) for name in ("x", "y", "error"))
    fibre, started = (int_column(content, name, n) for name in ("fibre", "started"))
    outcome, reason = int_column(content, "outcome", n), int_column(content, "reason", n)
    for name, values, known in (("outcome", outcome, Outcome), ("reason", reason, Reason)):
        if not np.isin(values, [int(code) for code in known]).all():
            raise BridgeError(f"{name} holds a number that is none")
    result = PlanResult(outcome, reason, error)
    goals = np.stack([x, y], axis=1)
    return LeftPlan(
        int(stamp), goals, fibre, started.astype(bool), result, content.get("ended") == 1
    )

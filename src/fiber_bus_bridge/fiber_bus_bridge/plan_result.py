"""The plan a session carries out, and what became of each robot in it."""

from dataclasses import dataclass, replace

import numpy as np

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.loader import LoadedPlan
from fiber_bus_bridge.wire import MAX_SEGMENTS
from fiber_core import kinematics
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion

__all__ = ["Plan", "PlanResult", "judge"]


@dataclass(frozen=True, eq=False)
class Plan:
    """Orders and what they are for.

    Args:
        motion: orders of every robot, from where its encoders are.
        goals: where each fibre should go [mm], shape (n, 2), nan = nothing asked.
    """

    motion: WireMotion
    goals: np.ndarray

    @classmethod
    def of(cls, plane: FocalPlane, motion: WireMotion, counts, targets) -> "Plan":
        """Make a plan of orders, from encoders [quanta], shape (n, 2), and targets or None.

        Without targets, the goals are where the orders of those that move should end.

        Raises:
            SessionError: targets do not fit the plane.
        """
        goals = targets
        if targets is None:
            goals = kinematics.forward(plane, motion.units.to_angles(motion.end))[1]
            moves = np.diff(motion.offsets).reshape(-1, 2).any(axis=1)
            goals = np.where(moves[:, None], goals, np.nan)
        goals = np.array(goals, dtype=float)
        if goals.shape != (plane.n, 2):
            raise SessionError(f"targets of shape {goals.shape} for {plane.n} robots")
        here = WireMotion(motion.units, counts, motion.offsets, motion.ticks, motion.velocity)
        return cls(here, goals)

    @property
    def asked(self) -> np.ndarray:
        """Robots with a goal, shape (n,)."""
        return np.isfinite(self.goals).all(axis=1)

    @property
    def moves(self) -> np.ndarray:
        """Robots with orders, shape (n,)."""
        return self._counts.any(axis=1)

    @property
    def crowded(self) -> np.ndarray:
        """Robots with more segments than one order carries, shape (n,)."""
        return (self._counts > MAX_SEGMENTS).any(axis=1)

    @property
    def _counts(self):
        return np.diff(self.motion.offsets).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class PlanResult:
    """How each robot ended a plan.

    Args:
        outcome: Outcome, shape (n,).
        reason: Reason, shape (n,).
        error_mm: distance of its tip, by its encoders, from its goal [mm], nan without, (n,).
    """

    outcome: np.ndarray
    reason: np.ndarray
    error_mm: np.ndarray

    def explained_by(self, reason) -> "PlanResult":
        """Return the same result with the reasons of earlier stages where they tell more.

        Args:
            reason: why an earlier stage held a robot, OK where none did, shape (n,).
        """
        vague = np.isin(self.reason, (Reason.NOT_PLANNED, Reason.OFF_TARGET))
        told = vague & (self.outcome == Outcome.HELD) & (np.asarray(reason) != Reason.OK)
        return replace(self, reason=np.where(told, reason, self.reason))


def judge(
    plane: FocalPlane,
    plan: Plan,
    upload: LoadedPlan | None,
    counts,
    known,
    arrived,
    failed,
    tolerance_mm: float,
) -> PlanResult:
    """Give every robot of a plan that has ended exactly one outcome and a reason.

    Args:
        plane: the focal plane.
        plan: what was asked.
        upload: what was started; None if it never came to that.
        counts: encoders now [quanta], shape (n, 2).
        known: robots that can be commanded, shape (n,).
        arrived: robots that reported the end of their orders, shape (n,).
        failed: robots that were started and fell silent or did not move, shape (n,).
        tolerance_mm: distance from its goal within which a tip has reached it [mm].
    """
    units = plan.motion.units
    tips = kinematics.forward(plane, units.to_angles(counts))[1]
    error = np.linalg.norm(tips - plan.goals, axis=1)
    concerned = plan.asked | plan.moves
    off = np.zeros(plane.n, dtype=bool)

    # later lines overrule earlier ones
    reason = np.where(plan.asked, Reason.NOT_PLANNED, Reason.NO_TARGET)
    if upload is None:
        reason[concerned] = Reason.STOPPED
    else:
        ordered = kinematics.forward(plane, units.to_angles(upload.motion.end))[1]
        off = upload.started & arrived & (np.hypot(*(tips - ordered).T) > tolerance_mm)
        reason[upload.started & ~arrived] = Reason.STOPPED
        reason[upload.started & arrived & plan.asked] = Reason.OFF_TARGET
        reason = np.where(upload.reason != Reason.OK, upload.reason, reason)
    reason[plan.crowded] = Reason.TOO_MANY_SEGMENTS
    reason[concerned & ~known] = Reason.NOT_ACKNOWLEDGED
    reason[concerned & ~plane.enabled] = Reason.DISABLED
    reason[failed] = Reason.NOT_ACKNOWLEDGED
    reason[off] = Reason.OFF_TARGET
    reached = plan.asked & (error <= tolerance_mm) & known & ~failed & ~off
    reason[reached] = Reason.OK

    outcome = np.full(plane.n, Outcome.HELD, dtype=np.int64)
    outcome[failed | off] = Outcome.FAILED
    outcome[reached] = Outcome.REACHED
    return PlanResult(outcome, reason.astype(np.int64), error)

# SPDX-License-Identifier: Apache-2.0
"""A plan as a session executes it, and the result of each robot."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.wire import MAX_SEGMENTS, Frames
from fiber_core import kinematics
from fiber_core.array_types import Angles, Codes, Counts, Floats, Ints, Mask, Points
from fiber_core.clearance import Certificate
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason, first_reason
from fiber_core.wire_units import WireMotion

__all__ = ["LoadedPlan", "Plan", "PlanResult", "Started", "Starting", "evaluate"]

# reasons of the bus for which an earlier stage may know the cause
_VAGUE = (Reason.NOT_PLANNED, Reason.OFF_TARGET)


@dataclass(frozen=True, eq=False)
class Plan:
    """Orders and their goals.

    Args:
        motion: orders of every robot, from the positions of the encoders.
        goals: target of each fibre [mm], shape (n, 2), nan = no target.
        fibre: number of the fibre that each target is for, -1 for any, shape (n,).
        within_mm: distance beyond which no point of a robot moves, wherever its arms are [mm],
            shape (n,), so that robots at unknown places may move; None for a plan of robots at
            known places.
        about: joint angles from which `within_mm` counts [rad], shape (n, 2), of robots at known
            places; None for the start of the motion.
        to_stops: whether robots turn to their stops, whose turn of theta is unknown.
    """

    motion: WireMotion
    goals: Points
    fibre: Ints
    within_mm: Floats | None = None
    about: Angles | None = None
    to_stops: bool = False

    @classmethod
    def of(
        cls,
        plane: FocalPlane,
        motion: WireMotion,
        counts: Counts,
        targets: ArrayLike | None,
        fibre: ArrayLike | None = None,
    ) -> "Plan":
        """Make a plan of orders.

        Args:
            plane: the focal plane.
            motion: the orders.
            counts: encoders now [quanta], shape (n, 2).
            targets: target of each fibre [mm], shape (n, 2), nan = no target; None for the ends of
                the orders of the robots that move.
            fibre: number of the fibre that each target is for, -1 for any, shape (n,); by default
                that of the plane.

        Raises:
            SessionError: the targets do not fit the plane.
            LayoutError: a robot has no such fibre.
        """
        plane = plane if fibre is None else plane.with_fibre(fibre)
        if targets is None:
            nowhere = np.full((plane.n, 2), np.nan)
            ends = kinematics.on_target(plane, motion.units.to_angles(motion.end), nowhere).place
            moves = motion.moves
            targets = np.where(moves[:, None], ends, np.nan)
        goals = np.array(targets, dtype=float)
        if goals.shape != (plane.n, 2):
            raise SessionError(f"targets have shape {goals.shape}, expected {(plane.n, 2)}")
        return cls(motion.starting_at(counts), goals, plane.fibre)

    @property
    def asked(self) -> Mask:
        """Robots with a target, shape (n,)."""
        return np.all(np.isfinite(self.goals), axis=1)

    @property
    def resumes(self) -> bool:
        """Whether robots that were stopped after a failure go on."""
        return self.within_mm is None and not self.to_stops

    @property
    def moves(self) -> Mask:
        """Robots with orders, shape (n,)."""
        return self.motion.moves

    @property
    def oversized(self) -> Mask:
        """Robots with more segments than one order can carry, shape (n,)."""
        return np.any(self.motion.counts > MAX_SEGMENTS, axis=1)


@dataclass(frozen=True, eq=False)
class LoadedPlan:
    """Result of loading and starting a phase of a plan.

    Args:
        started: robots that were started, shape (n,).
        reason: Reason of robots with orders that were not started, else OK, shape (n,).
        sequence: sequence number of the order of each robot, shape (n,).
        frames: the LOAD frames of the started robots, in the order of their rows.
        motion: the motion decoded from these frames.
        certificate: the certificate of this motion.
        go_s: time at which the GO was complete [s].
        start_s: time at which the robots begin to move, at the end of the countdown [s].
    """

    started: Mask
    reason: Codes
    sequence: Ints
    frames: Frames
    motion: WireMotion
    certificate: Certificate
    go_s: float
    start_s: float

    @cached_property
    def makespan_s(self) -> float:
        """Time from the start until the last robot arrives [s]."""
        return self.motion.decoded().makespan_s


class Started(Protocol):
    """What the result of a plan needs of a phase that was, or is about to be, started."""

    @property
    def started(self) -> Mask:
        """Robots that were started, shape (n,)."""
        ...

    @property
    def reason(self) -> Codes:
        """Reason of robots with orders that were not started, else OK, shape (n,)."""
        ...

    @property
    def motion(self) -> WireMotion:
        """The orders."""
        ...


class Starting(NamedTuple):
    """A phase that is about to be started, as in Started."""

    started: Mask
    reason: Codes
    motion: WireMotion


@dataclass(frozen=True, eq=False)
class PlanResult:
    """Result of each robot at the end of a plan.

    Args:
        outcome: Outcome, shape (n,).
        reason: Reason, shape (n,).
        error_mm: distance of the fibre, by the encoders, from its target [mm], nan without a
            target, shape (n,).
    """

    outcome: Codes
    reason: Codes
    error_mm: Floats

    @property
    def summary(self) -> str:
        """How many robots have which outcome; those without a target count if they failed."""
        concerned = (self.reason != Reason.NO_TARGET) | (self.outcome != Outcome.HELD)
        counts = np.bincount(self.outcome[concerned], minlength=len(Outcome))
        return ", ".join(f"{counts[each]} {each.name.lower()}" for each in Outcome)

    def explained_by(self, reason: ArrayLike) -> "PlanResult":
        """Return the same result with the reasons of earlier stages where they are the cause.

        A robot that is held because it had no orders, or orders that end off its target, was
        held by an earlier stage if that stage says so.

        Args:
            reason: Reason for which an earlier stage held each robot, else OK, shape (n,).
        """
        vague = np.isin(self.reason, _VAGUE) & (self.outcome == Outcome.HELD)
        return replace(self, reason=np.where(vague, first_reason(reason, self.reason), self.reason))


def evaluate(
    plane: FocalPlane,
    plan: Plan,
    loaded_plan: Started | None,
    counts: Counts,
    known: Mask,
    arrived: Mask,
    cause: Codes,
    stop_reason: Reason,
    tolerance_mm: float,
) -> PlanResult:
    """Return exactly one outcome and one reason for each robot of a plan that has ended.

    Args:
        plane: the focal plane.
        plan: the plan.
        loaded_plan: the started orders; None if the plan was never loaded.
        counts: encoders now [quanta], shape (n, 2).
        known: robots that can be commanded, shape (n,).
        arrived: robots that reported the end of their orders, shape (n,).
        cause: Reason for which a robot failed although it was started, else OK, shape (n,).
        stop_reason: Reason of robots that were stopped on the way and have not failed.
        tolerance_mm: distance from its target within which a tip has reached it [mm].
    """
    units = plan.motion.units
    angles = units.to_angles(counts)
    tips = kinematics.forward(plane, angles)[1]
    error = kinematics.on_target(plane.with_fibre(plan.fibre), angles, plan.goals).error_mm
    concerned = plan.asked | plan.moves
    off, failed = np.zeros(plane.n, dtype=bool), cause != Reason.OK

    # later lines overrule earlier ones
    reason = np.where(plan.asked, Reason.NOT_PLANNED, Reason.NO_TARGET)
    if loaded_plan is None:
        reason[concerned] = stop_reason
    else:
        started = loaded_plan.started
        ordered = kinematics.forward(plane, units.to_angles(loaded_plan.motion.end))[1]
        off = started & arrived & (np.hypot(*(tips - ordered).T) > tolerance_mm)
        reason[started & ~arrived] = stop_reason
        reason[started & arrived & plan.asked] = Reason.OFF_TARGET
        reason = np.where(loaded_plan.reason != Reason.OK, loaded_plan.reason, reason)
    reason[plan.oversized] = Reason.TOO_MANY_SEGMENTS
    reason[concerned & ~known] = Reason.NOT_ACKNOWLEDGED
    reason[concerned & ~plane.enabled] = Reason.DISABLED
    reason = np.where(failed, cause, reason)
    reason[off] = Reason.OFF_TARGET
    reached = plan.asked & (error <= tolerance_mm) & known & ~failed & ~off
    reason[reached] = Reason.OK

    outcome = np.full(plane.n, Outcome.HELD, dtype=np.int64)
    outcome[failed | off] = Outcome.FAILED
    outcome[reached] = Outcome.REACHED
    return PlanResult(outcome, reason.astype(np.int64), error)

# SPDX-License-Identifier: Apache-2.0
"""Keeps the messages that the recorder received, by plan and by attempt of a plan."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from sensor_msgs.msg import JointState, PointCloud2
from trajectory_msgs.msg import JointTrajectory

from fiber_core.array_types import Counts
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.outcomes import PlanOutcome
from fiber_msgs_py import Attempt, AttemptTable, PlanStamp

__all__ = ["PlanAttempts", "ReceivedAttempt", "ReceivedPlan", "ReceivedPlans"]

_PLANS_KEPT = 4
_ATTEMPTS_KEPT = 16


@dataclass
class ReceivedAttempt:
    """Messages with the stamp of one attempt.

    Args:
        plane: the focal plane before the first frame.
        counts: encoders before the first frame [quanta], shape (n, 2).
        trajectory: the planner's trajectory.
        corridors: the discretizer's corridors.
        logs: the frames.
    """

    plane: FocalPlane | None = None
    counts: Counts | None = None
    trajectory: JointTrajectory | None = None
    corridors: PointCloud2 | None = None
    logs: list[FrameLog] = field(default_factory=list)


@dataclass
class ReceivedPlan:
    """Messages of a plan that do not depend on its attempts.

    Args:
        targets: the targets of its first attempt.
        outcome: how its robots ended.
        outcome_s: when the outcome was received, on the monotonic clock [s].
        checked_logs: number of frame logs at the last check for completeness.
        rested: encoders of robots at rest, from the outcome on.
    """

    targets: PointCloud2 | None = None
    outcome: PlanOutcome | None = None
    outcome_s: float = 0.0
    checked_logs: int = 0
    rested: list[JointState] = field(default_factory=list)


@dataclass(frozen=True)
class PlanAttempts:
    """The attempts of one plan, in their order.

    Args:
        announced: the messages of each attempt.
    """

    announced: list[ReceivedAttempt]

    @property
    def executed(self) -> list[ReceivedAttempt]:
        """The attempts with frames on the buses."""
        return [attempt for attempt in self.announced if attempt.logs]

    @property
    def first(self) -> ReceivedAttempt:
        """The first attempt with frames on the buses, else the first of all."""
        return (self.executed + self.announced)[0]

    @property
    def logs(self) -> list[FrameLog]:
        """The frames of all attempts; each attempt begins where the one before it ended."""
        return [log for attempt in self.executed for log in attempt.logs]


class ReceivedPlans:
    """The newest plans and attempts; older ones are dropped."""

    def __init__(self):
        self._plans: dict[PlanStamp, ReceivedPlan] = {}
        self._attempts: dict[PlanStamp, ReceivedAttempt] = {}
        self._announced = AttemptTable()

    def plan(self, stamp: PlanStamp) -> ReceivedPlan:
        """Return the messages of a plan, to add to; the oldest plans make way for a new one.

        Those that have ended and wait for their recording stay longer.
        """
        for old in sorted(self._plans)[: -(_PLANS_KEPT - 1)]:
            if old < stamp and self._plans[old].outcome is None:
                self.drop(old)
        for old in sorted(self._plans)[: -(_ATTEMPTS_KEPT - 1)]:
            if old < stamp:
                self.drop(old)
        return self._plans.setdefault(stamp, ReceivedPlan())

    def attempt(self, stamp: PlanStamp) -> ReceivedAttempt:
        """Return the messages with the stamp of an attempt, to add to.

        The plan of the attempt may be unknown until targets or progress announce the attempt.
        """
        for old in sorted(self._attempts)[: -(_ATTEMPTS_KEPT - 1)]:
            if old < stamp:
                del self._attempts[old]
        return self._attempts.setdefault(stamp, ReceivedAttempt())

    def announce(self, attempt: Attempt) -> None:
        """Record which plan an attempt belongs to."""
        self._announced.add(attempt)

    def attempts(self, plan: PlanStamp) -> PlanAttempts:
        """Return the attempts of a plan that have been announced."""
        stamps = [attempt.stamp for attempt in self._announced.of_plan(plan)]
        return PlanAttempts([self._attempts.get(stamp, ReceivedAttempt()) for stamp in stamps])

    def has_unannounced_frames(self, plan: PlanStamp) -> bool:
        """Return whether there are frames that may belong to a later attempt of a plan."""
        return any(
            stamp > plan and attempt.logs and self._announced.find(stamp) is None
            for stamp, attempt in self._attempts.items()
        )

    def ended(self) -> Iterator[tuple[PlanStamp, ReceivedPlan, PlanOutcome]]:
        """Iterate over the plans with an outcome; they may be dropped meanwhile."""
        for stamp, plan in list(self._plans.items()):
            if plan.outcome is not None:
                yield stamp, plan, plan.outcome

    def drop(self, plan: PlanStamp) -> None:
        """Drop all messages of a plan and its attempts."""
        for attempt in self._announced.of_plan(plan):
            self._attempts.pop(attempt.stamp, None)
        del self._plans[plan]

# SPDX-License-Identifier: Apache-2.0
"""The attempts of a plan: which plan a stamp belongs to, and which attempt of the plan it names."""

from dataclasses import dataclass

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp

__all__ = ["Attempt", "AttemptTable"]

_ATTEMPTS_KEPT = 64


@dataclass(frozen=True)
class Attempt:
    """One pass of a plan through planner and discretizer.

    The first attempt has the stamp of the plan. A later attempt, around robots that could not be
    commanded, has a stamp of its own, which all messages derived from its targets carry.

    Args:
        stamp: names the attempt.
        plan: names the plan.
        number: which attempt of the plan, from 1.
        since_ns: time of the oldest joint states to plan with [ns]; None for any.
        layout_ns: time of the oldest layout to plan with [ns]; None for that of the joint states.

    Raises:
        MessageError: the number is less than 1 or too large for a message, a first attempt has
            another stamp than its plan, or a later attempt has not a later one.
    """

    stamp: PlanStamp
    plan: PlanStamp
    number: int = 1
    since_ns: int | None = None
    layout_ns: int | None = None

    def __post_init__(self):
        if not 1 <= self.number < 2**32:
            raise MessageError(
                "attempt", "is outside 1..4294967295", field="number", value=self.number
            )
        if (self.number == 1) != (self.stamp == self.plan) or self.stamp < self.plan:
            problem = f"does not fit attempt {self.number} of plan {self.plan}"
            raise MessageError("attempt", problem, field="stamp", value=str(self.stamp))

    @classmethod
    def first(cls, plan: PlanStamp) -> "Attempt":
        """Return the first attempt of a plan."""
        return cls(plan, plan)

    def next(self, stamp: PlanStamp, since_ns: int | None = None) -> "Attempt":
        """Return the next attempt of the same plan.

        Args:
            stamp: names the next attempt; later than the stamp of this one.
            since_ns: time of the oldest layout and joint states to plan with [ns]; None for any.
        """
        return Attempt(stamp, self.plan, self.number + 1, since_ns)

    def __str__(self) -> str:
        return str(self.plan) if self.number == 1 else f"{self.plan} attempt {self.number}"


class AttemptTable:
    """Finds the plan of a stamp.

    Targets and progress announce attempts; other messages carry the stamp of their attempt only.
    Topics overtake each other, so a message may come before its announcement: a receiver keeps
    such a message under its stamp and asks this table later. The last 64 attempts are kept.
    """

    def __init__(self):
        self._attempts: dict[PlanStamp, Attempt] = {}

    def add(self, attempt: Attempt) -> bool:
        """Record an announced attempt; return whether its stamp was unknown before."""
        if attempt.stamp in self._attempts:
            return False
        self._attempts[attempt.stamp] = attempt
        for old in list(self._attempts)[:-_ATTEMPTS_KEPT]:
            del self._attempts[old]
        return True

    def find(self, stamp: PlanStamp) -> Attempt | None:
        """Return the attempt that a stamp names, None if it has not been announced."""
        return self._attempts.get(stamp)

    def of_plan(self, plan: PlanStamp) -> list[Attempt]:
        """Return the attempts of a plan in their order; the first is always there."""
        later = [each for each in self._attempts.values() if each.plan == plan and each.number > 1]
        first = self._attempts.get(plan, Attempt.first(plan))
        return [first, *sorted(later, key=lambda attempt: attempt.number)]

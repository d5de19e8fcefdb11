# SPDX-License-Identifier: Apache-2.0
"""The attempts of a plan: whether another attempt is worthwhile, and the combined result."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.plan_result import PlanResult
from fiber_core.array_types import Mask, Points
from fiber_core.outcomes import Outcome, Reason

__all__ = ["Replanning"]

# reasons of robots that are held because of another robot
_BECAUSE_OF_OTHERS = (
    Reason.UNSAFE_AS_LOADED, Reason.STOPPED, Reason.OTHER_FAILED, Reason.PLACE_UNKNOWN,
)  # fmt: skip


class Replanning:
    """Combines the results of the attempts of one plan.

    A robot that cannot be commanded affects its neighbours: a neighbour that cannot be certified
    next to it is held, a moving neighbour is stopped. The neighbours can be planned again, with
    that robot as an obstacle, as long as each attempt finds such a robot that the planner did not
    know.

    Args:
        goals: target of each fibre [mm], shape (n, 2), nan = no target.
        max_attempts: largest number of attempts.
    """

    def __init__(self, goals: ArrayLike, max_attempts: int):
        self.goals: Points = np.asarray(goals, dtype=float)
        self.max_attempts = max_attempts
        self.asked: Mask = np.all(np.isfinite(self.goals), axis=1)
        self.attempts = 0
        self.result: PlanResult | None = None

    def add_attempt(self, result: PlanResult, asked: ArrayLike) -> PlanResult:
        """Add the result of an attempt; return the combined result of all attempts.

        Args:
            result: the result, n robots.
            asked: robots asked in the attempt, one value or shape (n,); of other robots only a
                failure counts.
        """
        self.attempts += 1
        if self.result is None:
            self.result = result
            return result
        new = np.asarray(asked, dtype=bool) | (result.outcome == Outcome.FAILED)
        old = self.result
        self.result = PlanResult(
            np.where(new, result.outcome, old.outcome),
            np.where(new, result.reason, old.reason),
            np.where(new, result.error_mm, old.error_mm),
        )
        return self.result

    def next_robots(self, ordered: Mask, commandable: Mask) -> Mask:
        """Return the robots to ask in the next attempt, none if there is no next attempt, (n,).

        Robots that have arrived are asked too: they may make way and come back.

        Args:
            ordered: robots with orders in the last attempt, shape (n,).
            commandable: robots that can be commanded now, shape (n,).
        """
        if self.result is None:
            return np.zeros(len(self.asked), dtype=bool)
        waiting = self.asked & commandable & (self.result.outcome == Outcome.HELD)
        waiting &= np.isin(self.result.reason, _BECAUSE_OF_OTHERS)
        new_obstacle = (ordered & ~commandable).any()
        worthwhile = self.attempts < self.max_attempts and new_obstacle and waiting.any()
        return self.asked & commandable & bool(worthwhile)

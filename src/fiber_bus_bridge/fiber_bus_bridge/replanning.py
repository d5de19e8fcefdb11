"""A plan and its attempts: whether it is worth another, and what came of them all."""

import numpy as np

from fiber_bus_bridge.plan_result import PlanResult
from fiber_core.outcomes import Outcome, Reason

__all__ = ["Replanning"]

_FOR_OTHERS = (Reason.UNSAFE_AS_LOADED, Reason.STOPPED)


class Replanning:
    """Adds up the attempts of one plan.

    A robot that cannot be commanded takes its neighbours with it: who cannot be certified beside
    it is held, who moved is stopped. They can be planned again, with it as an obstacle, for as
    long as each attempt finds such a robot that the planner did not know of.

    Args:
        goals: where fibres should go [mm], shape (n, 2), nan = nothing asked.
        most: how many attempts there may be.
    """

    def __init__(self, goals, most: int):
        self.goals, self.most = np.asarray(goals, dtype=float), most
        self.asked = np.isfinite(self.goals).all(axis=1)
        self.made = 0
        self.result: PlanResult | None = None

    def add(self, result: PlanResult, asked) -> None:
        """Take what came of an attempt.

        Args:
            result: its result, n robots.
            asked: robots asked in it, shape (n,): of the others, only a failure counts.
        """
        self.made += 1
        if self.result is None:
            self.result = result
            return
        new = np.asarray(asked) | (result.outcome == Outcome.FAILED)
        old = self.result
        self.result = PlanResult(
            np.where(new, result.outcome, old.outcome),
            np.where(new, result.reason, old.reason),
            np.where(new, result.error_mm, old.error_mm),
        )

    def again(self, ordered, commandable) -> np.ndarray:
        """Return whom to ask in the next attempt, nobody where there should be none, (n,).

        Robots that have arrived are asked too: they may make way and come back.

        Args:
            ordered: robots that had orders in the last attempt, shape (n,).
            commandable: robots that can be commanded now, shape (n,).
        """
        waits = self.asked & commandable & (self.result.outcome == Outcome.HELD)
        waits &= np.isin(self.result.reason, _FOR_OTHERS)
        news = (ordered & ~commandable).any()
        worth = self.made < self.most and news and waits.any()
        return self.asked & commandable & worth

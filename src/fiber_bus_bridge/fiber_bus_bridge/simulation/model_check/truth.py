# SPDX-License-Identifier: Apache-2.0
"""What really happens to robots, judged by the rules that the protocol must keep."""

from dataclasses import dataclass, field

import numpy as np

from fiber_bus_bridge.plan_result import PlanResult
from fiber_core.array_types import Counts, Floats, Ints, Mask
from fiber_core.outcomes import Outcome, Reason

__all__ = ["Truth"]


@dataclass
class Truth:
    """The true course of a plan; the controller does not see it.

    Args:
        accepted: attempt of the last GO that each robot has accepted, shape (n,).
        rest: encoders while no robot may move [quanta], shape (n, 2).
        goal: encoders at the end of the plan [quanta], shape (n, 2).
        attempt: number of the start that is certified, or was last.
        committed: attempt of the last start that the controller declared complete.
        stopped: whether all robots were stopped in this plan.
        certified: orders that were certified last, as bytes, by row.
        wrong: rules that were broken.
        apart_s: time between the first and the last stop of robots stopped together [s].
    """

    accepted: Ints
    rest: Counts
    goal: Counts
    attempt: int = 0
    committed: int = -1
    stopped: bool = False
    certified: dict[int, bytes] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    apart_s: float = 0.0

    def start(self, row: int, order: bytes, verified: bool) -> None:
        """Judge a robot that has accepted a GO: nothing moves uncertified.

        Args:
            row: the robot.
            order: the order that it will carry out; an empty one moves nothing.
            verified: whether the controller has verified an order of the robot.
        """
        self.accepted[row] = self.attempt
        if order and (self.certified.get(row) != order or not verified):
            self.wrong.append(f"robot {row} counts down with an order that is not certified")

    def commit(self, started: Mask, started_s: Floats, skew_s: float) -> None:
        """Judge a start that the controller declares complete: all robots count down together.

        Args:
            started: robots that were sent the GO, shape (n,).
            started_s: time at which each robot begins to move [s], shape (n,).
            skew_s: how far apart these times may be [s].
        """
        for row in np.flatnonzero(started & (self.accepted != self.attempt)):
            self.wrong.append(f"robot {row} does not count down, and the others start")
        begins_s = started_s[started & (self.accepted == self.attempt)]
        if len(begins_s) and np.ptp(begins_s) > skew_s:
            self.wrong.append(f"robots start {1e3 * np.ptp(begins_s):.3f} ms apart")
        self.committed = self.attempt

    def stop(self, at: Counts) -> None:
        """All robots have stopped, with these encoders."""
        self.rest, self.stopped = at, True
        self.attempt += 1

    def judge_places(self, at: Counts) -> None:
        """Judge robots away from their place: only those of a complete start may be."""
        may_move = (self.accepted == self.committed) & (self.committed == self.attempt)
        rule = "after a stop" if self.stopped else "before all robots of its plan count down"
        for row in np.flatnonzero((at != self.rest).any(axis=1) & ~may_move):
            self.wrong.append(f"robot {row} moves {rule}")

    def judge_outcomes(self, result: PlanResult | None, at: Counts) -> None:
        """Judge the result of a plan: each robot has one outcome, and it is true."""
        n = len(self.accepted)
        if result is None or not len(result.outcome) == len(result.reason) == n:
            self.wrong.append("not every robot has one outcome")
            return
        wrong = ~np.isin(result.outcome, list(Outcome)) | ~np.isin(result.reason, list(Reason))
        reached = result.outcome == Outcome.REACHED
        wrong |= reached != (result.reason == Reason.OK)
        wrong |= reached & (at != self.goal).any(axis=1)
        for row in np.flatnonzero(wrong).tolist():
            ended = result.outcome[row], result.reason[row]
            self.wrong.append(f"robot {row} has outcome {ended[0]}, reason {ended[1]}")

    def judge_rest(self, at: Counts, later: Counts) -> None:
        """Judge robots after the end of a plan: none moves."""
        for row in np.flatnonzero((at != later).any(axis=1)):
            self.wrong.append(f"robot {row} moves after the end of the plan")

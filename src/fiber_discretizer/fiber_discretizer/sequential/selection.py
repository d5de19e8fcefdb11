# SPDX-License-Identifier: Apache-2.0
"""Select for each robot the motion with the fewest segments that is proven safe."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Ints, Mask, Rows
from fiber_core.motion import SegmentMotion
from fiber_core.motors import motors_broken
from fiber_discretizer.sequential.segment_plan import SegmentPlan

__all__ = ["Selection"]

_UNCONSTRAINED_MM = -1e6  # required gap to a robot that will get another motion anyway


class Selection:
    """The best motion found so far for some robots, no two of them neighbours.

    A motion is safe when its pairs are proven to keep their gaps, and coupled motors keep their
    limits. Pairs with a robot that is in conflict and not rounded yet do not count: that robot
    gets another motion, or rests.

    Args:
        plan: segments of all robots.
        rows: the robots that select a motion, shape (m,).
        idle: which of them rest though they are to move, shape (m,).
        allowance_mm: gap that corridors keep beyond the required ones, for rounding [mm].
        max_segments: largest number of segments of one joint.

    Attributes:
        required_mm: gap that corridors of these robots keep to each pair, shape (p,).
    """

    def __init__(
        self, plan: SegmentPlan, rows: Rows, idle: Mask, allowance_mm: float, max_segments: int
    ):
        self.plan, self.rows, self._max_segments = plan, rows, max_segments
        in_conflict = plan.in_conflict
        provisional = np.zeros(plan.plane.n + plan.plane.fixtures, dtype=bool)
        provisional[: plan.plane.n] = in_conflict & ~plan.is_rounded
        provisional[rows] = False
        self._ignored = np.any(provisional[plan.pairs], axis=1)
        self.required_mm: Floats = np.where(
            self._ignored, _UNCONSTRAINED_MM, plan.most_required_mm + allowance_mm
        )
        acceptable = plan.is_rounded[rows] & ~in_conflict[rows] & ~idle
        self._present_cost = self._cost(plan.motion.counts[rows])
        self._present_cost[~acceptable] = np.inf
        self._best_cost = self._present_cost.copy()
        self._best = SegmentMotion.at_rest(plan.motion.start[rows])

    def unsolved(self) -> Ints:
        """Return the robots without a safe motion, as places in `rows`, shape (k,)."""
        return np.flatnonzero(np.isinf(self._best_cost))

    def longer_than(self, segments: ArrayLike) -> Ints:
        """Return the robots with more segments or without a safe motion.

        Args:
            segments: number of segments of both joints together, shape (m,).

        Returns:
            Places in `rows`, shape (k,).
        """
        return np.flatnonzero(self._best_cost >= np.asarray(segments) + 1)

    def evaluate(self, which: Ints, motion: SegmentMotion, possible: Mask | None = None) -> None:
        """Keep the motions that are shorter than the best so far and safe.

        Args:
            which: the robots, as places in `rows`, shape (k,).
            motion: their motions, of k robots.
            possible: which of them are motions at all, shape (k,); all by default.
        """
        cost = self._cost(motion.counts)
        shorter: Mask = cost < self._best_cost[which]
        shorter &= ~motors_broken(self.plan.plane, motion, self.rows[which])
        promising = np.flatnonzero(shorter if possible is None else possible & shorter)
        if len(promising) == 0:
            return
        which, cost = which[promising], cost[promising]
        motion = motion.of_robots(promising)
        plan, rows = self.plan, self.rows[which]
        pairs = plan.pairs_of(rows)
        pairs = pairs[~self._ignored[pairs]]
        unsafe = plan.robots_in(pairs[plan.unproven(pairs, rows, motion)])[rows]
        which, safe = which[~unsafe], np.flatnonzero(~unsafe)
        self._best_cost[which] = cost[safe]
        self._best = self._best.with_robots(which, motion.of_robots(safe))

    def commit(self) -> Ints:
        """Assign each robot its best motion where that is an improvement.

        Returns:
            The robots that got a new motion, as places in `rows`, shape (k,).
        """
        better = np.flatnonzero(self._best_cost < self._present_cost)
        if len(better):
            self.plan.assign(self.rows[better], self._best.of_robots(better))
        return better

    def _cost(self, counts: Ints) -> Floats:
        # segments of both joints; two and two cost less than one and three
        longest = counts.max(axis=1)
        cost = counts.sum(axis=1) + longest / (2.0 * self._max_segments + 2.0)
        return np.where(longest <= self._max_segments, cost, np.inf)

"""What robots choose at their turn: the fewest segments that are proven safe."""

import numpy as np

from fiber_discretizer.segments import Segments
from fiber_discretizer.sequential.segment_plan import Draft, profile_rows

__all__ = ["Choice"]

_NOT_IN_THE_WAY_MM = -1e6  # gap asked of somebody who has to do something else anyway


class Choice:
    """The best motion seen so far of some robots, no two of them neighbours.

    A motion is safe when its pairs are proven to keep their gaps. Unsettled neighbours that
    are in conflict themselves do not count: they will move otherwise, or not at all.

    Args:
        draft: segments of everybody.
        rows: the robots whose turn it is, shape (m,).
        idle: which of them rest though they are to move, shape (m,).
        allowance_mm: what tubes keep beyond the gaps required, for rounding [mm].
        max_segments: most segments of one motor.

    Attributes:
        asked_mm: gap that tubes of these robots keep to each pair, shape (p,).
    """

    def __init__(self, draft: Draft, rows, idle, allowance_mm: float, max_segments: int):
        self.draft, self.rows, self._most = draft, rows, max_segments
        in_conflict = draft.in_conflict
        in_trouble = np.zeros(draft.plane.n + len(draft.plane.obstacles), dtype=bool)
        in_trouble[: draft.plane.n] = in_conflict & ~draft.settled
        in_trouble[rows] = False
        self._ignored = in_trouble[draft.pairs].any(axis=1)
        self.asked_mm = np.where(
            self._ignored, _NOT_IN_THE_WAY_MM, draft.most_required_mm + allowance_mm
        )
        content = draft.settled[rows] & ~in_conflict[rows] & ~idle
        self._before = self._cost(draft.counts()[rows])
        self._before[~content] = np.inf
        self._best, self._chosen = self._before.copy(), Segments.none(2 * len(rows))

    def without(self) -> np.ndarray:
        """Return those that have no safe motion yet, places in rows, shape (k,)."""
        return np.flatnonzero(np.isinf(self._best))

    def longer_than(self, segments) -> np.ndarray:
        """Return those with more segments than these, shape (m,), or no motion; as without."""
        return np.flatnonzero(self._best >= np.asarray(segments) + 1)

    def consider(self, which, segments: Segments, possible=True) -> None:
        """Take what is shorter than the best so far and safe.

        Args:
            which: robots, places in rows, shape (k,).
            segments: their motions, of 2 k profiles.
            possible: which of them are motions at all, shape (k,).
        """
        cost = self._cost(segments.counts.reshape(-1, 2))
        hopeful = np.flatnonzero(possible & (cost < self._best[which]))
        if len(hopeful) == 0:
            return
        which, cost = which[hopeful], cost[hopeful]
        segments = segments.rows(profile_rows(hopeful))
        draft, rows = self.draft, self.rows[which]
        pairs = draft.pairs_of(rows)
        pairs = pairs[~self._ignored[pairs]]
        unsafe = draft.robots_in(pairs[draft.unproven(pairs, rows, segments)])[rows]
        which, safe = which[~unsafe], np.flatnonzero(~unsafe)
        self._best[which] = cost[safe]
        self._chosen = self._chosen.replaced(profile_rows(which), segments, profile_rows(safe))

    def settle(self) -> np.ndarray:
        """Give each robot what it chose; return which, places in rows, shape (k,)."""
        better = np.flatnonzero(self._best < self._before)
        if len(better):
            chosen = self._chosen.rows(profile_rows(better))
            self.draft.give(self.rows[better], chosen)
        return better

    def _cost(self, counts):
        # segments of both motors; of as many, rather two and two than one and three
        longest = counts.max(axis=1)
        cost = counts.sum(axis=1) + longest / (2.0 * self._most + 2.0)
        return np.where(longest <= self._most, cost, np.inf)

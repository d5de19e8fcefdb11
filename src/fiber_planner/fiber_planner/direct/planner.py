"""The planner: everybody straight to the target at once, and repair where they would meet."""

import time
from collections.abc import Callable

import numba as nb
import numpy as np

from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.search import Search
from fiber_planner.interface import PlannedMotion, ProgressCallback

__all__ = ["DirectPlanner"]


class DirectPlanner:
    """Straight moves over the whole makespan, repaired by guided local search.

    Every motor turns at constant speed from start to goal, all in the time the slowest
    robot would need alone. Robots that would meet try other profiles: windows of that
    time, third angles on the way, other elbows and turns. Where that does not clear
    everybody the makespan is stretched; who cannot be cleared at all is held where it
    is safe. The plan is certified in continuous time before it is returned.

    Args:
        parameters: what to keep apart, how long to search.
        clock: seconds, read only where the parameters set a budget.
    """

    name = "direct"

    def __init__(
        self,
        parameters: DirectParameters | None = None,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.parameters = parameters or DirectParameters()
        self._clock = clock

    def plan(self, problem: Problem, progress: ProgressCallback | None = None) -> PlannedMotion:
        """Plan the motion of every robot, see Planner.plan."""
        plane = problem.plane
        if plane.n == 0:
            nothing = SampledMotion([0.0], np.zeros((0, 2, 1)))
            return PlannedMotion(nothing, np.zeros((0, 2)), np.zeros(0))
        # Robots are taken in the order of their places: the plan does not depend on
        # how they are numbered.
        order = np.lexsort([plane.centers[:, 1], plane.centers[:, 0]])
        # Who stands outside its joint limits may not be moved: an obstacle like the disabled.
        low, high = np.moveaxis(plane.limits, -1, 0)
        inside = ((problem.start >= low) & (problem.start <= high)).all(axis=1)
        movable = plane.with_enabled(plane.enabled & inside)
        sorted_problem = Problem(
            movable.permuted(order), problem.start[order], problem.targets[order]
        )
        found = Search(sorted_problem, self.parameters, progress, self._clock).run()
        back = np.argsort(order)
        _put_in_order(found.q, order)
        found.q.setflags(write=False)
        reason = found.reason[back]
        reason[problem.asked & plane.enabled & ~inside] = Reason.START_OUTSIDE_LIMITS
        rows = np.concatenate([order, np.arange(plane.n, plane.n + len(plane.obstacles))])
        return PlannedMotion(
            SampledMotion(found.time_s, found.q[: plane.n]),
            found.goal[back],
            reason,
            np.sort(rows[found.tangled], axis=1),
        )


@nb.njit(cache=True)
def _put_in_order(q, order):
    # Row i goes to row order[i], in place: q is the largest array there is, and a fresh one
    # of its size costs more than all the moving.
    rows, steps = q.shape[0], q.shape[2]
    there = np.zeros(rows, dtype=np.bool_)
    for first in range(len(order)):
        i = first
        carried = q[first].copy()
        while not there[i]:
            there[i] = True
            i = order[i]
            for joint in range(2):
                for k in range(steps):
                    carried[joint, k], q[i, joint, k] = q[i, joint, k], carried[joint, k]

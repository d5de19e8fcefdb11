# SPDX-License-Identifier: Apache-2.0
"""The planner `direct`: straight motions for all robots, and local search where they collide."""

import time
from collections.abc import Callable

import numba as nb
import numpy as np

from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.shortening import shortest_plan
from fiber_planner.interface import PlannedMotion, ProgressCallback

__all__ = ["DirectPlanner"]


class DirectPlanner:
    """Straight motions over the whole makespan, with guided local search against collisions.

    Both joints of every robot move at constant speed from start to goal, in the time that the
    slowest robot needs alone. Robots that would collide try other profiles: parts of that
    time, third angles on the way, other elbows and turns. If conflicts are left the makespan
    is stretched; a robot that cannot be freed is held at a safe place. The plan is certified
    in continuous time before it is returned.

    Args:
        parameters: clearance to keep, effort to spend.
        clock: seconds, read only if the parameters set a budget.
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
            motion = SampledMotion(np.zeros(1), np.zeros((0, 2, 1)))
            return PlannedMotion(motion, np.zeros((0, 2)), np.zeros(0, dtype=np.int64))
        # Robots are sorted by their places, so that the plan does not depend on the order of
        # the rows.
        order = np.lexsort([plane.centers[:, 1], plane.centers[:, 0]])
        # A robot outside its joint limits may not be moved: an obstacle like the disabled ones.
        low, high = np.moveaxis(plane.limits, -1, 0)
        inside = ((problem.start >= low) & (problem.start <= high)).all(axis=1)
        movable = plane.with_enabled(plane.enabled & inside)
        sorted_problem = Problem(
            movable.permuted(order), problem.start[order], problem.targets[order]
        )
        result = shortest_plan(sorted_problem, self.parameters, progress, self._clock)
        back = np.argsort(order)
        _permute_rows(result.q, order)
        result.q.setflags(write=False)
        reason = result.reason[back]
        reason[problem.asked & plane.enabled & ~inside] = Reason.START_OUTSIDE_LIMITS
        rows = np.concatenate([order, np.arange(plane.n, plane.n + plane.fixtures)])
        return PlannedMotion(
            SampledMotion(result.time_s, result.q[: plane.n]),
            result.goal[back],
            reason,
            np.sort(rows[result.tangled], axis=1),
        )


@nb.njit(cache=True)
def _permute_rows(q, order):
    # Row i goes to row order[i], in place: q is the largest array of a plan, and to allocate
    # a second one costs more than to move all rows.
    rows, steps = q.shape[0], q.shape[2]
    moved = np.zeros(rows, dtype=np.bool_)
    for first in range(len(order)):
        i = first
        carried = q[first].copy()
        while not moved[i]:
            moved[i] = True
            i = order[i]
            for joint in range(2):
                for k in range(steps):
                    carried[joint, k], q[i, joint, k] = q[i, joint, k], carried[joint, k]

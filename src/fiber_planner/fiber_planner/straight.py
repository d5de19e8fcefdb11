# SPDX-License-Identifier: Apache-2.0
"""The planner of corrections: every robot goes straight to the next configuration of its target."""

import numpy as np

from fiber_core import kinematics
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner.goal_selection import travel_s
from fiber_planner.interface import PlannedMotion, ProgressCallback
from fiber_planner.scheduled import ScheduledParameters, timed

__all__ = ["StraightPlanner"]

_LEAST_S = 1e-3
_SLACK = 0.04  # corrections have few conflicts, and need no time in which arms fold


class StraightPlanner:
    """Straight lines in joint space to the nearest elbow and turn, all robots at once.

    For corrections of a degree or so, where no robot has to give way: it searches nothing, and the
    discretizer holds the robots whose motion cannot be certified. No correction flips an elbow.
    Motors with listed speeds get a timetable of moves to the same configurations, as from the
    planner `scheduled`.

    Args:
        most_rad: a robot whose joint would turn further than this stays where it is [rad].
        scheduled: clearance and effort for motors with listed speeds.
    """

    name = "straight"

    def __init__(self, most_rad: float = 0.5, scheduled: ScheduledParameters | None = None):
        self._most_rad = most_rad
        self._scheduled = scheduled or ScheduledParameters(slack=_SLACK)

    def plan(self, problem: Problem, progress: ProgressCallback | None = None) -> PlannedMotion:
        """Plan the motion; see fiber_planner.Planner."""
        plane, start = problem.plane, problem.start
        options, there = kinematics.inverse(plane, problem.targets)
        away = np.abs(options - start[:, None]).max(axis=2)
        away[~there] = np.inf
        rows, best = np.arange(plane.n), np.argmin(away, axis=1)
        near = (away[rows, best] <= self._most_rad) & plane.enabled
        goal = np.where(near[:, None], options[rows, best], start)
        reason = np.where(near, Reason.OK, Reason.GOAL_BLOCKED)
        reason = np.where(plane.enabled, reason, Reason.DISABLED)
        reason = np.where(problem.asked, reason, Reason.NO_TARGET)
        if plane.drive.listed is not None:
            return timed(problem, goal, goal[:, None], reason, self._scheduled, progress)
        time_s = np.array([0.0, max(float(travel_s(problem, goal).max(initial=0.0)), _LEAST_S)])
        return PlannedMotion(SampledMotion(time_s, np.stack([start, goal], axis=2)), goal, reason)

# SPDX-License-Identifier: Apache-2.0
"""Planners: from targets to a collision-free motion of a focal plane.

`plan_targets` is the whole planning stage: it checks targets, plans and gives every robot a
reason. `make_planner` builds a planner by its name. `Planner` is the interface that another
planner implements.
"""

from fiber_planner.direct import DirectParameters, DirectPlanner
from fiber_planner.dnf import (
    DnfArmsPlanner,
    DnfArmsPriorityPlanner,
    DnfParameters,
    DnfPlanner,
    DnfPriorityParameters,
    DnfPriorityPlanner,
)
from fiber_planner.errors import PlannerError
from fiber_planner.goal_selection import choose_goals, lower_bound_s, travel_s
from fiber_planner.interface import (
    PlannedMotion,
    Planner,
    ProgressCallback,
    SpacedPlanner,
    spacing_of,
)
from fiber_planner.pair_bound import PairBound, pair_bound
from fiber_planner.plan_stage import PlanStageResult, plan_assignment, plan_targets
from fiber_planner.registry import (
    DEFAULT_PLANNER,
    LISTED_PLANNER,
    default_planner,
    make_planner,
    parameters_of,
    planners,
)
from fiber_planner.scheduled import ScheduledParameters, ScheduledPlanner
from fiber_planner.straight import StraightPlanner

__all__ = [
    "DEFAULT_PLANNER",
    "DirectParameters",
    "DirectPlanner",
    "DnfArmsPlanner",
    "DnfArmsPriorityPlanner",
    "DnfParameters",
    "DnfPlanner",
    "DnfPriorityParameters",
    "DnfPriorityPlanner",
    "LISTED_PLANNER",
    "PairBound",
    "PlanStageResult",
    "PlannedMotion",
    "Planner",
    "PlannerError",
    "ProgressCallback",
    "ScheduledParameters",
    "ScheduledPlanner",
    "SpacedPlanner",
    "StraightPlanner",
    "choose_goals",
    "default_planner",
    "lower_bound_s",
    "make_planner",
    "pair_bound",
    "parameters_of",
    "plan_assignment",
    "plan_targets",
    "planners",
    "spacing_of",
    "travel_s",
]

"""From targets to motion: the choice of goals and the planners."""

from fiber_planner.dnf import DnfArmsPlanner, DnfParameters, DnfPlanner
from fiber_planner.errors import PlannerError
from fiber_planner.goal_selection import choose_goals, lower_bound_s, travel_s
from fiber_planner.interface import PlannedMotion, Planner, Progress
from fiber_planner.registry import DEFAULT_PLANNER, make_planner, parameters_of, planners

__all__ = [
    "DEFAULT_PLANNER",
    "DnfArmsPlanner",
    "DnfParameters",
    "DnfPlanner",
    "PlannedMotion",
    "Planner",
    "PlannerError",
    "Progress",
    "choose_goals",
    "lower_bound_s",
    "make_planner",
    "parameters_of",
    "planners",
    "travel_s",
]

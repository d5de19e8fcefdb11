"""The planners there are, by name."""

from dataclasses import fields

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
from fiber_planner.interface import Planner

__all__ = ["DEFAULT_PLANNER", "make_planner", "parameters_of", "planners"]

DEFAULT_PLANNER = "direct"

# name -> (parameters, planner): parameters is the frozen dataclass that owns the
# defaults and checks the ranges, planner is called with one of them.
_PLANNERS = {
    "direct": (DirectParameters, DirectPlanner),
    "dnf": (DnfParameters, DnfPlanner),
    "dnf_arms": (DnfParameters, DnfArmsPlanner),
    "dnf_arms_priority": (DnfPriorityParameters, DnfArmsPriorityPlanner),
    "dnf_priority": (DnfPriorityParameters, DnfPriorityPlanner),
}


def planners() -> tuple[str, ...]:
    """Return the names make_planner knows, sorted."""
    return tuple(sorted(_PLANNERS))


def parameters_of(name: str) -> type:
    """Return the parameter class of the planner of that name.

    Raises:
        PlannerError: no such planner.
    """
    if name not in _PLANNERS:
        raise PlannerError(f"no planner is called {name!r}; there are {', '.join(planners())}")
    return _PLANNERS[name][0]


def make_planner(name: str, **parameters) -> Planner:
    """Build the planner of that name.

    Args:
        name: one of planners().
        parameters: fields of the planner's parameter class that differ from its defaults.

    Raises:
        PlannerError: no such planner, no such parameter, or a value out of range.
    """
    parameter_class = parameters_of(name)
    known = [f.name for f in fields(parameter_class)]
    for given in parameters:
        if given not in known:
            raise PlannerError(
                f"planner {name!r} has no parameter {given!r}; it has {', '.join(known)}"
            )
    return _PLANNERS[name][1](parameter_class(**parameters))

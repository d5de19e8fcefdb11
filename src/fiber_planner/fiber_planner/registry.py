# SPDX-License-Identifier: Apache-2.0
"""The planners of this package by name."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import NamedTuple, TypeAlias

from fiber_core.focal_plane import FocalPlane
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
from fiber_planner.scheduled import ScheduledParameters, ScheduledPlanner

__all__ = [
    "DEFAULT_PLANNER",
    "LISTED_PLANNER",
    "Parameters",
    "default_planner",
    "make_planner",
    "parameters_of",
    "planners",
    "suited",
]

DEFAULT_PLANNER = "direct"
LISTED_PLANNER = "scheduled"  # for motors with listed speeds

# The parameter classes: frozen dataclasses that own the defaults and check the ranges.
Parameters: TypeAlias = DirectParameters | DnfParameters | ScheduledParameters


class _Entry(NamedTuple):
    parameters: type[Parameters]
    planner: Callable[..., Planner]  # called with an instance of `parameters`


_PLANNERS = {
    "direct": _Entry(DirectParameters, DirectPlanner),
    "dnf": _Entry(DnfParameters, DnfPlanner),
    "dnf_arms": _Entry(DnfParameters, DnfArmsPlanner),
    "dnf_arms_priority": _Entry(DnfPriorityParameters, DnfArmsPriorityPlanner),
    "dnf_priority": _Entry(DnfPriorityParameters, DnfPriorityPlanner),
    LISTED_PLANNER: _Entry(ScheduledParameters, ScheduledPlanner),
}


def planners() -> tuple[str, ...]:
    """Return the names of the planners of this package, sorted."""
    return tuple(sorted(_PLANNERS))


def suited(name: str, plane: FocalPlane) -> str:
    """Return the name of a planner, or `scheduled` in place of the default for listed speeds.

    Args:
        name: one of planners().
        plane: the focal plane.
    """
    listed = plane.drive.listed is not None
    return LISTED_PLANNER if listed and name == DEFAULT_PLANNER else name


def default_planner(plane: FocalPlane) -> Planner:
    """Return the planner for the motors of a plane: `direct`, or `scheduled` for listed speeds.

    Args:
        plane: the focal plane.
    """
    return make_planner(suited(DEFAULT_PLANNER, plane))


def parameters_of(name: str) -> type[Parameters]:
    """Return the parameter class of a planner.

    Args:
        name: one of planners().

    Raises:
        PlannerError: there is no planner of that name.
    """
    return _entry(name).parameters


def make_planner(planner: str | Planner, **parameters: object) -> Planner:
    """Return a planner: one of this package built by its name, or the given object itself.

    Args:
        planner: one of planners(), or an object that fulfils the interface `Planner`, as a
            planner that is not part of this package.
        parameters: fields of the parameter class that differ from its defaults; only with
            a name, because an object has its parameters already.

    Raises:
        PlannerError: there is no planner of that name, the object is not a planner, or a
            parameter is unknown or out of range.
    """
    if isinstance(planner, str):
        return _built(planner, parameters)
    if isinstance(planner, type) or not isinstance(planner, Planner):
        hint = "; pass an instance of the class" if isinstance(planner, type) else ""
        raise PlannerError(
            f"{planner!r} is no planner: expected an object with a name and a method plan, "
            f"or one of {', '.join(planners())}{hint}"
        )
    if parameters:
        raise PlannerError(
            f"planner {planner.name!r} is an object and has its parameters already, "
            f"got {', '.join(parameters)}"
        )
    return planner


def _entry(name: str) -> _Entry:
    if name not in _PLANNERS:
        raise PlannerError(f"no planner is called {name!r}; there are {', '.join(planners())}")
    return _PLANNERS[name]


def _built(name: str, parameters: dict[str, object]) -> Planner:
    entry = _entry(name)
    known = [field.name for field in fields(entry.parameters)]
    for given in parameters:
        if given not in known:
            raise PlannerError(
                f"planner {name!r} has no parameter {given!r}; it has {', '.join(known)}"
            )
    return entry.planner(replace(entry.parameters(), **parameters))

# SPDX-License-Identifier: Apache-2.0
"""Parameters of the direct planner, their defaults and ranges."""

from dataclasses import dataclass
from typing import ClassVar

from fiber_core.bounds import Range
from fiber_planner.safe_parameters import SafeParameters

__all__ = ["DirectParameters", "effort_share"]

_TINY_PLANE, _LARGE_PLANE, _TIMES = 100, 1000, 4  # see effort_share


@dataclass(frozen=True)
class DirectParameters(SafeParameters):
    """Margin and timing errors, the allowance beyond them, and the effort of the search.

    Args:
        allowance_mm: gap that is planned beyond the one that safety requires [mm];
            discretization and rounding may use it up.
        intervals: approximate number of intervals of the common time grid; every breakpoint
            of a profile is on the grid.
        stretch: longest makespan tried, in units of the time that the slowest robot needs
            alone; if that time is short, the makespan may be as long as it takes to fold, go
            and unfold.
        effort: moves that the local search may evaluate, per robot of the plane. It
            bounds the computing time without a clock, so that a plan is repeatable.
        shortening: moves that further searches for shorter makespans of a crowded plane may
            evaluate, per robot, once a plan is found; 0 returns the first plan.
        budget_s: computing time after which the best certified plan so far is returned [s].
            The plan then depends on the speed of the machine.
        seed: seed of the random numbers.

    Raises:
        PlannerError: a value is out of range.
    """

    RANGES: ClassVar = {
        **SafeParameters.RANGES,
        "allowance_mm": Range(0.0, 1e3),
        "intervals": Range(4, 1024, whole=True),
        "stretch": Range(1.0, 10.0),  # times that of the slowest robot; memory grows with it
        "effort": Range(0.0, 1e6),  # 200 times the default: hours for 5000 robots
        "shortening": Range(0.0, 1e6),
        "budget_s": Range(0.0, float("inf")),
        "seed": Range(0, 2**32 - 1, whole=True),
    }

    allowance_mm: float = 0.03
    intervals: int = 48
    stretch: float = 2.2
    effort: float = 5000.0
    shortening: float = 800.0
    budget_s: float = float("inf")
    seed: int = 0


def effort_share(robots: int) -> int:
    """Return the number of robots for which effort is granted.

    A stuck pair is as hard on a small plane as on a large one: a small plane is granted up to
    _TIMES the effort of its robots, and no more than a large plane has.
    """
    return max(_TINY_PLANE, robots, min(_TIMES * robots, _LARGE_PLANE))

# SPDX-License-Identifier: Apache-2.0
"""Parameters of the decentralized navigation function, their defaults and ranges."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fiber_core import bounds
from fiber_core.array_types import Floats
from fiber_core.bounds import Range, check_ranges
from fiber_core.focal_plane import FocalPlane
from fiber_planner.errors import PlannerError

__all__ = ["DnfParameters", "DnfPriorityParameters"]

_PAPER_SPEED = np.pi  # [rad/s] 30 rpm, the speed for which the paper chose 10 ms
_PAPER_STEP_S = 0.01
_PATIENCE_S, _YIELD_S = 0.05, 0.3
_LEAST_HORIZON_S = 2.5  # the motion time the paper announces
_HORIZON_RATIO = 3.0

_MOST_WAIT_S = 1e5


@dataclass(frozen=True)
class DnfParameters:
    """Weights and ranges of attraction and repulsion, time step and horizon.

    None stands for a value that is computed from the plane.

    Args:
        lambda1: weight of the attraction to the target [1/mm^2].
        lambda2: weight of the repulsion between neighbours [1/s].
        outer_mm: distance of tips below which neighbours repel [mm], the D of the paper; None for
            the plane's envelope.
        inner_mm: distance that tips of neighbours never reach [mm], the d of the paper; None for
            half of outer_mm.
        dt_s: time step [s]; None for the paper's 10 ms at 180 deg/s, longer in
            proportion if the fastest joint is slower.
        tolerance_mm: a tip this near to its target has arrived [mm].
        horizon_s: end of the plan [s], at which robots that have not arrived stay; None for
            three times the time that the slowest robot needs alone, and at least 2.5 s.
        margin_mm: gap between the outlines at the goals, and with dnf_arms at every instant
            [mm].
        sign: sign of the repulsion: 'corrected', or 'printed' for that of the papers, with
            which neighbours attract each other.
        attraction: attraction of the target: 'joint' towards the goal in joint space, or 'tip'
            as printed.
        adaptive: whether steps are shortened near neighbours so that no two come nearer
            than inner_mm; False is the fixed step of the papers.

    Raises:
        PlannerError: a value is out of range.
    """

    # weights of any sensible size; a step from a microsecond; a horizon of 28 hours
    RANGES: ClassVar = {
        "lambda1": Range(1e-12, 1e12),
        "lambda2": Range(0.0, 1e12),
        "outer_mm": Range(bounds.MIN_LENGTH_MM, bounds.MAX_LENGTH_MM),
        "inner_mm": Range(bounds.MIN_LENGTH_MM, bounds.MAX_LENGTH_MM),
        "dt_s": Range(1e-6, 1e3),
        "tolerance_mm": Range(1e-9, bounds.MAX_LENGTH_MM),
        "horizon_s": Range(1e-6, 1e5),
        "margin_mm": Range(0.0, 1e3),
    }
    CHOICES: ClassVar = {"sign": ("corrected", "printed"), "attraction": ("joint", "tip")}

    lambda1: float = 1.0
    lambda2: float = 0.05
    outer_mm: float | None = None
    inner_mm: float | None = None
    dt_s: float | None = None
    tolerance_mm: float = 0.1
    horizon_s: float | None = None
    margin_mm: float = 0.1
    sign: str = "corrected"
    attraction: str = "joint"
    adaptive: bool = True

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, PlannerError)
        for name, choices in self.CHOICES.items():
            if getattr(self, name) not in choices:
                raise PlannerError(f"{name} is {getattr(self, name)!r}, expected one of {choices}")
        if not isinstance(self.adaptive, (bool, np.bool_)):
            raise PlannerError(f"adaptive is {self.adaptive!r}, expected True or False")
        outer, inner = self.outer_mm, self.inner_mm
        if outer is not None and inner is not None and inner >= outer:
            raise PlannerError(f"d is {inner} mm, expected less than D, {outer} mm")

    def radii_mm(self, plane: FocalPlane) -> tuple[float, float]:
        """Return D and d for a plane [mm].

        Raises:
            PlannerError: neither the parameters nor the plane give a D above d.
        """
        outer = plane.envelope_mm if self.outer_mm is None else self.outer_mm
        inner = outer / 2 if self.inner_mm is None else self.inner_mm
        if not outer > inner > 0:
            raise PlannerError(
                f"D is {outer} mm and d is {inner} mm on plane {plane.name!r}, expected D > d > 0"
            )
        return float(outer), float(inner)

    def step_s(self, plane: FocalPlane) -> float:
        """Return the time step for a plane [s]."""
        if self.dt_s is not None:
            return float(self.dt_s)
        return _PAPER_STEP_S * _slowness(plane.speeds)

    def end_s(self, alone_s: float) -> float:
        """Return the horizon [s] of a plan in which the slowest robot needs alone_s alone [s]."""
        if self.horizon_s is not None:
            return float(self.horizon_s)
        return max(_LEAST_HORIZON_S, _HORIZON_RATIO * alone_s)


@dataclass(frozen=True)
class DnfPriorityParameters(DnfParameters):
    """Parameters of the navigation function, and of the priorities that resolve deadlocks.

    Args:
        patience_s: time that a robot stands still before it claims the way [s]; None for
            50 ms at 180 deg/s, longer in proportion if the fastest joint is slower.
        yield_s: time that a robot gives way, and that it claims the way without success [s];
            None for 300 ms at 180 deg/s, longer in the same proportion.
        claims: how often a robot may claim the way.
        rehearsals: how many remedies are rehearsed for robots that arrive late; 0 for none.

    Raises:
        PlannerError: a value is out of range, attraction is not 'joint' (a folded arm is
            a configuration), or steps are not adaptive (they show which robot blocks which).
    """

    RANGES: ClassVar = {
        **DnfParameters.RANGES,
        "patience_s": Range(1e-6, _MOST_WAIT_S),
        "yield_s": Range(1e-6, _MOST_WAIT_S),
        "claims": Range(0, 10_000, whole=True),
        "rehearsals": Range(0, 100, whole=True),
    }

    patience_s: float | None = None
    yield_s: float | None = None
    claims: int = 5
    rehearsals: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.attraction != "joint" or not self.adaptive:
            raise PlannerError(
                f"attraction is {self.attraction!r} and adaptive is {self.adaptive}, "
                "priorities work with 'joint' and True"
            )

    def waits_s(self, speeds: Floats) -> tuple[float, float]:
        """Return patience_s and yield_s for speed limits [rad/s], shape (n, 2)."""
        slowness = _slowness(speeds)
        return (
            _PATIENCE_S * slowness if self.patience_s is None else float(self.patience_s),
            _YIELD_S * slowness if self.yield_s is None else float(self.yield_s),
        )


def _slowness(speeds: Floats) -> int:
    # by how many times the fastest joint is slower than those of the paper
    fastest = float(np.max(speeds, initial=0.0)) or _PAPER_SPEED
    return max(1, round(_PAPER_SPEED / fastest))

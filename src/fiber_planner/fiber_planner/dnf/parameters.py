"""Parameters of the decentralized navigation function, their defaults and ranges."""

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from fiber_core.focal_plane import FocalPlane
from fiber_planner.errors import PlannerError

__all__ = ["DnfParameters", "DnfPriorityParameters"]

_PAPER_SPEED = np.pi  # [rad/s] 30 rpm, the speed for which the paper chose 10 ms
_PAPER_STEP_S = 0.01
_PATIENCE_S, _YIELD_S = 0.05, 0.3
_LEAST_HORIZON_S = 2.5  # the motion time the paper announces
_HORIZON_RATIO = 3.0

_FROM_PLANE = ("outer_mm", "inner_mm", "dt_s", "horizon_s")
_MAY_BE_ZERO = ("lambda2", "margin_mm")
_NUMBERS = ("lambda1", "tolerance_mm", *_MAY_BE_ZERO, *_FROM_PLANE)


@dataclass(frozen=True)
class DnfParameters:
    """How the robots attract and repel, and how finely and how long the law is followed.

    None stands for a value that follows from the plane.

    Args:
        lambda1: weight of the attraction to the target [1/mm^2].
        lambda2: weight of the repulsion between neighbours [1/s].
        outer_mm: D of the paper, distance from which on neighbours repel [mm]; None for
            the plane's target spacing.
        inner_mm: d of the paper, distance they never reach [mm]; None for half of D.
        dt_s: time step [s]; None for the paper's 10 ms at 180 deg/s, longer in
            proportion where the fastest joint is slower.
        tolerance_mm: a tip this near to its target has arrived [mm].
        horizon_s: time after which robots still on their way are given up [s]; None for
            three times the time the slowest robot needs alone, and at least 2.5 s.
        margin_mm: gap kept between the outlines of the goal configurations, and by
            dnf_arms all the way [mm].
        sign: 'corrected', or 'printed' for the repulsion of the papers as printed,
            which attracts.
        attraction: 'joint' towards the chosen configuration, or 'tip' as printed.
        adaptive: whether steps are shortened near neighbours so that none comes nearer
            than d; False is the fixed step of the papers.

    Raises:
        PlannerError: a value is out of range.
    """

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

    def __post_init__(self):
        for name in _NUMBERS:
            value = getattr(self, name)
            if value is None and name in _FROM_PLANE:
                continue
            if not (isinstance(value, Real) and np.isfinite(value) and value >= 0):
                raise PlannerError(f"{name} is {value}, expected a number of at least zero")
            if value == 0 and name not in _MAY_BE_ZERO:
                raise PlannerError(f"{name} is {value}, expected more than zero")
        for name, choices in (("sign", ("corrected", "printed")), ("attraction", ("joint", "tip"))):
            if getattr(self, name) not in choices:
                raise PlannerError(f"{name} is {getattr(self, name)!r}, expected one of {choices}")
        if not isinstance(self.adaptive, (bool, np.bool_)):
            raise PlannerError(f"adaptive is {self.adaptive!r}, expected True or False")
        if None not in (self.outer_mm, self.inner_mm) and self.inner_mm >= self.outer_mm:
            raise PlannerError(f"d is {self.inner_mm} mm, expected less than D, {self.outer_mm} mm")

    def radii_mm(self, plane: FocalPlane) -> tuple[float, float]:
        """Return D and d for a plane [mm].

        Raises:
            PlannerError: neither the parameters nor the plane give a D above d.
        """
        outer = plane.spacing_mm if self.outer_mm is None else self.outer_mm
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
        """Return the horizon [s] when the slowest robot alone would need alone_s [s]."""
        if self.horizon_s is not None:
            return float(self.horizon_s)
        return max(_LEAST_HORIZON_S, _HORIZON_RATIO * alone_s)


@dataclass(frozen=True)
class DnfPriorityParameters(DnfParameters):
    """Parameters of the law with priorities: besides those of the law, how robots give way.

    Args:
        patience_s: how long a robot stands still before it claims the way [s]; None for
            50 ms at 180 deg/s, longer in proportion where the fastest joint is slower.
        yield_s: how long a robot gives way, and how long one that claims the way presses on
            without success [s]; None for 300 ms at 180 deg/s, in proportion likewise.
        claims: how often a robot may claim the way before it is given up.

    Raises:
        PlannerError: a value is out of range, attraction is not 'joint' (a folded arm is
            a configuration), or steps are not adaptive (they show who is hindered by whom).
    """

    patience_s: float | None = None
    yield_s: float | None = None
    claims: int = 5

    def __post_init__(self):
        super().__post_init__()
        for name in ("patience_s", "yield_s"):
            value = getattr(self, name)
            if value is not None and not (
                isinstance(value, Real) and np.isfinite(value) and value > 0
            ):
                raise PlannerError(f"{name} is {value}, expected a number above zero")
        if not isinstance(self.claims, Integral) or self.claims < 0:
            raise PlannerError(f"claims is {self.claims!r}, expected a whole number, at least zero")
        if self.attraction != "joint" or not self.adaptive:
            raise PlannerError(
                f"attraction is {self.attraction!r} and adaptive is {self.adaptive}, "
                "priorities work with 'joint' and True"
            )

    def waits_s(self, speeds) -> tuple[float, float]:
        """Return patience and time of giving way [s] for speed limits [rad/s], shape (n, 2)."""
        slowness = _slowness(speeds)
        return (
            _PATIENCE_S * slowness if self.patience_s is None else float(self.patience_s),
            _YIELD_S * slowness if self.yield_s is None else float(self.yield_s),
        )


def _slowness(speeds):
    # how many times slower than the paper's robots the fastest joint is
    fastest = float(np.max(speeds, initial=0.0)) or _PAPER_SPEED
    return max(1, round(_PAPER_SPEED / fastest))

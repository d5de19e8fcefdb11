"""How trajectories are discretized: every choice there is, with its default."""

from dataclasses import dataclass, field

import numpy as np

from fiber_discretizer.linearize import LINEARIZERS, UnknownOption
from fiber_discretizer.margin import RULES
from fiber_discretizer.quantize import Rounding

__all__ = ["DiscretizeOptions"]


@dataclass(frozen=True)
class DiscretizeOptions:
    """How trajectories are discretized.

    Args:
        method: how profiles are linearized, a name in LINEARIZERS.
        rule: where margins come from, "safe" or "printed" (see free_space_mm).
        first_joint: which motor is done first, 0 theta or 1 phi; the other one gets its
            margin from the new profiles of the first.
        max_segments: most segments of one motor an order can carry.
        cap_rad: margin of a joint nobody is near [rad].
        slack_rad: how far rounding may shift a profile nobody is near [rad].
        rounds: how often robots that fail their certificate are done again, each time
            with half the margin, at last with none.
        start_tolerance_rad: how far from where a robot is its profile may begin [rad].
        speed_tolerance: part by which a profile may exceed the speed limits; the motion
            made of it never does, it takes longer.
        rounding: how the last segments are searched.

    Raises:
        UnknownOption: no such method, rule or joint.
    """

    method: str = "paper"
    rule: str = "safe"
    first_joint: int = 0
    max_segments: int = 15
    cap_rad: float = np.pi
    slack_rad: float = 0.1
    rounds: int = 4
    start_tolerance_rad: float = 1e-3
    speed_tolerance: float = 0.01
    rounding: Rounding = field(default_factory=Rounding)

    def __post_init__(self):
        for name, known in (
            ("method", tuple(LINEARIZERS)),
            ("rule", RULES),
            ("first_joint", (0, 1)),
        ):
            if getattr(self, name) not in known:
                raise UnknownOption(f"{name} is {getattr(self, name)!r}, not one of {known}")

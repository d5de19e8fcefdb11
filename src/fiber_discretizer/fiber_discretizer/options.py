"""How trajectories are discretized: every choice there is, with its default."""

from dataclasses import dataclass, field

from fiber_discretizer.fit.linearize import LINEARIZERS, UnknownOption
from fiber_discretizer.makarem2014.margin import RULES
from fiber_discretizer.quantize import Rounding

__all__ = ["SHARINGS", "DiscretizeOptions"]

SHARINGS = ("turns", "halves")


@dataclass(frozen=True)
class DiscretizeOptions:
    """How trajectories are discretized.

    Args:
        sharing: how neighbours share the space between them: "turns" (see turns.py) or
            "halves", the seven steps of the paper (see halves.py).
        method: how profiles are linearized, a name in LINEARIZERS.
        rule: where the margins of "halves" come from, "safe" or "printed" (see margin.py).
        first_joint: which motor is done first where both are, 0 theta or 1 phi; the other
            one then knows the new profile of the first.
        max_segments: most segments of one motor an order can carry.
        rounds: how often robots without a safe motion are done again; with "halves" each
            time with half the margin, at last with none.
        reach_rad: how far "turns" lets a joint leave what it is meant to do.
        allowance_mm: what its tubes keep beyond the gap required, for rounding.
        slack_rad: how far rounding may shift a profile beside a neighbour.
        start_tolerance_rad: how far from where a robot is its profile may begin [rad].
        speed_tolerance: part by which a profile may exceed the speed limits; the motion
            made of it never does, it takes longer.
        rounding: how the last segments are searched.

    Raises:
        UnknownOption: no such sharing, method, rule or joint.
    """

    sharing: str = "turns"
    method: str = "relaxed"
    rule: str = "safe"
    first_joint: int = 0
    max_segments: int = 15
    rounds: int = 4
    reach_rad: float = 1.6
    allowance_mm: float = 0.005
    slack_rad: float = 0.005
    start_tolerance_rad: float = 1e-3
    speed_tolerance: float = 0.01
    rounding: Rounding = field(default_factory=Rounding)

    def __post_init__(self):
        for name, known in (
            ("sharing", SHARINGS),
            ("method", tuple(LINEARIZERS)),
            ("rule", RULES),
            ("first_joint", (0, 1)),
        ):
            if getattr(self, name) not in known:
                raise UnknownOption(f"{name} is {getattr(self, name)!r}, not one of {known}")

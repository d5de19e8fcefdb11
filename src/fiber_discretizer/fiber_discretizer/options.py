# SPDX-License-Identifier: Apache-2.0
"""Options of the discretizer, with their defaults."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, TypeAlias

from fiber_core.bounds import MAX_ANGLE_RAD, Range, check_ranges
from fiber_discretizer.errors import OptionError, UnknownOption
from fiber_discretizer.fit.linearize import LINEARIZERS
from fiber_discretizer.quantize import Rounding

__all__ = ["RULES", "SHARINGS", "DiscretizeOptions", "ProgressCallback"]

SHARINGS = ("sequential", "makarem2014")
RULES = ("safe", "printed")

# Called from time to time with the fraction of the work that is done, 0..1, and a short text. It
# ends the work by raising an exception.
ProgressCallback: TypeAlias = Callable[[float, str], None]


@dataclass(frozen=True)
class DiscretizeOptions:
    """Options of the discretizer.

    Args:
        sharing: how neighbours share the free space between them. "sequential": robot after
            robot, each with all the space that the others leave (package `sequential`);
            "makarem2014": half of the space each, the seven steps of the paper (package
            `makarem2014`).
        method: how profiles are fitted by straight lines, a name in LINEARIZERS.
        rule: what "makarem2014" counts as free space, "safe" or "printed" (see
            `makarem2014.share`).
        first_joint: the joint that is fitted first where both are, 0 theta or 1 phi; the
            corridor of the other joint is found with the new profile of the first.
        max_segments: largest number of segments of one joint that an order can carry.
        rounds: how often robots without a safe motion are tried again; "makarem2014" halves
            their share each time and tries the last time without any.
        reach_rad: how far "sequential" lets a joint leave its desired profile [rad].
        allowance_mm: gap that corridors keep beyond the required one, for rounding [mm].
        slack_rad: how far rounding may shift a profile that passes a neighbour [rad].
        start_tolerance_rad: largest difference between the present angle of a joint and the
            begin of its profile [rad].
        speed_tolerance: fraction by which a profile may exceed the speed limits; the motion
            that is sent never does, it takes longer.
        rounding: limits of the search for the last segments.

    Raises:
        UnknownOption: the sharing, method, rule or joint does not exist.
        OptionError: a number is not finite, negative or out of bounds; names it.
    """

    RANGES: ClassVar = {
        "max_segments": Range(1, 1000, whole=True),
        "rounds": Range(0, 1000, whole=True),
        "reach_rad": Range(0.0, MAX_ANGLE_RAD),
        "allowance_mm": Range(0.0, 1e3),
        "slack_rad": Range(0.0, MAX_ANGLE_RAD),
        "start_tolerance_rad": Range(0.0, MAX_ANGLE_RAD),
        "speed_tolerance": Range(0.0, 1.0),
    }
    CHOICES: ClassVar = {
        "sharing": SHARINGS,
        "method": tuple(LINEARIZERS),
        "rule": RULES,
        "first_joint": (0, 1),
    }

    sharing: str = "sequential"
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
        for name, known in self.CHOICES.items():
            if getattr(self, name) not in known:
                raise UnknownOption(name, getattr(self, name), known)
        check_ranges(self, self.RANGES, OptionError)

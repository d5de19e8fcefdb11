# SPDX-License-Identifier: Apache-2.0
"""Parameters of planners whose plans keep the margin and survive the timing errors."""

from dataclasses import dataclass
from typing import ClassVar

from fiber_core.bounds import check_ranges
from fiber_core.clearance import Safety
from fiber_planner.errors import PlannerError

__all__ = ["SafeParameters"]


@dataclass(frozen=True)
class SafeParameters:
    """The margin that a plan must keep, and the timing errors that it must survive.

    Args:
        margin_mm: margin, the gap between outlines that must remain at every instant [mm].
        clock_ppm: largest error of a positioner's clock, fast or slow [1e-6].
        start_skew_s: largest difference between the starts of two positioners [s].
        stop_skew_s: largest difference between the stops of two positioners when one must stop
            early [s].
        border_start_skew_s: largest difference between the starts of two positioners of
            different sectors [s].
        border_stop_skew_s: largest difference between the stops of two positioners of different
            sectors [s].

    Raises:
        PlannerError: a value is out of range.
    """

    RANGES: ClassVar = Safety.RANGES

    margin_mm: float = Safety.margin_mm
    clock_ppm: float = Safety.clock_ppm
    start_skew_s: float = Safety.start_skew_s
    stop_skew_s: float = Safety.stop_skew_s
    border_start_skew_s: float = Safety.border_start_skew_s
    border_stop_skew_s: float = Safety.border_stop_skew_s

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, PlannerError)

    @property
    def safety(self) -> Safety:
        """The margin and the timing errors in one value."""
        return Safety(**{name: getattr(self, name) for name in Safety.RANGES})

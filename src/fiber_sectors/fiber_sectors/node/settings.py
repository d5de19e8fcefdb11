# SPDX-License-Identifier: Apache-2.0
"""Parameters of coordinator and sectors."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from fiber_core.bounds import Range, check_ranges
from fiber_sectors.errors import SectorError

__all__ = ["SectorsConfig", "namespace_of"]


@dataclass(frozen=True)
class SectorsConfig:
    """How a plane is shared out.

    Args:
        shares: number of sectors with equally many buses, or the buses of each, as
            "0-3,8; 4-7; 9".
        number: number of this sector, from 0; the coordinator has none.
        patience_s: longest wait for a beat, or its answer, while robots move and the time of
            simulated buses stands still [s].
        call_s: longest wait of the coordinator for the answer to a call [s].
        clock_scale: seconds of the buses in one second of the steady clock of each host: 1 is real
            time. 0: the time of simulated buses goes on when all sectors have come to one instant.

    Raises:
        SectorError: a number is no number or out of bounds.
    """

    RANGES: ClassVar = {
        "number": Range(0, 65535, whole=True),
        "patience_s": Range(0.1, 3600.0),
        "call_s": Range(1.0, 3600.0),
        "clock_scale": Range(0.0, 1.0),
    }

    shares: str = "1"
    number: int = 0
    patience_s: float = 5.0
    call_s: float = 300.0
    clock_scale: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, SectorError)

    @property
    def clock(self) -> Callable[[], float] | None:
        """The time of the buses by the clock of this host [s], None for that of the beats."""
        scale = self.clock_scale
        return (lambda: scale * time.monotonic()) if scale else None

    def wait(self, clock_s: float) -> None:
        """Wait for some seconds of the clock."""
        time.sleep(clock_s / self.clock_scale)


def namespace_of(sector: int) -> str:
    """Return the namespace of a sector in that of its plane."""
    return f"sector_{sector}"

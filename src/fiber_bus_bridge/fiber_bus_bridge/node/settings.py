# SPDX-License-Identifier: Apache-2.0
"""Settings of the bridge that belong to no core: its pace, its captures, and its attempts."""

from dataclasses import dataclass
from typing import ClassVar

from fiber_bus_bridge.errors import BridgeError
from fiber_core.bounds import Range, check_ranges

__all__ = ["AttemptConfig", "ExecutionConfig", "StartConfig"]

_MOST = 1e6  # of attempts, of their seconds, and of simulated seconds per second


@dataclass(frozen=True)
class ExecutionConfig:
    """The pace of the simulated buses, and captures of their traffic.

    Args:
        time_scale: simulated seconds per second; 0 for as fast as possible.
        capture: folder for captures of the bus traffic, one folder in it for each plan; an empty
            text for no captures.
        discovery_s: time in which another bridge of the plane would be seen in the graph, before
            any robot is asked [s].

    Raises:
        BridgeError: a number is no number, negative or out of bounds.
    """

    RANGES: ClassVar = {"time_scale": Range(0.0, _MOST), "discovery_s": Range(0.0, 60.0)}

    time_scale: float = 1.0
    capture: str = ""
    discovery_s: float = 0.25

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, BridgeError)


@dataclass(frozen=True)
class AttemptConfig:
    """How often a plan is tried, around robots that cannot be commanded.

    Args:
        attempts: largest number of attempts of a plan.
        attempt_timeout_s: longest wait for the orders of a later attempt [s].

    Raises:
        BridgeError: a value is no number or out of bounds.
    """

    RANGES: ClassVar = {
        "attempts": Range(1, _MOST, whole=True),
        "attempt_timeout_s": Range(0.0, _MOST),
    }

    attempts: int = 2
    attempt_timeout_s: float = 60.0

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, BridgeError)


@dataclass(frozen=True)
class StartConfig:
    """Which plan the next call of the service start means.

    Args:
        start_plan: stamp of the plan that the next start is for, such as 1700000000.000000123; an
            empty text for the plan that is ready, if no other orders have taken its place.
    """

    start_plan: str = ""

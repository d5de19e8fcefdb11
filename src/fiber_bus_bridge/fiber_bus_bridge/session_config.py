# SPDX-License-Identifier: Apache-2.0
"""Settings of a session: tolerances, timeouts, and the period of the heartbeat."""

from dataclasses import dataclass
from typing import ClassVar

from fiber_bus_bridge.errors import BridgeError
from fiber_core.bounds import MAX_ANGLE_RAD, MAX_LENGTH_MM, Range, check_ranges

__all__ = ["SessionConfig"]


@dataclass(frozen=True)
class SessionConfig:
    """Settings of a session and their defaults.

    Args:
        tolerance_mm: distance from its target within which a tip has reached it [mm].
        start_tolerance_rad: largest distance of the start of an order from the encoders [rad].
        watchdog_ms: longest time that an order may wait on a robot for its GO [ms].
        grace_s: time after the expected arrival of the last robot at which the plan is ended [s].
        silence_ms: longest time that a moving robot continues without a heartbeat [ms].
        heartbeat_period_s: time between two heartbeats [s]. The longer it is, the later the stop
            of a single robot is noticed, which `Safety.stop_skew_s` must contain.
        stretch_s: how much longer than the shortest a heartbeat may take on a bus [s]; a STOP would
            be late by as much. inf on a host without real-time behaviour.
        resumes: how often in a plan the other robots resume after a stop of all.
        counters_kept: whether the counters of a robot outlive a loss of its power and a joint that
            did not follow. Else the place of such a robot is unknown until a camera tells it, or an
            operator vouches for it.

    Raises:
        BridgeError: a value is not a number, negative or out of bounds; names it.
    """

    RANGES: ClassVar = {
        "tolerance_mm": Range(0.0, MAX_LENGTH_MM),
        "start_tolerance_rad": Range(0.0, MAX_ANGLE_RAD),
        "watchdog_ms": Range(0, 2**16 - 1, whole=True),  # 16 bits each in CONFIG
        "grace_s": Range(0.0, 3600.0),
        "silence_ms": Range(0, 2**16 - 1, whole=True),
        "heartbeat_period_s": Range(1e-5, 60.0),
        "stretch_s": Range(0.0, float("inf")),
        "resumes": Range(0, 1000, whole=True),
    }

    tolerance_mm: float = 0.1
    start_tolerance_rad: float = 1e-4
    watchdog_ms: int = 10_000
    grace_s: float = 1.0
    silence_ms: int = 5
    heartbeat_period_s: float = 2.5e-3
    stretch_s: float = 1e-3
    resumes: int = 3
    counters_kept: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.counters_kept, bool):
            raise BridgeError(f"counters_kept must be true or false, got {self.counters_kept!r}")
        check_ranges(self, self.RANGES, BridgeError)

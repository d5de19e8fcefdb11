"""Settings of a session: tolerances, timeouts, and the period of the heartbeat."""

from dataclasses import dataclass

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
    """

    tolerance_mm: float = 0.1
    start_tolerance_rad: float = 1e-4
    watchdog_ms: int = 10_000
    grace_s: float = 1.0
    silence_ms: int = 5
    heartbeat_period_s: float = 2.5e-3
    stretch_s: float = 1e-3
    resumes: int = 3

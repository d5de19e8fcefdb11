"""What can be set of a session: tolerances, how long is waited, how often is looked."""

from dataclasses import dataclass

__all__ = ["SessionConfig"]


@dataclass(frozen=True)
class SessionConfig:
    """Settings of a session and their defaults.

    Args:
        tolerance_mm: distance from its target within which a tip has reached it [mm].
        start_tolerance_rad: how far orders may begin from where encoders are [rad].
        watchdog_ms: how long an order may wait on a robot for its GO [ms].
        grace_s: how long after the last robot should have arrived the plan is ended [s].
        silence_ms: how long a moving robot goes on without hearing from the bridge [ms].
        watch_s: time between two beats [s]; the longer, the later a robot that stops by
            itself is noticed, which `Safety.stop_skew_s` must contain.
        stretch_s: how much longer than usual a beat may take on a bus before all are stopped,
            as a STOP would come as late there [s]; inf where the host keeps no time.
        resumes: how often in a plan those who can go on after all had to stop, without whoever
            was at fault.
    """

    tolerance_mm: float = 0.1
    start_tolerance_rad: float = 1e-4
    watchdog_ms: int = 10_000
    grace_s: float = 1.0
    silence_ms: int = 5
    watch_s: float = 2.5e-3
    stretch_s: float = 1e-3
    resumes: int = 3

# SPDX-License-Identifier: Apache-2.0
"""The terms on which sectors move together, and the skews that follow from them."""

from dataclasses import dataclass
from typing import ClassVar

from fiber_bus_bridge import SessionConfig
from fiber_core.bounds import MAX_SKEW_S, Range, check_ranges
from fiber_core.clearance import Safety
from fiber_sectors.errors import SectorError

__all__ = ["Terms"]


@dataclass(frozen=True)
class Terms:
    """Times on which coordinator and sectors agree.

    Args:
        period_s: time between two beats of the coordinator, and two reports of a sector [s].
        lease_s: time for which a sector may move after it has sent a report that a beat answers
            [s].
        fresh_s: age of the newest beat that each sector has answered, up to which the coordinator
            lets the others move on [s].
        step_s: longest time by which a step of the supervision of a sector may be late while it
            still answers beats [s].
        notice_s: longest time for which robots move without heartbeats [s].
        start_error_s: largest error of the instant at which a sector starts, with the error bound
            of the offset between the clocks of two hosts [s].
        drift_ppm: largest difference between the rates of the clocks of two hosts [1e-6].
        spare: beats that may be lost in a row after the last confirmation before a start fails.
        ready_s: longest time in which a sector loads and verifies its orders [s].
        gone_s: time without a report after which a sector counts as lost [s].

    Raises:
        SectorError: a value is no number or out of bounds, or the lease is too short for its beats.
    """

    RANGES: ClassVar = {
        "period_s": Range(1e-4, MAX_SKEW_S),
        "lease_s": Range(1e-4, MAX_SKEW_S),
        "fresh_s": Range(1e-4, MAX_SKEW_S),
        "step_s": Range(0.0, MAX_SKEW_S),
        "notice_s": Range(0.0, MAX_SKEW_S),
        "start_error_s": Range(0.0, MAX_SKEW_S),
        "drift_ppm": Range(0.0, 1e5),
        "spare": Range(1, 100, whole=True),
        "ready_s": Range(1e-3, 3600.0),
        "gone_s": Range(1e-3, 3600.0),
    }

    period_s: float = 2.5e-3
    lease_s: float = 8.75e-3
    fresh_s: float = 6.25e-3
    step_s: float = 2.5e-3
    notice_s: float = 5e-3
    start_error_s: float = 1e-3
    drift_ppm: float = 100.0
    spare: int = 2
    ready_s: float = 60.0
    gone_s: float = 1.0

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, SectorError)
        # a beat may be lost: the next one still comes in time
        for name, beats in (("lease_s", 3), ("fresh_s", 2)):
            if getattr(self, name) < beats * self.period_s:
                raise SectorError(
                    f"{name} is {getattr(self, name):g} s: {beats} beats take "
                    f"{beats * self.period_s:g} s"
                )

    @property
    def start_skew_s(self) -> float:
        """Largest difference between the instants at which two sectors start [s]."""
        return 2 * self.start_error_s

    @property
    def stop_skew_s(self) -> float:
        """Longest time from the stop of one sector until the robots of all others rest [s].

        A sector that stops at t has answered no beat that was sent after t. So no beat sent after
        t + fresh_s lets another sector move, and a lease ends lease_s after the report that its
        beat answers, which was sent before the beat. The last heartbeat that robots hear follows a
        look at the clock before that end, by less than notice_s (see LeasedBuses), and they rest at
        most notice_s after it. Each of these times runs on a clock that may be slow.
        """
        drift = 1.0 + 1e-6 * self.drift_ppm
        return drift * (self.fresh_s + self.lease_s + 2.0 * self.notice_s)

    def border_skews_s(self, safety: Safety) -> tuple[float, float]:
        """Return the skews of start and stop that two robots of different sectors need [s].

        Each sector has the skews of its own buses as well.

        Args:
            safety: has these.
        """
        return safety.start_skew_s + self.start_skew_s, safety.stop_skew_s + self.stop_skew_s

    def check_session(self, config: SessionConfig) -> None:
        """Check that the robots of a sector keep to these terms.

        Args:
            config: settings of its session.

        Raises:
            SectorError: robots move for longer than `notice_s` without heartbeats, or without end,
                a step lasts longer than `step_s`, or robots rest while their sector still answers
                beats as one that moves; names the values.
        """
        silence_s = 1e-3 * config.silence_ms
        if not 0.0 < silence_s <= self.notice_s:
            raise SectorError(
                f"session.silence_ms is {config.silence_ms}, terms.notice_s {self.notice_s:g} s: "
                f"robots must stop by themselves after {1e3 * self.notice_s:g} ms or sooner, and 0 "
                "is never"
            )
        if config.heartbeat_period_s > self.step_s:
            raise SectorError(
                f"session.heartbeat_period_s is {config.heartbeat_period_s:g} s, terms.step_s "
                f"{self.step_s:g} s: a step lasts as long as that period"
            )
        # it answers until step_s after the time of the next heartbeats
        if silence_s < config.heartbeat_period_s + self.step_s:
            raise SectorError(
                f"session.silence_ms is {config.silence_ms}, session.heartbeat_period_s "
                f"{config.heartbeat_period_s:g} s and terms.step_s {self.step_s:g} s: robots must "
                "move without heartbeats for as long as their sector may wait for its next step"
            )

# SPDX-License-Identifier: Apache-2.0
"""The offset between the clocks of two hosts, measured by the messages that they exchange.

A beat is sent at t1 (coordinator), heard at t2, answered at t3 (sector), and the answer is heard at
t4 (coordinator). No message arrives before it is sent, so the sector's clock is ahead by something
between t3 - t4 and t2 - t1: the middle is off by at most half of what the messages took (RFC 5905).
"""

import math
from typing import NamedTuple

__all__ = ["ClockFit", "Offset"]


class Offset(NamedTuple):
    """How far the clock of a sector is ahead of the coordinator's: between two values [s]."""

    low_s: float
    high_s: float

    @property
    def middle_s(self) -> float:
        """The best estimate [s]."""
        return 0.5 * (self.low_s + self.high_s)

    @property
    def bound_s(self) -> float:
        """Largest error of the best estimate [s]."""
        return 0.5 * (self.high_s - self.low_s)

    def widened(self, by_s: float) -> "Offset":
        """Return the offset with both values further out by a time [s]."""
        return Offset(self.low_s - by_s, self.high_s + by_s)


_UNKNOWN = Offset(-math.inf, math.inf)


class ClockFit:
    """The clock of one sector as the coordinator knows it.

    Args:
        drift_ppm: largest difference between the rates of the two clocks [1e-6].

    Attributes:
        jumps: how often a measurement contradicted those before it: a clock has jumped.
        newest: the newest measurement alone, which no earlier jump can falsify.
    """

    def __init__(self, drift_ppm: float):
        self._drift = 1e-6 * drift_ppm
        self._fitted, self._at_s = _UNKNOWN, 0.0
        self.newest = _UNKNOWN
        self.jumps = 0

    def add(self, sent_s: float, heard_s: float, answered_s: float, back_s: float) -> None:
        """Add a measurement: t1 and t4 on the coordinator's clock, t2 and t3 on the sector's."""
        took_s = self._drift * max(back_s - sent_s, 0.0)
        new = Offset(answered_s - back_s, heard_s - sent_s).widened(took_s)
        before = self.offset(back_s)
        both = Offset(max(new.low_s, before.low_s), min(new.high_s, before.high_s))
        if new.low_s > new.high_s:  # a clock jumped between the beat and its answer
            new = both = _UNKNOWN
            self.jumps += 1
        elif both.low_s > both.high_s:
            both = new
            self.jumps += 1
        self.newest, self._fitted, self._at_s = new, both, back_s

    def offset(self, now_s: float) -> Offset:
        """Return the offset by all measurements since the last jump.

        Args:
            now_s: time of the coordinator [s].
        """
        return self._fitted.widened(self._drift * max(now_s - self._at_s, 0.0))

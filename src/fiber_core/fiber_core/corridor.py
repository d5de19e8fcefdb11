# SPDX-License-Identifier: Apache-2.0
"""Corridors: the interval of angles in which each joint may move at each instant of a motion."""

from dataclasses import dataclass

import numpy as np

from fiber_core.array_types import Floats, Times
from fiber_core.errors import MotionError
from fiber_core.validation import frozen_array

__all__ = ["JointCorridors"]


@dataclass(frozen=True, eq=False)
class JointCorridors:
    """Bounds of the corridor of each joint, at equally spaced instants of a motion.

    The instants of a robot go from 0 to the end of its motion. Nothing is known between them.

    Args:
        lasts_s: time of the last instant of each robot [s], shape (k,).
        low: lowest angle of each joint at each instant [rad], shape (k, 2, t), t >= 2.
        high: highest angle of each joint at each instant [rad], shape (k, 2, t).

    Raises:
        MotionError: shapes do not fit, a value is not finite, a time is negative, or a low
            bound is above the high bound.
    """

    lasts_s: Times
    low: Floats
    high: Floats

    def __post_init__(self):
        k = np.size(self.lasts_s)
        for name, shape in (("lasts_s", (k,)), ("low", (k, 2, None)), ("high", (k, 2, None))):
            value = frozen_array(getattr(self, name), np.float64, shape, name, MotionError)
            if not np.isfinite(value).all():
                wrong = value[~np.isfinite(value)][0]
                raise MotionError(f"{name} must be finite, but holds {wrong}")
            object.__setattr__(self, name, value)
        if self.low.shape != self.high.shape or self.low.shape[2] < 2:
            raise MotionError(
                f"bounds must have the same shape with 2 or more instants, "
                f"got {self.low.shape} and {self.high.shape}"
            )
        if (self.lasts_s < 0).any():
            raise MotionError(f"lasts_s must be 0 or more, got {self.lasts_s.min()}")
        if (self.low > self.high).any():
            row = int(np.argwhere(self.low > self.high)[0][0])
            raise MotionError(f"row {row}: the low bound is above the high bound")

    def __len__(self) -> int:
        return len(self.lasts_s)

    def times_s(self, row: int) -> Times:
        """Return the instants of the robot in a row [s], shape (t,)."""
        return np.linspace(0.0, float(self.lasts_s[row]), self.low.shape[2])

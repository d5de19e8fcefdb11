"""How far joints may turn either way on their motion: corridors as they travel and are drawn."""

from dataclasses import dataclass

import numpy as np

from fiber_core.errors import MotionError
from fiber_core.validation import frozen_array

__all__ = ["JointCorridors"]


@dataclass(frozen=True, eq=False)
class JointCorridors:
    """Walls of the space a joint has, at equally spaced instants from 0 to the end of a motion.

    Nothing is known between these instants.

    Args:
        lasts_s: time of the last instant of each robot [s], shape (k,).
        low: lowest angle of each joint at each instant [rad], shape (k, 2, t), t >= 2.
        high: highest, alike.

    Raises:
        MotionError: shapes do not fit, a value is not finite, a time is negative, or a low
            wall is above the high one.
    """

    lasts_s: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def __post_init__(self):
        k = np.size(self.lasts_s)
        for name, shape in (("lasts_s", (k,)), ("low", (k, 2, None)), ("high", (k, 2, None))):
            value = frozen_array(getattr(self, name), np.float64, shape, name, MotionError)
            if not np.isfinite(value).all():
                raise MotionError(f"{name} holds {value[~np.isfinite(value)][0]}")
            object.__setattr__(self, name, value)
        if self.low.shape != self.high.shape or self.low.shape[2] < 2:
            raise MotionError(f"walls have shapes {self.low.shape} and {self.high.shape}")
        if (self.lasts_s < 0).any():
            raise MotionError(f"a motion lasts {self.lasts_s.min()} s")
        if (self.low > self.high).any():
            row = int(np.argwhere(self.low > self.high)[0][0])
            raise MotionError(f"row {row}: the low wall is above the high one")

    def __len__(self) -> int:
        return len(self.lasts_s)

    def times_s(self, row: int) -> np.ndarray:
        """Instants of one robot [s], shape (t,)."""
        return np.linspace(0.0, self.lasts_s[row], self.low.shape[2])

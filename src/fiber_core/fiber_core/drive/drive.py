# SPDX-License-Identifier: Apache-2.0
"""The drive of a focal plane: how its motors carry out orders, and how well."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core import bounds
from fiber_core.array_types import Angles, Floats
from fiber_core.errors import LayoutError
from fiber_core.validation import frozen_array

__all__ = ["Drive"]

_MAX_RAMP_S = 60.0  # longer than any motion of an instrument
_MIN_ACCELERATION_RAD_S2 = 1e-6
_MAX_UNCERTAINTY_RAD = np.pi  # beyond half a turn nothing is known about a joint


@dataclass(frozen=True, eq=False, init=False)
class Drive:
    """How the motors of all robots carry out orders, one row per robot, theta and phi.

    A motor with a *ramp* spreads each change of its ordered velocity evenly over a fixed time: the
    velocity of the joint is the mean of the ordered velocity over the last `ramp_s`. It ends
    exactly where it was ordered to, `ramp_s` later, and its acceleration is at most the ordered
    change of velocity divided by `ramp_s`. The ramp is the same for all robots, so that robots
    that start and end together keep the geometry of their orders.

    The true angle of a joint is within `uncertainty_rad` of the angle that it reports:
    calibration, hysteresis, non-linearity. All outlines of a robot are grown by as much as they
    can be displaced.

    Args:
        n: number of robots.
        ramp_s: time over which every change of velocity is spread [s]; 0 is none.
        acceleration_rad_s2: highest acceleration of each joint [rad/s2], shape (n, 2) or one
            that broadcasts to it; inf is unlimited.
        uncertainty_rad: largest difference between the true angle of each joint and the reported
            one [rad], shape (n, 2) or one that broadcasts to it.
        name: name of the drive, as in `fiber_core.DRIVES`.

    Raises:
        LayoutError: a shape does not fit or a value is out of range; names the row.
    """

    n: int
    ramp_s: float
    acceleration_rad_s2: Floats
    uncertainty_rad: Angles
    name: str

    def __init__(
        self,
        n: int,
        ramp_s: float = 0.0,
        acceleration_rad_s2: ArrayLike = np.inf,
        uncertainty_rad: ArrayLike = 0.0,
        name: str = "ideal",
    ):
        bounds.check_number(ramp_s, "ramp of the drive [s]", 0.0, _MAX_RAMP_S, LayoutError)
        object.__setattr__(self, "n", int(n))  # the class is frozen
        object.__setattr__(self, "ramp_s", float(ramp_s))
        object.__setattr__(self, "name", name)
        for field, value, low, high in (
            ("acceleration_rad_s2", acceleration_rad_s2, _MIN_ACCELERATION_RAD_S2, np.inf),
            ("uncertainty_rad", uncertainty_rad, 0.0, _MAX_UNCERTAINTY_RAD),
        ):
            array = self._per_joint(value, field)
            outside = ~((array >= low) & (array <= high))  # nan is outside
            if outside.any():
                at = int(np.argmax(outside.any(axis=1)))
                raise LayoutError(
                    f"robot row {at}: {field} must be {low:.6g} to {high:.6g}, "
                    f"got {array[at].tolist()}"
                )
            object.__setattr__(self, field, array)
        if ramp_s == 0.0 and not np.isinf(self.acceleration_rad_s2).all():
            at = int(np.argmax(np.isfinite(self.acceleration_rad_s2).any(axis=1)))
            limit = self.acceleration_rad_s2[at].tolist()
            raise LayoutError(
                f"robot row {at}: an acceleration of {limit} rad/s2 needs a ramp, got 0 s"
            )

    def __eq__(self, other: object) -> bool:
        """Whether both carry out every order in the same way, and have the same name."""
        if not isinstance(other, Drive):
            return NotImplemented
        return (
            (self.n, self.ramp_s, self.name) == (other.n, other.ramp_s, other.name)
            and np.array_equal(self.acceleration_rad_s2, other.acceleration_rad_s2)
            and np.array_equal(self.uncertainty_rad, other.uncertainty_rad)
        )

    def _per_joint(self, value: ArrayLike, name: str) -> NDArray[np.float64]:
        if np.ndim(value) == 2:
            return frozen_array(value, np.float64, (self.n, 2), name, LayoutError)
        shape = (2,) if np.ndim(value) else ()
        row = frozen_array(value, np.float64, shape, name, LayoutError)
        return frozen_array(
            np.broadcast_to(row, (self.n, 2)), np.float64, (self.n, 2), name, LayoutError
        )

    @property
    def is_ideal(self) -> bool:
        """Whether joints follow their orders exactly: no ramp, no limit, no uncertainty."""
        exact = self.ramp_s == 0.0 and not self.uncertainty_rad.any()
        return exact and bool(np.isinf(self.acceleration_rad_s2).all())

    @property
    def largest_step_rad_s(self) -> Floats:
        """Largest change of velocity that each joint may be ordered to make [rad/s], (n, 2)."""
        if self.ramp_s == 0.0:
            return np.full((self.n, 2), np.inf)
        return self.acceleration_rad_s2 * self.ramp_s

    def of_robots(self, rows: ArrayLike) -> "Drive":
        """Return the drive of some robots.

        Args:
            rows: their rows, in the order of the result, shape (k,).
        """
        rows = np.asarray(rows, dtype=np.int64)
        return Drive(
            len(rows),
            self.ramp_s,
            self.acceleration_rad_s2[rows],
            self.uncertainty_rad[rows],
            self.name,
        )

# SPDX-License-Identifier: Apache-2.0
"""The drive of a focal plane: how its motors carry out orders, and how well."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core import bounds
from fiber_core.array_types import Angles, Floats, Ints
from fiber_core.drive.listed import ListedSpeeds
from fiber_core.errors import LayoutError
from fiber_core.validation import frozen_array

__all__ = ["MAX_RAMP_S", "Drive"]

MAX_RAMP_S = 60.0  # longer than any motion of an instrument
_MIN_ACCELERATION_RAD_S2 = 1e-6
_MAX_UNCERTAINTY_RAD = np.pi  # beyond half a turn nothing is known about a joint
_MIN_SCALE, _MAX_SCALE = 0.01, 100.0  # beyond it a gear is not the one that was meant
_MIN_MOTORS_ON = 1e-3


@dataclass(frozen=True, eq=False, init=False)
class Drive:
    """How the motors of all robots carry out orders, one row per robot, theta and phi.

    A motor with a *ramp* spreads each change of its ordered velocity evenly over a fixed time: the
    velocity of the joint is the mean of the ordered velocity over the last `ramp_s`. It ends
    exactly where it was ordered to, `ramp_s` later, and its acceleration is at most the ordered
    change of velocity divided by `ramp_s`. The ramp is the same for all robots, so that robots
    that start and end together keep the geometry of their orders.

    A motor with `listed` speeds has a ramp for each of them and rules for its moves instead; see
    ListedSpeeds. A joint then turns `scale` times as far as its motor, either way.

    The true angle of a joint is within `uncertainty_rad` of the angle that it reports:
    calibration, hysteresis, non-linearity; and after a reversal its gear may lose `lost_motion_rad`
    more. All outlines of a robot are grown by as much as they can be displaced.

    At most the share `motors_on` of the motors of a supply turns at any instant.

    Args:
        n: number of robots.
        ramp_s: time over which every change of velocity is spread [s]; 0 is none.
        acceleration_rad_s2: highest acceleration of each joint [rad/s2], shape (n, 2) or one
            that broadcasts to it; inf is unlimited.
        uncertainty_rad: largest difference between the true angle of each joint and the reported
            one [rad], shape (n, 2) or one that broadcasts to it.
        name: name of the drive, as in `fiber_core.DRIVES`, or `own`.
        listed: the speeds of motors that have only a few; None for any speed.
        scale: turn of each joint by that of its motor, shape (n, 2, 2): robot, joint, direction
            (falling, rising angle), or one that broadcasts to it. It has an effect only on
            listed speeds: other motors are taken to reach the joint speeds of the plane.
        lost_motion_rad: angle that each joint may lose at a reversal [rad], shape (n, 2) or one
            that broadcasts to it.
        supply: number of the power supply of each robot, shape (n,); None for that of its bus.
        motors_on: largest share of the motors of a supply that may turn at once, above 0 to 1.
        ids: ids of the robots for messages, shape (n,); None for their rows.

    Raises:
        LayoutError: a shape does not fit or a value is out of range; names the robot.
    """

    n: int
    ramp_s: float
    acceleration_rad_s2: Floats
    uncertainty_rad: Angles
    name: str
    listed: ListedSpeeds | None
    scale: Floats
    lost_motion_rad: Angles
    supply: Ints | None
    motors_on: float

    def __init__(
        self,
        n: int,
        ramp_s: float = 0.0,
        acceleration_rad_s2: ArrayLike = np.inf,
        uncertainty_rad: ArrayLike = 0.0,
        name: str = "ideal",
        listed: ListedSpeeds | None = None,
        scale: ArrayLike = 1.0,
        lost_motion_rad: ArrayLike = 0.0,
        supply: ArrayLike | None = None,
        motors_on: float = 1.0,
        ids: ArrayLike | None = None,
    ):
        bounds.check_number(ramp_s, "ramp of the drive [s]", 0.0, MAX_RAMP_S, LayoutError)
        bounds.check_number(
            motors_on, "share of motors that may be on", _MIN_MOTORS_ON, 1.0, LayoutError
        )
        object.__setattr__(self, "n", int(n))  # the class is frozen
        object.__setattr__(self, "ramp_s", float(ramp_s))
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "listed", listed)
        object.__setattr__(self, "motors_on", float(motors_on))
        if supply is not None:
            supply = frozen_array(supply, np.int64, (n,), "supply", LayoutError)
        object.__setattr__(self, "supply", supply)
        if listed is not None and ramp_s > 0.0:
            raise LayoutError(f"listed speeds have ramps of their own, got a ramp of {ramp_s} s")
        for field, value, low, high, shape in (
            ("acceleration_rad_s2", acceleration_rad_s2, _MIN_ACCELERATION_RAD_S2, np.inf, (2,)),
            ("uncertainty_rad", uncertainty_rad, 0.0, _MAX_UNCERTAINTY_RAD, (2,)),
            ("scale", scale, _MIN_SCALE, _MAX_SCALE, (2, 2)),
            ("lost_motion_rad", lost_motion_rad, 0.0, _MAX_UNCERTAINTY_RAD, (2,)),
        ):
            array = self._per_joint(value, field, shape)
            outside = ~((array >= low) & (array <= high))  # nan is outside
            if outside.any():
                at = int(np.argmax(outside.reshape(len(array), -1).any(axis=1)))
                raise LayoutError(
                    f"{_robot(ids, at)}: {field} must be {low:.6g} to {high:.6g}, "
                    f"got {array[at].tolist()}"
                )
            object.__setattr__(self, field, array)
        if ramp_s == 0.0 and not np.isinf(self.acceleration_rad_s2).all():
            at = int(np.argmax(np.isfinite(self.acceleration_rad_s2).any(axis=1)))
            limit = self.acceleration_rad_s2[at].tolist()
            raise LayoutError(
                f"{_robot(ids, at)}: an acceleration of {limit} rad/s2 needs a ramp, got 0 s"
            )

    def __eq__(self, other: object) -> bool:
        """Whether both carry out every order in the same way, and have the same name."""
        if not isinstance(other, Drive):
            return NotImplemented
        arrays = ("acceleration_rad_s2", "uncertainty_rad", "scale", "lost_motion_rad", "supply")
        return (
            (self.n, self.ramp_s, self.name) == (other.n, other.ramp_s, other.name)
            and (self.listed, self.motors_on) == (other.listed, other.motors_on)
            and all(np.array_equal(getattr(self, a), getattr(other, a)) for a in arrays)
        )

    def _per_joint(
        self, value: ArrayLike, name: str, shape: tuple[int, ...]
    ) -> NDArray[np.float64]:
        if np.ndim(value) == len(shape) + 1:
            return frozen_array(value, np.float64, (self.n, *shape), name, LayoutError)
        row = frozen_array(value, np.float64, shape if np.ndim(value) else (), name, LayoutError)
        whole = (self.n, *shape)
        return frozen_array(np.broadcast_to(row, whole), np.float64, whole, name, LayoutError)

    @property
    def is_ideal(self) -> bool:
        """Whether joints follow their orders exactly: no ramp, no limit, no uncertainty."""
        exact = not self.has_curves and not self.interval_rad.any() and self.motors_on == 1.0
        return exact and bool(np.isinf(self.acceleration_rad_s2).all())

    @property
    def is_plain(self) -> bool:
        """Whether it is ideal, and nothing else is known about gears and supplies."""
        return self.is_ideal and self.supply is None and bool((self.scale == 1.0).all())

    @property
    def has_curves(self) -> bool:
        """Whether joints follow other curves than those ordered."""
        return self.ramp_s > 0.0 or self.listed is not None

    @property
    def longest_ramp_s(self) -> float:
        """How much longer than its order a joint moves at most [s]."""
        return self.ramp_s if self.listed is None else self.listed.longest_ramp_s

    @property
    def interval_rad(self) -> Angles:
        """How far each joint may be from its reported angle, lost motion included [rad], (n, 2)."""
        return self.uncertainty_rad + self.lost_motion_rad

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
            self.listed,
            self.scale[rows],
            self.lost_motion_rad[rows],
            None if self.supply is None else self.supply[rows],
            self.motors_on,
        )


def _robot(ids: ArrayLike | None, row: int) -> str:
    return f"robot row {row}" if ids is None else f"robot {np.asarray(ids)[row]}"

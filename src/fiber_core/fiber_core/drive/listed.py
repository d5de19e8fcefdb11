# SPDX-License-Identifier: Apache-2.0
"""Motors with a list of speeds: which moves of a joint they can make."""

from dataclasses import dataclass, field, fields
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Floats
from fiber_core.errors import LayoutError
from fiber_core.validation import frozen_array

__all__ = ["ListedSpeeds"]

_MOST_SPEEDS = 6  # that an order can name
_MAX_RAMP_S = 60.0


@dataclass(frozen=True, eq=False)
class ListedSpeeds:
    """The speeds of motors that have only a few, and the rules of a move; the same for all robots.

    A motor rests or turns at one of its speeds. Each speed has a ramp of its own: the joint begins
    and ends to turn evenly over that time, so both ramps together turn it by speed times ramp. A
    move is a run of segments of one velocity; it must turn the motor by `least_rad` of its speed,
    ramps included, and its ramp ends before the next move begins. The last move of a joint is its
    *approach*: it goes in one direction, at one of the speeds, for a distance. Where `returns` is
    set, the move before it goes the same distance back at the same speed, as DESI takes up the play
    of its gears.

    Args:
        speeds_rad_s: speeds of the motors, falling [rad/s], shape (k,).
        ramp_s: time over which a move at each speed begins, and ends [s], shape (k,).
        least_rad: least move of a motor at each speed [rad], shape (k,).
        tolerance_rad_s: largest difference of an ordered speed from a listed one, for the rounding
            of orders [rad/s].
        approach_rad: distance of the approach of theta and phi [rad], 0 for none, shape (2,).
        approach_sign: direction of the approach of theta and phi, -1 or 1, shape (2,).
        approach_speed: number of the speed of the approach.
        returns: whether the approach is preceded by the same distance back.

    Raises:
        LayoutError: a shape does not fit or a value is out of range; names it.
    """

    speeds_rad_s: Floats
    ramp_s: Floats
    least_rad: Floats
    tolerance_rad_s: float = 1e-9
    approach_rad: Floats = field(default_factory=lambda: np.zeros(2))
    approach_sign: Floats = field(default_factory=lambda: np.array([-1.0, 1.0]))
    approach_speed: int = 0
    returns: bool = False

    def __post_init__(self):
        speeds = frozen_array(self.speeds_rad_s, np.float64, (None,), "speeds_rad_s", LayoutError)
        k = len(speeds)
        bounds.check_number(k, "number of speeds", 1, _MOST_SPEEDS, LayoutError, whole=True)
        most = bounds.MAX_SPEED_RAD_S
        for name, shape, low, high in (
            ("speeds_rad_s", (k,), bounds.MIN_SPEED_RAD_S, most),
            ("ramp_s", (k,), 0.0, _MAX_RAMP_S),
            ("least_rad", (k,), 0.0, bounds.MAX_ANGLE_RAD),
            ("approach_rad", (2,), 0.0, bounds.MAX_ANGLE_RAD),
            ("approach_sign", (2,), -1.0, 1.0),
        ):
            value = frozen_array(getattr(self, name), np.float64, shape, name, LayoutError)
            if not ((value >= low) & (value <= high)).all():
                raise LayoutError(f"{name} must be {low:.6g} to {high:.6g}, got {value.tolist()}")
            object.__setattr__(self, name, value)
        if (np.diff(self.speeds_rad_s) >= 0.0).any():
            raise LayoutError(f"speeds must fall, got {self.speeds_rad_s.tolist()} rad/s")
        if not np.isin(self.approach_sign, (-1.0, 1.0)).all():
            signs = self.approach_sign.tolist()
            raise LayoutError(f"approach_sign must be -1 or 1, got {signs}")
        bounds.check_number(
            self.tolerance_rad_s, "tolerance of speeds [rad/s]", 0.0, most, LayoutError
        )
        bounds.check_number(
            self.approach_speed, "approach_speed", 0, k - 1, LayoutError, whole=True
        )

    def __eq__(self, other: object) -> bool:
        """Whether both allow the same moves."""
        if not isinstance(other, ListedSpeeds):
            return NotImplemented
        return bool(np.array_equal(self.numbers, other.numbers))

    @property
    def numbers(self) -> Floats:
        """All values in a row, as tables and messages hold them: k, then the fields in order."""
        values = [np.ravel(getattr(self, each.name)) for each in fields(self)]
        return np.concatenate([[len(self.speeds_rad_s)], *values]).astype(np.float64)

    @classmethod
    def of_numbers(cls, numbers: ArrayLike) -> Self:
        """Return the list that has these `numbers`.

        Raises:
            LayoutError: there are too few or too many, or a value is out of range.
        """
        row = np.asarray(numbers, dtype=np.float64).ravel()
        k = row[0] if len(row) else 0.0
        if not (k in range(1, _MOST_SPEEDS + 1) and len(row) == 8 + 3 * int(k)):
            raise LayoutError(f"{len(row)} numbers do not describe a list of {k:g} speeds")
        sizes = (int(k), int(k), int(k), 1, 2, 2, 1, 1)
        *arrays, sign, speed, returns = np.split(row[1:], np.cumsum(sizes)[:-1])
        speeds, ramp, least, tolerance, approach = arrays
        whole = speed[0] == np.rint(speed[0]) and returns[0] in (0.0, 1.0)
        if not whole:
            raise LayoutError(f"approach_speed and returns are {speed[0]} and {returns[0]}")
        return cls(
            speeds, ramp, least, float(tolerance[0]), approach, sign,
            int(speed[0]), bool(returns[0]),
        )  # fmt: skip

    @property
    def longest_ramp_s(self) -> float:
        """The longest ramp of all speeds [s]."""
        return float(self.ramp_s.max())

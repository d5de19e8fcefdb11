# SPDX-License-Identifier: Apache-2.0
"""What motors, supplies and ranges do not allow, as entries with the values."""

from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_core.drive.breaches import Breaches, MotorRule
from fiber_core.drive.curves import CurveMotion
from fiber_core.drive.drive import Drive
from fiber_core.drive.power import motors_allowed
from fiber_core.motion import SegmentMotion

__all__ = ["accelerations", "approaches", "overloads"]


def accelerations(drive: Drive, curves: SegmentMotion | CurveMotion) -> Breaches:
    """Return the joints that would change their speed too fast: acceleration and limit.

    Args:
        drive: the drive of n robots.
        curves: the curves that it makes of their orders.
    """
    limit, hardest = drive.acceleration_rad_s2, curves.hardest
    too_hard = hardest > limit * (1.0 + 1e-9)
    return Breaches.of(MotorRule.ACCELERATION, too_hard, hardest, most=limit)


def overloads(supply: ArrayLike, share: float, robots: ArrayLike) -> Breaches:
    """Return the robots that are one too many for their supply: motors on, and how many may be.

    Args:
        supply: number of the supply of each robot, shape (n,).
        share: largest share of the motors of a supply that may be on at once.
        robots: the robots that are too many, shape (n,) of bool.
    """
    allowed = motors_allowed(supply, share)
    return Breaches.of(MotorRule.SUPPLY, robots, allowed + 1, most=allowed)


def approaches(drive: Drive, limits: Floats, goals: Floats) -> Breaches:
    """Return the goals whose approach would leave the range of a joint: where it would begin.

    Args:
        drive: the drive of n robots.
        limits: ranges of their joints [rad], shape (n, 2, 2).
        goals: a goal of each [rad], nan for none, shape (n, 2).
    """
    if drive.listed is None:
        return Breaches.none()
    begins = goals - drive.listed.approach_sign * drive.listed.approach_rad
    least, most = limits[..., 0], limits[..., 1]
    outside = (begins < least) | (begins > most)
    return Breaches.of(MotorRule.APPROACH_BEGIN, outside, begins, least, most)

# SPDX-License-Identifier: Apache-2.0
"""Why a drive does not let a robot move as it was told to: sentences with robot and value."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Ids
from fiber_core.drive.curves import CurveMotion
from fiber_core.drive.drive import Drive
from fiber_core.drive.power import motors_allowed
from fiber_core.motion import SegmentMotion

__all__ = ["accelerations_told", "approaches_told", "overloads_told"]

_JOINTS = ("theta", "phi")


def accelerations_told(drive: Drive, curves: SegmentMotion | CurveMotion, ids: Ids) -> list[str]:
    """Return for each joint that would change its speed too fast the acceleration and the limit.

    Args:
        drive: the drive of n robots.
        curves: the curves that it makes of their orders.
        ids: ids of the robots, shape (n,).
    """
    limit, hardest = np.rad2deg(drive.acceleration_rad_s2), np.rad2deg(curves.hardest)
    return [
        f"robot {ids[i]}: {_JOINTS[j]} is to change its speed by "
        f"{hardest[i, j] * drive.ramp_s:.4g} deg/s within its ramp of {drive.ramp_s:.4g} s, at "
        f"{hardest[i, j]:.4g} deg/s2; its motor does {limit[i, j]:.4g} deg/s2 at most"
        for i, j in np.argwhere(hardest > limit * (1.0 + 1e-9))
    ]


def overloads_told(supply: ArrayLike, share: float, robots: ArrayLike, ids: Ids) -> list[str]:
    """Return for each robot that is one too many for its supply how many motors may be on.

    Args:
        supply: number of the supply of each robot, shape (n,).
        share: largest share of the motors of a supply that may be on at once.
        robots: the robots that are too many, shape (n,) of bool.
        ids: ids of the robots, shape (n,).
    """
    groups = np.asarray(supply)
    allowed = motors_allowed(groups, share)
    return [
        f"robot {ids[i]}: its motors are too many for supply {groups[i]}, which feeds {allowed[i]} "
        f"of its {2 * (groups == groups[i]).sum()} motors at once"
        for i in np.flatnonzero(robots)
    ]


def approaches_told(drive: Drive, limits: Floats, goals: Floats, ids: Ids) -> list[str]:
    """Return for each goal where the approach leaves the range of a joint where it would begin.

    Args:
        drive: the drive of k robots.
        limits: ranges of their joints [rad], shape (k, 2, 2).
        goals: a goal of each [rad], shape (k, 2).
        ids: ids of these robots, shape (k,).
    """
    if drive.listed is None:
        return []
    begins = goals - drive.listed.approach_sign * drive.listed.approach_rad
    outside = (begins < limits[..., 0]) | (begins > limits[..., 1])
    return [
        f"robot {ids[i]}: the approach of {_JOINTS[j]} to {np.rad2deg(goals[i, j]):.4g} deg begins "
        f"at {np.rad2deg(begins[i, j]):.4g} deg, its range is "
        f"{np.rad2deg(limits[i, j, 0]):.4g} to {np.rad2deg(limits[i, j, 1]):.4g} deg"
        for i, j in np.argwhere(outside)
    ]

# SPDX-License-Identifier: Apache-2.0
"""Power: how many of the motors of a group turn at once."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_core.drive.curves import CurveMotion
from fiber_core.motion import SegmentMotion

__all__ = ["most_motors_on"]

_SAME_S = 1e-9  # a motor that ends this near to the begin of another one is off by then
_REST_RAD_S = 1e-12


def most_motors_on(motion: SegmentMotion | CurveMotion, groups: ArrayLike) -> Floats:
    """Return the largest share of the motors of each group that turn at the same instant.

    A motor turns while its velocity or its acceleration is not zero.

    Args:
        motion: true joint profiles of all robots.
        groups: number of the group of each robot, as its bus or its supply, shape (n,).

    Returns:
        Shares, 0 to 1, in the order of the group numbers, shape (g,).
    """
    numbers, group = np.unique(np.asarray(groups), return_inverse=True)
    # the sums of a ramp leave a speed of 1e-17 rad/s where a joint rests
    turns = np.abs(motion.velocity_rad_s) > _REST_RAD_S
    if isinstance(motion, CurveMotion):
        turns |= motion.acceleration_rad_s2 != 0.0
    begins = np.round(motion.begins_s[turns] / _SAME_S)
    ends = np.round((motion.begins_s + motion.duration_s)[turns] / _SAME_S)
    of_group = group[motion.parts.owner[turns] // 2]
    # ends before begins at the same instant
    change = np.repeat([-1, 1], len(begins))
    instant = np.concatenate([ends, begins])
    owner = np.concatenate([of_group, of_group])
    order = np.lexsort([change, instant, owner])
    on = np.cumsum(change[order])  # zero again where a group ends
    most = np.zeros(len(numbers), dtype=np.int64)
    np.maximum.at(most, owner[order], on)
    return most / (2.0 * np.bincount(group, minlength=len(numbers)))

# SPDX-License-Identifier: Apache-2.0
"""Power: how many of the motors of a group turn at once."""

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Ints, Mask
from fiber_core.drive.curves import CurveMotion
from fiber_core.motion import SegmentMotion

__all__ = ["most_motors_on", "motors_allowed", "motors_turning", "overloading"]

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
    robot, instant, change = _switches(motion)
    owner = group[robot]
    # ends before begins at the same instant
    order = np.lexsort([change, instant, owner])
    on = np.cumsum(change[order])  # zero again where a group ends
    most = np.zeros(len(numbers), dtype=np.int64)
    np.maximum.at(most, owner[order], on)
    return most / (2.0 * np.bincount(group, minlength=len(numbers)))


def motors_turning(
    motion: SegmentMotion | CurveMotion, groups: ArrayLike, edges_s: ArrayLike
) -> Ints:
    """Return the largest number of motors of each group that turn at once in each bin of time.

    Args:
        motion: true joint profiles of all robots.
        groups: number of the group of each robot, as its bus or its supply, shape (n,).
        edges_s: begins of k bins and the end of the last [s], increasing, shape (k + 1,).

    Returns:
        Numbers in the order of the group numbers, shape (g, k).
    """
    edges = np.asarray(edges_s, dtype=float)
    numbers, group = np.unique(np.asarray(groups), return_inverse=True)
    robot, instant, change = _switches(motion)
    order = np.lexsort([change, instant])
    owner, instant_s, change = group[robot[order]], _SAME_S * instant[order], change[order]
    most = np.zeros((len(numbers), len(edges) - 1), dtype=np.int64)
    for g, own in enumerate(most):
        at_s, on = instant_s[owner == g], np.cumsum(change[owner == g])
        before = np.searchsorted(at_s, edges[:-1], side="left")
        own[:] = np.where(before > 0, on[before - 1] if len(on) else 0, 0)
        place = np.searchsorted(edges, at_s, side="right") - 1
        within = (place >= 0) & (place < len(own))
        np.maximum.at(own, place[within], on[within])
    return most


def motors_allowed(groups: ArrayLike, share: float) -> Ints:
    """Return how many motors of each robot's group may turn at once, shape (n,).

    Args:
        groups: number of the group of each robot, shape (n,).
        share: largest share of the motors of a group, above 0 to 1.
    """
    _, group, robots = np.unique(np.asarray(groups), return_inverse=True, return_counts=True)
    return np.floor(2.0 * robots * share + 1e-9).astype(np.int64)[group]


def overloading(motion: SegmentMotion | CurveMotion, groups: ArrayLike, share: float) -> Mask:
    """Return robots without which no group has more motors on than it may, shape (n,).

    In the order in which motors are switched on, the robot of each motor that is one too many.

    Args:
        motion: true joint profiles of all robots.
        groups: number of the group of each robot, shape (n,).
        share: largest share of the motors of a group that may turn at once, above 0 to 1.
    """
    robot, instant, change = _switches(motion)
    order = np.lexsort([robot, change, instant])
    allowed, groups = motors_allowed(groups, share), np.asarray(groups)
    _, group = np.unique(groups, return_inverse=True)
    return _one_too_many(robot[order], change[order], group, allowed)


def _switches(motion: SegmentMotion | CurveMotion) -> tuple[Ints, Floats, Ints]:
    # for each piece in which a motor turns twice: its robot, the instant, -1 at its end, then 1
    # The sums of a ramp leave a speed of 1e-17 rad/s where a joint rests.
    turns = np.abs(motion.velocity_rad_s) > _REST_RAD_S
    if isinstance(motion, CurveMotion):
        turns |= np.abs(motion.acceleration_rad_s2) > _REST_RAD_S
    begins = np.round(motion.begins_s[turns] / _SAME_S)
    ends = np.round((motion.begins_s + motion.duration_s)[turns] / _SAME_S)
    robot = motion.parts.owner[turns] // 2
    change = np.repeat([-1, 1], len(begins))
    return np.concatenate([robot, robot]), np.concatenate([ends, begins]), change


@nb.njit(cache=True)
def _one_too_many(robot: Ints, change: Ints, group: Ints, allowed: Ints) -> Mask:
    n = len(group)
    held, on = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.int64)
    total = np.zeros(n, dtype=np.int64)
    for k in range(len(robot)):
        i = robot[k]
        if held[i]:
            continue
        on[i] += change[k]
        total[group[i]] += change[k]
        if total[group[i]] > allowed[i]:
            held[i] = True
            total[group[i]] -= on[i]
    return held

# SPDX-License-Identifier: Apache-2.0
"""How far one joint can turn at one instant without touching a neighbour.

A turn by x changes the gap by lever * x at most, so a step of gap / lever touches no neighbour:
a bound is approached in such steps (sphere tracing, Hart 1996) and never crossed.
"""

import math

import numpy as np
from numba import njit

from fiber_core.clearance import posed_gap, swept_gap

__all__ = [
    "FINEST_RAD",
    "least_spare",
    "move_out",
    "pose_bodies",
    "turn_from",
    "turn_on",
    "within_reach",
]

FINEST_RAD = 2e-3  # a smaller step ends the approach
_OUT_RAD = 0.02  # least step out of a neighbour
_FAR_MM = 1e-6  # far above the rounding of a gap

# A scene is (table, robot, bodies, required, poses, work): the outlines, the robot that turns, its
# neighbours with the gaps they need [mm] and their poses at the instant, and two rows to work in.
# An axis is (joint, lever, bottom, top, most steps): the joint that turns, its lever [mm], its
# limits [rad], and the largest number of steps to a bound.


@njit(cache=True)
def move_out(scene, axis, angles, side):
    """Turn the joint until it is out of all neighbours, the deepest first, in `angles`.

    Returns:
        Whether it is out; where that is impossible, `angles` are of no use.
    """
    _, _, bodies, _, _, work = scene
    joint, lever, bottom, top, _ = axis
    spare, count = work[0], len(bodies)
    while _measure(scene, angles, _FAR_MM) < 0.0:
        if side == 0:
            return False
        q = np.argmin(spare[:count])
        while spare[q] < 0.0:
            if not bottom <= angles[joint] <= top:
                return False
            angles[joint] += side * max(-spare[q] / lever, _OUT_RAD)
            spare[q] = _spare_gap(scene, q, angles, _FAR_MM)
    return True


@njit(cache=True)
def turn_from(scene, axis, angles, free, way, reach):
    """Return how far the joint can turn from a free angle, up (+1) or down (-1), at most `reach`.

    Each neighbour has a bound; only the neighbour with the least bound is evaluated again.
    """
    angles[axis[0]] = free
    least_spare(scene, axis, angles, reach)
    return turn_on(scene, axis, angles, free, way, reach)


@njit(cache=True)
def least_spare(scene, axis, angles, reach):
    """Measure the spare gaps to all neighbours for turns up to `reach`; return the least [mm]."""
    return _measure(scene, angles, axis[1] * reach + _FAR_MM)


@njit(cache=True)
def turn_on(scene, axis, angles, free, way, reach):
    """Return the same as turn_from; the spare gaps at the free angle are measured already."""
    work, count = scene[5], len(scene[2])
    joint, lever, most_steps = axis[0], axis[1], axis[4]
    spare, bound = work[0], work[1]
    for q in range(count):
        bound[q] = spare[q] / lever
    steps, turned = 0, reach
    while True:
        q, turned = -1, reach
        for o in range(count):
            if bound[o] < turned:
                q, turned = o, bound[o]
        if q < 0 or steps == most_steps:
            return turned
        steps += 1
        angles[joint] = free + way * turned
        more = _spare_gap(scene, q, angles, lever * (reach - turned) + _FAR_MM) / lever
        if more < FINEST_RAD:
            return turned
        bound[q] = turned + more


@njit(cache=True)
def within_reach(scene, joint, angles, finest_mm, near):
    """Fill in which neighbours the robot can come near, however far the joint turns.

    Args:
        scene: the robot, with the poses of its neighbours.
        joint: the joint that turns.
        angles: the joint angles of the robot [rad], shape (2,).
        finest_mm: spare gap above which a neighbour never counts [mm].
        near: numbers of these neighbours, written.

    Returns:
        How many there are.
    """
    table, i, bodies, required, poses, _ = scene
    c, s = math.cos(angles[0]), math.sin(angles[0])
    count = 0
    for q in range(len(bodies)):
        gap = swept_gap(table, i, joint, c, s, bodies[q], poses[q])
        if gap < required[q] + finest_mm:
            near[count] = q
            count += 1
    return count


@njit(cache=True)
def pose_bodies(motion, bodies, time, poses):
    """Fill in cosine and sine of theta, then of theta + phi, of some bodies at a time."""
    start, offsets, duration, velocity = motion
    for q in range(len(bodies)):
        body, angle = bodies[q], 0.0
        for j in range(2):
            if body < len(start):
                turned = at_begin = start[body, j]
                begins = 0.0
                for k in range(offsets[2 * body + j], offsets[2 * body + j + 1]):
                    if begins > time:
                        break
                    ends = begins + duration[k]
                    turned = at_begin + (min(time, ends) - begins) * velocity[k]
                    at_begin += velocity[k] * duration[k]
                    begins = ends
                angle += turned
            poses[q, 2 * j], poses[q, 2 * j + 1] = math.cos(angle), math.sin(angle)


@njit(cache=True)
def _measure(scene, angles, far):
    # Put the spare gaps to all neighbours into the first row of the work; returns the least. Those
    # above `far` are bounded from below only.
    work, least = scene[5], np.inf
    for q in range(len(scene[2])):
        work[0, q] = _spare_gap(scene, q, angles, far)
        least = min(least, work[0, q])
    return least


@njit(cache=True)
def _spare_gap(scene, q, angles, far):
    # gap to a neighbour less the required gap; a lower bound of it where that is above `far`
    table, i, bodies, required, poses, _ = scene
    pose = poses[q]
    both = angles[0] + angles[1]
    return (
        posed_gap(
            table, i, bodies[q],
            math.cos(angles[0]), math.sin(angles[0]), math.cos(both), math.sin(both),
            pose[0], pose[1], pose[2], pose[3], required[q] + far,
        )
        - required[q]
    )  # fmt: skip

# SPDX-License-Identifier: Apache-2.0
"""The corridor of a joint: how far it can turn at each sample without touching a neighbour.

A turn by x changes the gap by lever * x at most, so a step of gap / lever touches no neighbour:
the bounds are approached in such steps (sphere tracing, Hart 1996) and never crossed.
"""

import math

import numpy as np
from numba import njit

from fiber_core.array_types import Bools, Floats, Rows
from fiber_core.clearance import Neighbours, most_neighbours, posed_gap
from fiber_core.motion import MotionArrays

__all__ = ["FINEST_RAD", "corridor_bounds", "free_intervals"]

FINEST_RAD = 2e-3  # a smaller step ends the approach
_SEARCH_STEPS = 24  # largest number of steps to a bound in a search, which looks for any path
_ALL_STEPS = 1 << 30  # each step is FINEST_RAD or more, so the approach ends by itself
_OUT_RAD = 0.02  # least step out of a neighbour
_FAR_MM = 1e-6  # far above the rounding of a gap


@njit(cache=True, nogil=True)
def corridor_bounds(
    table: Floats,
    levers: Floats,
    limits: Floats,
    motion: MotionArrays,
    neighbours: Neighbours,
    required: Floats,
    rows: Rows,
    joint: int,
    times: Floats,
    desired: Floats,
    side: int,
    reach: float,
) -> tuple[Floats, Floats, Bools]:
    """Return the bounds of a corridor that one joint can pass, all other joints as they are.

    Where the desired angle is not free, the corridor passes on one side of the neighbour that is
    in the way, and intervals before it are traced again on that side if they do not connect. The
    corridor holds at the samples only. Along a neighbour a bound can be too close: it is where 24
    steps end.

    Args:
        table: outlines, from bodies_of.
        levers: farthest point of a robot from the axis of each joint [mm], shape (n, 2).
        limits: joint limits [rad], shape (n, 2, 2).
        motion: the arrays of the motion of all robots.
        neighbours: from neighbours_of.
        required: gap that each pair must keep [mm], shape (p,).
        rows: the robots, shape (m,).
        joint: the joint that turns, 0 theta, 1 phi.
        times: sample times of each robot [s], shape (m, t).
        desired: desired angles of both joints at these times [rad], shape (m, 2, t).
        side: where to pass a neighbour: +1 at higher angles, -1 at lower ones, 0 not at all.
        reach: largest distance of a bound from the desired angle, or from the nearest free
            angle [rad].

    Returns:
        Low and high bounds [rad], shape (m, t), and whether each corridor is open, shape (m,).
    """
    m, t = times.shape
    low, high = desired[:, joint].copy(), desired[:, joint].copy()
    is_open = np.ones(m, np.bool_)
    most = most_neighbours(neighbours)
    poses, work = np.empty((most, 4)), np.empty((2, most))
    for r in range(m):
        i = rows[r]
        first, stop = neighbours.offsets[i], neighbours.offsets[i + 1]
        bodies, pairs = neighbours.body[first:stop], neighbours.pair[first:stop]
        scene = (table, i, bodies, required[pairs], poses, work)
        axis = (
            joint, levers[i, joint], limits[i, joint, 0], limits[i, joint, 1], reach,
            _SEARCH_STEPS,
        )  # fmt: skip
        diverted, begin = False, desired[r, joint, 0]
        for k in range(t):
            # Begin at the desired angle, after a diversion at the free angle before.
            begin = begin if diverted and k < t - 1 else desired[r, joint, k]
            _pose_bodies(motion, bodies, times[r, k], poses)
            passing = side if 0 < k < t - 1 else 0
            begin, low[r, k], high[r, k] = _free_interval(
                scene, axis, desired[r, 1 - joint, k], begin, passing
            )
            diverted = not low[r, k] <= desired[r, joint, k] <= high[r, k]
            if begin == np.inf:
                is_open[r] = False
                break
            # An interval on the other side of a neighbour has to connect to the ones before.
            back, begin_back = k, begin
            while back > 0 and (
                low[r, back] > high[r, back - 1] or high[r, back] < low[r, back - 1]
            ):
                back -= 1
                _pose_bodies(motion, bodies, times[r, back], poses)
                begin_back, low[r, back], high[r, back] = _free_interval(
                    scene, axis, desired[r, 1 - joint, back], begin_back, side
                )
                if begin_back == np.inf or back == 0:
                    is_open[r] = False
                    break
            if not is_open[r]:
                break
    return low, high, is_open


@njit(cache=True)
def free_intervals(
    table: Floats,
    levers: Floats,
    limits: Floats,
    motion: MotionArrays,
    neighbours: Neighbours,
    required: Floats,
    joint: int,
    times: Floats,
    angles: Floats,
    reach: float,
) -> tuple[Floats, Floats]:
    """Return how far one joint of every robot can turn at each sample, all others as they are.

    Each sample stands alone. An interval has no width where the angle is not free.

    Args:
        table: outlines, from bodies_of.
        levers: farthest point of a robot from the axis of each joint [mm], shape (n, 2).
        limits: joint limits [rad], shape (n, 2, 2).
        motion: the arrays of the motion of all robots.
        neighbours: from neighbours_of.
        required: gap that each pair must keep [mm], shape (p,).
        joint: the joint that turns, 0 theta, 1 phi.
        times: sample times of each robot [s], shape (n, t).
        angles: angles of both joints at these times [rad], shape (n, 2, t).
        reach: largest distance of an end of an interval from the angle [rad].

    Returns:
        Low and high ends [rad], shape (n, t). At each end a turn of lever * FINEST_RAD [mm] more
        may use up the gap to a neighbour, or the end is a joint limit or at the full reach.
    """
    n, t = times.shape
    low, high = angles[:, joint].copy(), angles[:, joint].copy()
    most = most_neighbours(neighbours)
    poses, work = np.empty((most, 4)), np.empty((2, most))
    for i in range(n):
        first, stop = neighbours.offsets[i], neighbours.offsets[i + 1]
        bodies, pairs = neighbours.body[first:stop], neighbours.pair[first:stop]
        scene = (table, i, bodies, required[pairs], poses, work)
        axis = (
            joint, levers[i, joint], limits[i, joint, 0], limits[i, joint, 1], reach, _ALL_STEPS,
        )  # fmt: skip
        for k in range(t):
            _pose_bodies(motion, bodies, times[i, k], poses)
            _, low[i, k], high[i, k] = _free_interval(
                scene, axis, angles[i, 1 - joint, k], angles[i, joint, k], 0
            )
    return low, high


@njit(cache=True)
def _free_interval(scene, axis, other_angle, begin, side):
    # The first free angle from `begin` on, in the direction `side`, and the bounds around it at
    # one instant; infinity where no angle is free.
    joint, _, bottom, top, _, _ = axis
    angles = np.empty(2)
    angles[joint], angles[1 - joint] = begin, other_angle
    if not _move_out(scene, axis, angles, side):
        return np.inf, begin, begin
    free = angles[joint]
    if not bottom <= free <= top:
        return (free, free, free) if free == begin else (np.inf, begin, begin)
    low = free - _approach(scene, axis, angles, free, -1)
    high = free + _approach(scene, axis, angles, free, 1)
    return free, low, high


@njit(cache=True)
def _move_out(scene, axis, angles, side):
    # Turn the joint until it is out of all neighbours, the deepest first; False where that is
    # impossible. The spare gaps at the new angle are left in the first row of `work`.
    table, i, bodies, required, poses, work = scene
    joint, lever, bottom, top, reach, _ = axis
    spare, count = work[0], len(bodies)
    far = lever * reach + _FAR_MM  # no turn uses up a gap this large
    least = np.inf
    for q in range(count):
        spare[q] = _spare_gap(table, i, bodies[q], angles, poses[q], required[q], far)
        least = min(least, spare[q])
    while least < 0.0:
        if side == 0:
            return False
        q = np.argmin(spare[:count])
        while spare[q] < 0.0:
            if not bottom <= angles[joint] <= top:
                return False
            angles[joint] += side * max(-spare[q] / lever, _OUT_RAD)
            spare[q] = _spare_gap(table, i, bodies[q], angles, poses[q], required[q], far)
        least = np.inf
        for q in range(count):
            spare[q] = _spare_gap(table, i, bodies[q], angles, poses[q], required[q], far)
            least = min(least, spare[q])
    return True


@njit(cache=True)
def _approach(scene, axis, angles, free, way):
    # How far the joint can turn from a free angle, up (+1) or down (-1). Each neighbour has a
    # bound; only the neighbour with the least bound is evaluated again.
    table, i, bodies, required, poses, work = scene
    joint, lever, bottom, top, reach, most_steps = axis
    spare, bound, count = work[0], work[1], len(bodies)
    farthest = min(free - bottom if way < 0 else top - free, reach)
    for q in range(count):
        bound[q] = spare[q] / lever
    steps, turned = 0, farthest
    while True:
        q, turned = -1, farthest
        for o in range(count):
            if bound[o] < turned:
                q, turned = o, bound[o]
        if q < 0 or steps == most_steps:
            return turned
        steps += 1
        angles[joint] = free + way * turned
        far = lever * (farthest - turned) + _FAR_MM
        more = _spare_gap(table, i, bodies[q], angles, poses[q], required[q], far) / lever
        if more < FINEST_RAD:
            return turned
        bound[q] = turned + more


@njit(cache=True)
def _pose_bodies(motion, bodies, time, poses):
    # cosine and sine of theta, then of theta + phi, of some bodies at a time
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
def _spare_gap(table, i, body, angles, pose, required, far):
    # gap to a neighbour less the required gap; a lower bound of it where that is above `far`
    both = angles[0] + angles[1]
    return (
        posed_gap(
            table, i, body,
            math.cos(angles[0]), math.sin(angles[0]), math.cos(both), math.sin(both),
            pose[0], pose[1], pose[2], pose[3], required + far,
        )
        - required
    )  # fmt: skip

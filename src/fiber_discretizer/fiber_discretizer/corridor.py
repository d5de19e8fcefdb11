# SPDX-License-Identifier: Apache-2.0
"""The corridor of a joint: how far it can turn at each sample without touching a neighbour.

Most bounds of a corridor are never needed: the path that is fitted stays far from them. So bounds
are traced where the desired angle is not free, and elsewhere as far as a path wants to go.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from fiber_core.array_types import Bools, Floats, Rows
from fiber_core.clearance import Neighbours, most_neighbours
from fiber_core.motion import MotionArrays
from fiber_discretizer.tracing import (
    FINEST_RAD,
    least_spare,
    move_out,
    pose_bodies,
    turn_from,
    turn_on,
    within_reach,
)

__all__ = [
    "FINEST_RAD",
    "Corridors",
    "Task",
    "free_intervals",
    "keep_inside",
    "open_corridors",
]

_SEARCH_STEPS = 24  # largest number of steps to a bound in a search, which looks for any path
_ALL_STEPS = 1 << 30  # each step is FINEST_RAD or more, so the approach ends by itself
_FAR_MM = 1e-6  # far above the rounding of a gap


class Task(NamedTuple):
    """One joint of some robots, to be turned among all others as they move.

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
        reach: largest distance of a bound from the desired angle, or from the nearest free
            angle [rad].
    """

    table: Floats
    levers: Floats
    limits: Floats
    motion: MotionArrays
    neighbours: Neighbours
    required: Floats
    rows: Rows
    joint: int
    times: Floats
    desired: Floats
    reach: float


class Corridors(NamedTuple):
    """The corridors of a task, as far as they are traced.

    Args:
        begin: a free angle at each sample, from which the bounds are traced [rad], shape (m, t).
        free: the lowest and the highest angle down to and up to which the joint is known to be
            free [rad], shape (2, m, t).
        bounds: low and high bounds [rad], shape (2, m, t): equal to `free` where they are traced
            to their end, else at the reach or at the limit of the joint.
        is_open: which of the corridors can be passed as far as is known, shape (m,).
    """

    begin: Floats
    free: Floats
    bounds: Floats
    is_open: Bools


@njit(cache=True, nogil=True)
def open_corridors(task: Task, side: int) -> Corridors:
    """Return the corridors of a task, traced where the desired angle is not free.

    There a corridor passes on one side of the neighbour that is in the way, and the intervals
    before it are found again on that side if they do not connect.

    Args:
        task: what turns among what.
        side: where to pass a neighbour: +1 at higher angles, -1 at lower ones, 0 not at all.
    """
    m, t = task.times.shape
    begin = task.desired[:, task.joint].copy()
    corridors = Corridors(begin, np.empty((2, m, t)), np.empty((2, m, t)), np.ones(m, np.bool_))
    corridors.free[:], corridors.bounds[:] = begin, begin
    most = most_neighbours(task.neighbours)
    poses, work = np.empty((most, 4)), np.empty((2, most))
    for r in range(m):
        robot = _robot(task, task.rows[r], _SEARCH_STEPS, poses, work)
        corridors.is_open[r] = _open_corridor(task, corridors, robot, r, side)
    return corridors


@njit(cache=True)
def _open_corridor(task, corridors, robot, r, side):
    # find a free angle at each sample; returns whether these connect
    wish, begin, t = task.desired[r, task.joint], corridors.begin[r], task.times.shape[1]
    if not _begin_at(task, corridors, robot, r, t - 1, wish[t - 1], 0):
        return False
    bottom, top = robot[1][2], robot[1][3]
    diverted = was_outside = False
    for k in range(t):
        # Begin at the desired angle, after a diversion at the free angle before.
        first = begin[k - 1] if diverted and k < t - 1 else wish[k]
        passing = side if 0 < k < t - 1 else 0
        if not _begin_at(task, corridors, robot, r, k, first, passing):
            return False
        was_diverted = diverted
        diverted = not _reaches(task, corridors, robot, r, k, wish[k])
        # An interval on the other side of a neighbour has to connect to the ones before, and one
        # outside the limits of the joint, which has no width.
        outside = not bottom <= begin[k] <= top
        back = k if was_diverted or diverted or outside or was_outside else 0
        was_outside = outside
        while back > 0 and not _connected(task, corridors, robot, r, back):
            back -= 1
            if back == 0 or not _begin_at(task, corridors, robot, r, back, begin[back + 1], side):
                return False
    return True


@njit(cache=True, nogil=True)
def keep_inside(task: Task, corridors: Corridors, places: Rows, paths: Floats, pad: float) -> Bools:
    """Return which paths are inside their corridors; the bounds that the others cross are traced.

    A path is inside where each sample is free between it and the begin of the corridor there.

    Args:
        task: what turns among what.
        corridors: its corridors; traced as far as the paths go.
        places: the corridors of the paths, as places in the rows of the task, shape (c,).
        paths: angles of the paths at the samples [rad], shape (c, t).
        pad: how far on either side of a path the joint has to be free, up to its bound [rad].
    """
    inside = np.ones(len(places), np.bool_)
    most = most_neighbours(task.neighbours)
    poses, work = np.empty((most, 4)), np.empty((2, most))
    for p in range(len(places)):
        r = places[p]
        robot = _robot(task, task.rows[r], _SEARCH_STEPS, poses, work)
        for w in range(2):
            way, bound = 2 * w - 1, corridors.bounds[w, r]
            for k in range(paths.shape[1]):
                goal = way * min(way * paths[p, k] + pad, way * bound[k])
                inside[p] &= _reaches(task, corridors, robot, r, k, goal)
    return inside


@njit(cache=True, nogil=True)
def free_intervals(task: Task) -> tuple[Floats, Floats]:
    """Return how far one joint of every robot can turn at each sample, all others as they are.

    Each sample stands alone. An interval has no width where the angle is not free.

    Args:
        task: what turns among what.

    Returns:
        Low and high ends [rad], shape (m, t). At each end a turn of lever * FINEST_RAD [mm] more
        may use up the gap to a neighbour, or the end is a joint limit or at the full reach.
    """
    m, t = task.times.shape
    low, high = task.desired[:, task.joint].copy(), task.desired[:, task.joint].copy()
    most = most_neighbours(task.neighbours)
    poses, work = np.empty((most, 4)), np.empty((2, most))
    own = np.empty(most, np.int64), np.empty(most), np.empty((most, 4)), np.empty(most, np.int64)
    for r in range(m):
        robot = _robot(task, task.rows[r], _ALL_STEPS, poses, work)
        for k in range(t):
            low[r, k], high[r, k] = _free_interval(task, robot, r, k, own)
    return low, high


@njit(cache=True)
def _free_interval(task, robot, r, k, own):
    # Ends of the interval at one sample. Neighbours out of reach of the joint are left out, which
    # changes no end: each neighbour has a bound of its own.
    scene, axis, angles = robot
    joint, lever, bottom, top, _ = axis
    angles[0], angles[1] = task.desired[r, 0, k], task.desired[r, 1, k]
    here = angles[joint]
    pose_bodies(task.motion, scene[2], task.times[r, k], scene[4])
    bodies, required, poses, near = own
    count = within_reach(scene, joint, angles, lever * FINEST_RAD + _FAR_MM, near)
    for q in range(count):
        bodies[q], required[q] = scene[2][near[q]], scene[3][near[q]]
        for j in range(4):
            poses[q, j] = scene[4][near[q], j]
    part = (scene[0], scene[1], bodies[:count], required[:count], poses, scene[5])
    low, high = max(bottom, here - task.reach), min(top, here + task.reach)
    if not low <= here <= high or least_spare(part, axis, angles, task.reach) < 0.0:
        return here, here
    down = turn_on(part, axis, angles, here, -1, here - low)
    up = turn_on(part, axis, angles, here, 1, high - here)
    return (here - down if down < here - low else low), (here + up if up < high - here else high)


@njit(cache=True)
def _robot(task, i, steps, poses, work):
    # scene and axis of a robot, for `tracing`
    first, stop = task.neighbours.offsets[i], task.neighbours.offsets[i + 1]
    bodies, pairs = task.neighbours.body[first:stop], task.neighbours.pair[first:stop]
    low, high = task.limits[i, task.joint]
    scene = (task.table, i, bodies, task.required[pairs], poses, work)
    return scene, (task.joint, task.levers[i, task.joint], low, high, steps), np.empty(2)


@njit(cache=True)
def _begin_at(task, corridors, robot, r, k, angle, side):
    # Put the begin of a corridor at a sample on the first free angle from an angle on; returns
    # whether there is one.
    scene, axis, angles = robot
    bottom, top = axis[2], axis[3]
    angles[task.joint], angles[1 - task.joint] = angle, task.desired[r, 1 - task.joint, k]
    pose_bodies(task.motion, scene[2], task.times[r, k], scene[4])
    is_free = move_out(scene, axis, angles, side)
    free = angles[task.joint] if is_free else angle
    low, high = max(bottom, free - task.reach), min(top, free + task.reach)
    if not is_free or not low <= free <= high:
        low = high = free
    corridors.begin[r, k] = free
    corridors.free[0, r, k] = corridors.free[1, r, k] = free
    corridors.bounds[0, r, k], corridors.bounds[1, r, k] = low, high
    return is_free and (bottom <= free <= top or free == angle)


@njit(cache=True)
def _reaches(task, corridors, robot, r, k, goal):
    # whether the joint is free up to an angle; its bound is traced that far
    begin = corridors.begin[r, k]
    w = 1 if goal > begin else 0
    way, free, bound = 2 * w - 1, corridors.free[w, r], corridors.bounds[w, r]
    if way * (goal - free[k]) <= 0.0:
        return True
    if free[k] == bound[k]:
        return False
    scene, axis, angles = robot
    end = way * min(way * goal, way * bound[k])
    angles[1 - task.joint] = task.desired[r, 1 - task.joint, k]
    pose_bodies(task.motion, scene[2], task.times[r, k], scene[4])
    turned = turn_from(scene, axis, angles, begin, way, way * (end - begin))
    if turned < way * (end - begin):
        free[k] = bound[k] = begin + way * turned
        return False
    free[k] = end
    return end == goal


@njit(cache=True)
def _connected(task, corridors, robot, r, k):
    # whether the interval at a sample overlaps the one before
    before, here = corridors.begin[r, k - 1], corridors.begin[r, k]
    if _reaches(task, corridors, robot, r, k - 1, here):
        return True
    farthest = corridors.free[1 if here > before else 0, r, k - 1]
    return _reaches(task, corridors, robot, r, k, farthest)

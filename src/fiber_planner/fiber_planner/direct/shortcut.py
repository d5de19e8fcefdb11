# SPDX-License-Identifier: Apache-2.0
"""Shortcuts: breakpoints that are not needed to avoid a collision leave the profiles."""

import math

import numba as nb
import numpy as np

from fiber_core.array_types import Rows
from fiber_core.clearance import most_neighbours
from fiber_planner.direct.coupled import motors_follow
from fiber_planner.direct.plan_state import (
    PlanState,
    commit,
    is_free,
    rank_neighbours,
)
from fiber_planner.direct.profile_sampling import (
    copy_profile,
    fill_two_ramps,
    sample_line,
    sample_via,
)
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.splitmix64 import next_uniform, seeded_rng

__all__ = ["shortcut_profiles"]

_STRAIGHT_RAD = 1e-9
_REMOVED = 0.7  # share of the profiles with a moved breakpoint in which another one is removed
_ANGLE = 0.8  # by which a breakpoint is moved at most [rad]


@nb.njit(cache=True, error_model="numpy", nogil=True)
def shortcut_profiles(
    scene: Scene, plan: PlanState, step_s: float, lines: int, moved: int, rows: Rows
) -> int:
    """Remove breakpoints from the profiles of a plan without conflict while it stays free.

    A robot whose straight motion over the whole time is free of collisions uses it. Otherwise
    profiles of fewer lines are tried, and then breakpoints are removed one by one while the motion
    stays free. A line that joins two pieces is never faster than the faster one of them, and stays
    between their ends; coupled motors are tested. A robot is tried again only after its profile or
    that of a neighbour has changed.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; profiles, costs and folded times are written.
        step_s: length of a grid interval [s].
        lines: how many profiles of fewer lines are tried for each robot with breakpoints.
        moved: how many profiles are tried after that in which a breakpoint is moved, and mostly the
            one beside it removed.
        rows: the robots to visit, in this order, shape (k,).

    Returns:
        Number of robots whose profiles became simpler.
    """
    steps = plan.q.shape[2]
    profile = np.empty((2, steps))
    costs = np.empty(most_neighbours(scene.near))
    order = np.empty((2, len(costs)), dtype=np.int64)
    breaks = np.empty(steps + 1, dtype=np.int64)
    changed = 0
    for row in rows:
        i = int(row)
        if not (scene.movable[i] and plan.shortcut_due[i]):
            continue
        plan.shortcut_due[i] = False
        if _is_straight(plan, i):
            continue
        rank_neighbours(scene, plan, i, order)
        simpler = False
        if _straight_is_free(scene, plan, i, step_s, profile, order, costs):
            commit(scene, plan, i, profile, costs)
            simpler = True
        elif _try_lines(scene, plan, i, step_s, lines, breaks, profile, order, costs):
            simpler = True
        if _move_breaks(scene, plan, i, step_s, moved, breaks, profile, order, costs):
            simpler = True
        for joint in range(2):
            count = _breaks(plan.q[i, joint], breaks)
            at = 1
            while at < count - 1:
                if _free_without_break(
                    scene, plan, i, joint, at, breaks, step_s, profile, order, costs
                ):
                    commit(scene, plan, i, profile, costs)
                    simpler = True
                    count = _breaks(plan.q[i, joint], breaks)
                    at = max(1, at - 1)
                else:
                    at += 1
        if simpler:
            plan.folded[i, 0] = plan.folded[i, 1] = 0
            changed += 1
    return changed


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _breaks(row, out):
    # grid times at which a profile changes its speed, start and arrival included; their number
    last = len(row) - 1
    while last > 0 and row[last - 1] == row[last]:
        last -= 1
    out[0] = 0
    count = 1
    for k in range(1, last):
        if abs(row[k + 1] - 2.0 * row[k] + row[k - 1]) > _STRAIGHT_RAD:
            out[count] = k
            count += 1
    out[count] = last
    return count + 1 if last > 0 else 0


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _lines(row, breaks):
    # number of lines of a profile until its arrival
    return max(0, _breaks(row, breaks) - 1)


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _is_straight(plan, i):
    # whether both joints of a robot go on one line to its goal, or rest if it has none
    last = plan.q.shape[2] - 1
    for joint in range(2):
        s, g = plan.q[i, joint, 0], plan.q[i, joint, last]
        if plan.choice[i] < 0 and g != s:
            return False
        slope = (g - s) / last
        for k in range(1, last):
            if abs(s + slope * k - plan.q[i, joint, k]) > _STRAIGHT_RAD:
                return False
    return True


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _straight_is_free(scene, plan, i, step_s, profile, order, costs):
    # straight lines over the whole time into `profile`; whether they are free of collisions
    last = profile.shape[1] - 1
    for joint in range(2):
        s = plan.q[i, joint, 0]
        g = plan.q[i, joint, last] if plan.choice[i] >= 0 else s
        fill_two_ramps(profile[joint], s, g, g, 0, last, last, last)
    if not motors_follow(scene, i, profile, step_s):
        return False
    return is_free(scene, plan, i, profile, order, costs)


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _try_lines(scene, plan, i, step_s, lines, breaks, profile, order, costs):
    # Give joints profiles to the same end with fewer lines: one line for both joints or for one
    # of them, the other as it is or by way of one more angle. Returns whether one was free.
    last = profile.shape[1] - 1
    rng, found = seeded_rng(scene.key[i], 0), False
    of = _lines(plan.q[i, 0], breaks), _lines(plan.q[i, 1], breaks)
    count = of[0] + of[1]
    for draw in range(lines):
        if count <= min(of[0], 1) + min(of[1], 1):  # one for each joint that moves
            break
        kind = draw % 5
        copy_profile(plan.q[i], profile)
        for joint in range(2):
            s, g, step = profile[joint, 0], profile[joint, last], scene.speed[i, joint] * step_s
            if kind == 0 or kind % 2 == joint:
                sample_line(profile[joint], s, g, step, False, rng)
            elif kind > 2:
                spread = math.pi * next_uniform(rng)
                low, high = scene.low[i, joint], scene.high[i, joint]
                sample_via(profile[joint], s, g, low, high, step, spread, False, rng)
        fewer = _lines(profile[0], breaks) + _lines(profile[1], breaks)
        if fewer < count and motors_follow(scene, i, profile, step_s):
            if is_free(scene, plan, i, profile, order, costs):
                commit(scene, plan, i, profile, costs)
                count, found = fewer, True
    return found


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _free_without_break(scene, plan, i, joint, at, breaks, step_s, profile, order, costs):
    # The robot's profile without breakpoint number `at`, a line from the one before to the one
    # after, into `profile`; whether it is free of collisions.
    copy_profile(plan.q[i], profile)
    row = profile[joint]
    begin, end = breaks[at - 1], breaks[at + 1]
    for k in range(begin + 1, end):
        row[k] = row[begin] + (row[end] - row[begin]) * ((k - begin) / (end - begin))
    if not motors_follow(scene, i, profile, step_s):
        return False
    return is_free(scene, plan, i, profile, order, costs)


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _move_breaks(scene, plan, i, step_s, moved, breaks, profile, order, costs):
    # Remove breakpoints and move those beside them, some also without; whether one was free.
    rng, found = seeded_rng(scene.key[i], 2), False
    for _ in range(moved):
        joint = int(next_uniform(rng) < 0.5)
        count = _breaks(plan.q[i, joint], breaks)
        if count < 3:
            joint = 1 - joint
            count = _breaks(plan.q[i, joint], breaks)
            if count < 3:
                break
        copy_profile(plan.q[i], profile)
        most = scene.speed[i, joint] * step_s
        low, high = scene.low[i, joint], scene.high[i, joint]
        if not _with_moved_break(profile[joint], breaks, count, low, high, most, rng):
            continue
        if motors_follow(scene, i, profile, step_s):
            if is_free(scene, plan, i, profile, order, costs):
                commit(scene, plan, i, profile, costs)
                found = True
    return found


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _with_moved_break(row, breaks, count, low, high, most, rng):
    # A profile with a breakpoint moved between its neighbours, the arrival in time only; mostly
    # one beside it is removed. Returns whether the joint can follow.
    last = len(row) - 1
    at = 1 + int(next_uniform(rng) * (count - 2))
    first, second = at - 1, at + 1
    if next_uniform(rng) < _REMOVED:
        if first > 0 and next_uniform(rng) < 0.5:
            first -= 1
        else:
            second += 1  # beyond the last one the arrival itself is moved
    begin = breaks[first]
    arrives = second == count
    end = last + 1 if arrives else breaks[second]
    if end - begin < 2:
        return False
    time = begin + 1 + int(next_uniform(rng) * (end - begin - 1))
    s, angle = row[begin], row[time]
    if arrives:
        angle = row[last]
    else:
        angle += _ANGLE * next_uniform(rng) ** 2 * (2.0 * next_uniform(rng) - 1.0)
        angle = min(max(angle, low), high)
    g, end = row[min(end, last)], min(end, last)
    if abs(angle - s) > most * (time - begin) or abs(g - angle) > most * (end - time):
        return False
    for k in range(begin + 1, time):
        row[k] = s + (angle - s) * ((k - begin) / (time - begin))
    row[time] = angle
    for k in range(time + 1, end):
        row[k] = angle + (g - angle) * ((k - time) / (end - time))
    return True

# SPDX-License-Identifier: Apache-2.0
"""Moves of the local search that change the present profiles of a robot a little."""

import math

import numba as nb

from fiber_core.array_types import Floats
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.profile_sampling import copy_profile
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.splitmix64 import RngState, next_uniform

__all__ = ["limit_speed", "perturb_profile"]

_IN_TIME = 0.5  # share of the moves that pass the same angles earlier or later
_ANGLE = 0.5 * math.pi  # largest change of an angle [rad]


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def limit_speed(row: Floats, most: float) -> None:
    """Change a profile of one joint where it is too fast, between the same ends.

    The joint follows as fast as it may, and leaves the profile in time to be at its end when the
    time is over. The end is in reach of the start.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,), written.
        most: largest change in one interval [rad].
    """
    last = len(row) - 1
    end = row[last]
    for k in range(1, last):
        row[k] = min(max(row[k], row[k - 1] - most), row[k - 1] + most)
    for k in range(1, last):
        left = most * (last - k)
        row[k] = min(max(row[k], end - left), end + left)


@nb.njit(cache=True, error_model="numpy")
def perturb_profile(
    scene: Scene, plan: PlanState, i: int, step_s: float, rng: RngState, profile: Floats
) -> None:
    """Sample a profile near the robot's present one: other times, or other angles for some time.

    Args:
        scene: the robots and their surroundings.
        plan: the plan.
        i: row of the robot.
        step_s: length of a grid interval [s].
        rng: of the random numbers.
        profile: joint angles on the grid [rad], shape (2, k + 1), written.
    """
    last = profile.shape[1] - 1
    at = 1 + int(next_uniform(rng) * (last - 1))
    copy_profile(plan.q[i], profile)
    kind = next_uniform(rng)
    if kind < _IN_TIME:
        ease = next_uniform(rng)
        come = at + (next_uniform(rng) - 0.5) * last * ease
        come = min(max(come, 0.5), last - 0.5)
        which = int(4.0 * kind / _IN_TIME)  # 2 and 3: both joints
        for joint in range(2):
            if which != 1 - joint:
                _warp(plan.q[i, joint], profile[joint], at, come)
    else:
        joint = int(next_uniform(rng) < 0.5)
        change = _ANGLE * next_uniform(rng) ** 2 * (2.0 * next_uniform(rng) - 1.0)
        wide = 1.0 + next_uniform(rng) * 0.4 * last
        rest = next_uniform(rng) * 0.5 * wide
        row = profile[joint]
        for k in range(1, last):
            share = min(1.0, (wide - abs(k - at)) / (wide - rest))
            if share > 0.0:
                angle = row[k] + share * change
                row[k] = min(max(angle, scene.low[i, joint]), scene.high[i, joint])
    for joint in range(2):
        limit_speed(profile[joint], scene.speed[i, joint] * step_s)


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _warp(before, row, at, come):
    # the angle that a profile has at the time `come` is had at the grid time `at`
    last = len(row) - 1
    for k in range(1, last):
        time = k * come / at if k <= at else last - (last - k) * (last - come) / (last - at)
        j = min(int(time), last - 1)
        row[k] = before[j] + (time - j) * (before[j + 1] - before[j])

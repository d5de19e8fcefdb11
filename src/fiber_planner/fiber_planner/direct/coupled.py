# SPDX-License-Identifier: Apache-2.0
"""Motors in the local search: whether they follow a profile, and moves of coupled ones."""

import math

import numba as nb

from fiber_core.array_types import Floats
from fiber_planner.direct.moves import INFEASIBLE, nearer_fold
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.profile_sampling import (
    least_intervals,
    sample_via,
    sample_window,
)
from fiber_planner.direct.ramps import ramps_follow
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.splitmix64 import RngState, next_uniform

__all__ = ["motors_follow", "sample_by_motors", "sample_legs"]

_ROUNDING = 1.0 + 1e-9
_SAME_RAD = 1e-9


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def motors_follow(scene: Scene, i: int, profile: Floats, step_s: float) -> bool:
    """Return whether the motors of a robot can carry out a profile.

    Motors with a ramp change their speed no faster than they can. Coupled motors and joints stay
    inside their speeds and ranges: between two grid times both joints turn at constant speed, and
    so do the motors. A motor that starts outside its range may come back, but not go farther out.
    Moves of joints that are not coupled are made inside their speeds and ranges.

    Args:
        scene: the robots and their surroundings.
        i: row of the robot.
        profile: joint angles on the grid [rad], shape (2, k + 1).
        step_s: length of a grid interval [s].
    """
    if scene.ramp_s > 0.0:
        for joint in range(2):
            largest = scene.largest_step[i, joint]
            if not ramps_follow(profile[joint], step_s, scene.ramp_s, largest):
                return False
    for m in range(scene.coupling.shape[1]):
        most = scene.speed[i, m] * step_s * _ROUNDING
        low, high = scene.low[i, m] - _SAME_RAD, scene.high[i, m] + _SAME_RAD
        for k in range(1, profile.shape[1]):
            at = profile[m, k]
            if abs(at - profile[m, k - 1]) > most or at < low or at > high:
                return False
        by_theta, by_phi = scene.coupling[i, m]
        most = scene.motor_speed[i, m] * step_s * _ROUNDING
        before = by_theta * profile[0, 0] + by_phi * profile[1, 0]
        low = min(before, scene.motor_range[i, m, 0]) - _SAME_RAD
        high = max(before, scene.motor_range[i, m, 1]) + _SAME_RAD
        for k in range(1, profile.shape[1]):
            at = by_theta * profile[0, k] + by_phi * profile[1, k]
            if abs(at - before) > most or at < low or at > high:
                return False
            before = at
    return True


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def sample_by_motors(
    scene: Scene,
    plan: PlanState,
    i: int,
    number: int,
    many: int,
    step_s: float,
    rng: RngState,
    profile: Floats,
) -> int:
    """Sample a profile of both coupled motors, and write that of the joints.

    A motor that needs all the time turns at constant speed while the other one is free: the joints
    then make a detour together that takes no longer than their straight way.

    Args:
        scene: the robots and their surroundings.
        plan: the plan.
        i: row of the robot.
        number, many: this is move `number` of `many`.
        step_s: length of a grid interval [s].
        rng: of the random numbers.
        profile: joint angles on the grid [rad], shape (2, k + 1), written.

    Returns:
        The option that the profile ends at, -1 if the robot may end anywhere: it ends as before.
    """
    last = profile.shape[1] - 1
    choice = plan.choice[i]
    by_theta_0, by_phi_0 = scene.coupling[i, 0]
    by_theta_1, by_phi_1 = scene.coupling[i, 1]
    theta, phi = plan.q[i, 0, last], plan.q[i, 1, last]
    for m in range(2):  # motor angles in the place of joint angles
        by_theta, by_phi = scene.coupling[i, m]
        s = by_theta * scene.start[i, 0] + by_phi * scene.start[i, 1]
        g = by_theta * theta + by_phi * phi
        per_interval = scene.motor_speed[i, m] * step_s
        if least_intervals(g - s, per_interval) > last:
            return INFEASIBLE
        if next_uniform(rng) < 0.4:
            sample_window(profile[m], s, g, per_interval, rng)
        else:
            ease = 0.1 + 0.9 * number / many
            spread = 2.0 * math.pi * ease * next_uniform(rng)
            dwell = next_uniform(rng) < 0.5
            sample_via(
                profile[m], s, g, scene.motor_range[i, m, 0], scene.motor_range[i, m, 1],
                per_interval, spread, dwell, rng,
            )  # fmt: skip
    determinant = by_theta_0 * by_phi_1 - by_phi_0 * by_theta_1
    for k in range(1, last):
        first, second = profile[0, k], profile[1, k]
        profile[0, k] = (by_phi_1 * first - by_phi_0 * second) / determinant
        profile[1, k] = (by_theta_0 * second - by_theta_1 * first) / determinant
    profile[0, 0], profile[1, 0] = scene.start[i]
    profile[0, last], profile[1, last] = theta, phi
    return choice


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _intervals(scene, i, step_s, theta, phi):
    # the number of grid intervals in which both joints can turn by these angles together
    angles = (theta, phi)
    least = 1
    for joint in range(2):
        least = max(least, least_intervals(angles[joint], scene.speed[i, joint] * step_s))
        by_theta, by_phi = scene.coupling[i, joint]
        turn = by_theta * theta + by_phi * phi
        least = max(least, least_intervals(turn, scene.motor_speed[i, joint] * step_s))
    return least


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def sample_legs(
    scene: Scene,
    plan: PlanState,
    i: int,
    number: int,
    many: int,
    step_s: float,
    rng: RngState,
    profile: Floats,
) -> int:
    """Sample a profile of three legs: fold the arm more or less, turn it, unfold it.

    On each leg both joints turn at constant speed, as fast as joints and motors let them. That is
    what a robot needs to pass a wall in little time. The time that is left is spread over rests
    before, between and after the legs.

    Args:
        scene: the robots and their surroundings.
        plan: the plan.
        i: row of the robot.
        number, many: this is move `number` of `many`.
        step_s: length of a grid interval [s].
        rng: of the random numbers.
        profile: joint angles on the grid [rad], shape (2, k + 1), written.

    Returns:
        The option that the profile ends at, -1 if the robot may end anywhere: it ends as before;
        INFEASIBLE if there is not as much time.
    """
    last = profile.shape[1] - 1
    begin_theta, begin_phi = scene.start[i]
    theta, phi = plan.q[i, 0, last], plan.q[i, 1, last]
    fold = nearer_fold(scene.folded_phi[i], phi)
    nearer = phi if abs(phi - fold) < abs(begin_phi - fold) else begin_phi
    folded = nearer + (fold - nearer) * next_uniform(rng)
    spread = math.pi * number / many * next_uniform(rng)
    low, high = scene.low[i, 0], scene.high[i, 0]
    theta1 = min(max(begin_theta + spread * (2.0 * next_uniform(rng) - 1.0), low), high)
    theta2 = min(max(theta + spread * (2.0 * next_uniform(rng) - 1.0), low), high)
    out = _intervals(scene, i, step_s, theta1 - begin_theta, folded - begin_phi)
    turn = _intervals(scene, i, step_s, theta2 - theta1, 0.0)
    back = _intervals(scene, i, step_s, theta - theta2, phi - folded)
    spare = last - out - turn - back
    if spare < 0:
        return INFEASIBLE
    first = 0 if next_uniform(rng) < 0.5 else int(next_uniform(rng) * (spare + 1))
    second = int(next_uniform(rng) * (spare - first + 1))
    third = int(next_uniform(rng) * (spare - first - second + 1))
    a1 = first + out
    b0, b1 = a1 + second, a1 + second + turn
    c0 = b1 + third
    for k in range(last + 1):
        if k <= b0:
            share = min(max(k - first, 0) / out, 1.0)
            profile[0, k] = begin_theta + (theta1 - begin_theta) * share
            profile[1, k] = begin_phi + (folded - begin_phi) * share
        elif k <= c0:
            profile[0, k] = theta1 + (theta2 - theta1) * min((k - b0) / turn, 1.0)
            profile[1, k] = folded
        else:
            share = min((k - c0) / back, 1.0)
            profile[0, k] = theta2 + (theta - theta2) * share
            profile[1, k] = folded + (phi - folded) * share
    profile[0, last], profile[1, last] = theta, phi
    return plan.choice[i]

# SPDX-License-Identifier: Apache-2.0
"""Compression: the profiles of a plan in less time, where the speed limits allow it."""

import numba as nb

from fiber_core.array_types import Floats, Ints
from fiber_planner.direct.coupled import motors_follow
from fiber_planner.direct.perturbation import limit_speed
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.profile_sampling import fill_two_ramps
from fiber_planner.direct.scene import Scene

__all__ = ["compress_profiles"]


@nb.njit(cache=True, nogil=True)
def compress_profiles(
    scene: Scene, plan: PlanState, profiles: Floats, choice: Ints, step_s: float
) -> None:
    """Give robots the profiles of another plan, all sped up by one factor.

    Two robots that pass each other do so at any speed, if both are sped up. Where a joint would
    exceed its limit it follows as fast as it may, and leaves the profile in time to be at its end
    when the time is over. Only pairs with such a robot can be in conflict then. A robot with an end
    out of reach keeps its profile; one whose coupled motors cannot follow goes straight.

    Args:
        scene: the robots and their surroundings.
        plan: a plan of less time; profiles and choices are written, costs have to be
            computed again.
        profiles: joint angles of the other plan [rad], shape (b, 2, k + 1).
        choice: its choices, shape (n,).
        step_s: length of a grid interval of `plan` [s].
    """
    last, last_before = plan.q.shape[2] - 1, profiles.shape[2] - 1
    for i in range(len(scene.start)):
        in_reach = scene.movable[i]
        for joint in range(2):
            way = abs(profiles[i, joint, last_before] - profiles[i, joint, 0])
            in_reach &= way <= scene.speed[i, joint] * step_s * last
        if not in_reach:
            continue
        plan.choice[i] = choice[i]
        plan.folded[i, 0] = plan.folded[i, 1] = 0
        for joint in range(2):
            row, before = plan.q[i, joint], profiles[i, joint]
            row[0], row[last] = before[0], before[last_before]
            for k in range(1, last):
                at = k * last_before / last
                j = min(int(at), last_before - 1)
                row[k] = before[j] + (at - j) * (before[j + 1] - before[j])
            limit_speed(row, scene.speed[i, joint] * step_s)
        if not motors_follow(scene, i, plan.q[i], step_s):
            for joint in range(2):
                s, g = plan.q[i, joint, 0], plan.q[i, joint, last]
                fill_two_ramps(plan.q[i, joint], s, g, g, 0, last, last, last)

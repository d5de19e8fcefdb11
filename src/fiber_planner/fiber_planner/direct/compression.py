# SPDX-License-Identifier: Apache-2.0
"""Compression: the profiles of a plan in less time, where the speed limits allow it."""

import numba as nb
import numpy as np

from fiber_core.array_types import Floats, Ints
from fiber_planner.direct.coupled import motors_follow
from fiber_planner.direct.perturbation import limit_speed
from fiber_planner.direct.plan_state import PlanState, mark_changed, measure_pairs
from fiber_planner.direct.profile_sampling import fill_two_ramps
from fiber_planner.direct.scene import Scene

__all__ = ["compress_late", "compress_profiles"]


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


def compress_late(scene: Scene, plan: PlanState, intervals: int, step_s: float) -> PlanState | None:
    """Return a plan that ends sooner, None if a robot cannot be at its end by then.

    Robots that rest by then keep their profiles, all others are sped up.

    Args:
        scene: the robots and their surroundings.
        plan: a plan without conflicts, which is not written.
        intervals: grid intervals of the new plan, fewer than the plan has.
        step_s: length of an interval [s].
    """
    n = len(plan.choice)
    late = np.any(plan.q[:n, :, intervals:-1] != plan.q[:n, :, -1:], axis=(1, 2))
    way = np.abs(plan.q[:n, :, -1] - plan.q[:n, :, 0])
    if (late[:, None] & (way > scene.speed * step_s * intervals)).any():
        return None
    sooner = PlanState._make([plan.q[:, :, : intervals + 1].copy(), *map(np.copy, plan[1:])])
    compress_profiles(scene, sooner, plan.q, plan.choice, step_s)
    sooner.q[:n][~late] = plan.q[:n][~late, :, : intervals + 1]
    folded = plan.folded[:, 1] <= intervals
    sooner.folded[folded & ~late] = plan.folded[folded & ~late]
    sooner.weight[:] = 1.0
    rows = np.flatnonzero(late)
    for i in rows.tolist():
        mark_changed(scene, sooner, i)
    measure_pairs(scene, sooner, np.flatnonzero(np.isin(scene.pairs, rows).any(axis=1)))
    return sooner

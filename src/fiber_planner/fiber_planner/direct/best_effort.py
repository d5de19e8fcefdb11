# SPDX-License-Identifier: Apache-2.0
"""Best effort: the robots of a plan with most conflict lose their targets, or rest."""

import numpy as np

from fiber_core.array_types import Bools, Ints
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.scene import Scene

__all__ = ["hold_at_start", "release_worst", "worst_robots"]


def worst_robots(scene: Scene, plan: PlanState, bad: Bools, among: Bools) -> Ints:
    """Return, of every bad pair, the robot with most conflict, if it is among some robots.

    Args:
        scene: the robots and their surroundings.
        plan: the plan, with its weights and costs.
        bad: pairs, shape (p,).
        among: robots, shape (b,).
    """
    total = np.zeros(len(scene.movable))
    for side in range(2):
        np.add.at(total, scene.pairs[bad, side], (plan.weight * plan.cost)[bad])
    total[~among] = -1.0
    a, b = scene.pairs[bad].T
    worst = np.where(total[a] >= total[b], a, b)
    return np.unique(worst[among[worst]])


def release_worst(scene: Scene, plan: PlanState, among: Bools) -> Ints:
    """Let the robots with most conflict end anywhere, and give all pairs equal weights.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; choices, weights and what is due are written.
        among: robots that may lose their targets, shape (b,).

    Returns:
        Rows of the robots that have lost their targets.
    """
    with_target = among.copy()
    with_target[: len(plan.choice)] &= plan.choice >= 0
    worst = worst_robots(scene, plan, plan.cost > 0.0, with_target)
    plan.choice[worst] = -1
    plan.shortcut_due[worst] = True
    plan.weight[:] = 1.0
    return worst


def hold_at_start(scene: Scene, plan: PlanState, rows: Ints) -> Ints:
    """Let robots rest where they start; return the rows of those that had targets.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; profiles and choices are written, costs have to be computed again.
        rows: the robots, shape (k,).
    """
    plan.q[rows] = scene.start[rows][:, :, None]
    plan.changed[rows] = True
    lost = rows[plan.choice[rows] >= 0]
    plan.choice[lost] = -1
    return lost

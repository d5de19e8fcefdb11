# SPDX-License-Identifier: Apache-2.0
"""Profiles of fewer lines for the robots of a certified plan, as far as those are certified too."""

from collections.abc import Callable

import numpy as np

from fiber_core.array_types import Bools
from fiber_planner.direct.blocks import Blocks, shortcut_all
from fiber_planner.direct.plan_state import PlanState, measure_all
from fiber_planner.direct.scene import Scene

__all__ = ["simplify_plan"]


def simplify_plan(
    scene: Scene,
    plan: PlanState,
    step_s: float,
    lines: int,
    blocks: Blocks,
    unconfirmed: Callable[[], Bools],
) -> None:
    """Try many profiles of fewer lines for every robot, and keep those that are certified.

    Robots of pairs that are not confirmed get their profiles of before, and so do those that are in
    conflict with these, until all pairs are confirmed. A pair of which both robots have their
    profiles of before always is.

    Args:
        scene: the robots and their surroundings.
        plan: a certified plan; written.
        step_s: length of a grid interval [s].
        lines: how many profiles of fewer lines are tried, and of such with moved breakpoints.
        blocks: all robots.
        unconfirmed: returns the pairs that the certificate does not confirm, shape (p,); it may
            require more of them in the plan.
    """
    before = plan._replace(
        q=plan.q.copy(),
        choice=plan.choice.copy(),
        folded=plan.folded.copy(),
        required=plan.required.copy(),
    )
    plan.shortcut_due[:] = True
    shortcut_all(scene, plan, step_s, lines, lines, blocks)
    back = np.zeros(len(plan.q), dtype=bool)
    short = unconfirmed()
    while short.any():
        if back[scene.pairs[short]].all(axis=1).any():  # not met
            back[:] = True
        plan.required[:] = before.required
        while short.any():
            back[scene.pairs[short]] = True
            own = back[: len(plan.choice)]
            plan.q[back], plan.choice[own] = before.q[back], before.choice[own]
            plan.folded[own], plan.changed[back] = before.folded[own], True
            measure_all(scene, plan)
            # the rest is as before, also pairs that overlap from the start and cannot part
            short = (plan.cost > 0.0) & ~back[scene.pairs].all(axis=1)
        if back.all():
            break
        short = unconfirmed()

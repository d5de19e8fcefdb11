# SPDX-License-Identifier: Apache-2.0
"""Where a neighbour was in conflict last, its gap alone shows that a profile costs too much."""

import numpy as np

from fiber_core.presets import PRESETS, plane_from
from fiber_core.problem import Problem
from fiber_planner.direct.collision_cost import collision_cost, least_cost_at
from fiber_planner.direct.plan_state import (
    PlanState,
    is_free,
    measure_all,
    rank_neighbours,
    weighted_cost,
)
from fiber_planner.direct.scene import scene_of

_STEPS = 24


def _two_robots(rng, required):
    """Two DESI-like robots on profiles of three lines; they pass each other with little between."""
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [10.4, 0.0]])
    ends = np.array([[[-1.2, 0.9], [1.4, 1.1]], [[1.1, 2.3], [3.3, 2.1]]])
    scene = scene_of(Problem(plane, ends[:, 0], np.full((2, 2), np.nan)))
    q = np.empty((2, 2, _STEPS + 1))
    for i, joint in np.ndindex(2, 2):
        s, g = ends[i, :, joint]
        via = s + (g - s) * np.array([0.3, 0.7]) + rng.uniform(-0.3, 0.3, 2)
        q[i, joint] = np.interp(np.arange(_STEPS + 1), [0, 7, 16, _STEPS], [s, *via, g])
    pairs = len(scene.pairs)
    plan = PlanState(
        q, np.zeros(2, dtype=np.int64), np.full(pairs, required), np.full(pairs, required),
        np.zeros(pairs, dtype=np.int64), np.ones(pairs), np.zeros(pairs),
        np.zeros((2, 2), dtype=np.int64), np.zeros(2, dtype=bool), np.ones(2, dtype=bool),
    )  # fmt: skip
    measure_all(scene, plan)
    return scene, plan


def test_a_remembered_conflict_changes_neither_what_is_free_nor_what_costs_less():
    rng, free, dearer = np.random.default_rng(11), 0, 0
    fresh, known = np.empty((2, 1), np.int64), np.empty((2, 1), np.int64)
    scene, plan = _two_robots(rng, 0.1)
    rank_neighbours(scene, plan, 0, known)
    costs = np.zeros(1)
    for _ in range(300):
        profile = _two_robots(rng, 0.1)[1].q[0]
        rank_neighbours(scene, plan, 0, fresh)
        exact = weighted_cost(scene, plan, 0, profile, np.inf, fresh, costs)
        rank_neighbours(scene, plan, 0, fresh)
        alone = is_free(scene, plan, 0, profile, fresh, costs)
        assert alone == (exact == 0.0)
        # a graze at the remembered instant, which the strides of the other pass over
        if is_free(scene, plan, 0, profile, known, costs) != alone:
            assert alone
        best = rng.uniform(0.0, 2.0) * exact
        found = weighted_cost(scene, plan, 0, profile, best, known, costs)
        assert (found <= best) == (exact <= best) or exact < 1.5
        free, dearer = free + alone, dearer + (found > best)
    assert min(free, dearer) > 20


def test_the_cost_at_one_instant_is_part_of_the_whole():
    rng, seen = np.random.default_rng(5), 0
    for _ in range(200):
        scene, plan = _two_robots(rng, 0.1)
        a, b = plan.q
        whole, when = collision_cost(scene.bodies, scene.lever, 0, 1, a, b, 0.1, 0.1, 0, np.inf)
        assert (when < 0) == (whole == 0.0)
        if when >= 0:
            part = least_cost_at(scene.bodies, 0, 1, a, b, 0.1, 0.1, 0, when)
            seen += part > 0.0
            assert part <= whole * 1.3 + 1.5
    assert seen > 10

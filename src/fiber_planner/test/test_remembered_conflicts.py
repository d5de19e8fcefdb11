# SPDX-License-Identifier: Apache-2.0
"""Where a neighbour was in conflict last, its gap alone shows that a profile costs too much."""

import numpy as np

from fiber_planner.direct.collision_cost import collision_cost, least_cost_at
from fiber_planner.direct.plan_state import (
    is_free,
    rank_neighbours,
    weighted_cost,
)


def test_a_remembered_conflict_changes_neither_what_is_free_nor_what_costs_less(two_robots):
    rng, free, dearer = np.random.default_rng(11), 0, 0
    fresh, known = np.empty((2, 1), np.int64), np.empty((2, 1), np.int64)
    scene, plan = two_robots(rng, 0.1)
    rank_neighbours(scene, plan, 0, known)
    costs = np.zeros(1)
    for _ in range(300):
        profile = two_robots(rng, 0.1)[1].q[0]
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
        # of a graze the strides may miss the deepest 0.1 mm, which cost 1.5
        assert (found <= best) == (exact <= best) or exact < 1.5
        free, dearer = free + alone, dearer + (found > best)
    assert min(free, dearer) > 20


def test_a_conflict_is_remembered_where_it_is_deepest(two_robots):
    rng, seen = np.random.default_rng(5), 0
    for _ in range(200):
        scene, plan = two_robots(rng, 0.1)
        pair = scene.bodies, scene.lever, 0, 1, *plan.q
        whole, when = collision_cost(*pair, 0.1, 0.1, 0, np.inf)
        assert (when < 0) == (whole == 0.0)
        alone = [
            least_cost_at(scene.bodies, 0, 1, *plan.q, 0.1, 0.1, 0, k)
            for k in range(plan.q.shape[2])
        ]
        if max(alone) > 0.0:  # a graze between two grid times has no cost at any of them
            seen += 1
            assert abs(int(np.argmax(alone)) - when) <= 1
    assert seen > 10

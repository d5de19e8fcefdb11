# SPDX-License-Identifier: Apache-2.0
"""Laws of other ends: neighbours change theirs together, and all ends stay clear."""

import numpy as np
import pytest

from fiber_core.clearance import gaps
from fiber_planner.direct import DirectParameters
from fiber_planner.direct.initial_plan import choose_ends, straight_plan
from fiber_planner.direct.other_ends import change_ends
from fiber_planner.direct.scene import scene_of
from fiber_planner.direct.time_grid import time_grid


@pytest.fixture(params=[3, 5])
def begun(request, random_field):
    """Problem, scene and grid of a crowded field, and its straight plan."""
    problem, parameters = random_field("moons", 200, request.param), DirectParameters()
    scene = scene_of(problem, parameters)
    ends = choose_ends(problem, scene, parameters)
    grid = time_grid(1.2 * ends.alone_s, 1e-3, parameters.intervals)
    plan, tangled = straight_plan(problem, scene, parameters, ends, grid)
    assert not tangled.any()
    return problem, scene, grid, plan


def test_robots_change_their_ends_together_and_all_ends_stay_clear(begun):
    problem, scene, grid, plan = begun
    together = 0
    for row in range(problem.plane.n):
        before, choice = plan.q.copy(), plan.choice.copy()
        changed = change_ends(scene, plan, np.array([row]), grid.step_s, number=0)
        others = np.delete(np.arange(problem.plane.n), row)
        alone = changed[row] and not changed[others].any()
        together += changed.any() and not alone
        assert np.array_equal(changed[: problem.plane.n], plan.choice != choice)
        np.testing.assert_array_equal(plan.q[~changed], before[~changed])
        rows = np.flatnonzero(changed)
        np.testing.assert_array_equal(plan.q[rows, :, -1], scene.options[rows, plan.choice[rows]])
        np.testing.assert_array_equal(plan.q[rows, :, 0], scene.start[rows])
        ends = gaps(problem.plane, scene.pairs, plan.q[:, :, -1])
        assert (ends >= plan.required - 1e-9).all()
        speed = np.abs(np.diff(plan.q[rows], axis=2)).max(axis=2, initial=0.0) / grid.step_s
        assert (speed <= scene.speed[rows] * (1.0 + 1e-6)).all()
    assert together > 0  # else a move of one robot would be enough


def test_robots_whose_neighbours_cannot_make_way_keep_their_ends(begun):
    problem, scene, grid, plan = begun
    scene = scene._replace(option_count=np.minimum(scene.option_count, 1))
    rows = np.arange(problem.plane.n)
    before = plan.q.copy()
    assert not change_ends(scene, plan, rows, grid.step_s, 0).any()
    np.testing.assert_array_equal(plan.q, before)

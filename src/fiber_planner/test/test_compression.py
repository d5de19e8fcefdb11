# SPDX-License-Identifier: Apache-2.0
"""Compression: the profiles of a plan in less time."""

import numpy as np
import pytest

from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_planner.direct.compression import compress_late, compress_profiles
from fiber_planner.direct.initial_plan import choose_ends, straight_plan
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.plan_state import measure_all
from fiber_planner.direct.profile_sampling import sample_window
from fiber_planner.direct.scene import scene_of
from fiber_planner.direct.splitmix64 import seeded_rng
from fiber_planner.direct.time_grid import time_grid


@pytest.mark.parametrize("stretch", [1.3, 1.15, 1.0])
def test_a_compressed_plan_keeps_ends_and_limits_and_the_way_of_robots_that_have_time(stretch):
    problem = random_problem(preset("sdss_v", 37), np.random.default_rng(1))
    parameters = DirectParameters(shortening=0.0)
    scene = scene_of(problem)
    ends = choose_ends(problem, scene, parameters)
    longer = time_grid(1.3 * ends.alone_s, 1e-2, 48)
    grid = time_grid(stretch * ends.alone_s, 1e-2, 48)
    before, _ = straight_plan(problem, scene, parameters, ends, longer)
    plan, _ = straight_plan(problem, scene, parameters, ends, grid)
    rng = seeded_rng(scene.key[0], 1)
    for i, joint in np.ndindex(problem.plane.n, 2):  # profiles with rests, many at full speed
        row, per_interval = before.q[i, joint], scene.speed[i, joint] * longer.step_s
        sample_window(row, row[0], row[-1], per_interval, rng)
    compress_profiles(scene, plan, before.q, before.choice, grid.step_s)
    n = problem.plane.n
    assert np.array_equal(plan.q[:n, :, 0], problem.start)
    assert np.array_equal(plan.q[:n, :, -1], before.q[:n, :, -1])
    most = scene.speed[:, :, None] * grid.step_s
    assert (np.abs(np.diff(plan.q[:n], axis=2)) <= most * (1 + 1e-9)).all()
    share = np.linspace(0.0, 1.0, plan.q.shape[2])
    share_before = np.linspace(0.0, 1.0, before.q.shape[2])
    wanted = [[np.interp(share, share_before, row) for row in robot] for robot in before.q[:n]]
    has_time = (np.abs(np.diff(wanted, axis=2)) <= most).all(axis=(1, 2))
    assert has_time.any() and (stretch == 1.3 or not has_time.all())
    np.testing.assert_allclose(plan.q[:n][has_time], np.array(wanted)[has_time], atol=1e-9)


LATE, MORE = [3, 11], 6  # robots that wait for so many intervals before they go


@pytest.fixture
def late():
    """Scene, a straight plan that lasts longer because of LATE, its grid and its intervals."""
    problem = random_problem(preset("desi", 37), np.random.default_rng(2))
    scene, parameters = scene_of(problem), DirectParameters()
    ends = choose_ends(problem, scene, parameters)
    grid = time_grid(ends.alone_s, 1e-2, 48)
    plan, _ = straight_plan(problem, scene, parameters, ends, grid)
    q = np.concatenate([plan.q, np.repeat(plan.q[:, :, -1:], MORE, axis=2)], axis=2)
    q[LATE] = np.concatenate([np.repeat(plan.q[LATE, :, :1], MORE, axis=2), plan.q[LATE]], axis=2)
    plan = plan._replace(q=q)
    measure_all(scene, plan)
    plan.changed[:] = False
    return scene, plan, grid


@pytest.mark.parametrize("more", [4, 1, 0])
def test_only_robots_that_are_late_are_sped_up(late, more):
    scene, plan, grid = late
    before = [np.copy(column) for column in plan]
    sooner = compress_late(scene, plan, grid.intervals + more, grid.step_s)
    assert all(np.array_equal(a, b) for a, b in zip(plan, before))  # is not written
    n, others = len(plan.choice), np.delete(np.arange(len(plan.q)), LATE)
    assert sooner.q.shape[2] == grid.intervals + more + 1
    assert np.array_equal(sooner.q[others], plan.q[others, :, : grid.intervals + more + 1])
    assert np.array_equal(sooner.q[LATE, :, -1], plan.q[LATE, :, -1])
    step = np.abs(np.diff(sooner.q[:n], axis=2))
    assert (step <= scene.speed[:, :, None] * grid.step_s * (1 + 1e-9)).all()
    assert np.flatnonzero(sooner.changed).tolist() == LATE
    measured = sooner.cost.copy()
    measure_all(scene, sooner)
    assert np.array_equal(measured, sooner.cost)


def test_no_robot_is_sped_up_beyond_its_highest_speed(late):
    scene, plan, grid = late
    assert compress_late(scene, plan, grid.intervals - 2, grid.step_s) is None

# SPDX-License-Identifier: Apache-2.0
"""Laws of moved breakpoints, and of compression with coupled motors."""

import numpy as np
import pytest

from fiber_core.fields import random_problem
from fiber_core.motors import motors_of
from fiber_core.presets import preset
from fiber_planner.direct import DirectParameters
from fiber_planner.direct.compression import compress_profiles
from fiber_planner.direct.initial_plan import choose_ends, straight_plan
from fiber_planner.direct.plan_state import measure_all
from fiber_planner.direct.scene import scene_of
from fiber_planner.direct.shortcut import shortcut_profiles
from fiber_planner.direct.time_grid import time_grid

_STEP_S = 0.1


def _lines(row):
    """Number of lines of a profile until its arrival."""
    moving = np.flatnonzero(np.diff(row))
    if not len(moving):
        return 0
    return 1 + int((np.abs(np.diff(row[: moving[-1] + 2], 2)) > 1e-9).sum())


def test_moved_breakpoints_leave_fewer_lines_and_keep_ends_limits_and_the_gap(two_robots):
    rng, fewer, differ, tried = np.random.default_rng(7), 0, 0, 0
    for _ in range(80):
        scene, plan = two_robots(rng, 0.1)
        if (plan.cost > 0.0).any():
            continue
        tried += 1
        before, least = plan.q.copy(), None
        for moved in (0, 300):
            plan.q[:], plan.shortcut_due[:] = before, True
            shortcut_profiles(scene, plan, _STEP_S, 0, moved, np.arange(2))
            np.testing.assert_array_equal(plan.q[:, :, [0, -1]], before[:, :, [0, -1]])
            most = np.maximum(
                scene.speed[:, :, None] * _STEP_S,
                np.abs(np.diff(before, axis=2)).max(axis=2, keepdims=True),
            )
            assert (np.abs(np.diff(plan.q, axis=2)) <= most * (1 + 1e-9)).all()
            assert (plan.q >= scene.low[:, :, None] - 1e-9).all()
            assert (plan.q <= scene.high[:, :, None] + 1e-9).all()
            assert measure_all(scene, plan) == 0
            lines = sum(_lines(row) for robot in plan.q for row in robot)
            assert lines <= sum(_lines(row) for robot in before for row in robot)
            fewer += least is not None and lines < least
            differ += least is not None and lines > least
            least = lines
    assert tried > 20 and fewer > 2 * differ


@pytest.mark.parametrize("stretch", [1.3, 1.1, 1.0])
def test_compressed_robots_with_coupled_motors_follow_or_go_straight(stretch):
    problem = random_problem(preset("spec_s5", 63), np.random.default_rng(2))
    plane, parameters = problem.plane, DirectParameters(shortening=0.0)
    scene, n = scene_of(problem), problem.plane.n
    ends = choose_ends(problem, scene, parameters)
    longer = time_grid(1.3 * ends.alone_s, 1e-2, 48)
    grid = time_grid(stretch * ends.alone_s, 1e-2, 48)
    before, _ = straight_plan(problem, scene, parameters, ends, longer)
    plan, _ = straight_plan(problem, scene, parameters, ends, grid)
    rng, last = np.random.default_rng(3), before.q.shape[2] - 1
    for i in range(n):  # both joints wait, then go: early ones have time, late ones have none
        begin = rng.integers(0, last // 3)
        for joint in range(2):
            s, g = before.q[i, joint, [0, -1]]
            before.q[i, joint] = np.interp(np.arange(last + 1), [0, begin, last], [s, s, g])
    compress_profiles(scene, plan, before.q, before.choice, grid.step_s)
    np.testing.assert_array_equal(plan.q[:n, :, 0], problem.start)
    np.testing.assert_array_equal(plan.q[:n, :, -1], before.q[:n, :, -1])
    share, share_before = np.linspace(0, 1, plan.q.shape[2]), np.linspace(0, 1, last + 1)
    straight = plan.q[:n, :, :1] + (plan.q[:n, :, -1:] - plan.q[:n, :, :1]) * share
    is_straight = np.isclose(plan.q[:n], straight, atol=1e-9).all(axis=(1, 2))
    turns = np.diff(plan.q[:n], axis=2)
    motors = np.stack([motors_of(plane, turns[:, :, k]) for k in range(turns.shape[2])], axis=2)
    too_fast = (np.abs(motors) > plane.motor_speeds[:, :, None] * grid.step_s).any(axis=(1, 2))
    assert not (too_fast & ~is_straight).any()
    wanted = np.array(
        [[np.interp(share, share_before, row) for row in robot] for robot in before.q[:n]]
    )
    kept = np.isclose(plan.q[:n], wanted, atol=1e-9).all(axis=(1, 2))
    moves = (np.abs(wanted - straight) > 1e-6).any(axis=(1, 2))
    assert (kept & moves).any()
    if stretch == 1.0:
        assert (is_straight & moves).any()
    assert (kept | is_straight | ~too_fast).all()

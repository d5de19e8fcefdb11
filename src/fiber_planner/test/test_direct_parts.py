# SPDX-License-Identifier: Apache-2.0
"""Laws of the parts of the direct planner: sampling, collision cost, pieces, reachability."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiber_core.clearance import Safety, certify, gaps, neighbour_pairs, pair_gap
from fiber_core.fields import random_problem
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import PRESETS, plane_from, preset
from fiber_core.problem import Problem
from fiber_planner.direct import DirectParameters, DirectPlanner, reachable, straight_pieces
from fiber_planner.direct.certify_changed import require_more, shortfall_mm
from fiber_planner.direct.collision_cost import _DEEPEST, collision_cost
from fiber_planner.direct.initial_plan import choose_ends, straight_plan
from fiber_planner.direct.local_search import fold_arms, straighten
from fiber_planner.direct.perturbation import perturb_profile
from fiber_planner.direct.pieces import pieces_of
from fiber_planner.direct.plan_state import PlanState, mark_changed, measure_all
from fiber_planner.direct.profile_sampling import (
    sample_fold,
    sample_via,
    sample_window,
)
from fiber_planner.direct.scene import scene_of
from fiber_planner.direct.shortcut import shortcut_profiles
from fiber_planner.direct.splitmix64 import next_uniform, place_keys, seeded_rng
from fiber_planner.direct.time_grid import TimeGrid, time_grid

_STEP_S = 0.1  # joints that are not coupled have no use for it
_STEPS = 24


def _profiles(kind, s, g, per_interval, rng):
    row = np.full(_STEPS + 1, np.nan)
    if kind == "window":
        sample_window(row, s, g, per_interval, rng)
    elif kind == "fold":
        sample_fold(row, s, np.pi, g, per_interval, rng)
    else:
        sample_via(row, s, g, -3.0, 3.2, per_interval, 2.0, kind == "dwell", rng)
    return row


@pytest.mark.parametrize("kind", ["window", "via", "dwell", "fold"])
@settings(deadline=None, max_examples=60)
@given(s=st.floats(-3, 3), g=st.floats(-3, 3), slow=st.floats(1, 10), key=st.integers(0, 2**32))
def test_sampled_profiles_keep_ends_speed_and_limits(kind, s, g, slow, key):
    per_interval = max(abs(g - s), 0.01) / _STEPS * slow
    rng = seeded_rng(np.uint64(key), 0)
    for _ in range(10):
        row = _profiles(kind, s, g, per_interval, rng)
        assert row[0] == s and row[-1] == g
        assert np.abs(np.diff(row)).max() <= per_interval * (1 + 1e-9)
        assert row.min() >= -3.0 - 1e-9 and row.max() <= 3.2 + 1e-9
        assert len(np.unique(np.round(np.diff(row), 9))) <= 5


def test_draws_are_uniform_and_differ_between_keys_and_rounds():
    rng = seeded_rng(np.uint64(5), 0)
    draws = np.array([next_uniform(rng) for _ in range(20_000)])
    assert 0.0 <= draws.min() and draws.max() < 1.0
    counts = np.bincount((10 * draws).astype(int), minlength=10)
    assert np.abs(counts - 2000).max() < 200
    firsts = [next_uniform(seeded_rng(np.uint64(k), r)) for k in range(20) for r in range(20)]
    assert len(set(firsts)) == 400


def test_keys_follow_the_place_not_the_row():
    plane = preset("desi", 50)
    order = np.random.default_rng(0).permutation(50)
    keys = place_keys(plane, 3)
    assert len(set(keys.tolist())) == 50
    assert np.array_equal(place_keys(plane.permuted(order), 3), keys[order])
    assert not np.array_equal(place_keys(plane, 4), keys)


@pytest.mark.parametrize("name", ["desi", "desi_outlines"])
def test_collision_cost_agrees_with_dense_sampling(name):
    rng = np.random.default_rng(1)
    facing = np.array([[0.0, 0.4], [np.pi, 0.4]])
    plane = plane_from(PRESETS[name], np.arange(2), [[0.0, 0.0], [10.4, 0.0]])
    scene = scene_of(Problem(plane, facing, np.full((2, 2), np.nan)))
    required, seen = 0.1, 0
    for _ in range(150):
        a, b = facing[:, :, None] + np.cumsum(rng.normal(0, 0.15, (2, 2, _STEPS + 1)), 2)
        found, when = collision_cost(
            scene.bodies, scene.lever, 0, 1, a, b, required, 0.0, 0, np.inf
        )
        fine = np.linspace(0, _STEPS, 40 * _STEPS + 1)
        ta, pa, tb, pb = (np.interp(fine, np.arange(_STEPS + 1), x) for x in (*a, *b))
        gap = np.array([pair_gap(scene.bodies, 0, 1, *q) for q in zip(ta, pa, tb, pb)])
        deep = np.maximum(0, required - gap)
        integral = deep[:-1].sum() / 40 + deep[-1] + _DEEPEST * deep.max()
        if gap.min() > required:
            assert found == 0.0
        if gap.min() < required - 0.15:
            seen += 1
            assert found > 0.0
        assert found == pytest.approx(integral, rel=0.3, abs=_DEEPEST * 0.15)
        if found > 0.0:
            part, _ = collision_cost(
                scene.bodies, scene.lever, 0, 1, a, b, required, 0.0, 0, found / 3
            )
            assert part > found / 3
    assert seen > 20


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_straight_pieces_are_the_same_motion(seed):
    rng = np.random.default_rng(seed)
    knots = np.sort(rng.choice(np.arange(1, 12), 3, replace=False))
    time_s = np.linspace(0.0, 3.0, 13)
    angles = np.empty((4, 2, 13))
    for i in range(4):
        for joint in range(2):
            angles[i, joint] = np.interp(np.arange(13), [0, *knots, 12], rng.normal(size=5))
    angles[0, 0] = 0.7
    angles[1, 1] = np.interp(np.arange(13), [0, *knots, 12], [0.0, 1.0, -1.0, 0.5, 0.5])
    sampled = SampledMotion(time_s, angles)
    pieces = straight_pieces(sampled)
    for t in np.linspace(0.0, 3.2, 37):
        assert np.allclose(pieces(t), sampled(t), atol=1e-9)
    assert pieces.counts[0, 0] == 0
    assert pieces.counts.max() <= 4 and pieces.counts[1, 1] <= 3


def test_pieces_of_some_robots_leave_the_others_at_rest():
    sampled = SampledMotion([0.0, 1.0, 2.0], np.random.default_rng(0).normal(size=(3, 2, 3)))
    every = straight_pieces(sampled)
    some = pieces_of(sampled.time_s, sampled.angles, np.array([True, False, True]))
    for t in (0.0, 0.5, 1.7, 3.0):
        assert np.array_equal(some(t)[[0, 2]], every(t)[[0, 2]])
        assert np.array_equal(some(t)[1], sampled.start[1])


def _pair_with_a_disabled(theta_deg, pitch_mm=10.4):
    # robot 1 is disabled and stretched at an angle; robot 0 starts at 90 deg, stretched
    plane = plane_from(
        PRESETS["desi"], np.arange(2), [[0.0, 0.0], [pitch_mm, 0.0]], enabled=[True, False]
    )
    start = np.deg2rad([[90.0, 0.0], [theta_deg, 0.0]])
    return plane, start, neighbour_pairs(plane)


def test_a_target_under_a_disabled_arm_is_unreachable():
    plane, start, pairs = _pair_with_a_disabled(180.0)
    for target, expected in (([5.0, 0.3], False), ([-5.0, 0.0], True), ([9.0, 9.0], False)):
        problem = Problem(plane, start, [target, [np.nan, np.nan]])
        assert reachable(problem, pairs, 0.05).tolist() == [expected, False]


def test_a_target_behind_a_wall_is_unreachable_though_free_itself():
    # theta cannot turn away from the disabled arm, and phi may not bend: the only way is
    # through it
    plane, start, pairs = _pair_with_a_disabled(180.0, 11.6)
    narrow = np.deg2rad([[-100.0, 100.0], [0.0, 3.0]])
    stiff = plane_from(
        PRESETS["desi"], plane.ids, plane.centers, enabled=plane.enabled,
        limits=np.stack([narrow, plane.limits[1]]),
    )  # fmt: skip
    below = [[0.0, -5.999], [np.nan, np.nan]]
    assert reachable(Problem(plane, start, below), pairs, 0.05)[0]
    assert not reachable(Problem(stiff, start, below), pairs, 0.05)[0]


@pytest.mark.parametrize("missing_mm, expected", [(0.15, False), (-0.02, True)])
def test_a_passage_that_is_a_little_too_narrow_is_closed(missing_mm, expected):
    # theta has to turn past the tip of the disabled arm, and the arm cannot bend away from it
    plane, start, pairs = _pair_with_a_disabled(180.0, 14.0)
    gap = float(gaps(plane, pairs, np.deg2rad([[0.0, 0.0], [180.0, 0.0]]))[0])
    plane, start, pairs = _pair_with_a_disabled(180.0, 14.0 - gap + 0.05 - missing_mm)
    stiff = plane_from(
        PRESETS["desi"], plane.ids, plane.centers, enabled=plane.enabled,
        limits=np.stack([np.deg2rad([[-100.0, 100.0], [0.0, 0.3]]), plane.limits[1]]),
    )  # fmt: skip
    below = [[0.0, -6.0], [np.nan, np.nan]]
    assert reachable(Problem(stiff, start, below), pairs, 0.05)[0] == expected


def test_smaller_cells_prove_that_a_passage_is_too_narrow():
    plane, start, pairs = _pair_with_a_disabled(180.0, 14.0)
    gap = float(gaps(plane, pairs, np.deg2rad([[0.0, 0.0], [180.0, 0.0]]))[0])
    plane, start, pairs = _pair_with_a_disabled(180.0, 14.0 - gap + 0.05 - 0.015)
    stiff = plane_from(
        PRESETS["desi"], plane.ids, plane.centers, enabled=plane.enabled,
        limits=np.stack([np.deg2rad([[-100.0, 100.0], [0.0, 0.3]]), plane.limits[1]]),
    )  # fmt: skip
    problem = Problem(stiff, start, [[0.0, -6.0], [np.nan, np.nan]])
    assert reachable(problem, pairs, 0.05)[0]
    assert not reachable(problem, pairs, 0.05, np.deg2rad(0.125))[0]


def test_a_way_that_keeps_the_gap_at_the_start_is_open():
    # a disc at the elbow, nearer than the margin, from which phi turns neither away nor nearer
    plane = plane_from(
        PRESETS["desi"], [0], [[0.0, 0.0]],
        limits=np.deg2rad([[[-0.01, 0.01], [0.0, 180.0]]]),
    )  # fmt: skip
    elbow = float(plane.arms[0, 0])
    radius = 3.0 - float(plane.phi_radius[0]) - 0.02
    plane = replace(plane, obstacles=np.array([[elbow, -3.0, radius]]))
    problem = Problem(plane, np.zeros((1, 2)), [[elbow, float(plane.arms[0, 1])]])
    pairs = neighbour_pairs(plane)
    assert gaps(plane, pairs, problem.start)[0] == pytest.approx(0.02, abs=1e-6)
    assert reachable(problem, pairs, 0.05)[0]


def test_a_way_past_a_static_body_that_is_little_wider_than_the_margin_is_taken():
    plane, start, pairs = _pair_with_a_disabled(180.0, 14.0)
    gap = float(gaps(plane, pairs, np.deg2rad([[0.0, 0.0], [180.0, 0.0]]))[0])
    plane, start, pairs = _pair_with_a_disabled(180.0, 14.0 - gap + 0.065)
    stiff = plane_from(
        PRESETS["desi"], plane.ids, plane.centers, enabled=plane.enabled,
        limits=np.stack([np.deg2rad([[-100.0, 100.0], [0.0, 0.0]]), plane.limits[1]]),
    )  # fmt: skip
    start = np.array([[np.deg2rad(60.0), 0.0], start[1]])
    problem = Problem(stiff, start, [[0.0, -6.0], [np.nan, np.nan]])
    planned = DirectPlanner().plan(problem)
    assert planned.reason[0] == Reason.OK
    assert certify(stiff, straight_pieces(planned.motion), Safety()).ok


def test_reachable_needs_no_neighbours():
    plane = preset("desi", 40)
    problem = random_problem(plane, np.random.default_rng(2))
    assert reachable(problem, neighbour_pairs(plane), 0.05).all()
    nothing = Problem(plane, problem.start, np.full((40, 2), np.nan))
    assert not reachable(nothing, neighbour_pairs(plane), 0.05).any()


@settings(deadline=None, max_examples=200)
@given(
    least_s=st.floats(1e-4, 1e3), tick_s=st.floats(1e-3, 0.1), wanted=st.integers(4, 200)
)  # fmt: skip
def test_a_grid_lasts_long_enough_and_hardly_longer(least_s, tick_s, wanted):
    grid = time_grid(least_s, tick_s, wanted)
    ticks = least_s / tick_s
    assert grid.makespan_s >= least_s * (1 - 1e-9)
    assert grid.intervals >= 4 and grid.ticks >= 1
    if ticks > wanted:
        assert 0.45 * wanted <= grid.intervals <= 2.6 * wanted + 1
    if ticks > 4:  # longer by less than a tick and one wanted interval
        assert grid.makespan_s <= (least_s + tick_s) * (1 + 1 / wanted)
    longer = grid.lasting(1.3 * least_s)
    assert longer.ticks == grid.ticks
    assert 1.3 * least_s * (1 - 1e-9) <= longer.makespan_s
    assert longer.makespan_s <= max(grid.makespan_s, 1.3 * least_s + grid.step_s * (1 + 1e-9))


def test_a_grid_can_only_grow():
    assert TimeGrid(0.004, 10, 50).lasting(0.1) == TimeGrid(0.004, 10, 50)


def _plan(scene, q, required):
    pairs = len(scene.pairs)
    return PlanState(
        q, np.zeros(len(q), dtype=np.int64), np.full(pairs, required), np.full(pairs, required),
        np.zeros(pairs, dtype=np.int64), np.ones(pairs), np.zeros(pairs),
        np.full((len(q), 2), 5), np.ones(len(q), dtype=bool), np.ones(len(q), dtype=bool),
    )  # fmt: skip


def test_an_unneeded_detour_becomes_a_line_and_a_needed_one_stays():
    ahead = np.array([[0.8, 0.0], [np.pi, 0.0]])
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [10.4, 0.0]])
    scene = scene_of(Problem(plane, ahead, np.full((2, 2), np.nan)))
    time = np.arange(_STEPS + 1)
    q = np.repeat(ahead[:, :, None], _STEPS + 1, axis=2)
    q[0, 0] = np.interp(time, [0, 16, _STEPS], [0.8, 0.8, -0.5])
    plan = _plan(scene, q.copy(), 0.1)
    assert measure_all(scene, plan) == 1  # robot 1 stands in the way

    q[1, 0] = np.interp(time, [0, 4, 16], [0.0, 0.3, -1.0])  # it looks the other way
    plan = _plan(scene, q.copy(), 0.1)
    assert measure_all(scene, plan) == 0
    assert shortcut_profiles(scene, plan, _STEP_S, 0, 0, np.arange(2)) == 2
    assert measure_all(scene, plan) == 0
    assert np.allclose(plan.q[0, 0], np.linspace(0.8, -0.5, _STEPS + 1))
    assert np.allclose(plan.q[1, 0], np.linspace(0.0, -1.0, _STEPS + 1))
    assert (plan.folded == 0).all()

    q[1, 0] = np.interp(time, [0, 8, 16], [np.pi, np.pi, np.pi + 1.5])  # it leaves first
    plan = _plan(scene, q.copy(), 0.1)
    assert measure_all(scene, plan) == 0
    shortcut_profiles(scene, plan, _STEP_S, 0, 0, np.arange(2))
    assert measure_all(scene, plan) == 0
    assert np.array_equal(plan.q[0], q[0])  # and is waited for
    assert np.array_equal(plan.q[:, :, [0, -1]], q[:, :, [0, -1]])


def test_a_robot_that_goes_around_what_comes_later_is_there_sooner_on_one_line():
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [10.4, 0.0]])
    ahead = np.array([[-0.8, 0.0], [np.pi + 1.5, 0.0]])
    scene = scene_of(Problem(plane, ahead, np.full((2, 2), np.nan)))
    time = np.arange(_STEPS + 1)
    q = np.repeat(ahead[:, :, None], _STEPS + 1, axis=2)
    q[0, 0] = np.interp(time, [0, 8, _STEPS], [-0.8, 1.6, 0.8])
    q[1, 0] = np.interp(time, [0, 4, 12], [np.pi + 1.5, np.pi + 1.5, np.pi])
    plan = _plan(scene, q.copy(), 0.1)
    scene.movable[1] = False  # not for shortcut_profiles to change
    assert measure_all(scene, plan) == 0
    shortcut_profiles(scene, plan, _STEP_S, 0, 0, np.arange(2))
    assert np.array_equal(plan.q[0], q[0])  # on a line over the whole time it is in the way
    plan.shortcut_due[0] = True
    assert shortcut_profiles(scene, plan, _STEP_S, 100, 0, np.arange(2)) == 1
    assert measure_all(scene, plan) == 0
    arrives = int(np.argmax(plan.q[0, 0] == 0.8))
    assert arrives < 16
    assert np.allclose(plan.q[0, 0, : arrives + 1], np.linspace(-0.8, 0.8, arrives + 1))


def test_a_straightened_robot_keeps_its_ends_and_no_other_robot_changes():
    plane = plane_from(PRESETS["desi"], np.arange(3), [[0.0, 0.0], [10.4, 0.0], [40.0, 0.0]])
    scene = scene_of(Problem(plane, np.zeros((3, 2)), np.full((3, 2), np.nan)))
    q = np.random.default_rng(0).uniform(0.0, 1.0, (3, 2, _STEPS + 1))
    plan = _plan(scene, q.copy(), 0.1)
    plan.choice[1] = -1  # may end anywhere
    plan.changed[:] = plan.shortcut_due[:] = False
    straighten(scene, plan, np.array([True, True, False]))
    assert np.allclose(plan.q[0], np.linspace(q[0, :, 0], q[0, :, -1], _STEPS + 1).T)
    assert np.array_equal(plan.q[1:], q[1:])
    assert plan.folded.tolist() == [[0, 0], [5, 5], [5, 5]]
    assert plan.changed.tolist() == [True, False, False]
    assert plan.shortcut_due.tolist() == [True, True, False]  # the second is its neighbour


def test_a_robot_that_had_to_wait_is_tried_again_once_its_neighbour_has_changed():
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [10.4, 0.0]])
    ahead = np.array([[0.8, 0.0], [np.pi, 0.0]])
    scene = scene_of(Problem(plane, ahead, np.full((2, 2), np.nan)))
    time = np.arange(_STEPS + 1)
    q = np.repeat(ahead[:, :, None], _STEPS + 1, axis=2)
    q[0, 0] = np.interp(time, [0, 16, _STEPS], [0.8, 0.8, -0.5])  # waits for robot 1
    q[1, 0] = np.interp(time, [0, 8, 16], [np.pi, np.pi, np.pi + 1.5])
    plan = _plan(scene, q, 0.1)
    scene.movable[1] = False  # not for shortcut_profiles to change
    assert measure_all(scene, plan) == 0
    assert shortcut_profiles(scene, plan, _STEP_S, 0, 0, np.arange(2)) == 0
    plan.q[1, 0] = np.linspace(0.0, -1.0, _STEPS + 1)  # now it looks the other way
    assert measure_all(scene, plan) == 0
    assert (
        shortcut_profiles(scene, plan, _STEP_S, 0, 0, np.arange(2)) == 0
    )  # no robot is marked as changed
    mark_changed(scene, plan, 1)
    assert shortcut_profiles(scene, plan, _STEP_S, 0, 0, np.arange(2)) == 1
    assert np.allclose(plan.q[0, 0], np.linspace(0.8, -0.5, _STEPS + 1))


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
def test_what_is_missing_is_the_same_whether_all_or_only_the_changed_are_looked_at(name):
    parameters, rng = DirectParameters(), np.random.default_rng(3)
    problem = random_problem(preset(name, 200), rng)
    scene = scene_of(problem)
    ends = choose_ends(problem, scene, parameters)
    grid = time_grid(ends.alone_s, 1e-3, parameters.intervals)
    plan, tangled = straight_plan(problem, scene, parameters, ends, grid)

    def missing(plan):
        at_most = np.zeros(len(tangled), dtype=bool)
        return shortfall_mm(problem.plane, scene, parameters, plan, grid, tangled, at_most)

    before = missing(plan)
    assert 0 < (before > 0.0).sum() < len(before)
    assert np.array_equal(np.flatnonzero(plan.changed), np.unique(scene.pairs[before > 0.0]))
    for _ in range(5):
        for i in rng.choice(problem.plane.n, 20, replace=False):  # these rest where they start
            plan.q[i] = problem.start[i][:, None]
            mark_changed(scene, plan, i)
        assert not plan.changed.all()
        after = missing(plan)
        plan.changed[:] = True
        assert np.array_equal(missing(plan), after)


def test_no_more_is_required_beside_a_static_body_than_the_gap_at_the_start():
    parameters = DirectParameters()
    problem = random_problem(preset("desi", 200), np.random.default_rng(3))
    enabled = np.arange(200) % 3 > 0
    problem = replace(problem, plane=problem.plane.with_enabled(enabled))
    scene = scene_of(problem)
    ends = choose_ends(problem, scene, parameters)
    grid = time_grid(ends.alone_s, 1e-3, parameters.intervals)
    plan, tangled = straight_plan(problem, scene, parameters, ends, grid)
    at_start, before = gaps(problem.plane, scene.pairs, problem.start), plan.required.copy()
    at_most, missing = np.zeros(len(tangled), dtype=bool), np.full(len(tangled), 0.4)
    missing[::5] = 0.0
    assert not tangled.any()
    for _ in range(3):
        require_more(problem.plane, scene, plan, missing, at_most)
    static = ~scene.movable[scene.pairs].all(axis=1)
    assert (plan.required[static] <= at_start[static]).all()
    assert (plan.required[~static] - before[~static] >= 3 * missing[~static]).all()
    assert at_most[static].any() and not at_most[~static].any()
    assert (plan.required[at_most] == at_start[at_most] - 1e-6).all()
    # then half of the allowance is not asked for, the certificate's own demand is
    plan.changed[:] = True
    loose = shortfall_mm(problem.plane, scene, parameters, plan, grid, tangled, at_most)
    plan.changed[:] = True
    strict = shortfall_mm(problem.plane, scene, parameters, plan, grid, tangled, ~at_most & False)
    assert (loose <= strict).all() and (loose[at_most] > 0.0).any()


def test_a_profile_near_the_present_one_keeps_ends_speed_and_limits():
    problem = random_problem(preset("sdss_v", 37), np.random.default_rng(1))
    scene, parameters = scene_of(problem), DirectParameters()
    ends = choose_ends(problem, scene, parameters)
    grid = time_grid(1.1 * ends.alone_s, 1e-2, 48)
    plan, _ = straight_plan(problem, scene, parameters, ends, grid)
    fold_arms(scene, plan, scene.movable, grid.step_s)
    profile, changed = np.empty_like(plan.q[0]), np.zeros(plan.q.shape[2])
    for i in range(problem.plane.n):
        rng, present = seeded_rng(scene.key[i], 1), plan.q[i].copy()
        for _ in range(40):
            perturb_profile(scene, plan, i, grid.step_s, rng, profile)
            np.testing.assert_array_equal(profile[:, [0, -1]], present[:, [0, -1]])
            most = scene.speed[i, :, None] * grid.step_s
            assert (np.abs(np.diff(profile)) <= most * (1 + 1e-9)).all()
            assert (profile.T >= scene.low[i] - 1e-9).all() and (
                profile.T <= scene.high[i] + 1e-9
            ).all()
            changed += np.any(np.abs(profile - present) > 1e-6, axis=0)
        np.testing.assert_array_equal(plan.q[i], present)
    assert (changed[2:-2] > 0.1 * 40 * problem.plane.n).all()

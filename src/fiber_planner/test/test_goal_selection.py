# SPDX-License-Identifier: Apache-2.0
"""Laws of the choice of goals: fast where free, clear where crowded, refused where blocked."""

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import gaps, neighbour_pairs
from fiber_core.fields import random_problem
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_planner import choose_goals, lower_bound_s, travel_s

MARGIN = 0.1


def on_target(problem, goal):
    tips = kinematics.forward(problem.plane, goal)[1]
    return np.linalg.norm(tips - problem.targets, axis=1)


def least_gap(plane, angles):
    return gaps(plane, neighbour_pairs(plane), angles).min()


def fastest(problem):
    angles, valid = kinematics.inverse(problem.plane, problem.targets)
    return np.where(valid, travel_s(problem, angles), np.inf).min(axis=1)


@pytest.mark.parametrize("name", ["paper", "desi", "desi_outlines", "pfs", "sdss_v", "moons"])
def test_random_fields_are_solved_without_overlap(name):
    # the field was drawn from a choice that is clear, so one exists
    plane = preset(name, 300)
    for seed in range(2):
        problem = random_problem(plane, np.random.default_rng(seed))
        goal, reason = choose_goals(problem, MARGIN)
        assert np.all(reason == Reason.OK)
        assert on_target(problem, goal).max() < 1e-9
        assert least_gap(plane, goal) >= MARGIN
        assert np.all((plane.limits[..., 0] <= goal) & (goal <= plane.limits[..., 1]))


def test_the_fastest_choice_alone_would_overlap(random_field):
    # otherwise the test above would pass with no search at all
    problem = random_field("moons", 300, seed=0)
    angles, valid = kinematics.inverse(problem.plane, problem.targets)
    best = np.where(valid, travel_s(problem, angles), np.inf).argmin(axis=1)
    assert least_gap(problem.plane, angles[np.arange(problem.plane.n), best]) < 0


def test_a_robot_alone_takes_its_fastest_configuration(random_field):
    problem = random_field("moons", 200, seed=1)
    far = preset("moons", 200).permuted(np.arange(200))
    far = type(far)(**{**vars(far), "centers": 10 * far.centers})
    apart = Problem(far, problem.start, problem.targets + 9 * problem.plane.centers)
    goal, reason = choose_goals(apart, MARGIN)
    assert np.all(reason == Reason.OK)
    np.testing.assert_allclose(travel_s(apart, goal), fastest(apart), rtol=0, atol=1e-12)
    assert travel_s(apart, goal).max() == pytest.approx(lower_bound_s(apart), abs=1e-12)


def test_no_robot_could_be_faster_without_overlap(random_field):
    problem = random_field("moons", 150, seed=3)
    goal, _ = choose_goals(problem, MARGIN)
    time = travel_s(problem, goal)
    angles, valid = kinematics.inverse(problem.plane, problem.targets)
    faster = valid & (travel_s(problem, angles) < time[:, None] - 1e-12)
    assert faster.any()
    for i, option in np.argwhere(faster):
        other = goal.copy()
        other[i] = angles[i, option]
        assert least_gap(problem.plane, other) < MARGIN


def test_only_those_asked_move_and_all_others_stay(random_field):
    problem = random_field("desi", 300, seed=0, disabled=0.3)
    goal, reason = choose_goals(problem, MARGIN)
    still = ~problem.plane.enabled
    assert still.sum() > 50
    assert np.array_equal(goal[still], problem.start[still])
    assert np.all(reason[still] == Reason.NO_TARGET)
    assert np.all(reason[~still] == Reason.OK)
    assert least_gap(problem.plane, goal) >= MARGIN


def test_a_target_under_a_disabled_arm_is_blocked(robots):
    plane = robots([(0, 0), (10, 0)], enabled=[True, False])
    start = np.array([[np.pi, 1.0], [np.pi, 0.0]])  # the second one's arm lies from 7 to 4
    blocked = Problem(plane, start, [[5.5, 0.5], [np.nan, np.nan]])
    goal, reason = choose_goals(blocked, MARGIN)
    assert reason.tolist() == [Reason.GOAL_BLOCKED, Reason.NO_TARGET]
    assert np.array_equal(goal, start)
    free = Problem(plane, start, [[-4.0, 0.5], [np.nan, np.nan]])
    assert choose_goals(free, MARGIN)[1][0] == Reason.OK


@pytest.mark.parametrize("obstacles", [False, True])
def test_a_target_with_an_elbow_blocked_on_either_side_is_blocked(robots, obstacles):
    # each of the two leaves one elbow free, so only both together block the target
    for sides in [(-1,), (1,), (-1, 1)]:
        if obstacles:
            centers = [(0, 0)]
            columns = {"obstacles": np.array([[4.0 * side, 1.0, 0.8] for side in sides])}
        else:  # straight arms of disabled robots, that end 4.5 mm to the side
            centers = [(0, 0)] + [(10.5 * side, 1.0) for side in sides]
            columns = {"enabled": [True] + [False] * len(sides)}
        both_elbows = np.full((len(centers), 2, 2), [-np.pi, np.pi])
        plane = robots(centers, limits=both_elbows, **columns)
        start = np.zeros((plane.n, 2))
        start[:, 0] = np.where(plane.centers[:, 0] > 0, np.pi, 0.0)
        start[0] = -np.pi / 2, 0.0
        targets = np.full((plane.n, 2), np.nan)
        targets[0] = 0.0, 2.0
        _, reason = choose_goals(Problem(plane, start, targets), MARGIN)
        assert reason[0] == (Reason.GOAL_BLOCKED if len(sides) == 2 else Reason.OK)


def test_what_cannot_be_reached_or_moved_is_refused_with_its_reason(robots):
    plane = robots([(0, 0), (30, 0), (60, 0)], enabled=[True, False, True])
    start = np.zeros((3, 2))
    problem = Problem(plane, start, [[6.5, 0.0], [32.0, 0.0], [62.0, 0.0]])
    goal, reason = choose_goals(problem, MARGIN)
    assert reason.tolist() == [Reason.GOAL_BLOCKED, Reason.DISABLED, Reason.OK]
    assert np.array_equal(goal[:2], start[:2])


def test_when_two_want_one_place_one_gets_it(robots):
    plane = robots([(0, 0), (10, 0)])
    start = np.array([[np.pi, 0.5], [0.0, 0.5]])
    problem = Problem(plane, start, [[5.0, 0.2], [5.0, -0.2]])
    goal, reason = choose_goals(problem, MARGIN)
    assert sorted(reason.tolist()) == [Reason.OK, Reason.GOAL_BLOCKED]
    assert least_gap(plane, goal) >= MARGIN


def test_starts_that_already_overlap_do_not_block_each_other_for_ever(robots):
    plane = robots([(0, 0), (5, 0)])
    start = np.array([[0.0, 0.0], [np.pi, 0.0]])
    problem = Problem(plane, start, [[-4.0, 0.0], [np.nan, np.nan]])
    goal, reason = choose_goals(problem, MARGIN)
    assert reason[0] == Reason.OK
    assert np.array_equal(goal[1], start[1])


def test_the_choice_does_not_depend_on_how_robots_are_numbered(random_field):
    problem = random_field("moons", 150, seed=5)
    order = np.random.default_rng(0).permutation(150)
    shuffled = Problem(problem.plane.permuted(order), problem.start[order], problem.targets[order])
    goal, reason = choose_goals(problem, MARGIN)
    goal2, reason2 = choose_goals(shuffled, MARGIN)
    assert np.array_equal(reason[order], reason2)
    np.testing.assert_allclose(goal[order], goal2, rtol=0, atol=1e-9)


def test_obstacles_block_goals_too(robots):
    disc = np.array([[3.0, 3.5, 1.0]])
    plane = robots([(0, 0)], obstacles=disc)
    start = np.array([[-np.pi / 2, 0.0]])
    assert choose_goals(Problem(plane, start, [[3.0, 2.0]]), MARGIN)[1][0] == Reason.GOAL_BLOCKED
    goal, reason = choose_goals(Problem(plane, start, [[3.0, 0.2]]), MARGIN)
    assert reason[0] == Reason.OK and least_gap(plane, goal) >= MARGIN

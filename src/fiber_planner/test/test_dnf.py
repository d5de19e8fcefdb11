# SPDX-License-Identifier: Apache-2.0
"""Laws that every plan of the navigation function keeps, and its hard cases."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fiber_core import kinematics
from fiber_core.clearance import neighbour_pairs, sampled_gaps
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner import lower_bound_s, make_planner

ON_TIPS, ON_ARMS = ("dnf", "dnf_priority"), ("dnf_arms", "dnf_arms_priority")
NAMES = ON_TIPS + ON_ARMS
DT = 0.01
NOTHING = (np.nan, np.nan)


@pytest.fixture(scope="module")
def crowded_plans():
    """Plans of both planners on crowded fields, one robot in ten disabled."""
    plans = {}

    def of(name, field):
        if name not in plans:
            problems = [field("pfs", 120, seed, disabled=0.1) for seed in range(3)]
            plans[name] = [(p, make_planner(name).plan(p)) for p in problems]
        return plans[name]

    return of


@pytest.mark.parametrize("name", NAMES)
def test_speeds_and_joint_limits_are_kept(name, crowded_plans, random_field):
    for problem, plan in crowded_plans(name, random_field):
        angles = plan.motion.angles
        speeds = np.abs(np.diff(angles, axis=2)) / np.diff(plan.motion.time_s)
        assert (speeds <= problem.plane.speeds[..., None] * (1 + 1e-9)).all()
        low, high = np.moveaxis(problem.plane.limits[..., None], 2, 0)
        assert (low <= angles).all() and (angles <= high).all()


@pytest.mark.parametrize("name", NAMES)
def test_every_robot_is_reported_as_it_is(name, crowded_plans, random_field):
    arrived = asked = 0
    for problem, plan in crowded_plans(name, random_field):
        tips = kinematics.forward(problem.plane, plan.motion.end)[1]
        there = np.linalg.norm(tips - problem.targets, axis=1) <= 0.1
        assert np.array_equal(plan.reason == Reason.OK, there)
        assert np.array_equal(plan.reason == Reason.NO_TARGET, ~problem.asked)
        late = ~there & problem.asked
        assert np.isin(plan.reason[late], (Reason.NOT_CONVERGED, Reason.GOAL_BLOCKED)).all()
        arrived, asked = arrived + there.sum(), asked + problem.asked.sum()
    assert arrived > 0.85 * asked


@pytest.mark.parametrize("name", NAMES)
def test_motions_begin_at_the_start_and_the_disabled_never_move(name, crowded_plans, random_field):
    for problem, plan in crowded_plans(name, random_field):
        assert np.array_equal(plan.motion.start, problem.start)
        still = ~problem.plane.enabled
        assert still.any()
        assert (plan.motion.angles[still] == problem.start[still][..., None]).all()


@pytest.mark.parametrize("name", ON_TIPS)
def test_tips_never_come_within_d(name, crowded_plans, random_field, densely, closest_tips):
    for problem, plan in crowded_plans(name, random_field):
        assert closest_tips(problem.plane, densely(plan.motion)) > problem.plane.envelope_mm / 2


def test_without_adaptive_steps_they_do(random_field, densely, closest_tips):
    problem = random_field("pfs", 120, seed=0)
    plan = make_planner("dnf", adaptive=False).plan(problem)
    assert closest_tips(problem.plane, densely(plan.motion, 2)) < problem.plane.envelope_mm / 2


@pytest.mark.parametrize("name", ON_ARMS)
@pytest.mark.parametrize("preset", ["pfs", "desi_outlines", "sdss_v"])
def test_arms_never_come_within_the_margin(name, preset, random_field, densely):
    problem = random_field(preset, 60, seed=1)
    plan = make_planner(name).plan(problem)
    pairs = neighbour_pairs(problem.plane)
    assert sampled_gaps(problem.plane, pairs, densely(plan.motion)).min() > 0.1
    tips_only = make_planner("dnf").plan(problem)
    assert sampled_gaps(problem.plane, pairs, tips_only.motion.angles).min() < 0.0


@pytest.mark.parametrize("name", ON_TIPS)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    angles=st.lists(st.floats(-np.pi, np.pi), min_size=8, max_size=8),
    pitch=st.floats(7.0, 11.5),
    dt=st.floats(0.005, 0.2),
    speed=st.floats(1.0, 10.0),
)
def test_two_tips_never_come_within_d_whatever_the_step(
    name, robots, densely, closest_tips, angles, pitch, dt, speed
):
    plane = robots(
        [(0, 0), (pitch, 0)],
        speeds=np.full((2, 2), speed),
        limits=np.tile([[-4.0, 4.0], [-4.0, 4.0]], (2, 1, 1)),
        phi_vertices=np.full((2, 1, 2), [3.0, 0.0]),
    )
    start, goal = np.reshape(angles, (2, 2, 2))
    targets = kinematics.forward(plane, goal)[1]
    distance = np.linalg.norm(np.subtract(*kinematics.forward(plane, start)[1]))
    plan = make_planner(name, dt_s=dt, horizon_s=40 * dt).plan(Problem(plane, start, targets))
    assert np.isfinite(plan.motion.angles).all()
    if distance > 2.0:
        assert closest_tips(plane, densely(plan.motion)) > 2.0
    else:  # a field that is not valid: they may only part
        assert closest_tips(plane, densely(plan.motion)) >= distance - 1e-9


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("goal", [(2.0, 1.0), (-2.0, 0.0), (0.3, np.pi), (3.0, 2.5)])
@pytest.mark.parametrize("start", [(0.0, 0.0), (1.0, np.pi), (-1.0, 1.2)])
def test_a_lone_robot_arrives_exactly_at_its_lower_bound(name, start, goal, robots):
    # among them starts and targets with the arm stretched or folded, where the printed
    # attraction of the tip vanishes along phi
    plane = robots([(0, 0)], speeds=[[np.pi, 2.0]])
    problem = Problem(plane, [start], kinematics.forward(plane, [goal])[1])
    plan = make_planner(name).plan(problem)
    assert plan.reason[0] == Reason.OK
    assert np.array_equal(plan.motion.end, plan.goal)
    bound = lower_bound_s(problem)
    assert bound - 1e-9 <= plan.motion.makespan_s < bound + DT + 1e-9
    # both joints run straight to the goal: one segment per motor
    speeds = np.diff(plan.motion.angles[0], axis=1)[:, :-1] / DT
    assert np.ptp(speeds, axis=1).max() < 1e-9


def test_attraction_of_the_tip_as_printed_is_slower(robots):
    plane = robots([(0, 0)])
    problem = Problem(plane, [[0.0, 0.0]], kinematics.forward(plane, [[2.0, 1.0]])[1])
    plan = make_planner("dnf", attraction="tip").plan(problem)
    assert not plan.motion.makespan_s < lower_bound_s(problem) + 5 * DT


@pytest.mark.parametrize("name", NAMES)
def test_slow_and_long_armed_robots_arrive_too(name, random_field):
    problem = random_field("moons", 1, seed=0)
    plan = make_planner(name).plan(problem)
    assert plan.reason[0] == Reason.OK
    assert plan.motion.makespan_s < lower_bound_s(problem) * 1.02 + 0.1
    assert len(plan.motion.time_s) < 500


@pytest.mark.parametrize("name", NAMES)
def test_same_problem_same_plan(name, random_field):
    problem = random_field("pfs", 60, seed=7)
    one, two = (make_planner(name).plan(problem) for _ in range(2))
    assert np.array_equal(one.motion.angles, two.motion.angles)


@pytest.mark.parametrize("name", NAMES)
def test_numbering_the_robots_otherwise_numbers_the_plan_otherwise(name, random_field):
    problem = random_field("pfs", 60, seed=8)
    order = np.random.default_rng(0).permutation(problem.plane.n)
    shuffled = Problem(problem.plane.permuted(order), problem.start[order], problem.targets[order])
    plan, other = make_planner(name).plan(problem), make_planner(name).plan(shuffled)
    assert np.array_equal(plan.reason[order], other.reason)
    assert plan.motion.angles.shape == other.motion.angles.shape
    np.testing.assert_allclose(plan.motion.angles[order], other.motion.angles, rtol=0, atol=1e-6)


def facing(robots, apart):
    """Two robots without targets whose tips face each other, `apart` mm from tip to tip."""
    plane = robots([(0, 0), (8 + apart, 0)])
    bend = np.arccos((16 - 18) / 18)  # a tip 4 mm from its axis
    start = np.array([[-bend / 2, bend], [np.pi - bend / 2, bend]])
    return Problem(plane, start, [NOTHING, NOTHING])


def test_the_sign_as_printed_attracts(robots, closest_tips):
    problem = facing(robots, apart=3.0)
    assert closest_tips(problem.plane, problem.start[..., None]) == pytest.approx(3.0)

    def tips_after(**parameters):
        # with hardly any attraction home, what is left is what neighbours do to each other
        planner = make_planner(
            "dnf", attraction="tip", lambda1=1e-9, tolerance_mm=1e-6, horizon_s=1.0, **parameters
        )
        return closest_tips(problem.plane, planner.plan(problem).motion.end[..., None])

    assert tips_after(sign="printed") < 2.5
    assert tips_after(sign="corrected") > 3.5


def test_a_robot_without_target_makes_way_and_comes_back(robots, densely, closest_tips):
    plane = robots([(0, 0), (10, 0)])
    start = np.array([[-1.6, 1.0], [0.0, 0.0]])
    start[1] = kinematics.inverse(plane, [NOTHING, (6.9, 0.0)])[0][1, 0]
    goal = np.array([[0.6, 1.0], NOTHING])
    targets = [kinematics.forward(plane, goal)[1][0], NOTHING]
    plan = make_planner("dnf").plan(Problem(plane, start, targets))
    assert plan.reason.tolist() == [Reason.OK, Reason.NO_TARGET]
    assert np.ptp(plan.motion.angles[1], axis=1).max() > 0.05
    assert np.array_equal(plan.motion.end[1], start[1])
    assert closest_tips(plane, densely(plan.motion)) > 2.0


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_that_cannot_pass_is_reported_not_hidden(name, robots, densely, closest_tips):
    # The first robot's arm is kept straight by its stops and sweeps a circle on which the
    # second one, disabled, has its tip.
    stops = [[[-1.5, 1.5], [0.0, 0.0]], [[-3.4, 3.4], [0.0, np.pi]]]
    plane = robots([(0, 0), (10, 0)], enabled=[True, False], limits=stops)
    start = np.array([[-1.0, 0.0], [np.pi - 0.6, 0.8]])
    targets = [(6 * np.cos(1.0), 6 * np.sin(1.0)), NOTHING]
    plan = make_planner(name).plan(Problem(plane, start, targets))
    assert plan.reason.tolist() == [Reason.NOT_CONVERGED, Reason.NO_TARGET]
    assert plan.goal[0, 0] == pytest.approx(1.0)
    assert plan.motion.end[0, 0] < 0.5
    assert closest_tips(plane, densely(plan.motion)) > 2.0


# name: places [mm], start tips, target tips, mm. All have phi in 0..180 deg and one elbow.
HARD = {
    "robot 1 makes way, 2 passes between its neighbours (Fig. 5 of the papers)": (
        [(0, 0), (8, 0), (16, 0)],
        [(5.2, 0.0), (2.8, 0.0), (21.2, 0.0)],
        [(4.5, 3.8), (12.5, -2.6), (11.5, 2.6)],
    ),
    "two head on": (
        [(0, 0), (9, 0)],
        [(4.5, -2.4), (4.5, 2.4)],
        [(4.5, 2.4), (4.5, -2.4)],
    ),
    "targets exactly D apart": (
        [(0, 0), (10, 0)],
        [(0.0, 5.0), (10.0, -5.0)],
        [(3.0, 0.0), (7.0, 0.0)],
    ),
    "target on the stop of phi": (
        [(0, 0), (10, 0)],
        [(2.0, 3.0), (10.0, -4.0)],
        [(0.0, 6.0), (10.0, 0.0)],
    ),
}


@pytest.mark.parametrize("case", HARD)
def test_hard_cases_arrive(case, robots, densely, closest_tips):
    places, start, targets = HARD[case]
    plane = robots(places)
    angles, valid = kinematics.inverse(plane, start)
    problem = Problem(plane, angles[np.arange(plane.n), valid.argmax(axis=1)], targets)
    plan = make_planner("dnf").plan(problem)
    assert plan.reason.tolist() == [Reason.OK] * plane.n
    assert closest_tips(plane, densely(plan.motion)) > 2.0


def test_a_target_on_the_stop_of_theta_is_reached_exactly(robots):
    plane = robots([(0, 0)], limits=[[[-2.0, 2.0], [0.0, np.pi]]])
    problem = Problem(plane, [[-1.9, 0.3]], kinematics.forward(plane, [[2.0, 1.0]])[1])
    plan = make_planner("dnf").plan(problem)
    assert plan.reason[0] == Reason.OK
    assert plan.motion.end[0, 0] == pytest.approx(2.0, abs=1e-12) and plan.motion.end[0, 0] <= 2.0


def test_tips_keep_off_fixed_obstacles(robots, densely, tips_at):
    disc = np.array([[6.9, 0.0, 1.0]])
    start = np.array([[-1.6, 1.0]])

    def nearest(plane):
        targets = kinematics.forward(plane, [[0.6, 1.0]])[1]
        plan = make_planner("dnf").plan(Problem(plane, start, targets))
        x, y = tips_at(plane, densely(plan.motion))
        return np.hypot(x - disc[0, 0], y - disc[0, 1]).min()

    assert nearest(robots([(0, 0)])) < 1.7
    assert nearest(robots([(0, 0)], obstacles=disc)) > 2.0  # radius + d/2


def test_arms_that_overlap_at_the_outset_hold_still_and_the_others_go(robots):
    plane = robots([(0, 0), (5, 0), (40, 0)])
    start = np.array([[0.0, 0.0], [np.pi, 0.0], [0.0, 1.0]])
    goal = np.array([[2.0, 0.5], [0.5, 0.5], [1.0, 1.0]])
    problem = Problem(plane, start, kinematics.forward(plane, goal)[1])
    plan = make_planner("dnf_arms").plan(problem)
    assert plan.reason.tolist() == [Reason.NOT_CONVERGED] * 2 + [Reason.OK]
    assert np.array_equal(plan.motion.end[:2], start[:2])


def test_a_robot_outside_its_stops_only_comes_back(robots):
    plane = robots([(0, 0)], limits=[[[-2.0, 2.0], [0.0, np.pi]]])
    problem = Problem(plane, [[2.3, 0.5]], kinematics.forward(plane, [[-1.0, 1.0]])[1])
    plan = make_planner("dnf").plan(problem)
    assert plan.reason[0] == Reason.OK
    assert plan.motion.angles[0, 0].max() == 2.3

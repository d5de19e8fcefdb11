# SPDX-License-Identifier: Apache-2.0
"""Priorities resolve the deadlocks of the plain control law and keep its laws."""

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import neighbour_pairs, sampled_gaps
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner import PlannerError, make_planner
from fiber_planner.dnf import DnfParameters, DnfPriorityParameters
from fiber_planner.dnf.arm_repulsion import ArmNeighbours
from fiber_planner.dnf.navigation_function import ControlLaw, Swarm
from fiber_planner.dnf.priority import CLAIMING, FREE, YIELDING, Priorities
from fiber_planner.dnf.tip_repulsion import TipNeighbours

NOTHING = (np.nan, np.nan)

# name: places [mm], start tips, target tips [mm]. Pairs are symmetric about their middle.
DEADLOCKS = {
    "head on": (
        [(0, 0), (10, 0)],
        [(2.7, -3.2), (7.3, 3.2)],
        [(4.1, 2.2), (5.9, -2.2)],
    ),
    "head on, arms almost straight": (
        [(0, 0), (10, 0)],
        [(1.8, -1.1), (8.2, 1.1)],
        [(5.1, 2.2), (4.9, -2.2)],
    ),
    "head on, from behind": (
        [(0, 0), (10, 0)],
        [(-2.2, -4.8), (12.2, 4.8)],
        [(4.3, 3.0), (5.7, -3.0)],
    ),
    "three in a row as in Fig. 5 of the papers: the middle one passes between its neighbours": (
        [(0, 0), (8, 0), (16, 0)],
        [(1.2, -2.5), (6.9, -5.6), (11.9, -1.1)],
        [(1.9, -4.8), (2.3, 0.4), (12.8, -2.8)],
    ),
    "three in a row, the other way round": (
        [(0, 0), (8, 0), (16, 0)],
        [(-3.7, -4.3), (5.1, -1.7), (19.9, -4.1)],
        [(-4.2, 3.9), (5.6, -1.6), (11.9, -3.2)],
    ),
}


@pytest.mark.parametrize("case", DEADLOCKS)
def test_deadlocks_of_the_plain_law_are_undone(case, robots, densely, closest_tips):
    places, tips, targets = DEADLOCKS[case]
    plane = robots(places)
    angles, valid = kinematics.inverse(plane, tips)
    problem = Problem(plane, angles[np.arange(plane.n), valid.argmax(axis=1)], targets)
    stuck = make_planner("dnf", horizon_s=20.0).plan(problem)
    assert (stuck.reason == Reason.NOT_CONVERGED).sum() == 2
    plan = make_planner("dnf_priority").plan(problem)
    assert plan.reason.tolist() == [Reason.OK] * plane.n
    assert np.array_equal(plan.motion.end, plan.goal)
    assert plan.motion.makespan_s < 2.5
    assert closest_tips(plane, densely(plan.motion)) > 2.0


@pytest.mark.parametrize("name", ["dnf", "dnf_arms"])
def test_a_crowded_plane_arrives_and_ends_sooner(name, random_field):
    problems = [random_field("pfs", 200, seed) for seed in range(3)]
    plain = [make_planner(name).plan(problem) for problem in problems]
    cured = [make_planner(f"{name}_priority").plan(problem) for problem in problems]
    assert sum((plan.reason != Reason.OK).sum() for plan in plain) >= 9
    assert sum((plan.reason != Reason.OK).sum() for plan in cured) == 0
    for one, other in zip(cured, plain):
        assert one.motion.makespan_s < 0.9 * other.motion.makespan_s


@pytest.mark.parametrize("name", ["dnf", "dnf_arms"])
def test_without_blocked_robots_nothing_changes(name, random_field):
    problem = random_field("paper", 30, seed=1)
    plan = make_planner(name).plan(problem)
    assert (plan.reason == Reason.OK).all()
    same = make_planner(f"{name}_priority").plan(problem)
    assert np.array_equal(plan.motion.angles, same.motion.angles)


def test_without_claims_it_is_the_plain_law_and_ends_when_all_stand_still(random_field):
    problem = random_field("pfs", 120, seed=0)
    plain = make_planner("dnf").plan(problem).motion.angles
    none = make_planner("dnf_priority", claims=0).plan(problem).motion.angles
    assert none.shape[2] < plain.shape[2]
    assert np.array_equal(none, plain[..., : none.shape[2]])


def test_a_robot_that_can_never_pass_ends_the_plan_before_the_horizon(robots):
    # an arm kept straight by its stops, and a disabled robot's tip on its circle
    stops = [[[-1.5, 1.5], [0.0, 0.0]], [[-3.4, 3.4], [0.0, np.pi]]]
    plane = robots([(0, 0), (10, 0)], enabled=[True, False], limits=stops)
    start = np.array([[-1.0, 0.0], [np.pi - 0.6, 0.8]])
    problem = Problem(plane, start, [(6 * np.cos(1.0), 6 * np.sin(1.0)), NOTHING])
    plan = make_planner("dnf_priority", horizon_s=60.0).plan(problem)
    assert plan.reason[0] == Reason.NOT_CONVERGED
    assert plan.motion.makespan_s < 10.0


def test_a_home_robot_makes_way_and_comes_back(robots, densely, closest_tips):
    # the second robot is where it shall be, in the middle of the first one's sweep
    plane = robots([(0, 0), (8, 0)], limits=[[[-3.4, 3.4], [0.4, 0.5]], [[-3.4, 3.4], [0, 3.1]]])
    start = np.array([[-1.2, 0.45], [1.95, 2.4]])
    goal = np.array([[1.0, 0.45], [1.95, 2.4]])
    targets = kinematics.forward(plane, goal)[1]
    for second in (targets[1], NOTHING):
        problem = Problem(plane, start, [targets[0], second])
        plan = make_planner("dnf_priority").plan(problem)
        assert plan.reason[0] == Reason.OK
        assert np.ptp(plan.motion.angles[1], axis=1).max() > 0.5
        np.testing.assert_allclose(plan.motion.end[1], start[1], rtol=0, atol=1e-9)
        assert closest_tips(plane, densely(plan.motion)) > 2.0


@pytest.mark.parametrize("name", ["dnf", "dnf_arms"])
def test_priority_does_not_depend_on_the_order_of_the_rows(name, random_field):
    problem = random_field("pfs", 200, seed=1)
    plan = make_planner(f"{name}_priority").plan(problem)
    assert (make_planner(name).plan(problem).reason != Reason.OK).any()  # claims are made
    order = np.random.default_rng(0).permutation(problem.plane.n)
    shuffled = Problem(problem.plane.permuted(order), problem.start[order], problem.targets[order])
    other = make_planner(f"{name}_priority").plan(shuffled)
    assert np.array_equal(plan.reason[order], other.reason)
    np.testing.assert_allclose(plan.motion.angles[order], other.motion.angles, rtol=0, atol=1e-6)


def neighbours_of(kind, problem, law):
    if kind == "tips":
        return TipNeighbours(problem.plane, law)
    return ArmNeighbours(problem.plane, problem.start, problem.start, law, margin_mm=0.1)


@pytest.mark.parametrize("kind", ["tips", "arms"])
def test_ranks_decide_which_neighbours_repel_and_never_how_long_a_step_is(kind, random_field):
    problem = random_field("pfs", 60, seed=3)
    plane, start = problem.plane, np.array(problem.start)
    neighbours = neighbours_of(kind, problem, ControlLaw.of(plane, DnfParameters()))
    at = start, *kinematics.forward(plane, start)
    equal = neighbours.repel(*at, np.zeros(plane.n))
    felt = np.flatnonzero(equal[1].any(axis=1))
    assert len(felt) > 10
    turn = np.random.default_rng(0).uniform(-0.2, 0.2, start.shape)
    free = neighbours.step_fractions(turn, equal[2])
    for i in felt[:10]:
        above = neighbours.repel(*at, np.where(np.arange(plane.n) == i, 1.0, 0.0))
        assert above[0][i] == 0.0 and not above[1][i].any()
        others = np.arange(plane.n) != i
        assert np.array_equal(above[1][others], equal[1][others])
        for one, other in zip(neighbours.step_fractions(turn, above[2]), free):
            assert np.array_equal(one, other)


@pytest.mark.parametrize("kind", ["tips", "arms"])
def test_the_blocker_of_a_robot_is_the_one_its_step_is_shortened_for(kind, random_field):
    problem = random_field("pfs", 60, seed=4)
    plane, start = problem.plane, np.array(problem.start)
    law = ControlLaw.of(plane, DnfParameters(dt_s=0.6 / plane.speeds.min()))
    neighbours = neighbours_of(kind, problem, law)
    _, _, contacts = neighbours.repel(start, *kinematics.forward(plane, start), np.zeros(plane.n))
    turn = np.random.default_rng(1).uniform(-0.3, 0.3, start.shape)
    part, blocker = neighbours.step_fractions(turn, contacts)
    assert np.array_equal(part < 1.0, blocker >= 0)
    assert (part < 1.0).sum() > 3
    # made whole, a shortened turn brings the two of them nearer
    for i in np.flatnonzero(part < 1.0):
        j = blocker[i]
        path = np.repeat(start[..., None], 21, axis=2)
        path[i] += turn[i][:, None] * np.linspace(0.0, 1.0, 21)
        if kind == "arms":
            apart = sampled_gaps(plane, [sorted((i, j))], path)[0]
        else:
            tips = np.stack([kinematics.forward(plane, path[..., k])[1] for k in range(21)])
            apart = np.linalg.norm(tips[:, i] - tips[:, j], axis=1)
        assert apart.min() < apart[0]


def crowd(n, alone_s=None, **parameters):
    """Robots in a row that would all like to turn theta by 1 rad, and their Priorities."""
    numbers = {"dt": 0.01, "patience_s": 0.05, "yield_s": 0.3, "claims": 2} | parameters
    centers = np.stack([10.0 * np.arange(n), np.zeros(n)], axis=1)
    limits = np.full((n, 2), np.pi)
    swarm = Swarm(
        centers, np.full((n, 2), 3.0), np.zeros((n, 2)), limits, limits, np.ones(n, dtype=bool),
        np.tile([1.0, 0.5], (n, 1)), np.zeros((n, 2)),
    )  # fmt: skip
    alone_s = np.linspace(1.0, 2.0, n) if alone_s is None else alone_s
    start = np.tile([0.0, 0.5], (n, 1))
    return Priorities(swarm, start, alone_s, **numbers), start


def stand_still(order, angles, blocker, steps):
    """Let no robot move for a number of steps, robot i blocked by blocker[i] (-1: by none)."""
    blocker = np.array(blocker)
    last = False
    for _ in range(steps):
        last = order.update(angles, angles, np.where(blocker < 0, 1.0, 0.0), blocker)
    return last


def test_a_blocked_robot_claims_the_way_and_the_lower_one_folds():
    order, angles = crowd(2)
    stand_still(order, angles, [1, 0], 5)
    assert order.state.tolist() == [FREE, FREE]
    stand_still(order, angles, [1, 0], 2)
    assert order.state.tolist() == [YIELDING, CLAIMING]  # the second has the longer way
    assert order.ranks[0] < order.ranks[1]
    assert order.aim[0].tolist() == [0.0, np.pi] and order.aim[1].tolist() == [1.0, 0.5]


def test_a_robot_that_gives_way_hands_the_rank_on():
    # 2 is blocked by 0 and 0, folding, by 1, whose own way is longer than that of 0
    order, angles = crowd(3)
    stand_still(order, angles, [1, -1, 0], 8)
    assert order.state.tolist() == [YIELDING, YIELDING, CLAIMING]
    assert order.ranks[1] < order.ranks[0] < order.ranks[2]
    assert order.ranks[1] > 2.0  # above every standing but that of 2


def test_giving_way_ends_and_counts():
    order, angles = crowd(2)
    stand_still(order, angles, [1, 0], 7)
    assert order.state[0] == YIELDING
    goal = np.array([angles[0], order.aim[1]])
    order.update(goal, goal, np.ones(2), np.array([-1, -1]))
    assert order.state[1] == FREE and order.ranks[1] == 0.0
    stand_still(order, goal, [-1, -1], 32)
    assert order.state[0] == FREE and order.aim[0].tolist() == [1.0, 0.5]
    # back in the same place it goes first: it has given way before
    stand_still(order, angles, [1, 0], 7)
    assert order.state.tolist() == [CLAIMING, YIELDING]


def test_a_claim_without_success_ends_in_giving_way():
    order, angles = crowd(2)
    stand_still(order, angles, [-1, 0], 40)
    assert order.state[1] == YIELDING and order.ranks[1] == 0.0


def test_claims_are_limited_and_the_plan_ends():
    order, angles = crowd(2, claims=2)
    assert not stand_still(order, angles, [1, 0], 100)
    assert stand_still(order, angles, [1, 0], 400)
    assert order.state.tolist() == [FREE, FREE] and not order.ranks.any()


def test_a_robot_without_a_target_claims_nothing_and_always_makes_way():
    order, angles = crowd(2, alone_s=np.zeros(2))
    stand_still(order, angles, [1, 0], 20)
    assert order.state.tolist() == [FREE, FREE]
    order, angles = crowd(2, alone_s=np.array([0.0, 0.1]), claims=9)
    for _ in range(4):
        stand_still(order, angles, [1, 0], 7)
        assert order.state.tolist() == [YIELDING, CLAIMING]
        goal = np.array([angles[0], [1.0, 0.5]])
        stand_still(order, goal, [-1, -1], 40)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("patience_s", 0.0),
        ("patience_s", np.nan),
        ("yield_s", -1.0),
        ("yield_s", "long"),
        ("claims", -1),
        ("claims", 1.5),
        ("attraction", "tip"),
        ("adaptive", False),
        ("lambda1", 0.0),
    ],
)
@pytest.mark.parametrize("planner", ["dnf_priority", "dnf_arms_priority"])
def test_parameters_out_of_range_are_refused(planner, name, value):
    with pytest.raises(PlannerError, match=name):
        make_planner(planner, **{name: value})


def test_slow_robots_wait_longer():
    parameters = DnfPriorityParameters()
    assert parameters.waits_s(np.full((3, 2), np.pi)) == pytest.approx((0.05, 0.3))
    assert parameters.waits_s(np.full((3, 2), np.pi / 15)) == pytest.approx((0.75, 4.5))
    given = DnfPriorityParameters(patience_s=0.2, yield_s=1.0)
    assert given.waits_s(np.full((3, 2), np.pi / 15)) == (0.2, 1.0)


def test_arms_stay_apart_where_robots_press_for_long(random_field, densely):
    problem = random_field("desi", 100, seed=2, disabled=0.2)
    plan = make_planner("dnf_arms_priority").plan(problem)
    pairs = neighbour_pairs(problem.plane)
    assert sampled_gaps(problem.plane, pairs, densely(plan.motion, 4)).min() > 0.1

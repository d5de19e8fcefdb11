# SPDX-License-Identifier: Apache-2.0
"""Rehearsals: robots that would be called to give way make way from the start."""

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import neighbour_pairs, sampled_gaps
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner import make_planner
from fiber_planner.dnf.navigation_function import Swarm
from fiber_planner.dnf.priority import FREE, WAITING, YIELDING, Priorities, Run, Waits
from fiber_planner.dnf.rehearsal import Rehearsals

NEVER = np.inf
DT, PATIENCE, YIELD = 0.01, 0.05, 0.3
# two sites: 1 calls 0, and 3 calls 2; the slowest of all, 4, meets no robot
ALONE = np.array([0.5, 1.5, 0.4, 1.6, 2.0])
FOLDING = np.array([0.7, 0.2, 0.9, 0.1, 0.5])
PAIRS = np.array([[1, 0], [3, 2]])


def shown(arrived, waits=None, called=None, calls=None, pairs=PAIRS):
    """Return what a run of the five robots showed, by default that 1 called 0 and 3 called 2."""
    called = [0.8, NEVER, 1.5, NEVER, NEVER] if called is None else called
    calls = [NEVER, 0.8, NEVER, 1.5, NEVER] if calls is None else calls
    waits = Waits.none(5) if waits is None else waits
    return Run(waits, np.array(arrived), np.array(called), np.array(calls), np.array(pairs))


def rehearsals(remedies=4):
    return Rehearsals(ALONE, FOLDING, PATIENCE, YIELD, DT, remedies)


def test_robots_called_first_wait_folded_and_are_back_in_time():
    waits = rehearsals().next_waits(shown([2.4, 1.5, 2.6, 1.9, 2.0]))
    # YIELD after the call, but so that unfolding ends with the slowest robot alone
    np.testing.assert_allclose(waits.until_s, [1.1, 0.0, 1.1, 0.0, 0.0])
    assert not waits.at_start.any()


def test_only_late_sites_are_changed():
    waits = rehearsals().next_waits(shown([1.9, 1.5, 2.6, 1.9, 2.0]))
    assert (waits.until_s > 0.0).tolist() == [False, False, True, False, False]
    assert rehearsals().next_waits(shown([1.9, 1.5, 1.8, 1.9, 2.0])) is None
    assert rehearsals(remedies=0).next_waits(shown([2.4, 1.5, 2.6, 1.9, 2.0])) is None


def test_a_robot_that_called_before_it_was_called_does_not_wait():
    called, calls = [0.8, 1.2, NEVER, NEVER, NEVER], [1.2, 0.8, NEVER, NEVER, NEVER]
    run = shown([NEVER, 2.9, 0.4, 1.6, 2.0], called=called, calls=calls, pairs=[[1, 0], [0, 1]])
    waits = rehearsals().next_waits(run)
    assert (waits.until_s > 0.0).tolist() == [True, False, False, False, False]


def test_every_site_gets_the_waits_that_served_it_best():
    tries = rehearsals(remedies=2)
    fold = tries.next_waits(shown([2.4, 1.5, 2.6, 1.9, 2.0]))
    nothing = [NEVER] * 5
    start = tries.next_waits(shown([2.0, 1.5, 2.5, 1.9, 2.0], fold, nothing, nothing))
    # the first site is in time and stays as it is, the second waits at its start
    np.testing.assert_allclose(start.until_s, [1.1, 0.0, 1.6, 0.0, 0.0])
    assert start.at_start.tolist() == [False, False, True, False, False]
    # that does good to the second site and harm to the first
    best = tries.next_waits(shown([2.9, 1.5, 2.0, 1.9, 2.0], start, nothing, nothing))
    assert best is None  # as in the run before
    tries = rehearsals(remedies=2)
    fold = tries.next_waits(shown([2.4, 1.5, 2.6, 1.9, 2.0]))
    start = tries.next_waits(shown([2.1, 1.5, 2.7, 1.9, 2.0], fold, nothing, nothing))
    best = tries.next_waits(shown([2.9, 1.5, 2.1, 1.9, 2.0], start, nothing, nothing))
    np.testing.assert_allclose(best.until_s, [fold.until_s[0], 0.0, start.until_s[2], 0.0, 0.0])
    assert best.at_start.tolist() == [False, False, True, False, False]
    assert tries.next_waits(shown([2.1, 1.5, 2.1, 1.9, 2.0], best, nothing, nothing)) is None


def test_a_robot_called_after_its_wait_waits_longer_and_then_the_caller_waits():
    tries = rehearsals()
    nothing = [NEVER] * 5
    fold = tries.next_waits(shown([2.4, 1.5, 1.0, 1.6, 2.0]))
    called, calls = [1.4, NEVER, NEVER, NEVER, NEVER], [NEVER, 1.4, NEVER, NEVER, NEVER]
    start = tries.next_waits(shown([2.2, 1.5, 1.0, 1.6, 2.0], fold, called, calls))
    later = tries.next_waits(shown([2.3, 1.5, 1.0, 1.6, 2.0], start, nothing, nothing))
    assert later.until_s[0] == pytest.approx(1.4 + PATIENCE) and not later.at_start[0]
    caller = tries.next_waits(shown([2.9, 1.5, 1.0, 1.6, 2.0], later, nothing, nothing))
    np.testing.assert_allclose(caller.until_s, [0.0, 1.7, 0.0, 0.0, 0.0])


def test_remedies_do_not_depend_on_the_order_of_the_rows():
    order = np.array([3, 0, 4, 2, 1])
    place = np.argsort(order)
    run = shown([2.4, 1.5, 2.6, 1.9, 2.0])
    moved = Run(
        Waits.none(5), run.arrived_s[order], run.called_s[order], run.calls_s[order],
        place[run.pairs],
    )  # fmt: skip
    one, other = rehearsals(), Rehearsals(ALONE[order], FOLDING[order], PATIENCE, YIELD, DT, 4)
    for _ in range(3):
        waits, same = one.next_waits(run), other.next_waits(moved)
        assert np.array_equal(waits.until_s[order], same.until_s)
        assert np.array_equal(waits.at_start[order], same.at_start)
        run, moved = run._replace(waits=waits), moved._replace(waits=same)


def row_of_two(until_s, at_start=False):
    """Two robots in a row that would turn theta by 1 rad, the first one waiting."""
    limits, start = np.full((2, 2), np.pi), np.tile([0.0, 0.5], (2, 1))
    swarm = Swarm(
        np.array([[0.0, 0.0], [10.0, 0.0]]), np.full((2, 2), 3.0), np.zeros((2, 2)), limits,
        limits, np.ones(2, dtype=bool), np.tile([1.0, 0.5], (2, 1)), np.zeros((2, 2)),
    )  # fmt: skip
    waits = Waits(np.array([until_s, 0.0]), np.array([at_start, False]))
    alone_s = np.array([1.0, 2.0])
    return Priorities(swarm, start, alone_s, DT, PATIENCE, YIELD, 5, waits), start


def still(order, angles, blocker, steps):
    blocker = np.array(blocker)
    for _ in range(steps):
        order.update(angles, angles, np.where(blocker < 0, 1.0, 0.0), blocker)


def test_a_waiting_robot_folds_then_turns_and_then_goes_to_its_goal():
    order, angles = row_of_two(until_s=0.4)
    assert order.state.tolist() == [WAITING, FREE] and not order.ranks.any()
    assert order.aim[0].tolist() == [0.0, np.pi] and order.aim[1].tolist() == [1.0, 0.5]
    still(order, angles, [-1, -1], 16)
    assert order.aim[0].tolist() == [1.0, np.pi]
    still(order, angles, [-1, -1], 25)
    assert order.state[0] == FREE and order.aim[0].tolist() == [1.0, 0.5]


def test_a_robot_that_waits_at_its_start_aims_at_it_and_folds_when_called():
    order, angles = row_of_two(until_s=0.6, at_start=True)
    assert order.aim[0].tolist() == [0.0, 0.5]
    still(order, angles, [-1, 0], 8)  # the second one claims the way
    assert order.state[0] == YIELDING and order.aim[0].tolist() == [0.0, np.pi]
    goal = np.array([angles[0], [1.0, 0.5]])
    still(order, goal, [-1, -1], 31)
    assert order.state[0] == WAITING and order.ranks[0] == 0.0
    assert order.aim[0].tolist() == [0.0, 0.5]
    still(order, goal, [-1, -1], 22)
    assert order.state[0] == FREE
    run = order.shown()
    assert run.pairs.tolist() == [[1, 0]] and np.isfinite(run.calls_s[1])
    assert run.called_s[0] == np.inf  # it was called in its wait only
    assert run.arrived_s[0] == np.inf and run.arrived_s[1] == pytest.approx(0.09)


def test_a_call_without_a_wait_is_noted_once():
    order, angles = row_of_two(until_s=0.0)
    still(order, angles, [-1, 0], 20)
    run = order.shown()
    assert run.called_s[0] == run.calls_s[1] == pytest.approx(0.06)
    assert run.called_s[1] == run.calls_s[0] == np.inf


# start and goal of two robots 8 mm apart [rad]: what one of them does early is in the way of what
# the other one does later
ONE_IN_THE_WAY = [
    ([[2.1, 1.8], [-2.5, 1.7]], [[0.9, 1.3], [2.5, 1.2]]),
    ([[-1.3, 2.8], [1.4, 0.0]], [[-1.4, 2.3], [-3.1, 2.7]]),
    ([[-1.5, 2.3], [0.0, 0.2]], [[-0.3, 2.2], [-3.3, 2.0]]),
]


@pytest.mark.parametrize(("start", "goal"), ONE_IN_THE_WAY)
def test_a_robot_makes_way_before_it_is_in_the_way(start, goal, robots, densely):
    plane = robots([(0, 0), (8, 0)])
    problem = Problem(plane, np.array(start), kinematics.forward(plane, np.array(goal))[1])
    bound_s = lower_bound_s(problem)
    unforeseen = make_planner("dnf_arms_priority", rehearsals=0).plan(problem)
    assert unforeseen.motion.makespan_s > 1.35 * bound_s
    foreseen = make_planner("dnf_arms_priority").plan(problem)
    assert (foreseen.reason == Reason.OK).all()
    assert foreseen.motion.makespan_s < 1.2 * bound_s
    assert np.array_equal(foreseen.motion.end, foreseen.goal)
    path = densely(foreseen.motion)
    assert sampled_gaps(plane, [[0, 1]], path).min() > 0.1
    speed = np.abs(np.diff(foreseen.motion.angles, axis=2)) / np.diff(foreseen.motion.time_s)
    assert (speed <= plane.speeds[..., None] * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("name", ["dnf_priority", "dnf_arms_priority"])
def test_crowded_planes_end_sooner_and_never_later(name, random_field, densely):
    won = 0
    for seed in (11, 12, 13, 14):
        problem = random_field("pfs", 300, seed)
        before = make_planner(name, rehearsals=0).plan(problem)
        after = make_planner(name).plan(problem)
        missing = [(plan.reason != Reason.OK).sum() for plan in (before, after)]
        assert missing[1] <= missing[0]
        if missing[1] == missing[0]:
            assert after.motion.makespan_s <= before.motion.makespan_s
        won += missing[1] < missing[0]
        won += after.motion.makespan_s < 0.95 * before.motion.makespan_s
        if name == "dnf_arms_priority":
            pairs = neighbour_pairs(problem.plane)
            assert sampled_gaps(problem.plane, pairs, densely(after.motion)).min() > 0.1
    assert won >= 2


def test_progress_grows_through_all_rehearsals(random_field):
    problem = random_field("pfs", 200, seed=1)
    heard = []
    make_planner("dnf_arms_priority").plan(problem, lambda part, text: heard.append((part, text)))
    parts = [part for part, _ in heard]
    assert parts == sorted(parts) and 0.0 <= parts[0] and parts[-1] <= 1.0
    assert any(text.startswith("run 2 of") for _, text in heard)

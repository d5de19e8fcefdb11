# SPDX-License-Identifier: Apache-2.0
"""The integer program of goals, against enumeration of all choices."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import gaps, neighbour_pairs
from fiber_core.fibres import ANY_FIBRE
from fiber_core.fields import random_problem
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_planner import make_planner, pair_bound, travel_s
from fiber_planner.direct import initial_plan
from fiber_planner.goal_program import goal_program, least_makespan_s, most_goals, robots_with_goals

MARGIN = 0.1


def on_target(problem, goal):
    tips = kinematics.forward(problem.plane, goal)[1]
    return np.linalg.norm(tips - problem.targets, axis=1)


def fastest(problem):
    angles, valid = kinematics.inverse(problem.plane, problem.targets)
    return np.where(valid, travel_s(problem, angles), np.inf).min(axis=1)


def crowded_field(seed, n=7, name="desi_outlines"):
    """Targets drawn with no regard to each other: some can only be reached by one of two robots."""
    rng = np.random.default_rng(seed)
    plane = preset(name, n).with_enabled(rng.random(n) < 0.85)
    start = random_problem(plane, rng).start
    distance, turn = plane.arms[0].sum() * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    offset = distance[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Problem(plane, start, plane.centers + np.where(plane.enabled[:, None], offset, np.nan))


def choices(problem):
    """The largest number of robots with clear goals, and the least time of their slowest [s]."""
    plane, pairs = problem.plane, neighbour_pairs(problem.plane)
    angles, valid = kinematics.inverse(plane, problem.targets)
    poses = [
        [None, *angles[i][valid[i]]] if plane.enabled[i] else ["stays"] for i in range(plane.n)
    ]
    best, soonest = 0, np.inf
    for choice in product(*poses):
        placed = np.array([pose is not None for pose in choice])
        count = np.count_nonzero(placed & plane.enabled)
        if count < best:
            continue
        at = [problem.start[i] if isinstance(p, str) else p for i, p in enumerate(choice)]
        at = np.array([problem.start[i] if p is None else p for i, p in enumerate(at)])
        both = pairs[placed[pairs].all(axis=1)]
        if not len(both) or gaps(plane, both, at).min() >= MARGIN:
            moves = placed & plane.enabled
            time = travel_s(problem, at)[moves].max(initial=0.0)
            soonest = min(time, soonest) if count == best else time
            best = count
    return best, soonest


@pytest.mark.parametrize("name", ["desi_outlines", "moons"])
def test_enumeration_finds_no_more_robots_and_no_shorter_time(name):
    given_up = later = 0
    for seed in range(12):
        problem = crowded_field(seed, name=name)
        seeking = np.isfinite(fastest(problem)) & problem.plane.enabled
        program = goal_program(problem, seeking, MARGIN)
        robots, soonest = choices(problem)
        chosen, proven = most_goals(program)
        assert proven and (chosen[~seeking] < 0).all()
        assert robots_with_goals(chosen) == robots, seed
        least_s, proven = least_makespan_s(program, robots)
        assert proven and least_s == pytest.approx(soonest, abs=1e-12), seed
        chosen, _ = most_goals(program, soonest, soonest=True)
        assert robots_with_goals(chosen) == robots
        given_up += np.count_nonzero(seeking) - robots
        later += soonest > fastest(problem)[chosen >= 0].max(initial=0.0) + 1e-6
    assert given_up > 2
    assert later > 2 or name != "moons"


def test_a_least_time_of_searches_that_were_given_up_is_not_called_proven(monkeypatch):
    problem = crowded_field(0, name="moons")
    program = goal_program(problem, problem.plane.enabled & np.isfinite(fastest(problem)), MARGIN)
    robots = robots_with_goals(most_goals(program)[0])
    assert least_makespan_s(program, robots)[1]
    monkeypatch.setattr(
        "fiber_planner.goal_program.most_goals", lambda *a, **k: (most_goals(*a, **k)[0], False)
    )
    assert not least_makespan_s(program, robots)[1]


def test_a_search_for_soon_ends_that_is_given_up_costs_no_robot_its_target(monkeypatch):
    problem = crowded_field(0, name="moons")
    seeking = problem.plane.enabled & np.isfinite(fastest(problem))
    robots = robots_with_goals(most_goals(goal_program(problem, seeking, MARGIN))[0])

    def given_up(program, within_s=np.inf, soonest=False):
        if not soonest:
            return most_goals(program, within_s)
        return np.full(len(program.possible), -1), False

    monkeypatch.setattr(initial_plan, "most_goals", given_up)
    elbow, _ = initial_plan._soonest_ends(problem, seeking, [MARGIN])
    assert robots_with_goals(elbow) == robots > 0


def test_direct_brings_all_others_to_their_targets():
    # without the test of ends, conflicts of goals last through all makespans
    for seed in range(5):
        problem = crowded_field(seed, 61)
        plan = make_planner("direct").plan(problem)
        lost = np.count_nonzero(plan.reason == Reason.GOAL_BLOCKED)
        assert lost and np.count_nonzero(plan.reason == Reason.NOT_CONVERGED) <= 1
        arrives = plan.reason == Reason.OK
        assert on_target(problem, plan.motion.end)[arrives].max() < 1e-9


@pytest.mark.parametrize("apart_mm, arrive", [(0.02, 1), (0.3, 2)])
def test_of_two_robots_that_start_too_close_one_arrives(apart_mm, arrive):
    plane = preset("desi", 2)
    start = np.array([[0.0, 0.0], [np.pi, 0.0]])  # stretched, tip to tip
    far = replace(plane, centers=np.array([[0.0, 0.0], [20.0, 0.0]]))
    wide = float(gaps(far, [[0, 1]], start)[0])
    plane = replace(far, centers=np.array([[0.0, 0.0], [20.0 - wide + apart_mm, 0.0]]))
    problem = Problem(plane, start, plane.centers + np.array([0.0, 5.0]))
    bound, plan = pair_bound(problem), make_planner("direct").plan(problem)
    arrived = plan.reason == Reason.OK
    assert (bound.robots, np.count_nonzero(arrived)) == (arrive, arrive)
    assert (plan.reason[~arrived] == Reason.TANGLED).all()


def test_no_plan_beats_the_pair_bound():
    refused = 0
    for seed in range(3):
        problem = crowded_field(seed, 37, "moons")
        plan, bound = make_planner("direct", shortening=0.0).plan(problem), pair_bound(problem)
        arrived = np.count_nonzero(plan.reason == Reason.OK)
        assert bound.proven and arrived <= bound.robots
        assert arrived < bound.robots or plan.motion.makespan_s >= bound.time_s
        refused += np.count_nonzero(problem.asked) - bound.robots
    assert refused


@pytest.mark.parametrize("fibre, proven", [(1, True), (ANY_FIBRE, False)])
def test_the_bound_is_not_called_proven_where_a_fibre_may_be_chosen(fibre, proven):
    plane, places = preset("sdss_v", 7), np.array([[14.9, -0.4], [14.9, 0.4]])
    fibres = np.broadcast_to(places, (7, *places.shape))
    plane = replace(plane, fibres=fibres, fibre_names=("a", "b"), fibre=np.full(7, fibre))
    problem = Problem(plane, np.full((7, 2), 1.5), plane.centers + [9.0, 0.0])
    assert pair_bound(problem).proven is proven

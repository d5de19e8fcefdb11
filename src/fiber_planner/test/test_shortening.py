# SPDX-License-Identifier: Apache-2.0
"""Laws of shortening: a plan is replaced by a shorter one in which as many robots arrive."""

import itertools

import numpy as np
import pytest

from fiber_core.clearance import certify
from fiber_core.fields import random_problem
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_planner.direct import DirectParameters, DirectPlanner, straight_pieces
from fiber_planner.direct.search import Search

CROWDED = [("sdss_v", 37, 1), ("sdss_v", 37, 2), ("sdss_v", 61, 3), ("moons", 37, 4)]


class Ended(Exception):
    pass


def plan(problem, shortening, progress=None, **parameters):
    parameters = DirectParameters(shortening=shortening, **parameters)
    return DirectPlanner(parameters).plan(problem, progress)


def makespan_s(planned):
    return planned.motion.time_s[-1]


@pytest.fixture(scope="module")
def plans():
    """First and shortened plan of each crowded field."""
    fields = [random_problem(preset(name, n), np.random.default_rng(s)) for name, n, s in CROWDED]
    return [(problem, plan(problem, 0.0), plan(problem, 300.0)) for problem in fields]


def test_a_plan_is_shortened_and_no_robot_loses_its_target(plans):
    shorter = 0
    for problem, first, best in plans:
        assert lower_bound_s(problem) <= makespan_s(best) <= makespan_s(first)
        assert (best.reason == Reason.OK).sum() >= (first.reason == Reason.OK).sum()
        shorter += makespan_s(best) < 0.95 * makespan_s(first)
    assert shorter >= len(plans) - 1


def test_a_shortened_plan_is_certified(plans):
    parameters = DirectParameters()
    for problem, _, best in plans:
        motion = straight_pieces(best.motion)
        assert certify(problem.plane, motion, parameters.safety).ok


def test_compressed_plans_follow_each_other_before_the_other_search_has_ended(plans, monkeypatch):
    begun, begin_at = [], Search.begin_at

    def spy(search, stretch, released, like=None):
        begun.append((stretch, like is not None))
        begin_at(search, stretch, released, like)

    monkeypatch.setattr(Search, "begin_at", spy)
    most = 0
    for problem, _, _ in plans:
        begun.clear()
        plan(problem, 1.0)  # ends when both searches have made their first moves
        anew = [stretch for stretch, compressed in begun if not compressed]
        compressed = [stretch for stretch, compressed in begun if compressed]
        assert len(anew) == 1
        assert all(later < stretch for stretch, later in itertools.pairwise(compressed))
        most = max(most, len(compressed))
    assert most > 1


def test_the_shortest_plan_takes_fewer_lines_than_it_was_found_with(plans, monkeypatch):
    monkeypatch.setattr(Search, "simplify", Search._result)
    problem, _, best = plans[2]
    as_found = plan(problem, 300.0)
    assert makespan_s(best) == makespan_s(as_found)
    np.testing.assert_array_equal(best.reason, as_found.reason)
    lines = [straight_pieces(planned.motion).counts.sum() for planned in (best, as_found)]
    assert lines[0] < lines[1]


def test_the_same_seed_gives_the_same_bytes_whatever_thread_is_first(plans):
    problem, _, best = plans[0]
    again = plan(problem, 300.0)
    assert again.motion.angles.tobytes() == best.motion.angles.tobytes()


def test_the_progress_callback_ends_the_further_searches(plans):
    problem, _, _ = plans[0]

    def end(fraction, text):
        assert 0.0 <= fraction <= 1.0
        if "looking for less" in text:
            raise Ended

    with pytest.raises(Ended):
        plan(problem, 1e6, end)


def test_a_budget_ends_the_further_searches(plans):
    problem, first, _ = plans[0]
    best = plan(problem, 1e6, budget_s=3.0)
    assert makespan_s(best) <= makespan_s(first)


def test_a_loose_plane_is_not_searched_again():
    plane = preset("desi", 2000)
    rng = np.random.default_rng(0)
    problem = random_problem(plane.with_enabled(rng.random(plane.n) >= 0.15), rng)
    first, best = plan(problem, 0.0), plan(problem, 300.0)
    assert makespan_s(first) > 1.02 * lower_bound_s(problem)  # there would be something to search
    assert best.motion.angles.tobytes() == first.motion.angles.tobytes()

# SPDX-License-Identifier: Apache-2.0
"""Laws of shortening: a plan is replaced by a shorter one in which as many robots arrive."""

import itertools
import time
from typing import NamedTuple

import numpy as np
import pytest

from fiber_core.clearance import certify
from fiber_core.fields import random_problem
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_planner.direct import DirectParameters, DirectPlanner, straight_pieces
from fiber_planner.direct.plan_state import measure_all
from fiber_planner.direct.search import Search
from fiber_planner.direct.simplification import simplify_plan

CROWDED = [("sdss_v", 37, 1), ("sdss_v", 37, 2), ("sdss_v", 61, 3), ("moons", 37, 4)]


class Ended(Exception):
    pass


def plan(problem, shortening, progress=None, **parameters):
    parameters = DirectParameters(shortening=shortening, **parameters)
    return DirectPlanner(parameters).plan(problem, progress)


def makespan_s(planned):
    return planned.motion.time_s[-1]


class Begun(NamedTuple):
    """A search for a shorter plan: the makespan of its plan and of the one it began with."""

    stretch: float
    before: float
    found: bool


@pytest.fixture(scope="module")
def searched():
    """First and shortened plan of each crowded field, and the searches between them."""
    fields = [random_problem(preset(name, n), np.random.default_rng(s)) for name, n, s in CROWDED]
    return [(problem, plan(problem, 0.0), *searches_of(problem)) for problem in fields]


@pytest.fixture(scope="module")
def plans(searched):
    """First and shortened plan of each crowded field."""
    return [(problem, first, best) for problem, first, best, _ in searched]


def searches_of(problem):
    begun, begin_at, go_on = {}, Search.begin_at, Search.go_on

    def begin(search, stretch, released, like):
        begun[search] = Begun(stretch, like.stretch, False)
        begin_at(search, stretch, released, like)

    def spy(search, moves):
        found = go_on(search, moves)
        begun[search] = begun[search]._replace(found=found)
        return found

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Search, "begin_at", begin)
        patched.setattr(Search, "go_on", spy)
        best = plan(problem, 300.0)
    return best, list(begun.values())


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


def test_every_search_begins_with_the_best_plan_so_far(searched):
    succeeded = 0
    for _, _, _, begun in searched:
        best = begun[0].before
        for before, some in itertools.groupby(begun, lambda search: search.before):
            assert before == best
            found = [search.stretch for search in some if search.found]
            best = min([best, *found])
            succeeded += len(found)
    assert succeeded > 2 * len(searched)


def test_after_a_search_in_vain_two_plans_are_compressed_by_less(searched):
    followed = 0
    for _, _, _, begun in searched:
        for failed, *two in zip(begun, begun[1:], begun[2:]):
            least = max(0.6 * (failed.before - failed.stretch), 0.006)  # a half, or the least step
            if not failed.found and two[0].before == two[1].before == failed.before:
                assert all(search.before - search.stretch <= least for search in two)
                followed += 1
    assert followed > 0


def test_the_shortest_plan_takes_fewer_lines_than_it_was_found_with(plans, monkeypatch):
    monkeypatch.setattr(Search, "simplify", Search.result)
    problem, _, best = plans[2]
    as_found = plan(problem, 300.0)
    assert makespan_s(best) == makespan_s(as_found)
    np.testing.assert_array_equal(best.reason, as_found.reason)
    lines = [straight_pieces(planned.motion).counts.sum() for planned in (best, as_found)]
    assert lines[0] < lines[1]


def test_only_robots_of_a_pair_that_is_not_confirmed_get_their_lines_of_before(plans):
    problem, _, _ = plans[2]
    search = Search(problem, DirectParameters(), None, time.monotonic)
    search.run()
    scene, before, calls = search._scene, search._plan.q.copy(), []

    def unconfirmed():
        changed = (search._plan.q != before).any(axis=(1, 2))
        calls.append(np.zeros(len(scene.pairs), dtype=bool))
        if len(calls) == 1:
            calls[0][np.flatnonzero(changed[scene.pairs].all(axis=1))[0]] = True
            calls[0][~scene.movable[scene.pairs].all(axis=1)] = False
        return calls[-1].copy()

    simplify_plan(scene, search._plan, search._grid.step_s, 200, search._blocks, unconfirmed)
    changed = (search._plan.q != before).any(axis=(1, 2))
    refused = scene.pairs[calls[0]]
    assert refused.size and not changed[refused].any()
    assert changed.sum() > 3
    assert measure_all(scene, search._plan) == 0


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


# Fields of which one pair or two have no way in the time that the slowest robot needs alone.
@pytest.mark.parametrize("seed", [117, 130, 132, 599])
def test_late_robots_of_a_loose_plane_end_sooner(seed):
    problem = random_problem(preset("desi_outlines", 60), np.random.default_rng(seed))
    first, best = plan(problem, 0.0), plan(problem, 800.0)
    assert makespan_s(first) > 1.1 * lower_bound_s(problem)
    assert makespan_s(best) < makespan_s(first) - 0.015 * lower_bound_s(problem)
    assert np.array_equal(best.reason, first.reason)
    assert certify(problem.plane, straight_pieces(best.motion), DirectParameters().safety).ok


def test_a_loose_plane_is_not_searched_again():
    plane = preset("desi", 2000)
    rng = np.random.default_rng(0)
    problem = random_problem(plane.with_enabled(rng.random(plane.n) >= 0.15), rng)
    begun = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Search, "begin_at", lambda *given: begun.append(given))
        first, best = plan(problem, 0.0), plan(problem, 300.0)
    assert makespan_s(first) > 1.02 * lower_bound_s(problem)  # there would be something to search
    assert not begun and np.array_equal(best.reason, first.reason)

# SPDX-License-Identifier: Apache-2.0
"""The registry, and what planners take and give."""

import numpy as np
import pytest

import fiber_planner
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_planner import (
    DnfParameters,
    PlannedMotion,
    Planner,
    PlannerError,
    make_planner,
    parameters_of,
    planners,
)

NAMES = planners()


def test_planners_go_by_their_names():
    assert {"dnf", "dnf_arms"} <= set(NAMES)
    assert [make_planner(name).name for name in NAMES] == list(NAMES)


def test_unknown_planner_is_refused_with_the_names_there_are():
    with pytest.raises(PlannerError, match="'navigator'.*dnf"):
        make_planner("navigator")


@pytest.mark.parametrize("name", NAMES)
def test_unknown_parameter_is_refused_by_name(name):
    with pytest.raises(PlannerError, match="lambda3"):
        make_planner(name, lambda3=1.0)


class StayingPlanner:
    """A planner from outside the package: no robot moves."""

    name = "staying"

    def plan(self, problem, progress=None):
        reason = np.where(problem.asked, Reason.NOT_CONVERGED, Reason.NO_TARGET)
        motion = SampledMotion(np.array([0.0]), problem.start[:, :, None])
        return PlannedMotion(motion, problem.start, reason)


def test_a_planner_of_another_package_is_used_as_it_is(random_field):
    planner = StayingPlanner()
    assert isinstance(planner, Planner)
    assert make_planner(planner) is planner
    assert make_planner(planner).plan(random_field("desi", 7, seed=0)).motion.makespan_s == 0.0


def test_an_object_without_a_method_plan_is_refused_with_the_names_there_are():
    with pytest.raises(PlannerError, match="7 is no planner.*dnf_arms"):
        make_planner(7)


def test_a_class_in_place_of_a_planner_is_refused_with_what_to_do():
    with pytest.raises(PlannerError, match="pass an instance"):
        make_planner(StayingPlanner)


def test_parameters_beside_a_planner_object_are_refused_by_name():
    with pytest.raises(PlannerError, match="'staying'.*seed"):
        make_planner(StayingPlanner(), seed=1)


def test_all_planners_and_their_parameters_are_public():
    for name in NAMES:
        planner = make_planner(name)
        assert getattr(fiber_planner, type(planner).__name__) is type(planner)
        assert getattr(fiber_planner, parameters_of(name).__name__) is parameters_of(name)


def test_given_parameters_arrive():
    assert make_planner("dnf", lambda2=0.25).parameters == DnfParameters(lambda2=0.25)


@pytest.mark.parametrize(
    "wrong",
    [
        {"lambda1": 0.0},
        {"lambda1": np.nan},
        {"lambda2": -0.05},
        {"dt_s": -0.01},
        {"tolerance_mm": 0.0},
        {"horizon_s": np.inf},
        {"margin_mm": -0.1},
        {"inner_mm": -2.0},
        {"sign": "reversed"},
        {"attraction": "elbow"},
        {"adaptive": 2},
        {"lambda1": "strong"},
    ],
)
def test_a_parameter_out_of_range_is_refused_with_its_name_and_value(wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(PlannerError) as refusal:
        make_planner("dnf", **wrong)
    assert name in str(refusal.value) and str(value) in str(refusal.value)


def test_envelopes_must_nest(robots):
    with pytest.raises(PlannerError, match="4.0"):
        DnfParameters(outer_mm=4.0, inner_mm=4.0)
    with pytest.raises(PlannerError, match="6.0"):
        DnfParameters(inner_mm=6.0).radii_mm(robots([(0, 0)]))
    with pytest.raises(PlannerError, match="0.0 mm"):
        DnfParameters().radii_mm(robots([(0, 0)], envelope_mm=0.0))


def test_planned_motion_checks_that_its_parts_belong_together():
    motion = SampledMotion(np.array([0.0]), np.zeros((3, 2, 1)))
    with pytest.raises(PlannerError, match="goal"):
        PlannedMotion(motion, np.zeros((2, 2)), np.zeros(3))
    with pytest.raises(PlannerError, match="reason"):
        PlannedMotion(motion, np.zeros((3, 2)), np.zeros(2))


@pytest.mark.parametrize("name", ["dnf", "dnf_arms"])
def test_a_plan_is_made_for_a_plane_with_nothing_asked(name, random_field):
    problem = random_field("desi", 7, seed=0, disabled=1.0)
    plan = make_planner(name).plan(problem)
    assert np.all(plan.reason == Reason.NO_TARGET)
    assert np.array_equal(plan.goal, problem.start)
    assert plan.motion.makespan_s == 0.0


@pytest.mark.parametrize("name", ["dnf", "dnf_arms"])
def test_progress_rises_and_comes_with_words(name, random_field):
    told = []
    make_planner(name).plan(random_field("desi", 7, seed=0), lambda *news: told.append(news))
    parts = [part for part, _ in told]
    assert parts and parts == sorted(parts) and 0 < parts[0] and parts[-1] <= 1
    assert all(isinstance(words, str) and words for _, words in told)

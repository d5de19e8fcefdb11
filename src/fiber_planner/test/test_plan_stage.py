# SPDX-License-Identifier: Apache-2.0
"""The planning stage: checked targets, the plan of the accepted ones, one reason per robot."""

import numpy as np
import pytest

from fiber_core.assignment import assign
from fiber_core.errors import TargetsError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_planner import (
    LISTED_PLANNER,
    PlannedMotion,
    PlannerError,
    make_planner,
    plan_assignment,
    plan_targets,
    planners,
)


class FixedPlanner:
    """A planner that keeps every robot where it is and reports given reasons."""

    name = "fixed"

    def __init__(self, reason=Reason.OK, robots=None):
        self.reason, self.robots, self.problem = reason, robots, None

    def plan(self, problem, progress=None):
        self.problem = problem
        if progress is not None:
            progress(1.0, "nothing to do")
        n = problem.plane.n if self.robots is None else self.robots
        reason = np.full(n, self.reason)
        reason[: len(problem.asked)][~problem.asked[:n]] = Reason.NO_TARGET
        start = np.resize(problem.start, (n, 2))
        return PlannedMotion(SampledMotion([0.0], start[:, :, None]), start, reason)


@pytest.fixture
def problem(random_field):
    return random_field("desi", 7, seed=2)


def targets_of(problem):
    return problem.plane.ids[problem.asked], problem.targets[problem.asked]


def test_the_stage_makes_the_plan_of_its_planner(problem):
    planner = make_planner("direct")
    result = plan_targets(problem.plane, problem.start, *targets_of(problem), planner)
    alone = planner.plan(problem)
    assert np.array_equal(result.planned.motion.angles, alone.motion.angles)
    assert np.array_equal(result.reason, alone.reason)
    assert np.array_equal(result.arriving, problem.asked) and not result.held.any()


def test_a_refused_target_is_not_planned_and_keeps_its_reason(problem):
    ids, xy_mm = targets_of(problem)
    xy_mm = np.array(xy_mm)
    xy_mm[0] = problem.plane.centers[ids[0]] + [40.0, 0.0]
    planner = FixedPlanner()
    result = plan_targets(problem.plane, problem.start, ids, xy_mm, planner)
    assert not planner.problem.asked[ids[0]] and result.problem is planner.problem
    assert result.planned.reason[ids[0]] == Reason.NO_TARGET
    assert result.reason[ids[0]] == Reason.UNREACHABLE
    assert np.array_equal(result.held, result.assignment.refused)


def test_planners_of_the_papers_ask_for_targets_that_are_d_apart(problem):
    plane, ids = problem.plane, problem.plane.ids[:2]
    towards = (plane.centers[1] - plane.centers[0]) / np.hypot(
        *(plane.centers[1] - plane.centers[0])
    )
    xy_mm = [plane.centers[0] + 3.5 * towards, plane.centers[1] - 3.5 * towards]  # 3.4 mm apart
    for name in planners():
        if name == LISTED_PLANNER:
            continue  # for other motors
        planner = make_planner(name)
        reason = plan_targets(plane, problem.start, ids, xy_mm, planner).assignment.reason[:2]
        expected = Reason.OK if name == "direct" else Reason.TARGET_TOO_CLOSE
        assert reason.tolist() == [Reason.OK, expected], name
    narrow = make_planner("dnf", outer_mm=3.0)
    reason = plan_targets(plane, problem.start, ids, xy_mm, narrow).assignment.reason[:2]
    assert reason.tolist() == [Reason.OK, Reason.OK]


def test_robots_that_the_planner_holds_have_its_reason(problem):
    planner = FixedPlanner(Reason.NOT_CONVERGED)
    result = plan_targets(problem.plane, problem.start, *targets_of(problem), planner)
    assert set(result.reason[problem.asked]) == {Reason.NOT_CONVERGED}
    assert np.array_equal(result.held, problem.asked) and not result.arriving.any()


def test_robots_without_a_target_are_neither_arriving_nor_held(problem):
    result = plan_targets(problem.plane, problem.start, [], np.zeros((0, 2)), FixedPlanner())
    assert set(result.reason) == {Reason.NO_TARGET}
    assert not result.arriving.any() and not result.held.any()


def test_malformed_targets_reach_no_planner(problem):
    planner = FixedPlanner()
    with pytest.raises(TargetsError, match="robot 99"):
        plan_targets(problem.plane, problem.start, [99], [[0.0, 0.0]], planner)
    assert planner.problem is None


def test_a_motion_of_another_plane_is_refused_with_both_numbers(problem):
    with pytest.raises(PlannerError, match="'fixed'.*6 robots.*plane of 7"):
        plan_targets(problem.plane, problem.start, *targets_of(problem), FixedPlanner(robots=6))


def test_progress_of_the_planner_is_passed_on(problem):
    reports = []
    plan_targets(
        problem.plane, problem.start, *targets_of(problem), FixedPlanner(),
        lambda fraction, text: reports.append((fraction, text)),
    )  # fmt: skip
    assert reports == [(1.0, "nothing to do")]


def test_an_assignment_can_be_planned_later_with_the_same_result(problem):
    planner = make_planner("direct")
    ids, xy_mm = targets_of(problem)
    whole = plan_targets(problem.plane, problem.start, ids, xy_mm, planner)
    assignment = assign(problem.plane, problem.start, ids, xy_mm)
    half = plan_assignment(problem.start, assignment, planner)
    assert np.array_equal(half.planned.motion.angles, whole.planned.motion.angles)
    assert np.array_equal(half.reason, whole.reason)


def test_a_target_of_a_disabled_robot_is_refused_and_the_others_are_planned(problem):
    plane = problem.plane.with_enabled(np.arange(7) != 5)
    ids = np.append(problem.plane.ids[problem.asked], 5)
    ids, at = np.unique(ids, return_index=True)
    xy_mm = np.vstack([problem.targets[problem.asked], plane.centers[5] + 1.0])[at]
    result = plan_targets(plane, problem.start, ids, xy_mm, make_planner("direct"))
    assert result.reason[5] == Reason.DISABLED and result.held[5]
    assert result.arriving.sum() >= 3

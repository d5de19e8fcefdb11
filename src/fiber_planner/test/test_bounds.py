# SPDX-License-Identifier: Apache-2.0
"""Slow robots and fixed joints do not hold others; absurd parameters are refused by name."""

from dataclasses import fields, replace

import numpy as np
import pytest

from fiber_core import Reason, WireUnits, forward, preset, random_problem
from fiber_core.errors import FiberError
from fiber_planner import make_planner, plan_targets, planners
from fiber_planner.direct import DirectParameters
from fiber_planner.dnf import DnfParameters, DnfPriorityParameters

EXTREMES = (0.0, -1.0, np.nan, np.inf, 1e-300, 1e12, 1e25, 2.0**63, "many")
ROBOT = 4


def planned(problem, name="direct"):
    rows = np.flatnonzero(problem.asked)
    return plan_targets(
        problem.plane, problem.start, problem.plane.ids[rows], problem.targets[rows],
        make_planner(name),
    )  # fmt: skip


@pytest.fixture(scope="module")
def problem():
    return random_problem(preset("desi", 19), np.random.default_rng(3))


@pytest.mark.parametrize("slower", [1e-6, 1e-4, 1e-3])
@pytest.mark.parametrize("name", ["direct", "dnf"])
def test_a_robot_too_slow_for_an_order_is_held_and_the_others_are_planned_without_it(
    problem, name, slower
):
    speeds = problem.plane.speeds.copy()
    speeds[ROBOT] *= slower
    slow = replace(problem, plane=replace(problem.plane, speeds=speeds))
    found = planned(slow, name)
    assert found.reason[ROBOT] == Reason.TOO_MANY_SEGMENTS
    assert np.count_nonzero(found.reason == Reason.TOO_MANY_SEGMENTS) == 1
    assert found.arriving.sum() >= 16
    motion = found.planned.motion
    assert (motion.angles[ROBOT] == problem.start[ROBOT][:, None]).all()
    assert motion.makespan_s < 4.0


def test_a_slow_robot_that_an_order_can_still_move_arrives(problem):
    speeds = problem.plane.speeds.copy()
    speeds[ROBOT] *= 0.1
    slow = replace(problem, plane=replace(problem.plane, speeds=speeds))
    found = planned(slow)
    assert found.reason[ROBOT] == Reason.OK
    units = WireUnits.for_plane(slow.plane)
    assert found.planned.motion.makespan_s <= units.longest_order_s


def test_a_slow_robot_without_a_target_does_not_make_the_motion_longer(problem):
    speeds, targets = problem.plane.speeds.copy(), problem.targets.copy()
    speeds[ROBOT] *= 1e-6
    targets[ROBOT] = np.nan
    slow = replace(problem, plane=replace(problem.plane, speeds=speeds), targets=targets)
    found = planned(slow)
    assert found.reason[ROBOT] == Reason.NO_TARGET
    assert found.planned.motion.makespan_s < 4.0


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("name", ["direct", "dnf"])
def test_a_robot_with_a_fixed_joint_reaches_a_target_with_the_other(problem, name, joint):
    limits, targets, start = problem.plane.limits.copy(), problem.targets.copy(), problem.start
    limits[ROBOT, joint] = start[ROBOT, joint]
    plane = replace(problem.plane, limits=limits)
    units = WireUnits.for_plane(plane)
    seen = units.to_angles(units.encoder_counts(plane, start))  # as a node has it
    goal = seen.copy()
    goal[ROBOT, 1 - joint] += -0.2 if joint == 0 and goal[ROBOT, 1] > 1 else 0.2
    targets[:] = np.nan
    targets[ROBOT] = forward(plane, goal)[1][ROBOT]
    found = planned(replace(problem, plane=plane, start=seen, targets=targets), name)
    assert found.reason[ROBOT] == Reason.OK
    assert (found.planned.motion.angles[ROBOT, joint] == seen[ROBOT, joint]).all()


@pytest.mark.parametrize("config", [DirectParameters, DnfParameters, DnfPriorityParameters])
@pytest.mark.parametrize("extreme", EXTREMES, ids=str)
def test_an_extreme_parameter_is_refused_by_name_or_works(config, extreme):
    small = random_problem(preset("desi", 2), np.random.default_rng(1))
    name = {DirectParameters: "direct", DnfParameters: "dnf"}.get(config, "dnf_priority")
    for field in fields(config):
        try:
            make_planner(name, **{field.name: extreme}).plan(small)
        except FiberError as error:
            names = {"outer_mm": "D is", "inner_mm": "d is", "horizon_s": "horizon"}
            assert field.name in str(error) or names.get(field.name, "?") in str(error)


@pytest.mark.parametrize("name", ["dnf", "dnf_priority", "dnf_arms"])
def test_a_horizon_of_too_many_steps_is_refused(name):
    assert name in planners()
    two = random_problem(preset("desi", 2), np.random.default_rng(1))
    with pytest.raises(FiberError, match="a horizon of 100000 s has 100000000000 steps of 1e-06"):
        make_planner(name, horizon_s=1e5, dt_s=1e-6).plan(two)

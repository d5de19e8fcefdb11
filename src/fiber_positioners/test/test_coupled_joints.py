# SPDX-License-Identifier: Apache-2.0
"""Coupled joints from the planner to the bytes: no motor over its limits, by dense sampling."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Outcome, Reason
from fiber_positioners import make_orders, preset, random_problem, reconfigure

ROBOTS = 189  # three rafts


@pytest.fixture(scope="module")
def problem():
    return random_problem(preset("spec_s5", ROBOTS), 4)


def motor_excess(plane, motion):
    # The highest speed of each motor by its limit, from the angles just after each break of either
    # joint to those just before the next. Shape (n, 2).
    knots = np.unique(np.round(np.append(motion.begins_s, motion.begins_s + motion.duration_s), 9))
    excess = np.zeros((plane.n, 2))
    for begin, end in zip(knots[:-1], knots[1:]):
        share = 1e-3 * (end - begin)
        change = motion(end - share) - motion(begin + share)
        motors = np.einsum("ikj,ij->ik", plane.coupling, change) / (end - begin - 2 * share)
        excess = np.maximum(excess, np.abs(motors) / plane.motor_speeds)
    return excess


def test_every_robot_reaches_its_target_and_no_motor_is_too_fast(problem):
    result = reconfigure(problem, seed=4)
    plane = problem.plane
    assert (result.outcome == Outcome.REACHED).all() and result.certificate.ok
    assert motor_excess(plane, result.motion).max() <= 1.0 + 1e-6
    assert result.motion.makespan_s <= 1.1 * lower_bound_s(problem)


def test_a_plan_made_without_the_gears_turns_motors_too_fast(problem):
    plain = replace(problem.plane, coupling=None, motor_speeds=None, motor_limits=None)
    motion = make_orders(replace(problem, plane=plain)).wire.decoded()
    assert (motor_excess(problem.plane, motion).max(axis=1) > 1.1).mean() > 0.1


def test_planners_that_do_not_know_gears_keep_to_them(problem):
    rows = np.arange(12)
    few = replace(
        problem,
        plane=problem.plane.permuted(rows),
        start=problem.start[rows],
        targets=problem.targets[rows],
    )
    orders = make_orders(few, planner="dnf_arms")
    assert np.count_nonzero(orders.reason == Reason.OK) > 0
    assert motor_excess(few.plane, orders.wire.decoded()).max() <= 1.0 + 1e-6
    assert orders.discretization.certificate.ok

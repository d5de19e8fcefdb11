# SPDX-License-Identifier: Apache-2.0
"""The least times of listed speeds are those of the best of all orders, approach included."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import kinematics, preset
from fiber_core.drive import Drive, ListedSpeeds
from fiber_core.drive.least_time import least_time_s
from fiber_core.metrics import bounds_of, lower_bound_s, power_bound_s
from fiber_core.problem import Problem

# In steps of angle and of time: at each speed a joint turns a whole number of steps in a step of
# time, by 2 falling for 3 rising.
_STEP_RAD, _STEP_S = 0.001, 0.01
_RISING, _FALLING = np.array([12, 6, 3]), np.array([8, 4, 2])
_RAMP = np.array([3, 1, 0])
_LEAST_RISING, _LEAST_FALLING = np.array([144, 72, 0]), np.array([96, 48, 0])
_APPROACH = 48
_MULTIPLE = 24  # the best orders of such turns consist of whole steps of time


def listed(sign, returns):
    return ListedSpeeds(
        _RISING * _STEP_RAD / _STEP_S, _RAMP * _STEP_S, _LEAST_RISING * _STEP_RAD,
        approach_rad=np.full(2, _APPROACH * _STEP_RAD), approach_sign=np.full(2, sign),
        approach_speed=2, returns=returns,
    )  # fmt: skip


def best_of_all_orders(low, high, sign, returns):
    """Least times to all angles from low to high, by all orders of up to five moves [steps]."""
    angles = np.arange(low, high + 1)
    turn = angles - angles[:, None]
    # one move from any angle to any other one, at each speed that turns as far in whole steps
    one = np.where(turn == 0, 0.0, np.inf)
    for k in range(3):
        speed = np.where(turn > 0, _RISING[k], _FALLING[k])
        least = np.where(turn > 0, _LEAST_RISING[k], _LEAST_FALLING[k])
        takes = np.abs(turn) / speed + _RAMP[k]
        possible = (turn % speed == 0) & (np.abs(turn) >= least) & (turn != 0)
        one = np.minimum(one, np.where(possible, takes, np.inf))
    creep = np.where(turn > 0, _RISING[2], _FALLING[2])
    part = np.where(turn % creep == 0, np.abs(turn) / creep, np.inf)
    forth = np.where(sign * turn >= _APPROACH, part, np.inf)
    back = np.where(-sign * turn >= _APPROACH, part, np.inf)
    at = one[-low]  # after one move from angle 0
    moves = [one, one] + ([back] if returns else []) + [forth]
    for move in moves:
        at = np.min(at[:, None] + move, axis=0)
    at[-low] = 0.0  # a joint on its goal rests
    return at


@pytest.mark.parametrize("returns", [True, False])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("low", "high"), [(-400, 400), (-60, 400), (-400, 100), (0, 350), (-170, 170)]
)
def test_the_least_time_is_that_of_the_best_order(low, high, sign, returns):
    best = best_of_all_orders(low, high, sign, returns)
    drive = Drive(1, listed=listed(sign, returns), scale=[[[2 / 3, 1.0], [2 / 3, 1.0]]])
    turns = np.arange(low, high + 1)
    span = np.tile([low * _STEP_RAD, high * _STEP_RAD], (1, 2, 1))
    both = np.repeat((turns * _STEP_RAD)[None, :, None], 2, axis=2)
    found = least_time_s(drive, np.ones((1, 2)), both, span)[0, :, 0] / _STEP_S
    exact = turns % _MULTIPLE == 0
    assert exact.sum() > 10
    np.testing.assert_allclose(found[exact], best[exact], rtol=1e-9)
    assert (found <= best * (1 + 1e-9)).all()
    # the way of the approach decides which goals have an order at all
    assert (np.isinf(found) == np.isinf(best))[exact].all() and np.isinf(found).any()


def with_approaches(sign=1.0):
    plane = replace(preset("desi", 7), speeds=np.full((7, 2), 1.3))
    drive = Drive(7, listed=listed(sign, True), supply=[0, 0, 0, 1, 1, 1, 1], motors_on=0.5)
    plane = replace(plane, drive=drive)
    middle = plane.limits.mean(axis=2)
    return plane, middle


def test_the_bounds_are_of_one_robot_alone_and_of_the_motor_time_over_the_cap():
    plane, start = with_approaches()
    rng = np.random.default_rng(2)
    end = start + rng.uniform(-0.4, 0.4, start.shape)
    problem = Problem(plane, start, kinematics.forward(plane, end)[1])
    angles, valid = kinematics.inverse(plane, problem.targets)
    alone, on = np.zeros(7), np.zeros(7)
    for robot in range(7):
        times = []
        for goal in angles[robot][valid[robot]]:
            span = plane.limits - start[:, :, None]
            turn = np.tile(goal - start[robot], (7, 1, 1))
            takes = least_time_s(plane.drive, plane.speeds, turn, span)[robot, 0]
            times.append((takes.max(), takes.sum()))
        alone[robot], on[robot] = np.min(times, axis=0)
    bounds = bounds_of(problem)
    assert bounds.alone_s == lower_bound_s(problem) == pytest.approx(alone.max())
    fed = max(on[:3].sum() / 3, on[3:].sum() / 4)
    assert bounds.supplies_s == pytest.approx(fed)
    assert power_bound_s(problem) == max(bounds)


def test_an_end_that_no_approach_comes_to_is_none():
    plane, start = with_approaches()
    # phi at its lower stop: an approach that rises would begin below it
    end = start.copy()
    end[0, 1] = plane.limits[0, 1, 0] + 0.5 * _APPROACH * _STEP_RAD
    targets = np.full((7, 2), np.nan)
    targets[0] = kinematics.forward(plane, end)[1][0]
    problem = Problem(plane, start, targets)
    falling = Problem(with_approaches(-1.0)[0], start, targets)
    assert lower_bound_s(problem) == 0.0 < lower_bound_s(falling)

# SPDX-License-Identifier: Apache-2.0
"""Plans for motors with a ramp: speeds change as fast as motors can, and true curves keep gaps."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.clearance import Safety, bodies_of, neighbour_pairs, unproven
from fiber_core.drive import Drive, carried_out
from fiber_core.fields import random_problem
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_planner.direct import DirectPlanner, straight_pieces
from fiber_planner.direct.ramps import ramps_follow

_STEP_S, _RAMP_S, _LARGEST = 0.04, 0.1, 3.0  # a ramp is two intervals and a half
_SHORT = 5  # intervals; a line of fewer may last less than one and a half ramps
_LINES = 5


def _hardest(durations, velocities) -> float:
    offsets = np.array([0, len(durations), len(durations)])
    motion = SegmentMotion(np.zeros((1, 2)), offsets, np.array(durations), np.array(velocities))
    return float(carried_out(Drive(1, _RAMP_S), motion).hardest[0, 0])


def _in_two_steps(durations, velocities):
    # each change above the largest one by way of the mean velocity, for the time of a ramp, where
    # both lines last more than half of that
    lasts, speeds = [durations[0]], [velocities[0]]
    for duration, velocity in zip(durations[1:], velocities[1:]):
        long = min(lasts[-1], duration) > 0.5 * _RAMP_S
        if long and abs(velocity - speeds[-1]) > _LARGEST * (1 + 1e-9):
            lasts[-1] -= 0.5 * _RAMP_S
            lasts.append(_RAMP_S)
            speeds.append(0.5 * (speeds[-1] + velocity))
            duration -= 0.5 * _RAMP_S
        lasts.append(duration)
        speeds.append(velocity)
    return lasts, speeds


@pytest.mark.parametrize("seed", range(4))
def test_what_follows_is_what_the_acceleration_allows_at_once_or_in_two_steps(seed):
    rng, limit = np.random.default_rng(seed), _LARGEST / _RAMP_S * (1 + 1e-6)
    at_once, in_two = 0, 0
    for _ in range(500):
        intervals = rng.integers(1, 8, _LINES)
        velocities = rng.integers(-10, 11, _LINES) * 0.1 * _LARGEST
        if (np.diff(velocities) == 0.0).any():
            continue  # these are one line
        row = np.append(0.0, np.cumsum(np.repeat(velocities, intervals))) * _STEP_S
        follows = ramps_follow(row, _STEP_S, _RAMP_S, _LARGEST)
        durations = intervals * _STEP_S
        if _hardest(durations, velocities) <= limit:
            assert follows
            at_once += 1
        elif follows:
            assert _hardest(*_in_two_steps(durations, velocities)) <= limit
            in_two += 1
        else:
            assert (intervals < _SHORT).any()
    assert at_once > 20 and in_two > 20


def test_a_joint_that_turns_back_after_less_than_a_ramp_does_not_follow():
    row = np.concatenate([[0.0, -_LARGEST], np.arange(10) * _LARGEST - 1.0]) * _STEP_S
    assert not ramps_follow(row, _STEP_S, _RAMP_S, _LARGEST)
    assert ramps_follow(row, _STEP_S, _RAMP_S, 2.0 * _LARGEST + 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_true_curves_of_slow_motors_keep_their_gaps(seed):
    plane = preset("desi", 200)
    acceleration = np.deg2rad(500.0)
    ramp_s = float(plane.speeds.max() / acceleration)
    plane = replace(plane, drive=Drive(plane.n, ramp_s, acceleration, name="slow"))
    planned = DirectPlanner().plan(random_problem(plane, np.random.default_rng(seed)))
    assert (planned.reason == Reason.OK).all()
    ordered = straight_pieces(planned.motion)
    assert ordered.counts.max() > 1  # some robots go around others
    curves = carried_out(plane.drive, ordered)
    assert curves.hardest.max() <= 2.0 * acceleration * (1 + 1e-9)
    safety = Safety()
    pairs = neighbour_pairs(plane, safety.at_full_speed_mm(plane, 30.0))
    lasts_s = planned.motion.time_s[-1] + ramp_s
    required = safety.required_from(plane, curves.start, curves.fastest, lasts_s, pairs)
    assert not unproven(bodies_of(plane), curves, pairs, required).any()

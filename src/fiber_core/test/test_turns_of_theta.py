# SPDX-License-Identifier: Apache-2.0
"""Angles of theta a whole turn apart."""

import numpy as np

from fiber_core.turns_of_theta import BEYOND_RAD, turns_in_range

TURN = 2.0 * np.pi


def test_all_turns_in_a_range_are_between_the_lowest_and_the_highest():
    rng = np.random.default_rng(0)
    low = rng.uniform(-7.0, 0.0, 500)
    ranges = np.stack([low, low + rng.uniform(3.0, 14.0, 500)], axis=1)
    theta = rng.uniform(*ranges.T)
    for beyond in (0.0, BEYOND_RAD):
        lowest, highest = turns_in_range(ranges, theta, beyond)
        turns = theta[:, None] + TURN * np.arange(-4, 5)
        within = (turns >= ranges[:, :1] - beyond) & (turns <= ranges[:, 1:] + beyond)
        np.testing.assert_allclose(lowest, np.where(within, turns, np.inf).min(axis=1))
        np.testing.assert_allclose(highest, np.where(within, turns, -np.inf).max(axis=1))


def test_an_arm_beyond_its_stop_has_its_own_turn_and_the_other_one():
    lowest, highest = turns_in_range([[-3.4, 3.4]] * 3, [3.42, -3.46, np.nan])
    np.testing.assert_allclose(lowest[:1], 3.42 - TURN)
    np.testing.assert_allclose(highest[:1], 3.42)
    # farther than an arm may stand beyond its range: it is told, and no turn is invented
    assert lowest[1] == -3.46 and highest[1] == -3.46 + TURN
    assert np.isnan([lowest[2], highest[2]]).all()

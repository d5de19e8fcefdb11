# SPDX-License-Identifier: Apache-2.0
"""Identification: the probabilities are those of all assignments, and doubt is told."""

from itertools import product

import numpy as np
import pytest

from fiber_metrology import IdentifyConfig, MetrologyError, identify
from fiber_metrology.identify import _evidence


def by_hand(places, sigma, chance, lights, config):
    """Probability of every light, and of none in the last column, of every robot."""
    n, s = len(places), len(lights)
    total = np.zeros((n, s + 1))
    for choice in product(range(s + 1), repeat=n):
        given = [c for c in choice if c < s]
        if len(set(given)) < len(given):
            continue
        value = 1.0
        for i, c in enumerate(choice):
            if c == s:
                value *= config.none
                continue
            at = [
                chance[i, h] * _evidence(places[i, h : h + 1], sigma[i, h : h + 1], lights[c])[0]
                for h in range(len(sigma[i]))
                if np.isfinite(places[i, h]).all()
            ]
            value *= sum(at) / config.stray_per_mm2
        for i, c in enumerate(choice):
            total[i, c] += value
    return total / total.sum(axis=1, keepdims=True)


def test_the_doubt_is_that_of_the_sum_over_all_assignments():
    rng, config = np.random.default_rng(4), IdentifyConfig()
    shared = 0
    for _ in range(40):
        n, s = rng.integers(1, 4), rng.integers(0, 4)
        places = rng.uniform(0.0, 0.18, (n, 2, 2))
        places[rng.random((n, 2)) < 0.2] = np.nan
        sigma, chance = rng.uniform(0.03, 0.06, (n, 2)), rng.uniform(0.01, 0.9, (n, 2))
        lights = rng.uniform(0.0, 0.18, (s, 2))
        found = identify(places, sigma, chance, lights, config=config)
        exact = by_hand(places, sigma, chance, lights, config)
        for i in range(n):
            best = exact[i].argmax()
            assert found.light[i] == (best if best < s else -1)
            # lights beyond nine sigma are no evidence at all
            assert found.doubt[i] == pytest.approx(1.0 - exact[i, best], rel=1e-6, abs=1e-12)
        shared += (found.group >= 0).any()
    assert shared > 10


def one(places, lights, **settings):
    """Robots with one place each, an error of 40 um."""
    n = len(places)
    places = np.asarray(places, dtype=float).reshape(n, 1, 2)
    lights = np.asarray(lights, dtype=float).reshape(-1, 2)
    return identify(
        places, np.full((n, 1), 0.04), np.full((n, 1), 0.9), lights,
        config=IdentifyConfig(**settings),
    )  # fmt: skip


def test_a_light_where_it_should_be_is_certain_and_one_far_away_is_not():
    assert one([[0, 0]], [[0.03, 0.0]]).doubt[0] < 1e-6
    far = one([[0, 0]], [[0.34, 0.0]])
    assert far.doubt[0] > 1e-4
    nothing = one([[0, 0]], [[5.0, 0.0]])
    assert nothing.light[0] == -1 and nothing.doubt[0] == 0.0 and nothing.group[0] == -1


def test_two_robots_near_one_light_are_both_in_doubt_and_name_each_other():
    found = one([[0, 0], [0.1, 0]], [[0.05, 0.0]])
    assert (found.doubt > 0.4).all() and found.group[0] == found.group[1] >= 0
    clear = one([[0, 0], [2.0, 0]], [[0.0, 0.0], [2.0, 0.01]])
    assert (clear.doubt < 1e-6).all() and (clear.group == -1).all()


def test_lights_that_only_one_order_explains_are_certain_although_they_are_shared():
    # the light between is near both, and the other robot has one of its own
    found = one([[0, 0], [0.3, 0]], [[0.02, 0.0], [0.28, 0.0]])
    assert found.light.tolist() == [0, 1] and (found.doubt < 1e-4).all()


def test_two_lights_near_one_robot_are_in_doubt():
    assert one([[0, 0]], [[0.05, 0.0], [-0.05, 0.0]]).doubt[0] > 0.4


def test_a_group_that_is_too_large_to_sum_is_in_doubt():
    rng = np.random.default_rng(1)
    found = one(rng.uniform(0, 0.1, (12, 2)), rng.uniform(0, 0.1, (12, 2)))
    assert (found.doubt == 1.0).all() and (found.light == -1).all()
    assert len(set(found.group)) == 1 and found.group[0] >= 0


def test_a_light_that_two_exposures_saw_is_less_likely_a_stray_one():
    places, error = np.zeros((1, 1, 2)), np.full((1, 1), 0.04)
    once, twice = (
        identify(places, error, np.ones((1, 1)), [[0.25, 0.0]], seen).doubt[0] for seen in (1, 2)
    )
    assert twice < 0.2 * once


def test_bad_settings_are_refused():
    with pytest.raises(MetrologyError, match="none"):
        IdentifyConfig(none=0.0)


def test_a_light_far_away_that_two_exposures_of_three_lack_is_not_told_as_a_fact():
    place, sigma = np.zeros((1, 1, 2)), np.full((1, 1), 0.04)
    doubt = [
        identify(place, sigma, np.ones((1, 1)), [[0.198, 0.0]], seen, 3).doubt[0]
        for seen in (1, 2, 3)
    ]
    assert doubt[0] > IdentifyConfig().certain > doubt[1] > doubt[2]
    near = identify(place, sigma, np.ones((1, 1)), [[0.02, 0.0]], 1, 3).doubt[0]
    assert near < IdentifyConfig().certain  # near its place one exposure is enough

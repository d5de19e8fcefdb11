# SPDX-License-Identifier: Apache-2.0
"""Line fits: inside their corridors, as fast as allowed, with as few lines as their method has."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_discretizer import LINEARIZERS, Polylines, UnknownOption, linearize

NOISE_RAD = 1e-9


def corridor(seed, samples, kind):
    """A random profile, its sample times, and the half width of its corridor by kind."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(0.002, 0.02, samples))
    steps = rng.normal(0.0, 0.03, samples) * (rng.random(samples) < 0.7)
    profile = np.cumsum(steps)
    width = {
        "wide": np.full(samples, 10.0),
        "unbounded": np.full(samples, np.inf),
        "zero": np.zeros(samples),
        "opens late": np.where(np.arange(samples) < 2 * samples // 3, 0.0, 1.0),
        "pinched": np.where(rng.random(samples) < 0.1, 0.0, 0.3),
        "random": rng.uniform(0.0, 0.2, samples),
    }.get(kind)
    if kind == "noise at the bound":
        profile = 0.3 * np.sin(4 * time_s) + 0.01 * rng.choice([-1.0, 1.0], samples)
        width = np.full(samples, 0.02)
    return time_s, profile, width


KINDS = ("wide", "unbounded", "zero", "opens late", "pinched", "random", "noise at the bound")
corridors = st.builds(
    corridor, st.integers(0, 2**32 - 1), st.integers(1, 80), st.sampled_from(KINDS)
)


NEVER_FASTER = ("greedy", "douglas_peucker")


def path_of(one, method="minimal", speed=np.inf):
    time_s, profile, width = one
    return linearize(time_s, profile[None], profile - width, profile + width, method, speed)


@pytest.mark.parametrize("method", LINEARIZERS)
@given(one=corridors)
def test_path_is_inside_its_corridor_everywhere_and_meets_both_ends(method, one):
    time_s, profile, width = one
    path = path_of(one, method)
    dense = np.unique(np.concatenate([np.linspace(time_s[0], time_s[-1], 401), time_s]))
    wanted, allowed = np.interp(dense, time_s, profile), np.interp(dense, time_s, width)
    assert np.all(np.abs(path(dense)[0] - wanted) <= allowed + 3 * NOISE_RAD)
    assert path.angles[0] == profile[0] and path.angles[-1] == profile[-1]
    assert path.time_s[0] == time_s[0] and np.all(np.diff(path.time_s) > 0)
    assert 0 <= path.counts[0] < len(time_s)


@pytest.mark.parametrize("method", LINEARIZERS)
@given(one=corridors)
def test_path_is_never_faster_than_its_limit_or_its_profile(method, one):
    time_s, profile, width = one
    fastest = np.abs(np.diff(profile) / np.diff(time_s)).max(initial=0.0)
    limit = fastest * (1 + 1e-6) + 1e-6  # bounds are met within 1e-9 rad
    path = path_of(one, method, limit)
    assert len(path.time_s) >= 1
    speeds = np.abs(np.diff(path.angles) / np.diff(path.time_s))
    assert np.all(speeds <= (fastest if method in NEVER_FASTER else limit) * (1 + 1e-6) + 1e-6)


@given(one=corridors)
def test_minimal_never_has_more_lines_than_any_other_method(one):
    fewest = path_of(one).counts[0]
    assert path_of(one, "relaxed").counts[0] == fewest
    assert all(fewest <= path_of(one, method).counts[0] for method in NEVER_FASTER)
    time_s, profile, _ = one
    limit = np.abs(np.diff(profile) / np.diff(time_s)).max(initial=0.0) * (1 + 1e-6) + 1e-6
    slow = path_of(one, "minimal", limit).counts[0]
    assert all(slow <= path_of(one, method).counts[0] for method in NEVER_FASTER)


@given(one=corridors, scale=st.floats(1.0, 10.0))
def test_a_wider_corridor_never_needs_more_lines(one, scale):
    time_s, profile, width = one
    wide = path_of((time_s, profile, scale * width))
    assert wide.counts[0] <= path_of(one).counts[0]


@pytest.mark.parametrize("method", LINEARIZERS)
@given(one=corridors)
def test_zero_width_keeps_the_profile(method, one):
    time_s, profile, _ = one
    path = path_of((time_s, profile, 0.0), method)
    np.testing.assert_allclose(path(time_s)[0], profile, rtol=0, atol=3 * NOISE_RAD)


@pytest.mark.parametrize("method", LINEARIZERS)
def test_number_of_lines_of_known_shapes(method):
    time_s = np.linspace(0.0, 1.0, 101)
    straight = 0.7 * time_s
    vee = np.abs(time_s - 0.37)
    move_then_rest = np.minimum(time_s, 0.5)
    rest_then_move = np.maximum(time_s, 0.5)
    nothing = np.full(101, 0.2)
    profiles = np.stack([straight, vee, move_then_rest, rest_then_move, nothing])
    paths = linearize(time_s, profiles, profiles, profiles, method)
    np.testing.assert_array_equal(paths.counts, [1, 2, 1, 2, 0])
    assert paths.time_s[paths.offsets[1] + 1] == pytest.approx(0.37)


def test_douglas_peucker_cuts_where_the_line_leaves_the_corridor_by_most():
    time_s = np.arange(5.0)
    profile = np.array([[0.0, 2.0, 3.0, 1.0, 0.0]])
    width = np.array([[0.0, 0.0, 2.5, 0.0, 0.0]])  # sample 2 is the farthest, 1 violates most
    path = linearize(time_s, profile, profile - width, profile + width, "douglas_peucker")
    assert 1.0 in path.time_s and 2.0 not in path.time_s


def test_greedy_takes_each_line_as_far_as_it_goes():
    # The bisection cuts at the peak, where the line from end to end is worst; greedy goes on.
    time_s = np.arange(5.0)
    profile = np.array([[0.0, 1.0, 2.2, 1.0, 0.0]])
    path = linearize(time_s, profile, profile - 0.3, profile + 0.3, "greedy")
    np.testing.assert_array_equal(path.time_s, [0.0, 2.0, 4.0])


@pytest.mark.parametrize("method", LINEARIZERS)
def test_many_profiles_at_once_are_each_as_alone(method):
    rng = np.random.default_rng(3)
    time_s = np.linspace(0.0, 2.5, 120)
    profiles = np.cumsum(rng.normal(0, 0.02, (200, 120)), axis=1)
    low = profiles - rng.uniform(0.0, 0.1, profiles.shape)
    high = profiles + rng.uniform(0.0, 0.1, profiles.shape)
    together = linearize(time_s, profiles, low, high, method)
    for i in (0, 57, 199):
        one = slice(i, i + 1)
        alone = linearize(time_s, profiles[one], low[one], high[one], method)
        part = slice(together.offsets[i], together.offsets[i + 1])
        np.testing.assert_array_equal(together.time_s[part], alone.time_s)
        np.testing.assert_array_equal(together.angles[part], alone.angles)


def test_polylines_rest_outside_their_knots():
    lines = Polylines([0, 2, 3], [1.0, 2.0, 5.0], [0.0, 4.0, 7.0])
    expected = [[0.0, 0.0, 1.0, 4.0, 4.0], [7.0] * 5]
    np.testing.assert_array_equal(lines([0.0, 1.0, 1.25, 2.0, 9.0]), expected)


def test_unknown_method_is_refused_by_name():
    with pytest.raises(UnknownOption, match="'best'.*douglas_peucker"):
        linearize([0.0], [[0.0]], [[0.0]], [[0.0]], method="best")

# SPDX-License-Identifier: Apache-2.0
"""Rounding: whole units inside their fields, and end errors below a micrometre or so."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.wire_units import WireUnits
from fiber_discretizer import Polylines, Rounding, quantize
from fiber_discretizer.fit.linearize import polylines_of

UNITS = WireUnits()
SPEED = np.pi
ANYWHERE = 10**9


def random_paths(seed, profiles, pieces, fastest=1.0):
    """An even number of profiles of `pieces` lines, no faster than `fastest` of the limit."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.05, 1.2, (profiles, pieces))
    speeds = fastest * SPEED * rng.uniform(-1.0, 1.0, (profiles, pieces))
    zero = np.zeros((profiles, 1))
    time_s = np.concatenate([zero, np.cumsum(steps, axis=1)], axis=1)
    angles = np.concatenate([zero, np.cumsum(speeds * steps, axis=1)], axis=1)
    return Polylines(np.arange(profiles + 1) * (pieces + 1), time_s.ravel(), angles.ravel())


def rounded(
    paths,
    units=UNITS,
    slack=0.05,
    limits=(-ANYWHERE, ANYWHERE),
    start=0,
    latest_s=np.inf,
    **rounding,
):
    n = len(paths.parts) // 2
    start = np.broadcast_to(start, (n, 2))
    ends = paths.angles[paths.offsets[1:] - 1].reshape(n, 2)
    goal = np.clip(start + units.to_counts(ends), *limits)
    return goal, quantize(
        paths,
        start,
        goal,
        np.tile(limits, (n, 2, 1)),
        np.full((n, 2), SPEED),
        np.full((n, 2), slack),
        units,
        Rounding(**rounding),
        latest_s,
    )


def check_fields(segments, units=UNITS):
    assert np.all((segments.ticks >= 1) & (segments.ticks <= units.max_ticks))
    assert np.all(np.abs(segments.velocity) * units.velocity_rad_s <= SPEED)
    ends = segments.offsets[1:][segments.parts.counts > 0] - 1
    assert np.all(segments.velocity[ends] != 0)  # no rest at the end is sent


@pytest.mark.parametrize("pieces", [1, 2, 3, 6])
def test_end_error_of_thousands_of_profiles(pieces):
    paths = random_paths(pieces, 4000, pieces)
    goal, segments = rounded(paths)
    check_fields(segments)
    error_um = (segments.end - goal) * UNITS.quantum_rad * 6e3  # at a 6 mm arm
    assert np.abs(error_um).max() <= 1.2
    assert np.sqrt(np.mean(error_um**2)) <= 0.1
    assert segments.counts.mean() <= pieces + 0.05


@pytest.mark.parametrize("intervals", [300, 500.4])
def test_no_profile_makes_the_motion_longer_to_meet_its_end(intervals):
    speeds = SPEED * np.linspace(-0.998, 0.998, 4000)
    latest_s = intervals * UNITS.tick_s
    ends = np.stack([np.zeros(4000), speeds * latest_s], axis=1)
    paths = Polylines(2 * np.arange(4001), np.tile([0.0, latest_s], 4000), ends.ravel())
    goal, free = rounded(paths, slack=0.25)
    _, segments = rounded(paths, slack=0.25, latest_s=latest_s)
    check_fields(segments)

    assert free.parts.sums(free.ticks).max() > np.ceil(intervals) + 4
    assert segments.parts.sums(segments.ticks).max() == np.ceil(intervals)
    error_um = (segments.end - goal) * UNITS.quantum_rad * 6e3  # at a 6 mm arm
    assert np.abs(error_um).max() <= 1.2
    assert np.sqrt(np.mean(error_um**2)) <= 0.1
    assert segments.counts.mean() <= 1.03


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_motion_stays_beside_its_profile(seed, pieces):
    paths = random_paths(seed, 6, pieces)
    slack = 0.01
    _, segments = rounded(paths, slack=slack)
    drawn = polylines_of(segments)
    times = np.linspace(0.0, paths.time_s.max() + 0.1, 500)
    # break times move by half a tick and the end by up to one; velocities by half a unit;
    # the search may shift the last segment by the slack, twice
    bound = 2 * SPEED * UNITS.tick_s + UNITS.max_ticks * UNITS.quantum_rad + 2 * slack
    assert np.abs(drawn(times) - paths(times)).max() <= bound


def test_profile_at_exactly_the_speed_limit_takes_longer_and_arrives():
    seconds = np.linspace(0.1, 3.9, 500)
    paths = Polylines(
        np.arange(501) * 2,
        np.stack([0 * seconds, seconds], axis=1).ravel(),
        np.stack([0 * seconds, SPEED * seconds], axis=1).ravel(),
    )
    goal, segments = rounded(paths)
    check_fields(segments)
    assert np.abs(segments.end - goal).max() * UNITS.quantum_rad * 6e3 <= 1.2
    lasts = segments.parts.sums(segments.ticks) * UNITS.tick_s
    assert np.all(lasts >= seconds - 1e-9)
    assert np.all(lasts <= seconds + 12 * UNITS.tick_s)


def test_too_fast_profiles_are_slowed_down_not_cut_short():
    paths = random_paths(5, 500, 4, fastest=1.5)
    goal, segments = rounded(paths)
    check_fields(segments)
    assert np.abs(segments.end - goal).max() * UNITS.quantum_rad * 6e3 <= 1.2


@pytest.mark.parametrize("duration_bits", [3, 5, 10])
def test_segments_longer_than_their_field_are_split(duration_bits):
    units = WireUnits(duration_bits=duration_bits)
    paths = random_paths(8, 200, 2)
    long = Polylines(paths.offsets, 10 * paths.time_s, paths.angles)
    goal, segments = rounded(long, units)
    check_fields(segments, units)
    assert segments.counts.max() > 2
    assert np.abs(segments.end - goal).max() * units.quantum_rad * 6e3 <= 1.2


def test_limits_are_never_left_even_by_rounding():
    time_s, angles = [0.0, 1.003, 1.707, 2.5], [0.1, 1.0, 0.3, 1.0]
    limit = UNITS.to_counts(1.0)
    starts = UNITS.to_counts(0.1) + np.arange(300).reshape(150, 2)
    paths = Polylines(np.arange(301) * 4, np.tile(time_s, 300), np.tile(angles, 300))
    segments = quantize(
        paths,
        starts,
        np.full((150, 2), limit),
        np.tile([0, limit], (150, 2, 1)),
        np.full((150, 2), SPEED),
        np.full((150, 2), 0.05),
        UNITS,
    )
    assert segments.knots()[2].max() <= limit
    assert np.abs(segments.end - limit).max() <= 130


def test_rests_at_the_begin_are_sent_and_rests_at_the_end_are_not():
    first_rest = Polylines([0, 3, 4], [0.0, 0.4, 0.8, 0.0], [0.0, 0.0, 0.1, 0.0])
    _, segments = rounded(first_rest)
    np.testing.assert_array_equal(segments.velocity == 0, [True, False])
    assert segments.ticks[0] == 100
    begins_late = Polylines([0, 2, 3], [0.4, 0.8, 0.0], [0.0, 0.1, 0.0])
    _, same = rounded(begins_late)
    np.testing.assert_array_equal(same.ticks, segments.ticks)
    last_rest = Polylines([0, 3, 4], [0.0, 0.4, 0.8, 0.0], [0.0, 0.1, 0.1, 0.0])
    _, segments = rounded(last_rest)
    np.testing.assert_array_equal(segments.counts, [[1, 0]])


def test_breaks_within_one_tick_leave_no_empty_segments():
    time_s = np.array([0.0, 0.0005, 0.001, 0.0015, 0.5, 0.0])
    paths = Polylines([0, 5, 6], time_s, [0.0, 0.0003, -0.0002, 0.0004, 0.2, 0.0])
    goal, segments = rounded(paths)
    check_fields(segments)
    assert segments.counts[0, 0] == 1
    assert abs(segments.end - goal)[0, 0] <= 60


def test_tiny_moves_arrive():
    sizes = np.arange(1, 401)
    ends = UNITS.to_angles(sizes)
    paths = Polylines(
        np.arange(len(sizes) + 1) * 2,
        np.tile([0.0, 2.0], len(sizes)),
        np.stack([0 * ends, ends], axis=1).ravel(),
    )
    goal, segments = rounded(paths, sooner_ticks=2000)
    assert np.abs(segments.end - goal).max() <= 6


def test_polylines_decode_the_same_motion_as_the_wire():
    paths = random_paths(11, 10, 3)
    _, segments = rounded(paths, start=1234)
    lines, motion = polylines_of(segments), segments.decoded()
    for t in (0.0, 0.333, 1.0, 2.2, 9.0):
        np.testing.assert_allclose(lines([t])[:, 0], motion(t).ravel(), rtol=0, atol=1e-12)


def test_a_short_last_line_at_full_speed_ends_in_time():
    # what rounding leaves of a long line before it is more than a short line at full speed catches
    rng, ticks, last, share = np.random.default_rng(3), 480, 8, 0.998
    speeds = share * SPEED * rng.uniform(0.2, 0.9, 2000)
    knots = UNITS.tick_s * np.array([0.0, ticks, ticks + last])
    turned = speeds * knots[1]
    ends = np.stack([0.0 * turned, turned, turned + share * SPEED * last * UNITS.tick_s], axis=1)
    paths = Polylines(3 * np.arange(2001), np.tile(knots, 2000), ends.ravel())
    goal, segments = rounded(paths, latest_s=knots[-1])
    check_fields(segments)
    assert segments.decoded().makespan_s <= knots[-1] + 1e-9
    assert np.abs(segments.end - goal).max() <= Rounding().worst_quanta
    beside = np.abs(segments.decoded()(knots[1]).ravel() - turned)
    assert beside.max() <= 0.05 + ticks * UNITS.quantum_rad  # the slack, and a unit of velocity

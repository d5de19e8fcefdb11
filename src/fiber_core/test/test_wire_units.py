# SPDX-License-Identifier: Apache-2.0
"""Motions in whole numbers: the decoded motion is exactly that of the numbers."""

import numpy as np
import pytest

from fiber_core import PRESETS, MotionError, WireMotion, WireUnits, preset
from fiber_core.ragged import Parts


def random_motion(seed, units, n=30):
    rng = np.random.default_rng(seed)
    offsets = Parts.from_counts(rng.integers(0, 5, 2 * n)).offsets
    m = offsets[-1]
    return WireMotion(
        units,
        rng.integers(-2_000_000, 2_000_000, (n, 2)),
        offsets,
        rng.integers(1, units.max_ticks + 1, m),
        rng.integers(-units.max_velocity, units.max_velocity + 1, m),
    )


@pytest.mark.parametrize("seed", range(3))
def test_robots_without_segments_rest_and_the_others_move_as_alone(seed):
    units = WireUnits.for_plane(preset("sdss_v", 7))
    motion, rows = random_motion(seed, units, 4), np.array([1, 2, 5, 6])
    start = np.arange(16).reshape(8, 2)
    start[rows] = motion.start
    every = WireMotion.at_rest(units, start).with_robots(rows, motion)
    assert np.array_equal(every.counts[rows], motion.counts)
    assert np.array_equal(every.end[rows], motion.end)
    others = np.setdiff1d(np.arange(8), rows)
    assert not every.moves[others].any() and np.array_equal(every.end[others], start[others])
    for name in ("start", "offsets", "ticks", "velocity"):
        only = getattr(every.only(every.moves), name)
        assert np.array_equal(only, getattr(every, name))
    at_rest = WireMotion.at_rest(units, start)
    assert not at_rest.moves.any() and np.array_equal(at_rest.end, start)
    assert np.array_equal(every.only(np.zeros(8, bool)).offsets, at_rest.offsets)


@pytest.mark.parametrize("name", PRESETS)
def test_the_units_of_every_instrument_carry_its_speed_and_half_a_turn(name):
    plane = preset(name, 7)
    units = WireUnits.for_plane(plane)
    assert units.max_velocity * units.velocity_rad_s >= 1.02 * plane.speeds.max()
    assert (units.max_velocity - 1) * units.velocity_rad_s < 1.02 * plane.speeds.max()
    assert units.max_ticks * units.tick_s * plane.speeds.max() > np.pi


@pytest.mark.parametrize("seed", range(3))
def test_the_decoded_motion_is_that_of_the_counts(seed):
    units = WireUnits.for_plane(preset("sdss_v", 7))
    motion = random_motion(seed, units)
    decoded = motion.decoded()
    turn = np.zeros((30, 2), dtype=np.int64)
    for profile in range(60):
        rows = slice(motion.offsets[profile], motion.offsets[profile + 1])
        turn[profile // 2, profile % 2] = int(motion.ticks[rows] @ motion.velocity[rows])
    assert np.array_equal(motion.end, motion.start + turn)
    assert np.array_equal(motion.counts, decoded.counts)
    assert np.array_equal(motion.moves, motion.counts.any(axis=1))
    assert np.array_equal(units.to_counts(decoded.end), motion.end)
    assert np.abs(decoded.end - units.to_angles(motion.end)).max() < 1e-6 * units.quantum_rad
    ticks = [motion.ticks[a:b].sum() for a, b in zip(motion.offsets[:-1], motion.offsets[1:])]
    assert decoded.makespan_s == pytest.approx(max(ticks) * units.tick_s, rel=1e-12)


def test_held_robots_rest_and_the_others_are_unchanged():
    motion = random_motion(8, WireUnits())
    held = np.arange(30) % 3 == 0
    rest, decoded = motion.without(held), motion.decoded().without(held)
    assert np.array_equal(rest.end[held], motion.start[held])
    assert np.array_equal(rest.end[~held], motion.end[~held])
    assert np.array_equal(rest.decoded().offsets, decoded.offsets)
    assert np.array_equal(rest.decoded().velocity_rad_s, decoded.velocity_rad_s)


def test_at_every_tick_a_joint_stands_on_a_whole_quantum():
    units = WireUnits()
    motion = random_motion(7, units)
    decoded = motion.decoded()
    for tick in range(0, 2000, 137):
        quanta = decoded(tick * units.tick_s) / units.quantum_rad
        assert np.abs(quanta - np.rint(quanta)).max() < 1e-6


def test_counts_are_the_nearest():
    units = WireUnits()
    angles = np.random.default_rng(0).uniform(-10, 10, 1000)
    back = units.to_angles(units.to_counts(angles))
    assert np.abs(back - angles).max() <= 0.5000001 * units.quantum_rad
    counts = np.arange(-5, 6)
    assert np.array_equal(units.to_counts(units.to_angles(counts)), counts)


GOOD = {"start": [[0, 0], [0, 0]], "offsets": [0, 1, 1, 2, 2], "ticks": [5, 6], "velocity": [1, -1]}


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"ticks": [5, 0]}, ["robot row 1", "duration 0", "1..1023"]),
        ({"ticks": [1024, 5]}, ["robot row 0", "duration 1024"]),
        ({"velocity": [1, -8192]}, ["robot row 1", "velocity -8192", "-8191..8191"]),
        ({"velocity": [8192, 1]}, ["robot row 0", "velocity 8192"]),
        ({"velocity": [1.5, 1]}, ["velocity", "1.5"]),
        ({"velocity": [1, 2, 3]}, ["2 durations but 3 velocities"]),
        ({"offsets": [0, 2, 1, 2, 2]}, ["offsets"]),
        ({"offsets": [0, 1, 1, 2, 3]}, ["offsets"]),
        ({"offsets": [0, 1, 2]}, ["offsets"]),
        ({"start": [0, 0]}, ["start", "(2,)"]),
        ({"start": [[0, np.nan], [0, 0]]}, ["start", "nan"]),
    ],
)
def test_numbers_that_do_not_fit_are_refused(changes, words):
    WireMotion(WireUnits(), **GOOD)
    with pytest.raises(MotionError) as refusal:
        WireMotion(WireUnits(), **{**GOOD, **changes})
    assert all(word in str(refusal.value) for word in words), str(refusal.value)


@pytest.mark.parametrize(
    "size", [{"tick_us": 0}, {"quantum_prad": -1}, {"velocity_bits": 1}, {"duration_bits": 0}]
)
def test_impossible_units_are_refused(size):
    with pytest.raises(MotionError, match=next(iter(size))):
        WireUnits(**size)


def test_the_extremes_of_the_fields_fit():
    units = WireUnits()
    extreme = {"ticks": [1, 1023], "velocity": [8191, -8191]}
    motion = WireMotion(units, **{**GOOD, **extreme})
    assert np.array_equal(motion.end, [[8191, 0], [-8191 * 1023, 0]])
    assert units.segment_bytes == 3


def test_a_robot_on_its_stop_reads_a_position_inside_its_range():
    plane = preset("desi", robots=7)
    units = WireUnits.for_plane(plane)
    for side in (0, 1):
        counts = units.encoder_counts(plane, plane.limits[:, :, side])
        angles = units.to_angles(counts)
        assert (angles >= plane.limits[..., 0]).all() and (angles <= plane.limits[..., 1]).all()
        assert np.abs(angles - plane.limits[:, :, side]).max() < units.quantum_rad
    beyond = plane.limits[:, :, 1] + 0.01
    np.testing.assert_array_equal(units.encoder_counts(plane, beyond), units.to_counts(beyond))

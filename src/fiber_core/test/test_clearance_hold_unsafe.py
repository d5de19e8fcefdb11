# SPDX-License-Identifier: Apache-2.0
"""Holding robots until the rest of a motion is certified."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.clearance import Safety, certify, hold_until_safe, neighbour_pairs
from fiber_core.errors import MotionError
from fiber_core.fields import random_field
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_core.ragged import Parts

_MARGIN_ONLY = Safety(margin_mm=0.05, clock_ppm=0.0, start_skew_s=0.0, stop_skew_s=0.0)


def _direct(start, goal, speed=1.0) -> SegmentMotion:
    """Return the motion of every joint straight to its goal at one speed; none for joints there."""
    way = (np.asarray(goal) - start).ravel()
    moves = way != 0.0
    offsets = Parts.from_counts(moves).offsets
    return SegmentMotion(start, offsets, np.abs(way[moves]) / speed, speed * np.sign(way[moves]))


def _crowd(seed, robots=150, name="desi", disabled=0.1):
    """Return a plane with some robots disabled, and a direct motion with many collisions."""
    rng = np.random.default_rng(seed)
    plane = preset(name, robots)
    plane = plane.with_enabled(rng.random(robots) >= disabled)
    field = random_field(plane, rng)
    motion = _direct(field.problem.start, field.goal, 0.99 * plane.speeds.min())
    return field.problem.plane, motion


def _moving(motion) -> np.ndarray:
    return np.array(
        [
            motion.velocity_rad_s[motion.offsets[2 * i] : motion.offsets[2 * i + 2]].any()
            for i in range(motion.n)
        ]
    )


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
@pytest.mark.parametrize("seed", range(3))
def test_the_remaining_motion_is_certified_and_otherwise_unchanged(name, seed):
    plane, wished = _crowd(seed, name=name)
    assert certify(plane, wished, Safety()).unsafe.sum() > 5
    motion, held, certificate = hold_until_safe(plane, wished, Safety())
    assert certificate.ok
    repeated = certify(plane, motion, Safety())
    assert repeated.ok
    np.testing.assert_array_equal(certificate.required_mm, repeated.required_mm)
    assert certificate.min_gap_mm == pytest.approx(repeated.min_gap_mm, abs=0.6e-3)
    assert held.sum() > 3 and not _moving(motion)[held].any()
    np.testing.assert_array_equal(_moving(motion), _moving(wished) & ~held)
    for i in np.flatnonzero(~held):
        for joint in (2 * i, 2 * i + 1):
            before = slice(*wished.offsets[joint : joint + 2])
            after = slice(*motion.offsets[joint : joint + 2])
            assert wished.duration_s[before].tolist() == motion.duration_s[after].tolist()
            assert wished.velocity_rad_s[before].tolist() == motion.velocity_rad_s[after].tolist()


@pytest.mark.parametrize("seed", range(3))
def test_no_held_robot_could_be_released(seed):
    plane, wished = _crowd(seed)
    motion, held, certificate = hold_until_safe(plane, wished, _MARGIN_ONLY)
    assert certificate.ok
    unsafe = certify(plane, wished, _MARGIN_ONLY).unsafe_robots
    assert held.sum() < 0.75 * unsafe.sum()
    for robot in np.flatnonzero(held):
        released = held.copy()
        released[robot] = False
        assert not certify(plane, wished.without(released), _MARGIN_ONLY).ok


def test_no_robot_is_held_in_a_safe_motion():
    plane, wished = _crowd(0)
    motion, _, _ = hold_until_safe(plane, wished, Safety())
    same, held, certificate = hold_until_safe(plane, motion, Safety())
    assert certificate.ok and not held.any()
    np.testing.assert_array_equal(same.offsets, motion.offsets)
    np.testing.assert_array_equal(same.velocity_rad_s, motion.velocity_rad_s)


def test_holding_is_repeatable():
    plane, wished = _crowd(5)
    runs = [hold_until_safe(plane, wished, Safety()) for _ in range(2)]
    (_, held, one), (_, held_too, two) = runs
    np.testing.assert_array_equal(held, held_too)
    np.testing.assert_array_equal(one.gap_mm, two.gap_mm)


def _sweeps(centers, start, turn, **columns):
    """Return robots with stretched arms that turn theta by `turn` [rad] in one second."""
    n = len(centers)
    plane = replace(
        preset("desi", n), centers=centers, limits=np.tile([-9.0, 9.0], (n, 2, 1)), **columns
    )
    start = np.stack([start, np.zeros(n)], axis=1)
    return plane, _direct(start, start + np.stack([turn, np.zeros(n)], axis=1))


def test_one_robot_in_the_path_of_three_is_held_alone():
    # Robot 3, in the middle, would turn past the three others, each on its own side.
    around = np.deg2rad([90.0, 210.0, 330.0])
    centers = 13.0 * np.stack([np.cos(around), np.sin(around)], axis=1)
    plane, wished = _sweeps(
        np.concatenate([centers, [[0.0, 0.0]]]),
        [*(around + np.pi - 0.9), 0.0],
        [0.9, 0.9, 0.9, 2 * np.pi],
    )
    assert certify(plane, wished, Safety()).unsafe.sum() == 3
    _, held, certificate = hold_until_safe(plane, wished, Safety())
    assert held.tolist() == [False, False, False, True]
    assert certificate.ok


def test_of_two_equal_robots_the_first_is_held_unless_it_rests():
    centers, start = [[0.0, 0.0], [12.0, 0.0]], [-0.8, np.pi + 0.8]
    plane, wished = _sweeps(centers, start, [1.6, 0.0])
    assert hold_until_safe(plane, wished, Safety())[1].tolist() == [False, False]
    plane, wished = _sweeps(centers, start, [1.6, -0.8])
    assert hold_until_safe(plane, wished, Safety())[1].tolist() == [True, False]
    plane, wished = _sweeps(centers, [0.0, np.pi + 0.8], [0.0, -0.8])
    assert hold_until_safe(plane, wished, Safety())[1].tolist() == [False, True]


def test_a_held_robot_can_make_another_one_unsafe():
    # 0 would leave before 1 arrives, but also meets the disc: once held, 1 must be held too.
    plane, wished = _sweeps(
        [[0.0, 0.0], [12.0, 0.0]], [0.0, np.pi + 2.0], [3.0, -2.0], obstacles=[[-4.0, 4.0, 0.5]]
    )
    assert certify(replace(plane, obstacles=np.zeros((0, 3))), wished, Safety()).ok
    _, held, certificate = hold_until_safe(plane, wished, Safety())
    assert held.tolist() == [True, True]
    assert certificate.ok


def test_robots_that_break_their_limits_or_are_disabled_are_held():
    plane, wished = _sweeps([[0.0, 0.0], [40.0, 0.0], [80.0, 0.0]], np.zeros(3), np.ones(3))
    limits = plane.limits.copy()
    limits[1, 0, 1] = 0.5
    plane = replace(plane, limits=limits, enabled=[True, True, False])
    motion, held, certificate = hold_until_safe(plane, wished, Safety())
    assert held.tolist() == [False, True, True]
    assert certificate.ok and not certificate.limits_broken.any()


def test_a_robot_that_breaks_its_limits_stays_held_when_a_neighbour_is_released():
    for seed in range(3):
        plane, wished = _crowd(seed)
        limits = plane.limits.copy()
        bad = np.random.default_rng(seed).random(plane.n) < 0.3
        limits[bad] = 0.0
        plane = replace(plane, limits=limits)
        _, held, certificate = hold_until_safe(plane, wished, Safety())
        assert certificate.ok
        assert held[bad & _moving(wished)].all()


def test_resting_robots_too_close_at_the_start_are_reported_and_the_rest_is_made_safe():
    # 0 and 1 overlap where they stand; 2 and 3 would meet.
    plane, wished = _sweeps(
        [[0.0, 0.0], [9.0, 0.0], [100.0, 0.0], [112.0, 0.0]],
        [0.0, np.pi, -0.8, np.pi + 0.8],
        [0.0, 0.0, 1.6, -1.6],
    )
    motion, held, certificate = hold_until_safe(plane, wished, Safety())
    assert held.tolist() == [False, False, True, False]
    assert not certificate.ok
    assert certificate.unsafe_robots.tolist() == [True, True, False, False]
    assert certificate.min_pair == (0, 1)
    assert certificate.min_gap_mm == pytest.approx(-2.0, abs=1e-3)
    # what is told of the motion is not the overlap of two robots that rest
    margin_mm = Safety().margin_mm
    nearer = certificate.nearer(plane, motion.start, margin_mm)
    assert certificate.pairs[nearer].tolist() == [[0, 1]]
    assert margin_mm <= certificate.gap_mm[~nearer].min() < 10.0


def test_a_robot_that_leaves_one_too_close_is_told_as_nearer_from_the_start():
    plane, wished = _sweeps([[0.0, 0.0], [9.0, 0.0]], [0.0, np.pi], [1.0, 0.0])
    motion, held, certificate = hold_until_safe(plane, wished, Safety())
    assert certificate.ok and not held.any() and certificate.min_gap_mm < 0.0
    nearer = certificate.nearer(plane, motion.start, Safety().margin_mm)
    assert nearer.sum() == 1 and nearer.all()


def test_only_the_given_pairs_are_examined():
    plane, wished = _crowd(2)
    pairs = neighbour_pairs(plane)
    _, held, certificate = hold_until_safe(plane, wished, Safety(), pairs[:0])
    assert not held.any() and certificate.ok
    _, some, _ = hold_until_safe(plane, wished, Safety(), pairs)
    assert some.any()


@pytest.mark.parametrize(("duration_s", "speed"), [(1.0, 1e9), (1e12, 0.1), (1e6, 1e4)])
def test_a_robot_that_turns_beyond_all_bounds_is_refused_by_name_and_held(duration_s, speed):
    plane = preset("desi", 7)
    start = np.stack([np.linspace(-1.0, 1.0, 7), np.full(7, 2.6)], axis=1)
    lasts_s, velocity = np.full(14, 1.0), np.full(14, 0.01)
    lasts_s[6], velocity[6] = duration_s, speed  # theta of the fourth robot
    motion = SegmentMotion(start, np.arange(15), lasts_s, velocity)
    with pytest.raises(MotionError, match=f"robot {plane.ids[3]} turns to .* rad at up to"):
        certify(plane, motion, Safety())
    rest, held, certificate = hold_until_safe(plane, motion, Safety())
    assert np.flatnonzero(held).tolist() == [3] and certificate.ok
    assert np.array_equal(_moving(rest), ~held)

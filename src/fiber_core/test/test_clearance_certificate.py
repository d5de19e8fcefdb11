# SPDX-License-Identifier: Apache-2.0
"""The certificate against dense sampling, and against collisions that sampling misses."""

from dataclasses import replace

import numpy as np
import pytest
from random_motions import RESOLVE_ALL, Fixed, all_at, angles_at, random_motion

from fiber_core.clearance import (
    Safety,
    bodies_of,
    certify,
    neighbour_pairs,
    sampled_gaps,
    smallest_gaps,
    unproven,
)
from fiber_core.fields import random_field
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_core.ragged import Parts

_TOLERANCE = 0.5e-3


def _couples(rng: np.random.Generator, count: int, phi: int, theta: int) -> FocalPlane:
    """Return couples of robots with a disc near each couple, far from all other couples.

    With some robots the first link is the longer and faster one.

    Args:
        rng: source of the random shapes and places.
        count: number of couples.
        phi, theta: number of vertices of the two outlines.
    """
    n = 2 * count
    places = 60.0 * np.stack(np.divmod(np.arange(count), 20), axis=1)
    place = np.repeat(places, 2, axis=0)
    stout = rng.random((n, 1)) < 0.4
    return FocalPlane(
        ids=np.arange(n),
        centers=place + rng.uniform(-6, 6, (n, 2)),
        arms=np.where(stout, 0.1, 1.0) * rng.uniform(0.5, 5.0, (n, 2)),
        limits=np.tile([-100.0, 100.0], (n, 2, 1)),
        speeds=np.full((n, 2), 1e3),
        phi_vertices=rng.normal(0.0, 1.5, (n, phi, 2)) + [1.0, 0.0],
        phi_radius=rng.uniform(0.0, 1.0, n),
        theta_vertices=np.where(stout, 3.0, 1.0)[:, None] * rng.normal(0.0, 1.5, (n, theta, 2)),
        theta_radius=rng.uniform(0.0, 1.0, n),
        enabled=np.ones(n, dtype=bool),
        obstacles=np.c_[places + rng.uniform(-6, 6, (count, 2)), rng.uniform(0.0, 1.0, count)],
    )


def _dense_minimum(plane, motion, pairs) -> np.ndarray:
    """Return the smallest gap of pairs that share no robot, by finer and finer sampling."""
    pairs = np.asarray(pairs)
    middle = np.full(len(pairs), motion.makespan_s / 2)
    half = motion.makespan_s / 2
    smallest = np.full(len(pairs), np.inf)
    for samples in (1501, 61, 61, 61):
        times = np.clip(middle[:, None] + np.linspace(-half, half, samples), 0, motion.makespan_s)
        own = np.zeros((plane.n, samples))
        for column in pairs.T:
            robots = column < plane.n
            own[column[robots]] = times[robots]
        found = sampled_gaps(plane, pairs, angles_at(motion, own))
        at = np.argmin(found, axis=1)
        rows = np.arange(len(pairs))
        smallest = np.minimum(smallest, found[rows, at])
        middle = times[rows, at]
        half *= 4 / samples
    return smallest


@pytest.mark.parametrize(
    "phi, theta", [(1, 0), (2, 0), (2, 5), (7, 13)], ids=["disc", "capsule", "body", "polygon"]
)
def test_bounds_are_below_the_dense_minimum_and_within_the_tolerance(phi, theta):
    rng = np.random.default_rng(100 * phi + theta)
    count = 160
    plane, motion = _couples(rng, count, phi, theta), random_motion(rng, 2 * count)
    k = np.arange(count)
    for a, b in ((2 * k, 2 * k + 1), (2 * k, 2 * count + k), (2 * k + 1, 2 * count + k)):
        pairs = np.stack([a, b], axis=1)
        found = certify(plane, motion, RESOLVE_ALL, pairs)
        dense = _dense_minimum(plane, motion, pairs)
        assert (found.gap_mm <= dense).all()
        # Near, because that gap really occurs at the instant given.
        own = np.zeros((plane.n, 1))
        for column in pairs.T:
            own[column[column < plane.n], 0] = found.time_s[column < plane.n]
        met = sampled_gaps(plane, pairs, angles_at(motion, own))[:, 0]
        assert (met - found.gap_mm <= _TOLERANCE + 1e-6).all()
        assert min((dense < 0).sum(), (dense > 0).sum()) > 5
        assert found.unsafe.all()


@pytest.mark.parametrize("phi, theta", [(2, 0), (7, 13)])
def test_unresolved_gaps_are_still_bounds_and_the_smallest_gap_is_found(phi, theta):
    rng = np.random.default_rng(phi)
    count = 160
    plane, motion = _couples(rng, count, phi, theta), random_motion(rng, 2 * count)
    pairs = np.stack([2 * np.arange(count), 2 * np.arange(count) + 1], axis=1)
    dense = _dense_minimum(plane, motion, pairs)
    for margin in (0.3, 5.0):
        apart = dense > margin + 0.05  # without the unsafe ones the smallest gap is a safe one
        for some in (np.ones(count, dtype=bool), apart):
            found = certify(plane, motion, Fixed(margin), pairs[some])
            assert (found.gap_mm <= dense[some]).all()
            below = dense[some] < margin
            assert (found.unsafe == below)[np.abs(dense[some] - margin) > 2e-3].all()
            assert (dense[some] - found.gap_mm <= 1e-3)[below].all()
            assert found.ok == (some is apart)
            assert found.min_gap_mm == pytest.approx(dense[some].min(), abs=1e-3)
            assert found.min_pair == tuple(pairs[some][np.argmin(dense[some])])
            a, b = found.min_pair
            then = sampled_gaps(plane, [(a, b)], motion(found.min_time_s)[:, :, None])[0, 0]
            assert then == pytest.approx(found.min_gap_mm, abs=1e-3)


@pytest.mark.parametrize("phi, theta", [(2, 0), (7, 13)])
def test_a_certificate_without_figures_gives_the_same_verdict(phi, theta):
    rng = np.random.default_rng(10 + phi)
    plane, motion = _couples(rng, 120, phi, theta), random_motion(rng, 240)
    pairs = np.stack([2 * np.arange(120), 2 * np.arange(120) + 1], axis=1)
    found = certify(plane, motion, Safety(0.3, 0.0, 0.0), pairs)
    bare = unproven(bodies_of(plane), motion, pairs, found.required_mm)
    doubtful = np.abs(_dense_minimum(plane, motion, pairs) - 0.3) < 2e-3
    assert found.unsafe.sum() > 10 and (~found.unsafe).sum() > 10
    np.testing.assert_array_equal(bare[~doubtful], found.unsafe[~doubtful])
    lower = smallest_gaps(bodies_of(plane), motion, pairs, found.required_mm)
    np.testing.assert_array_equal(lower < found.required_mm, found.unsafe)
    np.testing.assert_array_equal(lower[found.unsafe], found.gap_mm[found.unsafe])


_MARGIN_ONLY = Safety(margin_mm=0.05, clock_ppm=0.0, start_skew_s=0.0, stop_skew_s=0.0)


def _needles() -> FocalPlane:
    """Return two robots 8 mm apart with phi arms as thin as wire and without speed limits."""
    return replace(
        preset("desi", 2),
        centers=[[0.0, 0.0], [8.0, 0.0]],
        phi_radius=[1e-3, 1e-3],
        limits=np.tile([-100.0, 100.0], (2, 2, 1)),
        speeds=np.full((2, 2), 1e4),
    )


def test_a_crossing_between_samples_is_caught():
    # Robot 1 points at robot 0, which points away, turns around once in 1 ms, and points away.
    plane = _needles()
    start = [[np.pi, 0.0], [np.pi, 0.0]]
    waits = [0.5034, 1e-3, 0.4956]
    motion = SegmentMotion(start, [0, 3, 3, 3, 3], waits, [0.0, 2 * np.pi / 1e-3, 0.0])
    sampled = sampled_gaps(plane, [(0, 1)], all_at(motion, np.linspace(0.0, 1.0, 101)))
    assert sampled.min() > 1.0
    found = certify(plane, motion, _MARGIN_ONLY)
    assert found.unsafe.tolist() == [True] and not found.ok
    assert found.unsafe_robots.tolist() == [True, True]
    assert found.min_gap_mm == pytest.approx(-2e-3, abs=2e-3)
    assert found.min_time_s == pytest.approx(0.5039, abs=1e-5)


def test_thin_arms_that_turn_past_each_other_fast_are_resolved():
    # Both point at the other for an instant, within 0.2 ms of each other.
    rng = np.random.default_rng(0)
    plane = _needles()
    missed = caught = 0
    for meet in rng.uniform(0.1, 0.9, 60):
        wait = meet - 0.5e-3 + rng.uniform(-1e-4, 1e-4, 2)
        turn = rng.choice([-1, 1], 2) * 2 * np.pi / 1e-3
        motion = SegmentMotion(
            [[np.pi, 0.0], [0.0, 0.0]],
            [0, 2, 2, 4, 4],
            [wait[0], 1e-3, wait[1], 1e-3],
            [0.0, turn[0], 0.0, turn[1]],
        )
        around = np.linspace(meet - 1e-3, meet + 1e-3, 8001)
        truth = sampled_gaps(plane, [(0, 1)], all_at(motion, around)).min()
        found = certify(plane, motion, _MARGIN_ONLY)
        assert found.gap_mm[0] <= truth
        assert found.unsafe[0] or truth > 0.05
        missed += truth > 0.1 and found.ok
        caught += truth < 0.0
    assert caught > 10 and missed > 10


def test_rest_after_the_end_of_a_profile_is_part_of_the_motion():
    # Robot 0 has long arrived in the path of robot 1 when that sweeps past.
    plane = _needles()
    motion = SegmentMotion(
        [[np.pi, 0.0], [2.0, 0.0]], [0, 1, 1, 3, 3], [0.1, 1.0, 1.0], [10 * np.pi, 0.0, 2.0]
    )
    found = certify(plane, motion, _MARGIN_ONLY)
    assert not found.ok
    assert found.min_time_s == pytest.approx(1.0 + (np.pi - 2.0) / 2.0, abs=1e-3)


def test_a_motion_at_rest_is_certified_by_its_gaps():
    field = random_field(preset("desi", 60), np.random.default_rng(4), gap_mm=0.15)
    plane, start = field.problem.plane, field.problem.start
    found = certify(plane, SegmentMotion.at_rest(start), Safety(margin_mm=0.05))
    assert found.ok
    exact = sampled_gaps(plane, found.pairs, start[:, :, None])[:, 0]
    np.testing.assert_allclose(found.gap_mm, exact, rtol=0, atol=1e-8)
    assert found.required_mm == pytest.approx(0.05)
    assert (found.time_s == 0.0).all()


def test_two_resting_robots_too_close_are_unsafe():
    found = certify(_needles(), SegmentMotion.at_rest([[0.0, 0.0], [np.pi, 0.0]]), _MARGIN_ONLY)
    assert not found.ok and found.unsafe.all()


def test_all_pairs_that_could_need_it_are_examined():
    plane = preset("desi", 40)
    motion = SegmentMotion.at_rest(np.zeros((40, 2)))
    wide = certify(plane, motion, Safety(margin_mm=12.0))
    assert len(wide.pairs) == len(neighbour_pairs(plane, 12.0)) > len(neighbour_pairs(plane))


def test_a_motion_must_keep_clear_of_obstacles():
    plane = replace(preset("desi", 1), obstacles=[[0.0, 6.0, 0.5]])
    sweep = SegmentMotion([[0.0, 0.0]], [0, 1, 1], [1.0], [3.0])
    found = certify(plane, sweep, Safety())
    assert found.unsafe.tolist() == [True]
    assert found.unsafe_robots.tolist() == [True]
    assert found.min_pair == (0, 1)
    clear = replace(plane, obstacles=[[0.0, 7.7, 0.5]])
    found = certify(clear, sweep, Safety())
    assert found.ok
    # The arm of 6 mm, rounded by 1, ends 0.2 mm below the disc when it points at it.
    assert found.min_gap_mm == pytest.approx(0.2, abs=1e-3)
    assert found.min_time_s == pytest.approx(np.pi / 6, abs=0.02)


_LOW, _HIGH = -np.pi, np.pi / 2
_FASTEST = 2.0
_JOINT_CASES = {
    # (start, durations, speeds) of one joint, and whether it breaks its limits
    "inside": (0.0, [0.5], [2.0], False),
    "to the stop": (0.0, [np.pi / 4], [2.0], False),
    "past the stop": (0.0, [np.pi / 4 + 1e-6], [2.0], True),
    "past the stop and back": (1.5, [0.5, 0.5], [1.0, -1.0], True),
    "past the lower stop": (-3.0, [0.5], [-1.0], True),
    "to the lower stop": (_LOW + 0.5, [0.5], [-1.0], False),
    "just past the lower stop": (_LOW + 0.5, [0.5 + 1e-6], [-1.0], True),
    "away from the lower stop": (_LOW, [0.5], [1.0], False),
    "too fast": (0.0, [0.1], [2.0001], True),
    "too fast backwards": (0.0, [0.1], [-2.0001], True),
    "resting outside": (2.0, [1.0], [0.0], False),
    "coming back inside": (2.0, [1.0], [-1.0], True),
}


@pytest.mark.parametrize("joint", [0, 1], ids=["theta", "phi"])
@pytest.mark.parametrize("case", _JOINT_CASES)
def test_a_broken_limit_or_speed_is_found(case, joint):
    start, duration, speed, broken = _JOINT_CASES[case]
    plane = preset("desi", 2)
    plane = replace(
        plane,
        centers=40 * plane.centers,
        limits=np.tile([_LOW, _HIGH], (2, 2, 1)),
        speeds=np.full((2, 2), _FASTEST),
    )
    angles = np.zeros((2, 2))
    angles[1, joint] = start
    counts = np.zeros(4, dtype=int)
    counts[2 + joint] = len(duration)
    motion = SegmentMotion(angles, Parts.from_counts(counts).offsets, duration, speed)
    found = certify(plane, motion, Safety())
    assert found.limits_broken.tolist() == [False, broken]
    assert found.ok == (not broken)


def test_a_disabled_robot_must_rest():
    plane = preset("desi", 3)
    plane = replace(plane, centers=40 * plane.centers, enabled=[True, False, False])
    motion = SegmentMotion(np.ones((3, 2)), [0, 1, 1, 2, 2, 2, 3], [1.0, 1.0, 1.0], [1.0, 0.1, 0.0])
    found = certify(plane, motion, Safety())
    assert found.moved_disabled.tolist() == [False, True, False]
    assert not found.ok


def test_certificates_do_not_depend_on_order_or_repetition():
    rng = np.random.default_rng(8)
    plane, motion = _couples(rng, 40, 3, 4), random_motion(rng, 80)
    pairs = np.stack([2 * np.arange(40), 2 * np.arange(40) + 1], axis=1)
    first, second = (certify(plane, motion, Safety(), pairs) for _ in range(2))
    back = certify(plane, motion, Safety(), pairs[::-1])
    np.testing.assert_array_equal(first.gap_mm, second.gap_mm)
    np.testing.assert_array_equal(first.unsafe, back.unsafe[::-1])
    np.testing.assert_array_equal(first.gap_mm[first.unsafe], back.gap_mm[::-1][first.unsafe])
    assert first.min_pair == back.min_pair and first.min_gap_mm == back.min_gap_mm


@pytest.mark.parametrize("tolerance_mm", [0.0, 1e-6, 0.1])
def test_gaps_are_resolved_to_the_tolerance(tolerance_mm):
    rng = np.random.default_rng(9)
    plane, motion = _couples(rng, 10, 2, 0), random_motion(rng, 20)
    pairs = np.stack([2 * np.arange(10), 2 * np.arange(10) + 1], axis=1)
    dense = _dense_minimum(plane, motion, pairs)
    found = certify(plane, motion, RESOLVE_ALL, pairs, tolerance_mm)
    assert (found.gap_mm <= dense).all()
    assert (dense - found.gap_mm <= tolerance_mm + 1e-4).all()


def test_a_plane_without_pairs_is_safe():
    found = certify(preset("desi", 1), SegmentMotion.at_rest([[0.0, 0.0]]), Safety())
    assert found.ok
    assert found.min_gap_mm == np.inf and found.min_pair == () and np.isnan(found.min_time_s)

# SPDX-License-Identifier: Apache-2.0
"""Laws of motions: continuous, velocity is the derivative, robots independent of each other."""

import numpy as np
import pytest

from fiber_core import MotionError, SampledMotion, SegmentMotion
from fiber_core.ragged import Parts


def random_segments(seed, n=20, longest=6):
    rng = np.random.default_rng(seed)
    offsets = Parts.from_counts(rng.integers(0, longest, 2 * n)).offsets
    m = offsets[-1]
    # ticks of 4 ms: segments of different robots end at the same instants
    duration = 0.004 * rng.integers(1, 200, m)
    return SegmentMotion(rng.normal(size=(n, 2)), offsets, duration, rng.normal(size=m))


def random_samples(seed, n=20, t=30):
    rng = np.random.default_rng(seed)
    time = rng.normal() + np.cumsum(rng.uniform(0.01, 0.2, t))
    return SampledMotion(time, np.cumsum(rng.normal(size=(n, 2, t)), axis=2))


def breaks(motion):
    if isinstance(motion, SampledMotion):
        return motion.time_s
    ends = [
        np.cumsum(motion.duration_s[a:b]) for a, b in zip(motion.offsets[:-1], motion.offsets[1:])
    ]
    return np.unique(np.concatenate([[0.0], *ends]))


KINDS = pytest.mark.parametrize("kind", [random_segments, random_samples])
SEEDS = pytest.mark.parametrize("seed", range(3))


@KINDS
@SEEDS
def test_velocity_is_the_derivative(kind, seed):
    motion = kind(seed)
    times = breaks(motion)
    wide = np.flatnonzero(np.diff(times) > 1e-6)  # equal instants may differ in floats
    for k in wide:
        a, b = times[k], times[k + 1]
        early, late = a + 0.1 * (b - a), b - 0.1 * (b - a)
        slope = (motion(late) - motion(early)) / (late - early)
        assert np.allclose(motion.velocity(early), slope, atol=1e-8)
        assert np.array_equal(motion.velocity(early), motion.velocity(late))


@KINDS
@SEEDS
def test_a_motion_is_continuous_and_rests_outside(kind, seed):
    motion = kind(seed)
    times = breaks(motion)
    fastest = max(np.abs(motion.velocity(t)).max() for t in 0.5 * (times[1:] + times[:-1]))
    for t in times:
        jump = np.abs(motion(t + 1e-7) - motion(t - 1e-7)).max()
        assert jump <= 2.1e-7 * fastest
    assert np.array_equal(motion(times[0] - 1.0), motion.start)
    assert np.array_equal(motion(times[-1] + 1.0), motion.end)
    assert not motion.velocity(times[0] - 1.0).any()
    assert not motion.velocity(times[-1] + 1.0).any()


@SEEDS
def test_at_a_break_exactly_one_segment_is_active(seed):
    motion = random_segments(seed)
    for profile in range(2 * motion.n):
        a, b = motion.offsets[profile], motion.offsets[profile + 1]
        at = np.concatenate([[0.0], np.cumsum(motion.duration_s[a:b])])
        speeds = [motion.velocity(t)[profile // 2, profile % 2] for t in at]
        assert np.array_equal(speeds, [*motion.velocity_rad_s[a:b], 0.0])


@SEEDS
def test_end_and_makespan_are_sums_of_segments(seed):
    motion = random_segments(seed)
    for profile in range(2 * motion.n):
        rows = slice(motion.offsets[profile], motion.offsets[profile + 1])
        robot, joint = divmod(profile, 2)
        turn = sum((motion.duration_s[rows] * motion.velocity_rad_s[rows]).tolist())
        assert motion.end[robot, joint] == pytest.approx(
            motion.start[robot, joint] + turn, abs=1e-12
        )
        assert motion.durations[robot, joint] == pytest.approx(
            sum(motion.duration_s[rows].tolist())
        )
        assert motion.counts[robot, joint] == rows.stop - rows.start
    assert motion.makespan_s == motion.durations.max()


def test_without_holds_some_robots_and_changes_no_other():
    motion = random_segments(5)
    held = np.random.default_rng(0).random(motion.n) < 0.4
    rest = motion.without(held)
    for t in np.linspace(0.0, motion.makespan_s, 17):
        assert np.array_equal(rest(t)[~held], motion(t)[~held])
        assert np.array_equal(rest(t)[held], motion.start[held])
    assert not rest.counts[held].any() and np.array_equal(rest.counts[~held], motion.counts[~held])


def test_the_motion_of_some_robots_alone_is_their_part_of_the_motion():
    motion, rows = random_segments(6), [7, 0, 19]
    some = motion.of_robots(rows)
    for t in np.linspace(0.0, motion.makespan_s, 17):
        assert np.array_equal(some(t), motion(t)[rows])
    assert np.array_equal(some.counts, motion.counts[rows])


def test_at_rest_no_robot_moves():
    start = np.random.default_rng(0).normal(size=(4, 2))
    motion = SegmentMotion.at_rest(start)
    assert motion.makespan_s == 0.0 and not motion.counts.any()
    assert np.array_equal(motion.end, start) and np.array_equal(motion(1.0), start)
    assert SegmentMotion.at_rest(np.zeros((0, 2))).makespan_s == 0.0


def test_makespan_of_samples_ends_when_the_last_robot_stops():
    angles = np.zeros((2, 2, 4))
    angles[1, 0] = [0.0, 1.0, 2.0, 2.0]
    assert SampledMotion([0.0, 1.0, 3.0, 9.0], angles).makespan_s == 3.0
    assert SampledMotion([0.0, 1.0, 3.0, 9.0], 0 * angles).makespan_s == 0.0
    assert np.array_equal(SampledMotion([5.0], angles[:, :, :1])(0.0), np.zeros((2, 2)))


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"start": [[0.0, np.nan]]}, ["start[0, 1]", "nan"]),
        ({"start": [0.0, 0.0]}, ["start", "(2,)"]),
        ({"offsets": [1, 1, 2]}, ["offsets"]),
        ({"offsets": [0, 2, 1]}, ["offsets"]),
        ({"offsets": [0, 0.5, 2]}, ["offsets", "0.5"]),
        ({"offsets": [0, 2]}, ["offsets", "(2,)", "(3)"]),
        ({"duration_s": [1.0, 0.0]}, ["robot row 0", "segment 1", "0.0 s"]),
        ({"duration_s": [1.0]}, ["duration_s", "(1,)"]),
        ({"duration_s": [1.0, np.inf]}, ["duration_s[1]", "inf"]),
        ({"velocity_rad_s": [1.0, 2.0, 3.0]}, ["velocity_rad_s", "(3,)"]),
    ],
)
def test_bad_segments_are_refused(changes, words):
    good = {
        "start": [[0.0, 0.0]],
        "offsets": [0, 1, 2],
        "duration_s": [1.0, 1.0],
        "velocity_rad_s": [1.0, 1.0],
    }
    SegmentMotion(**good)
    with pytest.raises(MotionError) as refusal:
        SegmentMotion(**{**good, **changes})
    assert all(word in str(refusal.value) for word in words), str(refusal.value)


@pytest.mark.parametrize(
    "time, angles, words",
    [
        ([], np.zeros((1, 2, 0)), ["at least one"]),
        ([0.0, 0.0], np.zeros((1, 2, 2)), ["times must increase", "0.0 s follows 0.0 s"]),
        ([0.0, np.nan], np.zeros((1, 2, 2)), ["time_s[1]"]),
        ([0.0, 1.0], np.zeros((1, 2, 3)), ["angles", "(1, 2, 3)"]),
        ([0.0], np.full((1, 2, 1), np.nan), ["angles[0, 0, 0]"]),
    ],
)
def test_bad_samples_are_refused(time, angles, words):
    with pytest.raises(MotionError) as refusal:
        SampledMotion(time, angles)
    assert all(word in str(refusal.value) for word in words), str(refusal.value)

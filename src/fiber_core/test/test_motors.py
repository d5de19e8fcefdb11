# SPDX-License-Identifier: Apache-2.0
"""Coupled joints: motors by a matrix, their speeds and ranges by dense sampling."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.clearance import Safety, certify
from fiber_core.drive import Drive, carried_out
from fiber_core.errors import LayoutError
from fiber_core.kinematics import forward, inverse
from fiber_core.metrics import lower_bound_s
from fiber_core.motion import SegmentMotion
from fiber_core.motors import (
    alone_s,
    longest_move_s,
    motors_broken,
    motors_of,
    speeds_alone,
    with_independent_speeds,
)
from fiber_core.presets import preset
from fiber_core.problem import Problem, load_problem, save_problem

GEARS = [[1.0, 0.0], [-1.5, 1.5]]
WIDE = [[-50.0, 50.0]] * 2  # motor ranges [rad]
N = 40


@pytest.fixture
def rng():
    return np.random.default_rng(25)


def coupled(robots=N, **motors):
    plane = preset("desi", robots)
    return replace(
        plane,
        coupling=np.broadcast_to(GEARS, (robots, 2, 2)),
        **{name: np.broadcast_to(v, (robots, *np.shape(v))) for name, v in motors.items()},
    )


def random_motion(rng, robots=N):
    counts = rng.integers(0, 5, 2 * robots)
    offsets = np.append(0, np.cumsum(counts))
    return SegmentMotion(
        rng.uniform(0.0, 3.0, (robots, 2)),
        offsets,
        rng.integers(1, 40, offsets[-1]) * 0.01,
        rng.uniform(-2.0, 2.0, offsets[-1]),
    )


def sampled(plane, motion, step_s=0.0025):
    # joints and motors at instants that include all breaks, which are multiples of 10 ms
    times = np.arange(0.0, motion.makespan_s + step_s, step_s)
    angles = np.stack([motion(t) for t in times])
    motors = np.stack([motors_of(plane, each) for each in angles])
    return motors, np.abs(np.diff(motors, axis=0)) / step_s


@pytest.mark.parametrize("speeds", [(1.0, 2.0), (1.9, 4.0), (2.5, 6.5)])
def test_a_motor_is_too_fast_exactly_where_dense_samples_say_so(speeds, rng):
    plane = coupled(motor_speeds=speeds, motor_limits=WIDE)
    motion = random_motion(rng)
    _, fastest = sampled(plane, motion)
    expected = (fastest.max(axis=0) > np.array(speeds) + 1e-6).any(axis=1)
    assert speeds != (1.9, 4.0) or 0 < expected.sum() < N
    np.testing.assert_array_equal(motors_broken(plane, motion), expected)


def test_a_motor_leaves_its_range_exactly_where_dense_samples_say_so(rng):
    limits = [[-0.2, 3.0], [-2.0, 3.0]]
    plane, motion = coupled(motor_limits=limits, motor_speeds=(50.0, 50.0)), random_motion(rng)
    motors, _ = sampled(plane, motion)
    low, high = np.array(limits).T
    moves = motion.counts.any(axis=1)
    outside = (motors < low - 1e-5) | (motors > high + 1e-5)
    expected = outside.any(axis=(0, 2)) & moves
    assert 0 < expected.sum() < N
    np.testing.assert_array_equal(motors_broken(plane, motion), expected)


def test_true_curves_are_judged_where_they_are_fastest_and_farthest(rng):
    limits, speeds = [[-0.2, 3.0], [-2.0, 3.0]], (1.5, 3.5)
    plane = coupled(motor_limits=limits, motor_speeds=speeds)
    motion = carried_out(Drive(N, ramp_s=0.09), random_motion(rng))
    motors, fastest = sampled(plane, motion, step_s=0.0005)
    low, high = np.array(limits).T
    moves = motion.counts.any(axis=1)
    outside = ((motors < low) | (motors > high)).any(axis=(0, 2)) & moves
    expected = outside | (fastest.max(axis=0) > np.array(speeds)).any(axis=1)
    near = (np.abs(fastest.max(axis=0) - speeds) < 0.01).any(axis=1)  # samples do not decide
    assert 5 < expected.sum() < N - 5 and near.sum() < 8
    np.testing.assert_array_equal(motors_broken(plane, motion)[~near], expected[~near])


def test_the_certificate_refuses_motors_that_are_too_fast_though_joints_are_not():
    plane = coupled(1, motor_speeds=(3.0, 3.0))
    against = SegmentMotion([[0.5, 1.5]], [0, 1, 2], [0.5, 0.5], [1.5, -1.5])
    along = SegmentMotion([[0.5, 0.5]], [0, 1, 2], [0.5, 0.5], [1.5, 1.5])
    assert certify(plane, along, Safety()).ok
    found = certify(plane, against, Safety())
    assert found.limits_broken.tolist() == [True] and not found.ok
    assert certify(preset("desi", 1), against, Safety()).ok


def test_motions_of_some_robots_are_judged_by_their_own_gears(rng):
    plane = coupled(motor_speeds=(1.9, 4.0), motor_limits=WIDE)
    motion = random_motion(rng)
    uneven = replace(plane, motor_speeds=plane.motor_speeds * rng.uniform(0.5, 2.0, (N, 1)))
    rows = rng.permutation(N)[:11]
    expected = motors_broken(uneven, motion)[rows]
    np.testing.assert_array_equal(motors_broken(uneven, motion.of_robots(rows), rows), expected)


def test_time_alone_is_that_of_the_slowest_joint_or_motor(rng):
    plane = coupled(motor_speeds=(3.0, 2.0))
    start, goals = rng.uniform(-1, 1, (N, 2)), rng.uniform(-1, 1, (N, 3, 2))
    change = goals - start[:, None]
    beta = 1.5 * (change[..., 1] - change[..., 0]) / 2.0
    joints = np.abs(change) / plane.speeds[:, None]
    expected = np.max([*np.moveaxis(joints, -1, 0), np.abs(change[..., 0]) / 3.0, np.abs(beta)], 0)
    np.testing.assert_allclose(alone_s(plane, start, goals), expected)
    plain = preset("desi", N)
    np.testing.assert_array_equal(alone_s(plain, start, goals), joints.max(axis=2))
    assert (
        longest_move_s(plane) >= alone_s(plane, plane.limits[:, :, 0], plane.limits[:, :, 1])
    ).all()


def test_the_bound_counts_motors():
    plane = coupled(1, motor_speeds=(3.0, 0.5))
    start, goal = np.array([[0.0, 0.5]]), np.array([[-0.4, 0.7]])
    problem = Problem(plane, start, forward(plane, goal)[1])
    times = [alone_s(plane, start, one[None])[0] for one in inverse(plane, problem.targets)[0][0]]
    assert lower_bound_s(problem) == pytest.approx(np.nanmin(times))
    assert lower_bound_s(problem) > 1.5


def test_goals_outside_the_range_of_a_motor_are_none(rng):
    plane = coupled()
    angles = rng.uniform([-3.0, 0.1], [3.0, 3.0], (N, 2))
    points = forward(plane, angles)[1]
    narrow = coupled(motor_limits=[[-4.0, 4.0], [0.0, 10.0]])
    everywhere, valid = inverse(plane, points)
    found, inside = inverse(narrow, points)
    beta = motors_of(plane, everywhere)[..., 1]
    np.testing.assert_array_equal(inside, valid & (beta >= -1e-5) & (beta <= 10.0))
    assert 0 < inside.sum() < valid.sum()
    np.testing.assert_array_equal(found, everywhere)


def test_at_independent_speeds_no_motor_is_too_fast(rng):
    plane = coupled(motor_speeds=(3.0, 2.0))
    slow = with_independent_speeds(plane)
    assert (slow.speeds < plane.speeds).all()
    for signs in ((1, 1), (1, -1)):
        motors = np.abs(motors_of(plane, slow.speeds * signs))
        assert (motors <= plane.motor_speeds * (1 + 1e-12)).all()
    alone = speeds_alone(plane)
    np.testing.assert_allclose(alone, np.minimum(plane.speeds, [2.0 / 1.5, 2.0 / 1.5]))
    plain = preset("desi", 3)
    assert with_independent_speeds(plain) is plain


def test_gears_stay_in_a_problem_file(tmp_path, rng):
    plane = coupled(motor_speeds=(3.0, 2.0), motor_limits=[[-4.0, 4.0], [0.0, 10.0]])
    save_problem(tmp_path / "p.npz", Problem(plane, np.zeros((N, 2)), np.full((N, 2), np.nan)))
    again = load_problem(tmp_path / "p.npz").plane
    for name in ("coupling", "motor_speeds", "motor_limits"):
        np.testing.assert_array_equal(getattr(again, name), getattr(plane, name))


def test_without_figures_motors_do_what_joints_may():
    plane = coupled()
    top = np.abs(np.array(GEARS)) @ plane.speeds[0]
    np.testing.assert_allclose(plane.motor_speeds[0], top)
    theta, phi = plane.limits[0]
    ends = [1.5 * (p - t) for t in theta for p in phi]
    np.testing.assert_allclose(plane.motor_limits[0, 1], [min(ends), max(ends)])


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"coupling": np.ones((3, 1, 2))}, "1 motors a robot, expected 2"),
        ({"coupling": [GEARS, GEARS, [[1, 1], [1, 1]]]}, "robot 2: coupling must have an inverse"),
        ({"coupling": [GEARS, [[np.nan, 1], [1, 1]], GEARS]}, "robot 1: coupling"),
        ({"coupling": [GEARS] * 3, "motor_speeds": [[1, 1], [1, 0], [1, 1]]}, "robot 1: motor_sp"),
        ({"coupling": [GEARS] * 3, "motor_limits": [[[1, 0], [0, 1]]] * 3}, "robot 0: motor_lim"),
        ({"motor_speeds": [[1, 1]] * 3}, "motor_speeds"),
    ],
)
def test_impossible_gears_are_refused(values, text):
    with pytest.raises(LayoutError, match=text):
        replace(preset("desi", 3), **values)

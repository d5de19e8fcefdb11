# SPDX-License-Identifier: Apache-2.0
"""Drives: the true curves against their definition, and their certificate against sampling."""

from dataclasses import replace

import numpy as np
import pytest
from random_motions import RESOLVE_ALL, Fixed, all_at, random_motion

from fiber_core import kinematics
from fiber_core.clearance import (
    Safety,
    certify,
    certify_arms,
    hold_until_safe,
    neighbour_pairs,
    sampled_gaps,
)
from fiber_core.drive import CurveMotion, Drive, carried_out, most_motors_on
from fiber_core.drive.named import DRIVES, with_drive
from fiber_core.errors import LayoutError
from fiber_core.fields import random_problem
from fiber_core.metrics import lower_bound_s
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_core.problem import Problem, load_problem, save_plan, save_problem

_N = 40


def _mean_over_ramp(motion: SegmentMotion, t: float, ramp_s: float) -> np.ndarray:
    """Return the mean of the ordered angles from t - ramp to t, shape (n, 2).

    It is exact: between two breaks the mean is the angle at the middle. Before zero all rest.
    """
    breaks = np.concatenate([motion.begins_s, motion.begins_s + motion.duration_s, [0.0]])
    inside = breaks[(breaks > t - ramp_s) & (breaks < t)]
    knots = np.unique(np.concatenate([[t - ramp_s, t], inside]))
    middles, weights = 0.5 * (knots[1:] + knots[:-1]), np.diff(knots) / ramp_s
    return np.einsum("ijk,k->ij", all_at(motion, np.maximum(middles, 0.0)), weights)


@pytest.fixture
def moving(rng) -> tuple[SegmentMotion, CurveMotion, Drive]:
    drive = Drive(_N, ramp_s=0.13, acceleration_rad_s2=1e3)
    motion = random_motion(rng, _N)
    curve = carried_out(drive, motion)
    assert isinstance(curve, CurveMotion)
    return motion, curve, drive


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def _curve_at(curve: CurveMotion, times: np.ndarray) -> np.ndarray:
    return np.stack([curve(t) for t in times], axis=-1)


def test_the_curve_is_the_mean_of_the_ordered_angles_over_the_ramp(moving, rng):
    motion, curve, drive = moving
    for t in rng.uniform(0.0, curve.makespan_s, 30):
        expected = _mean_over_ramp(motion, t, drive.ramp_s)
        assert np.abs(curve(t) - expected).max() < 1e-12


def test_a_joint_ends_where_it_was_ordered_to_a_ramp_later(moving):
    motion, curve, drive = moving
    assert np.abs(curve.end - motion.end).max() < 1e-12
    moves = motion.counts > 0
    assert np.allclose(curve.durations[moves], motion.durations[moves] + drive.ramp_s, atol=1e-12)
    assert not curve.durations[~moves].any()


def test_speed_and_acceleration_are_bounded_by_the_orders(moving, rng):
    motion, curve, drive = moving
    assert (curve.fastest <= motion.fastest + 1e-12).all()
    assert (curve.hardest <= 2 * motion.fastest / drive.ramp_s + 1e-9).all()
    times = rng.uniform(0.0, curve.makespan_s, 2000)
    speeds = np.stack([curve.velocity(t) for t in times], axis=-1)
    assert (np.abs(speeds).max(axis=2) <= curve.fastest + 1e-12).all()
    angles = _curve_at(curve, times)
    assert (angles.min(axis=2) >= curve.lowest - 1e-12).all()
    assert (angles.max(axis=2) <= curve.highest + 1e-12).all()


def test_robots_that_start_and_end_together_keep_the_geometry_of_their_orders(rng):
    plane = preset("desi", _N)
    start, end = (random_problem(plane, rng, gap_mm=0.5).start for _ in range(2))
    straight = SegmentMotion(
        start, np.arange(2 * _N + 1), np.full(2 * _N, 2.0), (end - start).ravel() / 2
    )
    ramped = replace(plane, drive=Drive(_N, ramp_s=0.2))
    pairs = neighbour_pairs(plane)
    gaps = [certify(p, straight, RESOLVE_ALL, pairs).gap_mm for p in (plane, ramped)]
    assert np.abs(gaps[0] - gaps[1]).max() < 2e-3


def test_the_certificate_of_curves_agrees_with_dense_sampling(rng):
    plane = replace(preset("desi", _N), limits=np.tile([-100.0, 100.0], (_N, 2, 1)))
    plane = replace(plane, speeds=np.full((_N, 2), 1e3), drive=Drive(_N, ramp_s=0.17))
    pairs = neighbour_pairs(plane)
    found = 0
    for _ in range(4):
        motion = random_motion(rng, _N)
        certificate = certify(plane, motion, RESOLVE_ALL, pairs)
        curve = carried_out(plane.drive, motion)
        times = np.linspace(0.0, curve.makespan_s, 3001)
        sampled = sampled_gaps(plane, pairs, _curve_at(curve, times)).min(axis=1)
        assert (certificate.gap_mm <= sampled + 1e-9).all()
        # points move slower than 200 mm/s, so samples miss less than that times half a step
        assert (certificate.gap_mm >= sampled - 200 * times[1] - 2e-3).all()
        straight = certify(replace(plane, drive=Drive(_N)), motion, RESOLVE_ALL, pairs)
        found += np.count_nonzero(np.abs(straight.gap_mm - certificate.gap_mm) > 0.05)
    assert found > 20  # the ramp matters for these motions


def test_true_arms_inside_their_intervals_keep_the_certified_gap(rng):
    uncertainty = rng.uniform(0.0, 0.1, (_N, 2))
    plane = replace(preset("desi_outlines", _N), drive=Drive(_N, uncertainty_rad=uncertainty))
    exact = replace(plane, drive=Drive(_N))
    start = random_problem(plane, rng, gap_mm=0.2).start
    pairs = neighbour_pairs(plane)
    certificate = certify(plane, SegmentMotion.at_rest(start), Fixed(0.0), pairs)
    errors = rng.uniform(-1.0, 1.0, (400, _N, 2))
    errors[::2] = np.sign(errors[::2])
    true = np.moveaxis(start + errors * uncertainty, 0, -1)
    gaps = sampled_gaps(exact, pairs, true).min(axis=1)
    assert (gaps >= certificate.gap_mm - 1e-9).all()
    near = gaps < gaps.min() + 1.0
    nominal = certify(exact, SegmentMotion.at_rest(start), Fixed(0.0), pairs).gap_mm
    assert (gaps[near] < nominal[near]).all()  # the errors bring arms closer than they stand


def test_a_robot_that_would_be_accelerated_too_hard_is_held():
    plane = with_drive(preset("desi", 3), "accelerated")
    speed = plane.speeds[0, 0]
    offsets = np.array([0, 2, 2, 3, 3, 3, 3])
    velocity = [speed, -speed, speed]
    motion = SegmentMotion(np.tile([0.0, np.pi], (3, 1)), offsets, np.full(3, 0.3), velocity)
    kept, held, certificate = hold_until_safe(plane, motion, Safety())
    assert held.tolist() == [True, False, False]
    assert certificate.ok and kept.moves.tolist() == [False, True, False]
    assert certify(plane, motion, Safety()).limits_broken.tolist() == [True, False, False]


def test_the_bound_of_a_robot_alone_contains_its_acceleration():
    plane = with_drive(preset("desi", 1), "accelerated")
    speed, limit = plane.speeds[0, 0], plane.drive.acceleration_rad_s2[0, 0]
    start = np.array([[0.0, np.pi / 2]])
    for turn in (0.01, 1.0):
        tip = kinematics.forward(plane, start + [turn, 0.0])[1]
        rise = speed / limit
        expected = turn / speed + rise if turn > speed * rise else 2 * np.sqrt(turn / limit)
        bound = lower_bound_s(Problem(plane, start, tip))
        assert bound == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", DRIVES)
def test_a_drive_survives_its_file(tmp_path, name):
    plane = with_drive(preset("sdss_v", 7), name)
    problem = random_problem(plane, np.random.default_rng(1))
    save_problem(tmp_path / "problem.npz", problem)
    read = load_problem(tmp_path / "problem.npz").plane.drive
    assert (read.ramp_s, read.name) == (plane.drive.ramp_s, name)
    assert (read.acceleration_rad_s2 == plane.drive.acceleration_rad_s2).all()
    assert (read.uncertainty_rad == plane.drive.uncertainty_rad).all()


def test_a_plan_file_holds_every_change_of_the_law(tmp_path, moving):
    motion, curve, drive = moving
    save_plan(tmp_path / "plan.npz", motion, np.zeros(_N), np.zeros(_N), drive)
    data = np.load(tmp_path / "plan.npz")
    offsets, time_s = data["curve_offsets"], data["curve_time_s"]
    for profile in range(2 * _N):
        part = slice(offsets[profile], offsets[profile + 1])
        for k in range(part.start, part.stop):
            passed = 0.4 * (time_s[k + 1] - time_s[k]) if k + 1 < part.stop else 0.1
            angle = data["curve_angle_rad"][k] + passed * (
                data["curve_velocity_rad_s"][k]
                + 0.5 * data["curve_acceleration_rad_s2"][k] * passed
            )
            expected = curve(time_s[k] + passed)[profile // 2, profile % 2]
            assert angle == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    "values, words",
    [
        ({"ramp_s": -1.0}, "ramp of the drive"),
        ({"ramp_s": np.nan}, "ramp of the drive"),
        ({"ramp_s": 0.1, "acceleration_rad_s2": [[1.0, 2.0], [0.0, 1.0]]}, "robot row 1"),
        ({"acceleration_rad_s2": 5.0}, "needs a ramp, got 0 s"),
        ({"uncertainty_rad": [0.1, -0.1]}, "uncertainty_rad must be 0 to"),
        ({"uncertainty_rad": np.zeros((3, 2))}, "uncertainty_rad has shape"),
    ],
)
def test_impossible_drives_are_refused(values, words):
    with pytest.raises(LayoutError, match=words):
        Drive(2, **values)


def test_a_drive_of_another_number_of_robots_is_refused():
    with pytest.raises(LayoutError, match="the drive is of 2 robots, the plane has 3"):
        replace(preset("desi", 3), drive=Drive(2))
    with pytest.raises(LayoutError, match="no drive is named 'fast'; there are ideal"):
        with_drive(preset("desi", 3), "fast")


def test_a_cap_of_less_than_one_motor_is_refused():
    plane = preset("desi_petals", 30)
    assert with_drive(plane, "desi", 0.017).drive.motors_on == 0.017
    with pytest.raises(LayoutError, match=r"supply 0: 0.016 of its 60 motors is 0.96"):
        with_drive(plane, "desi", 0.016)


def test_the_most_motors_on_at_once_is_that_of_dense_sampling(moving, rng):
    motion, curve, _ = moving
    groups = rng.integers(3, 6, _N)
    for profile in (motion, curve):
        times = np.linspace(0.0, profile.makespan_s, 4001) + 1e-4
        on = np.stack([profile.velocity(t) != 0.0 for t in times])
        most = most_motors_on(profile, groups)
        for share, g in zip(most, (3, 4, 5)):
            sampled = on[:, groups == g].mean(axis=(1, 2)).max()
            # an instant between two samples may have one motor more
            one = 1.0 / on[0, groups == g].size
            assert sampled - 1e-12 <= share <= sampled + one + 1e-12


def test_motors_that_take_turns_are_never_on_together():
    # theta of robot 0 from 0 to 1 s, phi from 1 s on; robot 1 rests first, then turns theta
    offsets, duration = np.array([0, 1, 3, 5, 5]), [1.0, 1.0, 1.0, 0.5, 0.7]
    velocity = [0.3, 0.0, -0.2, 0.0, 0.1]
    motion = SegmentMotion(np.zeros((2, 2)), offsets, duration, velocity)
    assert most_motors_on(motion, [0, 1]).tolist() == [0.5, 0.5]
    assert most_motors_on(motion, [0, 0]).tolist() == [0.5]
    assert most_motors_on(carried_out(Drive(2, ramp_s=0.2), motion), [0, 1]).tolist() == [1.0, 0.5]
    assert most_motors_on(SegmentMotion.at_rest(np.zeros((2, 2))), [7, 7]).tolist() == [0.0]


def test_a_motor_that_rests_between_two_moves_is_off(rng):
    # the other motor turns only in the rest of the first, of which a ramp leaves 1e-17 rad/s
    for _ in range(50):
        ramp_s, (v, w) = 0.05, rng.uniform(0.1, 3.0, 2)
        offsets = np.array([0, 3, 5, 5, 5])
        motion = SegmentMotion(
            np.zeros((2, 2)), offsets, [0.3, 1.0, 0.3, 0.5, 0.2], [v, 0.0, -v / 3.0, 0.0, w]
        )
        curve = carried_out(Drive(2, ramp_s=ramp_s), motion)
        assert most_motors_on(curve, [0, 0]).tolist() == [0.25]


def test_the_motion_that_arms_made_is_judged_without_the_drive():
    plane = preset("desi", 7)
    drive = Drive(7, 0.5, np.inf, 0.05)
    problem = random_problem(plane, np.random.default_rng(3))
    motion = SegmentMotion.at_rest(problem.start)
    pairs, safety = neighbour_pairs(plane), Safety(0.0, 0.0, 0.0, 0.0)
    made = certify_arms(replace(plane, drive=drive), motion, safety, pairs)
    assert np.array_equal(made.gap_mm, certify(plane, motion, safety, pairs).gap_mm)
    ordered = certify(replace(plane, drive=drive), motion, safety, pairs)
    assert (ordered.gap_mm < made.gap_mm).all()


def test_drives_are_equal_by_value():
    drive = Drive(3, 0.1, 2.0, 0.01, "own")
    assert drive == Drive(3, 0.1, [2.0, 2.0], 0.01, "own")
    assert drive == drive.of_robots([2, 1, 0])
    for other in (
        Drive(2, 0.1, 2.0, 0.01, "own"),
        Drive(3, 0.2, 2.0, 0.01, "own"),
        Drive(3, 0.1, [2.0, 2.5], 0.01, "own"),
        Drive(3, 0.1, 2.0, [0.01, 0.02], "own"),
        Drive(3, 0.1, 2.0, 0.01, "other"),
    ):
        assert drive != other
    assert drive != "own"

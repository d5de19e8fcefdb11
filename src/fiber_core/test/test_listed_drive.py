# SPDX-License-Identifier: Apache-2.0
"""Laws of motors with a list of speeds: curves, rules of moves, supplies, least times."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import SegmentMotion, carried_out, preset
from fiber_core.clearance import Safety, certify, hold_until_safe
from fiber_core.drive import (
    Drive,
    ListedSpeeds,
    most_motors_on,
    motors_allowed,
    motors_turning,
    overloading,
    rules_broken,
)
from fiber_core.drive.breaches import MotorRule
from fiber_core.drive.least_time import least_time_s
from fiber_core.drive.named import with_drive
from fiber_core.errors import LayoutError
from fiber_core.problem import Problem, load_problem, save_problem

_LISTED = ListedSpeeds(
    np.array([3.0, 0.05]), np.array([0.03, 0.0]), np.array([0.1, 0.0]),
    approach_rad=(0.05, 0.05), approach_speed=1, returns=True,
)  # fmt: skip
_DRIVE = Drive(1, listed=_LISTED)
_REST = (0.03, 0.0)  # a ramp long


def motion_of(theta, phi=(), n=1):
    """The motion of n equal robots: segments (duration, velocity) of either joint."""
    joints = [list(theta), list(phi)] * n
    flat = [segment for joint in joints for segment in joint]
    offsets = np.concatenate([[0], np.cumsum([len(joint) for joint in joints])])
    duration, velocity = np.array(flat, dtype=float).reshape(-1, 2).T
    return SegmentMotion(np.zeros((n, 2)), offsets, duration, velocity)


def test_every_segment_is_spread_over_the_ramp_of_its_speed():
    motion = motion_of([(0.1, 0.0), (0.4, 3.0), (0.04, 0.0), (1.0, 0.05), (0.2, -0.05)])
    curve = carried_out(_DRIVE, motion)
    np.testing.assert_allclose(curve.end, motion.end, atol=1e-12)
    begins = np.array([0.1, 0.54, 1.54])
    for t in np.linspace(0.0, 1.8, 400):
        gone = np.clip(t - begins, 0.0, [0.4, 1.0, 0.2])
        # the cruise move follows the mean of the last 0.03 s, creep has no ramp
        past = np.clip(np.linspace(t - 0.03, t, 20001) - 0.1, 0.0, 0.4).mean()
        expected = 3.0 * past + 0.05 * gone[1] - 0.05 * gone[2]
        assert abs(curve(t)[0, 0] - expected) < 1e-6
    assert curve.fastest[0, 0] <= 3.0 * (1 + 1e-12)
    assert curve.makespan_s == pytest.approx(1.74)


def test_a_cruise_move_at_the_end_lasts_a_ramp_longer():
    curve = carried_out(_DRIVE, motion_of([(0.4, 3.0)]))
    assert curve.makespan_s == pytest.approx(0.43)
    assert most_motors_on(curve, [0]).tolist() == [0.5]


@pytest.mark.parametrize(
    "theta",
    [
        [(0.4, 2.5)],
        [(0.01, 3.0), _REST, (1.0, -0.05)],
        [(0.4, 3.0), (1.0, 0.05), (1.0, -0.05)],
        [(0.4, 3.0)],
        [(0.4, 3.0), _REST, (1.0, 0.05), (0.9, -0.05)],
        [(0.4, 3.0), _REST, (1.0, -0.05), (1.0, 0.05)],
        [(0.4, 3.0), _REST, (0.9, 0.05), (1.0, -0.05)],
        [(0.4, 3.0), _REST, (1.0, -0.05)],
    ],
    ids=["speed", "least", "ramp", "no end", "short end", "wrong way", "short back", "no back"],
)
def test_an_order_that_motors_cannot_carry_out_is_found(theta):
    assert rules_broken(_DRIVE, motion_of(theta)).robots(1).tolist() == [True]


@pytest.mark.parametrize(
    ("theta", "told"),
    [
        ([(0.4, 2.5)], "is to turn its motor at 143.2 deg/s, listed are 171.9, 2.865 deg/s"),
        (
            [(0.01, 3.0), _REST, (1.0, -0.05)],
            "is to turn its motor by 1.719 deg, at this speed at least 5.73 deg",
        ),
        (
            [(0.4, 3.0), (0.02, 0.0), (1.0, 0.05), (1.0, -0.05)],
            "rests for 0.02 s after a ramp of 0.03 s began",
        ),
        (
            [(0.4, 3.0), _REST, (1.0, 0.05), (0.9, -0.05)],
            "ends with a move of -2.578 deg, its approach is 2.865 deg in creep",
        ),
        (
            [(0.4, 3.0), _REST, (0.9, 0.05), (1.0, -0.05)],
            "ends with a move of 2.578 deg, its approach is 2.865 deg in creep",
        ),
    ],
    ids=["speed", "least", "ramp", "short end", "short back"],
)
def test_the_rule_and_the_value_are_told(theta, told):
    drive = Drive(2, listed=replace(_LISTED, approach_sign=np.full(2, -1.0)))
    good = [(0.4, 3.0), _REST, (1.0, 0.05), (1.0, -0.05)]
    joints = [good, good, [], theta]
    duration, velocity = np.array([each for joint in joints for each in joint]).T
    offsets = np.cumsum([0, *map(len, joints)])
    both = SegmentMotion(np.zeros((2, 2)), offsets, duration, velocity)
    broken = rules_broken(drive, both)
    assert broken.told(drive, [0, 0], np.array([7, 9])) == [f"robot 9: phi {told}"]
    assert broken.robot.tolist() == [1] and broken.joint.tolist() == [1]
    if broken.rule[0] == MotorRule.APPROACH:  # the whole approach, its way, is allowed
        whole = np.copysign(drive.listed.approach_rad[1], broken.value)
        assert broken.least <= whole <= broken.most
        assert not broken.least <= broken.value <= broken.most
    assert len(rules_broken(Drive(2), both)) == 0


@pytest.mark.parametrize(
    "theta",
    [
        [],
        [(0.4, 3.0), _REST, (1.0, 0.05), (1.0, -0.05)],
        [_REST, (0.2, 3.0), (0.2, 3.0), _REST, (0.7, 0.05), (0.4, 0.05), (0.5, -0.05), (1, -0.05)],
        [(1.1, 0.05), (0.3, 0.0), (1.0, -0.05)],
    ],
)  # fmt: skip
def test_moves_may_wait_and_may_last_longer_than_a_segment(theta):
    assert rules_broken(_DRIVE, motion_of(theta)).robots(1).tolist() == [False]


def test_a_joint_turns_as_far_as_its_gear_lets_it():
    scale = np.array([[[0.5, 0.75], [1.0, 1.0]]])
    drive = Drive(1, listed=_LISTED, scale=scale)
    good = motion_of([(0.4, 2.25), _REST, (2.0, 0.0375), (2.0, -0.025)])
    assert len(rules_broken(drive, good)) == 0
    assert (
        rules_broken(drive, motion_of([(0.4, 2.25), _REST, (2.0, 0.0375), (2.0, -0.0375)]))
        .robots(1)
        .any()
    )
    assert (
        rules_broken(drive, motion_of([(0.4, -2.25), _REST, (2.0, 0.0375), (2.0, -0.025)]))
        .robots(1)
        .any()
    )


def test_motors_without_a_list_have_no_rules():
    assert len(rules_broken(Drive(1), motion_of([(0.4, 2.5)]))) == 0


def test_robots_that_are_one_too_many_for_their_supply_are_found():
    late = motion_of([(0.3, 0.0), (0.4, 1.0)])
    early = motion_of([(0.4, 1.0)], [(0.4, 1.0)], n=3)
    both = SegmentMotion(
        np.zeros((4, 2)),
        np.concatenate([early.offsets, early.offsets[-1] + late.offsets[1:]]),
        np.concatenate([early.duration_s, late.duration_s]),
        np.concatenate([early.velocity_rad_s, late.velocity_rad_s]),
    )
    groups = [7, 7, 3, 7]  # supply 7 has six motors, four of them on, then five
    assert motors_allowed(groups, 0.7).tolist() == [4, 4, 1, 4]
    assert overloading(both, groups, 0.7).tolist() == [False, False, True, True]
    assert not overloading(both, groups, 1.0).any()
    kept = both.without(overloading(both, groups, 0.7))
    assert (most_motors_on(kept, groups) <= 0.7).all()


def test_motors_that_turn_at_once_are_counted_in_bins_of_time():
    late = motion_of([(0.3, 0.0), (0.4, 1.0)], [(0.5, 0.0), (0.01, 1.0)])
    assert motors_turning(late, [7], [0.0, 0.1, 0.32, 0.4, 0.6, 2.0]).tolist() == [[0, 1, 1, 2, 1]]
    rng = np.random.default_rng(1)
    lengths = rng.uniform(0.01, 0.3, (24, 3))
    speeds = rng.choice([0.0, 0.0, 2.0, -1.0], lengths.shape)
    motion = SegmentMotion(np.zeros((12, 2)), np.arange(25) * 3, lengths.ravel(), speeds.ravel())
    groups, edges_s = np.arange(12) % 3, np.linspace(0.0, 0.8, 41)
    found = motors_turning(motion, groups, edges_s)
    times = np.arange(0.0005, 0.8, 0.001)
    turns = np.array([(motion.velocity(t) != 0).sum(axis=1) for t in times])
    for group in range(3):
        on = turns[:, groups == group].sum(axis=1).reshape(40, 20).max(axis=1)
        assert (found[group] >= on).all() and (found[group] == on).mean() > 0.9
    most = most_motors_on(motion, groups)
    assert (found.max(axis=1) / 8).tolist() == most.tolist()


def test_the_certificate_refuses_orders_that_motors_or_supplies_do_not_allow():
    plane = preset("desi", 2)
    listed = replace(plane, drive=Drive(2, listed=_LISTED, supply=[0, 0], motors_on=0.25))
    good = [(0.4, 3.0), _REST, (1.0, 0.05), (1.0, -0.05)]
    bad = motion_of([(0.4, 2.5)], n=2)
    assert certify(listed, bad, Safety()).limits_broken.tolist() == [True, True]
    both = motion_of(good, n=2)
    certificate = certify(listed, both, Safety())
    assert certificate.limits_broken.tolist() == [False, True]  # one of four motors may be on
    assert not certificate.ok
    rest, held, certificate = hold_until_safe(listed, both, Safety())
    assert held.tolist() == [False, True]
    assert certificate.ok and rest.moves.tolist() == [True, False]
    free = replace(plane, drive=Drive(2, listed=_LISTED))
    assert certify(free, both, Safety()).ok


def test_no_move_is_shorter_than_the_least_time():
    scale = np.array([[[0.5, 0.8], [1.0, 1.0]]])
    for returns in (True, False):
        listed = replace(_LISTED, returns=returns)
        drive = Drive(1, listed=listed, scale=scale)
        for theta in (
            [(0.4, 2.4), _REST, (0.05 / 0.04, 0.04), (0.05 / 0.025, -0.025)],
            [(0.4, -1.5), _REST, (0.06 / 0.04, 0.04), (0.05 / 0.025, -0.025)],
            [(0.1 / 3, 2.4), _REST, (0.05 / 0.04, 0.04), (0.2 / 0.025, -0.025)],
            [(0.2 / 0.04, 0.04), (0.05 / 0.025, -0.025)],
        ):
            motion = motion_of(theta)
            assert len(rules_broken(drive, motion)) == 0
            turn = motion.end - motion.start
            least = least_time_s(drive, np.full((1, 2), 3.0), turn[:, None])[0, 0]
            assert least[1] == 0.0  # phi rests
            on = (motion.duration_s[np.abs(motion.velocity_rad_s) > 0]).sum()
            on += 0.03 * (np.abs(motion.velocity_rad_s) > 1.0).sum()
            assert least[0] <= on * (1 + 1e-9)
    # one move and the approach are the least time, to the digit
    turn = np.array([[[1.2, 0.0]]])
    expected = 1.2 / 2.4 + 0.03 + 0.05 / 0.04 + 0.05 / 0.025
    drive = Drive(1, listed=_LISTED, scale=scale)
    assert least_time_s(drive, np.ones((1, 2)), turn)[0, 0, 0] == pytest.approx(expected)


@pytest.mark.parametrize("returns", [False, True])
def test_no_order_at_any_of_three_speeds_is_shorter_than_the_least_time(returns):
    listed = ListedSpeeds(
        np.array([3.0, 0.7, 0.05]), np.array([0.2, 0.03, 0.0]), np.array([0.4, 0.1, 0.0]),
        approach_rad=(0.05, 0.05), approach_speed=2, returns=returns,
    )  # fmt: skip
    drive = Drive(1, listed=listed, scale=[[[0.8, 1.2], [1.0, 1.0]]])
    rng, nearest = np.random.default_rng(4), np.inf
    for _ in range(3000):
        theta = []
        for _ in range(rng.integers(0, 4)):
            speed, way = rng.integers(3), rng.integers(2)
            gear, least = drive.scale[0, 0, way], listed.least_rad[speed]
            turn = gear * (least + rng.choice([0.0, rng.exponential(0.2)]) + 1e-6)
            velocity = (2 * way - 1) * listed.speeds_rad_s[speed] * gear
            theta += [(turn / abs(velocity), velocity), (0.2, 0.0)]
        if returns:
            theta += [(rng.uniform(0.05, 0.2) / 0.06, 0.06)]
        theta += [(rng.uniform(0.05, 0.2) / 0.04, -0.04)]
        motion = motion_of(theta)
        assert len(rules_broken(drive, motion)) == 0
        curve = carried_out(drive, motion)
        turns = np.abs(curve.velocity_rad_s) + np.abs(curve.acceleration_rad_s2) > 1e-9
        least_s = least_time_s(drive, np.full((1, 2), 3.0), motion.end[:, None])[0, 0, 0]
        on_s = curve.duration_s[turns].sum()
        assert on_s >= least_s * (1 - 1e-9)
        nearest = min(nearest, on_s / max(least_s, 1e-9))
    assert nearest < 1.1  # the bound is near to what is possible


def test_two_moves_may_be_quicker_than_one_in_creep():
    # 0.02 rad in creep would take 0.4 s; ahead and back at 3 rad/s, no less than 0.1 rad
    least_s = least_time_s(_DRIVE, np.ones((1, 2)), np.array([[[0.02, 0.0]]]))[0, 0, 0]
    expected_s = 0.22 / 3.0 + 2 * 0.03 + 2 * 0.05 / 0.05
    assert least_s == pytest.approx(expected_s)
    order = [(0.12 / 3.0, 3.0), _REST, (0.1 / 3.0, -3.0), _REST, (1.0, 0.05), (1.0, -0.05)]
    assert len(rules_broken(_DRIVE, motion_of(order))) == 0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"speeds_rad_s": np.array([0.05, 3.0])}, "speeds must fall"),
        ({"speeds_rad_s": np.array([3.0, -1.0])}, "speeds_rad_s must be"),
        ({"ramp_s": np.array([0.03])}, "ramp_s has shape"),
        ({"least_rad": np.array([-0.1, 0.0])}, "least_rad must be 0 to"),
        ({"approach_sign": (0.0, 1.0)}, "approach_sign must be -1 or 1"),
        ({"approach_speed": 2}, "approach_speed"),
    ],
)
def test_lists_that_no_motor_has_are_refused(values, words):
    with pytest.raises(LayoutError, match=words):
        replace(_LISTED, **values)
    with pytest.raises(LayoutError, match="12 numbers do not describe a list of 2 speeds"):
        ListedSpeeds.of_numbers(_LISTED.numbers[:12])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"motors_on": 0.0}, "share of motors that may be on"),
        ({"scale": [[[1.0, 1.0], [0.0, 1.0]]]}, "robot row 0: scale must be 0.01 to 100"),
        ({"lost_motion_rad": -0.1}, "robot row 0: lost_motion_rad must be 0"),
        ({"supply": [1, 2]}, "supply has shape"),
        ({"listed": _LISTED, "ramp_s": 0.1}, "listed speeds have ramps of their own"),
    ],
)
def test_drives_that_no_robot_has_are_refused(values, words):
    with pytest.raises(LayoutError, match=words):
        Drive(1, **values)


def test_a_drive_with_a_list_is_saved_with_the_problem(tmp_path):
    plane = with_drive(preset("desi_petals", 30), "desi", motors_on=0.55)
    problem = Problem(plane, plane.limits.mean(axis=2), np.full((30, 2), np.nan))
    save_problem(tmp_path / "problem.npz", problem)
    assert load_problem(tmp_path / "problem.npz").plane.drive == plane.drive
    assert plane.drive.of_robots([3, 4]).scale.tolist() == plane.drive.scale[3:5].tolist()


def test_what_is_known_of_gears_stays_with_another_drive():
    plane = preset("desi_petals", 400)
    assert not plane.drive.is_plain and plane.drive.is_ideal
    scale = with_drive(plane, "desi").drive.scale
    assert (scale == plane.drive.scale).all() and scale.min() < 0.9
    assert with_drive(plane, "desi").drive.motors_on == 1.0


def test_another_drive_takes_the_place_of_the_one_before():
    plane = preset("desi", 300)
    for name in ("sdss_v", "desi", "accelerated"):
        back = with_drive(with_drive(plane, name, 0.5), "ideal", 1.0)
        assert back.drive == plane.drive
    assert not with_drive(with_drive(plane, "sdss_v"), "desi").drive.uncertainty_rad.any()
    # what is known of the robots themselves stays
    own = Drive(300, uncertainty_rad=np.deg2rad([2.0, 0.0]), supply=np.arange(300) % 3)
    known = with_drive(with_drive(replace(plane, drive=own), "sdss_v"), "desi").drive
    np.testing.assert_allclose(known.uncertainty_rad[0], np.deg2rad([2.0, 0.0]))
    assert (known.supply == np.arange(300) % 3).all()


def test_lost_motion_grows_the_outlines_as_uncertainty_does():
    plane = preset("desi_outlines", 3)
    lost = replace(plane, drive=Drive(3, lost_motion_rad=0.02, uncertainty_rad=0.01))
    uncertain = replace(plane, drive=Drive(3, uncertainty_rad=0.03))
    np.testing.assert_allclose(lost.growth_mm, uncertain.growth_mm)

# SPDX-License-Identifier: Apache-2.0
"""From trajectories to orders: certified, on their goals, or at rest with a reason."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.clearance import Safety, certify, gaps, neighbour_pairs, sampled_gaps
from fiber_core.errors import MotionError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireUnits
from fiber_discretizer import DiscretizeOptions, discretize, joint_shares
from fiber_discretizer.makarem2014 import seven_steps

UNITS = WireUnits()
SAFETY = Safety()
END_RAD = 1e-6 / 6e-3  # 1 um at a 6 mm arm
PAPER = DiscretizeOptions(sharing="makarem2014", method="douglas_peucker")
both_sharings = pytest.mark.parametrize(
    "options", [DiscretizeOptions(), PAPER], ids=["sequential", "makarem2014"]
)


def eased(start, goal, seconds=2.0, samples=101):
    """All joints from start to goal [rad], (n, 2), slow at both ends."""
    start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    part = np.linspace(0.0, 1.0, samples)
    part = part * part * (3 - 2 * part)
    angles = start[:, :, None] + (goal - start)[:, :, None] * part
    return SampledMotion(np.linspace(0.0, seconds, samples), angles)


def hexagon(rings, pitch=10.4):
    rows = np.arange(-rings, rings + 1)
    sites = [(a + b / 2, np.sqrt(0.75) * b) for a in rows for b in rows if abs(a + b) <= rings]
    return pitch * np.array(sites)


def clear_configuration(plane, rng):
    """Random joint angles [rad], (n, 2), all outlines 0.3 mm apart."""
    pairs, angles = neighbour_pairs(plane), np.zeros((plane.n, 2))
    remaining = np.arange(plane.n)
    while len(remaining):
        angles[remaining] = rng.uniform([-3.0, 0.5], [3.0, 3.1], (len(remaining), 2))
        remaining = np.unique(pairs[gaps(plane, pairs, angles) < 0.3, 0])
    return angles


@pytest.fixture(scope="module")
def dense_field(plane_at):
    """37 neighbours on random smooth moves, some of which meet."""
    plane = plane_at(hexagon(3))
    rng = np.random.default_rng(7)
    start, goal = clear_configuration(plane, rng), clear_configuration(plane, rng)
    return plane, eased(start, goal, seconds=4.0)


def check(plane, trajectory, result, safety=SAFETY):
    """Check what holds for every certified discretization."""
    motion = result.wire.decoded()
    goes = (result.reason == Reason.OK) & np.any(trajectory.start != trajectory.end, axis=1)
    assert result.certificate.ok
    assert certify(plane, motion, safety).ok
    np.testing.assert_allclose(motion.end[goes], trajectory.end[goes], rtol=0, atol=END_RAD)
    np.testing.assert_array_equal(motion.counts[~goes], 0)
    assert motion.counts.max() <= 15


def test_robots_far_apart_get_one_segment_a_joint(plane_at):
    plane = plane_at(hexagon(1, pitch=60.0))
    start = np.tile([-2.0, 0.3], (7, 1))
    trajectory = eased(start, start + [3.0, 2.0])
    result = discretize(plane, trajectory, UNITS, SAFETY)
    check(plane, trajectory, result)
    np.testing.assert_array_equal(result.reason, Reason.OK)
    np.testing.assert_array_equal(result.wire.decoded().counts, 1)
    assert result.wire.decoded().makespan_s <= 2.0 + 1e-9
    assert result.rounds == 0


@pytest.mark.parametrize("first_joint", [0, 1])
@both_sharings
def test_on_a_dense_plane_every_robot_goes_or_rests_with_a_reason(
    dense_field, options, first_joint
):
    plane, trajectory = dense_field
    options = replace(options, first_joint=first_joint)
    result = discretize(plane, trajectory, UNITS, SAFETY, options=options)
    check(plane, trajectory, result)
    going = result.reason == Reason.OK
    assert 0.5 * plane.n < going.sum()
    assert set(result.reason[~going]) <= {Reason.UNSAFE}
    if options.sharing == "makarem2014":  # a robot had to bend around a neighbour
        assert result.wire.decoded().counts[going].max() > 1


def test_sequential_moves_robots_that_makarem2014_has_to_hold(dense_field):
    plane, trajectory = dense_field
    sequential, by_halves = (
        discretize(plane, trajectory, UNITS, SAFETY, options=options) for options in (None, PAPER)
    )
    assert (by_halves.reason == Reason.OK).sum() < (sequential.reason == Reason.OK).sum()
    # their trajectories meet, so not even the profile itself could be sent
    pairs = neighbour_pairs(plane)
    gap = sampled_gaps(plane, pairs, trajectory.angles).min(axis=1)
    meet = np.unique(pairs[gap < 0.0])
    assert np.any(sequential.reason[meet] == Reason.OK)


def test_the_second_joint_has_its_share_beside_the_new_profile_of_the_first(plane_at, monkeypatch):
    plane = plane_at([[0.0, 0.0], [30.0, 0.0]])
    trajectory = eased([[0.0, 0.5], [0.0, 0.5]], [[1.0, 2.5], [1.0, 2.5]])
    seen = []

    def spy(plane, joint, pairs, free, phi, robots, cap):
        seen.append((joint, phi.copy()))
        return joint_shares(plane, joint, pairs, free, phi, robots, cap)

    monkeypatch.setattr(seven_steps, "joint_shares", spy)
    discretize(plane, trajectory, UNITS, SAFETY, options=replace(PAPER, first_joint=1))
    (first, planned), (second, new) = seen
    assert (first, second) == (1, 0)
    np.testing.assert_array_equal(planned, trajectory.angles[:, 1])
    np.testing.assert_allclose(new, [np.linspace(0.5, 2.5, 101)] * 2, atol=1e-9)


@both_sharings
def test_same_input_same_numbers(dense_field, options):
    plane, trajectory = dense_field
    one, two = (discretize(plane, trajectory, UNITS, SAFETY, options=options) for _ in range(2))
    for name in ("start", "offsets", "ticks", "velocity"):
        np.testing.assert_array_equal(getattr(one.wire, name), getattr(two.wire, name))
    np.testing.assert_array_equal(one.reason, two.reason)


@both_sharings
def test_of_two_robots_on_crossing_paths_one_is_held_at_most(plane_at, options):
    plane = plane_at([[0.0, 0.0], [10.0, 0.0]])
    start, goal = [[-0.9, 0.0], [np.pi - 0.9, 0.0]], [[0.9, 0.0], [np.pi + 0.1, 0.0]]
    trajectory = eased(start, goal)
    result = discretize(plane, trajectory, UNITS, SAFETY, options=options)
    check(plane, trajectory, result)
    assert set(result.reason) <= {Reason.OK, Reason.UNSAFE}
    assert np.any(result.wire.decoded().counts)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_of_two_robots_the_one_that_rests_out_of_the_way_is_held(plane_at, order):
    # Robot 1 starts in the path of robot 0, robot 0 starts clear of that of robot 1.
    plane = plane_at([[0.0, 0.0], [10.0, 0.0]]).permuted(order)
    start = np.array([[-1.2, 0.0], [np.pi, 0.0]])[order]
    goal = np.array([[0.9, 0.0], [np.pi + 1.2, 0.0]])[order]
    trajectory = eased(start, goal)
    result = discretize(plane, trajectory, UNITS, SAFETY, options=PAPER)
    check(plane, trajectory, result)
    np.testing.assert_array_equal(result.reason[order], [Reason.UNSAFE, Reason.OK])


@pytest.fixture
def past_a_post(plane_at):
    """A robot that folds to pass a fixed disc, and units fast enough for that."""
    part = np.linspace(0.0, 1.0, 101)
    angles = np.stack([[-1.5 + 3.0 * part, np.pi * np.sin(np.pi * part)]])
    plane = plane_at([[0.0, 0.0]], obstacles=[[6.0, 0.0, 0.8]], speeds=[[4.0, 4.0]])
    return plane, SampledMotion(2.5 * part, angles), WireUnits.for_plane(plane)


@both_sharings
def test_robots_keep_clear_of_an_obstacle(past_a_post, options):
    plane, trajectory, units = past_a_post
    nothing_there = replace(plane, obstacles=np.zeros((0, 3)))
    alone = discretize(nothing_there, trajectory, units, SAFETY, options=options)
    np.testing.assert_array_equal(alone.wire.decoded().counts, [[1, 0]])
    result = discretize(plane, trajectory, units, SAFETY, options=options)
    check(plane, trajectory, result)
    assert result.reason[0] == Reason.OK
    assert result.wire.decoded().counts[0, 1] >= 2


def test_a_motion_that_fails_its_certificate_is_tried_again_with_a_smaller_share(past_a_post):
    plane, trajectory, _ = past_a_post  # its units carry the profile at once, these do not
    at_once, patient = (
        discretize(
            plane, trajectory, UNITS, SAFETY, options=replace(PAPER, rule="printed", rounds=r)
        )
        for r in (0, 4)
    )
    check(plane, trajectory, at_once)
    check(plane, trajectory, patient)
    assert at_once.reason[0] == Reason.UNSAFE and at_once.rounds == 0
    assert patient.reason[0] == Reason.OK and 0 < patient.rounds < 4


def test_units_slower_than_the_joints_are_no_reason_to_hold(past_a_post):
    # The velocity field carries 3.2 rad/s, the joints turn at 4: lines respect both.
    plane, trajectory, _ = past_a_post
    slower = SampledMotion(1.5 * trajectory.time_s, trajectory.angles)
    result = discretize(plane, slower, UNITS, SAFETY)
    check(plane, slower, result)
    assert result.reason[0] == Reason.OK


BAD = {
    "jump": lambda a: a[:, 0, 50:].__iadd__(1.0),
    "too fast": lambda a: a[:, 1].__imul__(4.0),
    "outside its limits": lambda a: a[:, 1].__isub__(np.linspace(0.0, 1.2, 101)),
    "starts elsewhere": lambda a: a.__iadd__(0.01),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_profile_is_refused_and_the_others_go(plane_at, fault):
    plane = plane_at(hexagon(1, pitch=30.0))
    start = np.tile([-0.5, 0.3], (7, 1))
    good = eased(start, start + [1.0, 0.8])
    angles = good.angles.copy()
    BAD[fault](angles[3:4])
    trajectory = SampledMotion(good.time_s, angles)
    counts = UNITS.to_counts(start)
    result = discretize(plane, trajectory, UNITS, SAFETY, start_counts=counts)
    expected = np.where(np.arange(7) == 3, Reason.BAD_TRAJECTORY, Reason.OK)
    np.testing.assert_array_equal(result.reason, expected)
    check(plane, trajectory, result)
    np.testing.assert_array_equal(result.wire.start, counts)


@both_sharings
@pytest.mark.parametrize("points", ["two", "uneven", "late", "fast", "one"])
def test_trajectories_of_any_planner_are_taken_as_they_are(plane_at, options, points):
    plane = plane_at(hexagon(1, pitch=12.0))
    start = np.tile([-0.5, 2.0], (7, 1))
    goal = start + [1.0, 0.8]
    time_s = {
        "two": [0.0, 2.0],
        "uneven": [0.0, 0.001, 0.4, 0.41, 1.9, 2.0],
        "late": [0.7, 1.0, 2.7],
        "fast": np.linspace(0.0, 2.0, 2001),
        "one": [0.0],
    }[points]
    part = np.clip((np.array(time_s) - time_s[0]) / 2.0, 0.0, 1.0)
    angles = start[:, :, None] + (goal - start)[:, :, None] * part
    trajectory = SampledMotion(time_s, angles)
    result = discretize(plane, trajectory, UNITS, SAFETY, options=options)
    check(plane, trajectory, result)
    np.testing.assert_array_equal(result.reason, Reason.OK)
    assert result.wire.decoded().makespan_s <= trajectory.time_s[-1] + 0.1


@both_sharings
def test_velocities_beside_the_angles_are_held_against_the_limits(plane_at, options):
    plane = plane_at(hexagon(1, pitch=30.0))
    start = np.tile([-0.5, 0.3], (7, 1))
    trajectory = eased(start, start + [1.0, 0.8])
    velocities = np.gradient(trajectory.angles, trajectory.time_s, axis=2)
    counts = UNITS.to_counts(start)

    def reasons(speeds):
        given = discretize(plane, trajectory, UNITS, SAFETY, counts, options, velocities=speeds)
        assert given.certificate.ok
        return given.reason

    np.testing.assert_array_equal(reasons(velocities), Reason.OK)
    velocities[2, 1, 50] = -4.0
    velocities[5, 0, 7] = np.nan
    expected = np.full(7, int(Reason.OK))
    expected[[2, 5]] = Reason.BAD_TRAJECTORY
    np.testing.assert_array_equal(reasons(velocities), expected)
    with pytest.raises(MotionError, match="velocities"):
        reasons(velocities[:, :, :-1])


def test_disabled_robots_stay_and_are_kept_clear_of(plane_at):
    plane = plane_at([[0.0, 0.0], [10.0, 0.0]], enabled=[True, False])
    start, goal = [[-0.9, 0.0], [np.pi, 0.0]], [[0.9, 0.0], [np.pi + 1.0, 0.0]]
    result = discretize(plane, eased(start, goal), UNITS, SAFETY)
    np.testing.assert_array_equal(result.reason, [Reason.UNSAFE, Reason.DISABLED])
    assert result.certificate.ok and not result.wire.decoded().counts.any()


def test_a_motor_slower_than_one_velocity_unit_is_refused(plane_at):
    plane = plane_at([[0.0, 0.0]], speeds=[[np.pi, 1e-4]])
    trajectory = eased([[0.0, 1.0]], [[1.0, 1.00005]])
    assert discretize(plane, trajectory, UNITS, SAFETY).reason[0] == Reason.BAD_TRAJECTORY


def test_robots_that_need_more_segments_than_an_order_has_are_held(past_a_post):
    plane, trajectory, units = past_a_post
    goes = discretize(plane, trajectory, units, SAFETY)
    assert goes.reason[0] == Reason.OK
    most = int(goes.wire.decoded().counts.max())
    for options in (DiscretizeOptions(), PAPER):
        few = replace(options, max_segments=most - 1)
        result = discretize(plane, trajectory, units, SAFETY, options=few)
        assert result.reason[0] == Reason.TOO_MANY_SEGMENTS
        assert result.certificate.ok and not result.wire.decoded().counts.any()


def _touching(plane_at):
    plane = plane_at([[0.0, 0.0], [10.0, 0.0], [50.0, 0.0]])
    return plane, np.array([[0.0, 0.0], [np.pi, 0.0], [0.0, 0.0]])


def test_of_two_robots_that_touch_already_one_leaves(plane_at):
    plane, start = _touching(plane_at)
    trajectory = eased(start, start + [1.0, 0.0])
    result = discretize(plane, trajectory, UNITS, SAFETY)
    assert result.certificate.ok
    assert sorted(result.reason[:2]) == [Reason.OK, Reason.UNSAFE]
    assert result.reason[2] == Reason.OK
    at_start = gaps(plane, [[0, 1]], start)[0]
    motion = result.wire.decoded()
    later = [gaps(plane, [[0, 1]], motion(t))[0] for t in np.linspace(0.0, 3.0, 200)]
    assert min(later) > at_start - 2e-3 and later[-1] > 0.1


def test_robots_that_touch_and_rest_are_named_and_the_others_go(plane_at):
    plane, start = _touching(plane_at)
    trajectory = eased(start, start + [[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    result = discretize(plane, trajectory, UNITS, SAFETY)
    assert not result.certificate.ok
    np.testing.assert_array_equal(result.certificate.unsafe_robots, [True, True, False])
    np.testing.assert_array_equal(result.wire.decoded().counts[:2], 0)
    assert result.reason[2] == Reason.OK and result.wire.decoded().counts[2, 0] > 0


def test_motion_begins_where_the_robots_are(plane_at):
    plane = plane_at([[0.0, 0.0]])
    trajectory = eased([[0.0, 1.0]], [[1.0, 2.0]])
    counts = UNITS.to_counts(trajectory.start) + [[300, -300]]  # 0.5 mrad
    result = discretize(plane, trajectory, UNITS, SAFETY, start_counts=counts)
    check(plane, trajectory, result)
    np.testing.assert_array_equal(result.wire.start, counts)


def test_start_at_a_limit_is_not_rounded_across_it(plane_at):
    limit = UNITS.to_angles(1_000_000) - 0.1 * UNITS.quantum_rad
    plane = plane_at([[0.0, 0.0]], limits=[[[-3.0, 3.0], [0.0, limit]]])
    trajectory = eased([[0.0, limit]], [[1.0, 0.5]])
    result = discretize(plane, trajectory, UNITS, SAFETY)
    check(plane, trajectory, result)
    assert result.reason[0] == Reason.OK and result.wire.start[0, 1] == 999_999


@both_sharings
def test_a_move_longer_than_the_longest_segment(plane_at, options):
    slow = plane_at([[0.0, 0.0]], speeds=[[0.25, 0.25]])
    trajectory = eased([[-2.0, 0.3]], [[2.0, 0.3]], seconds=30.0)
    result = discretize(slow, trajectory, UNITS, SAFETY, options=options)
    check(slow, trajectory, result)
    least = int(np.ceil(4.0 / 0.25 / (UNITS.max_ticks * UNITS.tick_s)))
    assert least <= result.wire.decoded().counts[0, 0] <= int(np.ceil(30.0 / 4.092))


def test_a_line_too_long_for_its_field_is_made_faster_instead_of_cut(plane_at):
    plane = plane_at([[0.0, 0.0]])
    trajectory = eased([[-3.0, 0.3]], [[3.0, 0.3]], seconds=30.0)
    result = discretize(plane, trajectory, UNITS, SAFETY)
    check(plane, trajectory, result)
    np.testing.assert_array_equal(result.wire.decoded().counts, [[1, 0]])


def test_nothing_to_move(plane_at):
    plane = plane_at(hexagon(1))
    rest = SampledMotion([0.0], np.tile([[[0.0], [np.pi]]], (7, 1, 1)))
    result = discretize(plane, rest, UNITS, SAFETY)
    assert result.certificate.ok and not result.reason.any()
    assert not result.wire.decoded().counts.any()


def test_a_trajectory_that_does_not_fit_raises(plane_at):
    plane = plane_at(hexagon(1))
    with pytest.raises(MotionError, match="2 robots for a plane of 7"):
        discretize(plane, eased(np.zeros((2, 2)), np.ones((2, 2))), UNITS, SAFETY)
    early = SampledMotion([-1.0, 1.0], np.zeros((7, 2, 2)))
    with pytest.raises(MotionError, match="-1.0 s, before time zero"):
        discretize(plane, early, UNITS, SAFETY)


def test_progress_rises_to_one(dense_field):
    plane, trajectory = dense_field
    reported = []
    discretize(plane, trajectory, UNITS, SAFETY, progress=lambda part, _: reported.append(part))
    assert reported == sorted(reported) and reported[0] == 0.0 and reported[-1] == 1.0

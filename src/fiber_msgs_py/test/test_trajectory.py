# SPDX-License-Identifier: Apache-2.0
"""Trajectory: a sampled motion comes back unchanged, or is refused by robot and value."""

import array

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fiber_core.motion import SampledMotion
from fiber_msgs_py import MessageError, PlanStamp, trajectory


@st.composite
def motions(draw):
    ids = sorted(draw(st.sets(st.integers(0, 2**32 - 1), min_size=1, max_size=6)))
    steps = draw(st.lists(st.integers(1, 10**9), max_size=6))
    time_s = (draw(st.integers(0, 10**9)) + np.cumsum([0, *steps])) / 1e9
    angles = draw(arrays(float, (len(ids), 2, len(time_s)), elements=st.floats(-10, 10)))
    return ids, SampledMotion(time_s, angles)


def example(stamp, n=3, t=4):
    rng = np.random.default_rng(1)
    motion = SampledMotion(0.01 * np.arange(t), rng.normal(size=(n, 2, t)))
    return motion, trajectory.encode(np.arange(n) * 40 + 2, motion, stamp)


@given(motions())
def test_round_trip(example):
    ids, motion = example
    got_ids, got, velocities = trajectory.decode(trajectory.encode(ids, motion, PlanStamp(1)))
    assert got_ids.tolist() == ids
    np.testing.assert_array_equal(got.angles, motion.angles)
    np.testing.assert_allclose(got.time_s, motion.time_s, rtol=0, atol=1e-9)
    assert velocities.shape == motion.angles.shape


def test_the_velocity_of_a_point_is_the_velocity_after_it(stamp):
    motion, message = example(stamp)
    *_, velocities = trajectory.decode(message)
    for k, t in enumerate(motion.time_s):
        np.testing.assert_allclose(velocities[:, :, k], motion.velocity(t), rtol=1e-9)
    assert not velocities[:, :, -1].any()


@given(st.permutations(range(6)))
def test_joints_may_come_in_any_order(order):
    motion, message = example(PlanStamp(1))
    message.joint_names = [message.joint_names[i] for i in order]
    for point in message.points:
        point.positions = array.array("d", [point.positions[i] for i in order])
        point.velocities = array.array("d")
    ids, got, velocities = trajectory.decode(message)
    assert ids.tolist() == [2, 42, 82]
    np.testing.assert_array_equal(got.angles, motion.angles)
    assert velocities is None


def test_names_are_those_of_the_contract(stamp):
    _, message = example(stamp, n=2)
    assert message.joint_names == ["p0002/theta", "p0002/phi", "p0042/theta", "p0042/phi"]


@pytest.mark.parametrize(
    "name",
    ["p42/theta", "p0042/Theta", "p0042/psi", "p0042", "q0042/theta", "", "p00042/theta",
     "p0042/theta ", "p\u0664\u0664\u0664\u0664/theta", "p-042/theta"],
)  # fmt: skip
def test_malformed_joint_names_are_refused(stamp, name):
    _, message = example(stamp)
    message.joint_names[2] = name
    with pytest.raises(MessageError) as caught:
        trajectory.decode(message)
    assert caught.value.value == repr(name)


def test_a_joint_without_the_other_or_given_twice_is_refused(stamp):
    _, message = example(stamp)
    message.joint_names[3] = "p0099/phi"
    with pytest.raises(MessageError, match="robot 42: joint p0042/theta has no matching phi joint"):
        trajectory.decode(message)
    message.joint_names[3] = "p0042/theta"
    with pytest.raises(MessageError, match="robot 42: joint p0042/theta appears twice"):
        trajectory.decode(message)
    message.joint_names[2:4] = ["p9999999999/theta", "p9999999999/phi"]
    with pytest.raises(MessageError, match="robot 9999999999: id 9999999999 is outside"):
        trajectory.decode(message)


@pytest.mark.parametrize("field", ["positions", "velocities"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_refused(stamp, field, value):
    _, message = example(stamp)
    getattr(message.points[2], field)[3] = value
    with pytest.raises(
        MessageError, match=f"robot 42: {field} of phi at point 2 {value} is not finite"
    ):
        trajectory.decode(message)


@pytest.mark.parametrize("field", ["positions", "velocities"])
@pytest.mark.parametrize("length", [0, 5, 7])
def test_a_point_of_the_wrong_length_is_refused(stamp, field, length):
    _, message = example(stamp)
    setattr(message.points[1], field, array.array("d", [0.0] * length))
    with pytest.raises(MessageError, match=f"{field} of point 1 has {length} values for 6 joints"):
        trajectory.decode(message)


def test_times_that_do_not_increase_are_refused(stamp):
    _, message = example(stamp)
    message.points[2].time_from_start = message.points[1].time_from_start
    with pytest.raises(MessageError, match="time 0.01 s does not follow 0.01 s"):
        trajectory.decode(message)
    message.points[0].time_from_start.sec = -1
    with pytest.raises(MessageError, match="time -1.0 s is negative"):
        trajectory.decode(message)
    message.points = []
    with pytest.raises(MessageError, match="has 0 points"):
        trajectory.decode(message)


def test_times_finer_than_a_nanosecond_are_not_sent(stamp):
    with pytest.raises(MessageError, match="does not follow"):
        trajectory.encode([1], SampledMotion([0.0, 1e-10], np.zeros((1, 2, 2))), stamp)


def test_ids_and_robots_must_agree(stamp):
    with pytest.raises(MessageError, match="1 robots, but 2 ids"):
        trajectory.encode([1, 2], SampledMotion([0.0], np.zeros((1, 2, 1))), stamp)


def test_foreign_frame_is_refused(stamp):
    _, message = example(stamp)
    message.header.frame_id = "base_link"
    with pytest.raises(MessageError, match="base_link"):
        trajectory.decode(message)


def test_a_plan_without_robots_is_a_plan(stamp):
    message = trajectory.encode([], SampledMotion([0.0], np.zeros((0, 2, 1))), stamp)
    ids, motion, _ = trajectory.decode(message)
    assert ids.shape == (0,) and motion.n == 0

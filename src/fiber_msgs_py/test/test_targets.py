# SPDX-License-Identifier: Apache-2.0
"""Targets: they come back unchanged, or are refused by robot and value."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import PointField

from fiber_core.errors import LayoutError
from fiber_msgs_py import Attempt, MessageError, PlanStamp, targets

IDS = st.lists(st.integers(0, 2**32 - 1), unique=True, max_size=20)
LENGTH = st.floats(-1e4, 1e4)


@given(IDS.flatmap(lambda ids: st.tuples(st.just(ids), st.lists(
    st.tuples(LENGTH, LENGTH), min_size=len(ids), max_size=len(ids)))))  # fmt: skip
def test_round_trip_keeps_the_order(example):
    ids, xy_mm = example
    xy_mm = np.array(xy_mm).reshape(-1, 2)
    stamp = PlanStamp(5)
    message = targets.encode(ids, xy_mm, stamp)
    got_ids, got_mm = targets.decode(message)
    assert got_ids.tolist() == ids
    np.testing.assert_allclose(got_mm, xy_mm, rtol=1e-12, atol=1e-300)


@given(st.integers(0, 2**31 * 10**9 - 1), st.integers(0, 2**30), st.integers(1, 2**30))
def test_targets_of_a_later_attempt_name_plan_attempt_and_since(since_ns, plan_ns, later):
    first = Attempt.first(PlanStamp(plan_ns))
    for number, since in ((2, since_ns), (3, None)):
        attempt = Attempt(PlanStamp(plan_ns + later), first.plan, number, since)
        message = targets.encode_attempt([4, 7], np.ones((2, 2)), attempt)
        assert targets.decode_attempt(message) == attempt
        assert PlanStamp.of(message) == attempt.stamp
        ids, xy_mm = targets.decode(message)
        assert ids.tolist() == [4, 7] and np.array_equal(xy_mm, np.ones((2, 2)))
    assert targets.decode_attempt(targets.encode([4], [[0.0, 1.0]], first.plan)) == first


def test_stock_tools_read_the_plan_of_a_later_attempt_from_named_columns(stamp):
    attempt = Attempt.first(stamp).next(PlanStamp(stamp.ns + 1), since_ns=5_000_000_006)
    message = targets.encode_attempt([4, 7], np.ones((2, 2)), attempt)
    sec, nanosec = divmod(stamp.ns, 10**9)
    expected = {"attempt": 2, "plan_sec": sec, "plan_nanosec": nanosec, "since_sec": 5}
    fields = {field.name: field for field in message.fields}
    for name, value in expected.items():
        assert (fields[name].datatype, fields[name].count) == (PointField.UINT32, 1)
        for row in range(message.width):
            at = row * message.point_step + fields[name].offset
            assert int.from_bytes(message.data[at : at + 4], "little") == value


def test_a_later_attempt_without_a_robot_or_with_part_of_its_columns_is_refused(stamp):
    attempt = Attempt.first(stamp).next(PlanStamp(stamp.ns + 1))
    with pytest.raises(MessageError, match="has no rows for attempt 2"):
        targets.encode_attempt([], np.zeros((0, 2)), attempt)
    message = targets.encode_attempt([4], np.ones((1, 2)), attempt)
    message.fields = [each for each in message.fields if each.name != "plan_sec"]
    with pytest.raises(MessageError, match="field plan_sec is missing"):
        targets.decode_attempt(message)


def test_targets_travel_in_metres(stamp):
    message = targets.encode([7], [[1500.0, -2.0]], stamp)
    assert np.frombuffer(message.data, "<f8", 2, offset=4).tolist() == [1.5, -0.002]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_target_that_is_not_finite_is_refused_on_both_sides(stamp, value, axis):
    xy = np.ones((3, 2))
    message = targets.encode([4, 17, 5], xy, stamp)
    xy[1, axis] = value
    with pytest.raises(MessageError, match=f"robot 17: .* {value} is not finite") as caught:
        targets.encode([4, 17, 5], xy, stamp)
    assert caught.value.robot == 17
    raw = np.frombuffer(message.data, [("id", "<u4"), ("x", "<f8"), ("y", "<f8")])
    raw["xy"[axis]][1] = value
    with pytest.raises(MessageError, match=f"robot 17: {'xy'[axis]} {value} is not finite"):
        targets.decode(message)


def test_a_robot_with_two_targets_is_refused_on_both_sides(stamp):
    with pytest.raises(MessageError, match="robot 17: id 17 appears twice"):
        targets.encode([17, 4, 17], np.zeros((3, 2)), stamp)
    message = targets.encode([17, 4, 18], np.zeros((3, 2)), stamp)
    np.frombuffer(message.data, [("id", "<u4"), ("xy", "<f8", 2)])["id"][2] = 17
    with pytest.raises(MessageError, match="robot 17: id 17 appears twice"):
        targets.decode(message)


@pytest.mark.parametrize("bad", [-1, 2**32])
def test_an_id_that_no_message_can_carry_is_refused(stamp, bad):
    with pytest.raises(MessageError, match=f"robot {bad}: id {bad} is outside"):
        targets.encode([bad], np.zeros((1, 2)), stamp)


def test_ids_are_whole_numbers_one_for_each_target(stamp):
    with pytest.raises(MessageError, match="1.5"):
        targets.encode([1.5], np.zeros((1, 2)), stamp)
    with pytest.raises(MessageError, match=r"\(3, 2\) does not fit 2 ids"):
        targets.encode([1, 2], np.zeros((3, 2)), stamp)


def test_a_target_can_name_its_fibre(plane, stamp):
    fibred = replace(plane, fibres=np.ones((3, 2, 2)))
    ids, xy_mm = [42, 3], [[0.0, 1.0], [2.0, 3.0]]
    message = targets.encode(ids, xy_mm, stamp, fibre=[1, -1])
    assert targets.decode_fibre(message).tolist() == [1, -1]
    assert targets.decode(message)[0].tolist() == ids
    assert targets.plane_for(fibred.with_fibre([0, 0, 0]), message).fibre.tolist() == [-1, 1, -1]
    with pytest.raises(LayoutError, match="robot 42: fibre must be 0 to 0, or -1 for any, got 1"):
        targets.plane_for(plane, message)
    attempt = Attempt.first(stamp).next(PlanStamp(stamp.ns + 1), since_ns=None)
    later = targets.encode_attempt(ids, xy_mm, attempt, fibre=[1, 0])
    assert targets.decode_fibre(later).tolist() == [1, 0]
    assert targets.decode_attempt(later) == attempt


def test_targets_for_any_fibre_have_no_such_column(stamp):
    plain = targets.encode([1], [[0.0, 1.0]], stamp)
    assert targets.encode([1], [[0.0, 1.0]], stamp, fibre=[-1]) == plain
    assert targets.decode_fibre(plain).tolist() == [-1]


@pytest.mark.parametrize("fibre", [-2, 16])
def test_impossible_fibres_are_refused_by_robot(fibre, stamp):
    with pytest.raises(MessageError, match=f"robot 7.*fibre.*{fibre} is not -1 to 15"):
        targets.encode([7], [[0.0, 1.0]], stamp, fibre=[fibre])
    message = targets.encode([7], [[0.0, 1.0]], stamp, fibre=[1])
    rows = np.frombuffer(message.data, targets_type()).copy()
    rows["fibre"] = fibre
    message.data = rows.tobytes()
    with pytest.raises(MessageError, match=f"robot 7.*fibre.*{fibre} is not -1 to 15"):
        targets.decode_fibre(message)


def targets_type():
    return [("id", "<u4"), ("x", "<f8"), ("y", "<f8"), ("fibre", "<i1")]

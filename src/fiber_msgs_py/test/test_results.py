# SPDX-License-Identifier: Apache-2.0
"""Messages about the course of a plan: joint states, outcome, held, progress, diagnostics."""

import array

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import (
    Attempt,
    Level,
    MessageError,
    PlanStamp,
    Progress,
    Stage,
    Status,
    diagnostics,
    held,
    joint_states,
    outcome,
    progress,
)
from fiber_msgs_py.joints import joint_columns, joint_names


@given(
    st.sets(st.integers(0, 2**32 - 1), max_size=8).map(sorted),
    st.integers(0, 2**31 * 10**9 - 1),
    st.randoms(use_true_random=False),
)
def test_joint_states_round_trip(ids, time_ns, random):
    angles = np.array([[random.uniform(-9, 9) for _ in range(2)] for _ in ids]).reshape(-1, 2)
    message = joint_states.encode(ids, angles, 2 * angles, time_ns)
    got_ids, got_angles, got_speeds, got_ns = joint_states.decode(message)
    assert got_ids.tolist() == ids and got_ns == time_ns
    np.testing.assert_array_equal(got_angles, angles)
    np.testing.assert_array_equal(got_speeds, 2 * angles)


def test_the_names_of_a_plane_are_read_once():
    ids = np.arange(5)
    first, second = (joint_columns(joint_names(ids, "test"), "test") for _ in range(2))
    for one, other in zip(first, second):
        assert one is other
        with pytest.raises(ValueError, match="read-only"):
            one[0] = 7
    kept = joint_names(ids, "test")
    kept.append("p0009/phi")  # the list belongs to the caller
    assert len(joint_names(ids, "test")) == 10


def test_joint_states_without_speeds_are_at_rest():
    message = joint_states.encode([7], [[1.0, 2.0]], [[3.0, 4.0]], 0)
    message.velocity = array.array("d")
    assert joint_states.decode(message)[2].tolist() == [[0.0, 0.0]]


def test_joint_states_are_refused_by_robot_and_value():
    message = joint_states.encode([7, 9], np.zeros((2, 2)), np.zeros((2, 2)), 0)
    message.position[3] = np.nan
    with pytest.raises(MessageError, match="robot 9: position nan is not finite"):
        joint_states.decode(message)
    message.position = array.array("d", [0.0])
    with pytest.raises(MessageError, match="position has 1 values for 4 joints"):
        joint_states.decode(message)
    with pytest.raises(MessageError, match=r"shape of velocity \(1, 2\)"):
        joint_states.encode([7, 9], np.zeros((2, 2)), np.zeros((1, 2)), 0)


@given(
    st.dictionaries(
        st.integers(0, 2**32 - 1),
        st.tuples(st.sampled_from(Outcome), st.sampled_from(Reason), st.floats(0, 1e3)),
        max_size=8,
    )
)
def test_outcome_round_trip(results):
    columns = list(zip(*results.values())) or [[], [], []]
    message = outcome.encode(list(results), *columns, PlanStamp(3))
    ids, outcomes, reasons, errors = outcome.decode(message)
    assert ids.tolist() == list(results)
    assert outcomes.tolist() == list(columns[0]) and reasons.tolist() == list(columns[1])
    np.testing.assert_allclose(errors, columns[2], rtol=1e-12, atol=1e-300)


def test_an_error_without_a_target_is_nan_and_none_is_negative(stamp):
    message = outcome.encode([1], [Outcome.HELD], [Reason.NO_TARGET], [np.nan], stamp)
    assert np.isnan(outcome.decode(message)[3]).all()
    for bad in (-1.0, np.inf):
        with pytest.raises(MessageError, match=f"robot 1: error {bad} is not a distance"):
            outcome.encode([1], [0], [0], [bad], stamp)


def test_errors_travel_in_metres(stamp):
    message = outcome.encode([1], [0], [0], [25.0], stamp)
    assert np.frombuffer(message.data, "<f8", 1, offset=6).tolist() == [0.025]


@pytest.mark.parametrize(("column", "offset"), [("outcome", 4), ("reason", 5)])
def test_unknown_outcome_codes_are_refused(stamp, column, offset):
    message = outcome.encode([17], [0], [0], [0.0], stamp)
    message.data[offset] = 250
    with pytest.raises(
        MessageError, match=f"robot 17: {column} 250 is not a member of {column.title()}"
    ):
        outcome.decode(message)


def test_held_round_trip_and_unknown_codes(stamp):
    message = held.encode([9, 4], [Reason.UNSAFE, Reason.NOT_CONVERGED], Stage.DISCRETIZER, stamp)
    ids, reasons, stages = held.decode(message)
    assert ids.tolist() == [9, 4]
    assert reasons.tolist() == [Reason.UNSAFE, Reason.NOT_CONVERGED]
    assert stages.tolist() == [Stage.DISCRETIZER] * 2
    for offset, column in ((4, "reason"), (5, "stage")):
        message = held.encode([9, 4], [Reason.UNSAFE] * 2, Stage.PLANNER, stamp)
        message.data[offset] = 77
        with pytest.raises(MessageError, match=f"robot 9: {column} 77 is not"):
            held.decode(message)
    with pytest.raises(MessageError, match="robot 4: reason 77"):
        held.encode([4], [77], Stage.PLANNER, stamp)


@given(st.floats(0, 1), st.text(max_size=20), st.integers(0, 2**31 * 10**9 - 3))
def test_progress_round_trip(fraction, text, ns):
    first = Attempt.first(PlanStamp(ns))
    for attempt in (first, first.next(PlanStamp(ns + 2)), first.next(PlanStamp(ns + 1), ns)):
        sent = Progress("planner", fraction, text, attempt)
        assert progress.decode(progress.encode(sent)) == sent


def test_progress_names_the_plan_and_the_attempt_by_key():
    attempt = Attempt.first(PlanStamp(7)).next(PlanStamp(8), since_ns=5)
    message = progress.encode(Progress("planner", 0.5, "half", attempt))
    values = {pair.key: pair.value for pair in message.values}
    assert values == {
        "fraction": "0.5", "stamp_ns": "8", "plan_ns": "7", "attempt": "2", "since_ns": "5",
    }  # fmt: skip
    message.values[3].value = "1"
    with pytest.raises(MessageError, match="does not fit attempt 1 of plan 0.000000007"):
        progress.decode(message)


def test_progress_without_its_values_is_refused(stamp):
    for bad in (-0.1, 1.1, float("nan")):
        with pytest.raises(MessageError, match=f"fraction {bad} is outside"):
            Progress("planner", bad, "", Attempt.first(stamp))
    message = progress.encode(Progress("planner", 0.5, "", Attempt.first(stamp)))
    message.values[0].value = "half"
    with pytest.raises(MessageError, match="fraction 'half' is not a number"):
        progress.decode(message)
    message.values = message.values[1:]
    with pytest.raises(MessageError, match="value fraction is missing"):
        progress.decode(message)


def test_diagnostics_round_trip():
    sent = [
        Status("bridge: bus 3", Level.ERROR, "SDA stuck low", {"nack": "4"}, "bus-3"),
        Status("planner", Level.OK, "idle"),
    ]
    message = diagnostics.encode(sent, 12_000_000_001)
    assert diagnostics.decode(message) == sent
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 1)

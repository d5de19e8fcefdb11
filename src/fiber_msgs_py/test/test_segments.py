# SPDX-License-Identifier: Apache-2.0
"""Segments: orders in wire units come back unchanged, and a lost row is noticed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import MessageError, PlanStamp, segments

UNITS = WireUnits()
ROW = [("id", "<u4"), ("joint", "<u1"), ("duration", "<u4"), ("velocity", "<i4"), ("start", "<i4")]
SEGMENT = st.tuples(
    st.integers(1, UNITS.max_ticks), st.integers(-UNITS.max_velocity, UNITS.max_velocity)
)


@st.composite
def plans(draw):
    ids = sorted(draw(st.sets(st.integers(0, 2**32 - 1), max_size=6)))
    profiles = [draw(st.lists(SEGMENT, max_size=4)) for _ in range(2 * len(ids))]
    offsets = Parts.from_counts([len(profile) for profile in profiles]).offsets
    flat = np.array([s for profile in profiles for s in profile], dtype=int).reshape(-1, 2)
    start = np.array(
        draw(st.lists(st.integers(-1000, 1000), min_size=2 * len(ids), max_size=2 * len(ids)))
    ).reshape(-1, 2)
    return ids, WireMotion(UNITS, start, offsets, flat[:, 0], flat[:, 1])


def example(stamp):
    """Robot 5 turns theta twice and rests phi, robot 17 moves both."""
    motion = WireMotion(
        UNITS, [[7, 8], [9, -9]], [0, 2, 2, 3, 4], [10, 20, 30, 40], [-100, 200, 300, -400]
    )
    message = segments.encode([5, 17], motion, stamp)
    return message, np.frombuffer(message.data, ROW)


@given(plans())
def test_round_trip(plan):
    ids, motion = plan
    robots, decoded = segments.decode(segments.encode(ids, motion, PlanStamp(1)), UNITS)
    assert robots.tolist() == ids
    for name in ("start", "offsets", "ticks", "velocity"):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(motion, name))


def test_rows_are_in_order_and_a_rest_is_a_row(stamp):
    _, rows = example(stamp)
    assert rows.tolist() == [
        (5, 0, 10, -100, 7),
        (5, 0, 20, 200, -993),
        (5, 1, 0, 0, 8),
        (17, 0, 30, 300, 9),
        (17, 1, 40, -400, -9),
    ]


@pytest.mark.parametrize(
    ("row", "values", "words"),
    [
        (2, (5, 2, 0, 0, 8), "robot 5: joint 2 is neither"),
        (2, (5, 0, 7, 7, 0), "robot 5: joints 1 of 2"),
        (2, (5, 1, 0, 9, 8), "robot 5: velocity 9 has the duration 0"),
        (1, (5, 0, 0, 0, 0), "robot 5: duration 0 is not the only row of its joint"),
        (3, (4, 0, 30, 300, 9), "robot 4: joint 0 is out of order"),
        (4, (18, 1, 40, -400, -9), "robot 17: joints 1 of 2"),
        (1, (5, 0, 20, 200, -992), "robot 5: start -992 is not the end of the segment before"),
    ],
)
def test_rows_that_contradict_each_other_are_refused(stamp, row, values, words):
    message, rows = example(stamp)
    rows[row] = values
    with pytest.raises(MessageError, match=words):
        segments.decode(message, UNITS)


def test_any_lost_profile_is_noticed(stamp):
    message, rows = example(stamp)
    for lost in (2, 3, 4):
        shorter = segments.encode_table(np.delete(rows, lost), stamp)
        with pytest.raises(MessageError, match="joints 1 of 2"):
            segments.decode(shorter, UNITS)


def test_numbers_too_large_for_the_units_are_refused(stamp):
    message, rows = example(stamp)
    rows["duration"][0] = UNITS.max_ticks + 1
    rows["start"][1] = 7 - 100 * (UNITS.max_ticks + 1)
    with pytest.raises(MessageError, match="robot 5: duration 1024 is more than 1023 ticks"):
        segments.decode(message, UNITS)
    message, rows = example(stamp)
    rows["velocity"][4] = UNITS.max_velocity + 1
    with pytest.raises(MessageError, match="robot 17: velocity 8192 is beyond 8191 either way"):
        segments.decode(message, UNITS)


def test_a_start_that_does_not_fit_its_column_is_refused(stamp):
    far = WireMotion(UNITS, [[0, 0], [2**31, 0]], np.zeros(5), [], [])
    with pytest.raises(MessageError, match="robot 17: start 2147483648 does not fit"):
        segments.encode([5, 17], far, stamp)


def test_ids_must_increase_and_agree_with_the_motion(stamp):
    rest = WireMotion(UNITS, np.zeros((2, 2)), np.zeros(5), [], [])
    with pytest.raises(MessageError, match="robot 5: id 5 does not increase"):
        segments.encode([17, 5], rest, stamp)
    with pytest.raises(MessageError, match="2 robots, but 1 ids"):
        segments.encode([5], rest, stamp)

# SPDX-License-Identifier: Apache-2.0
"""Frames: every byte of a batch comes back in its place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.frame_log import FrameLog
from fiber_core.ragged import Parts
from fiber_msgs_py import MessageError, PlanStamp, frames

FRAME = st.tuples(
    st.floats(0, 1e3),
    st.integers(0, 65_535),
    st.integers(0, 1023),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2),
    st.binary(max_size=40),
)


def log_of(rows):
    columns = list(zip(*rows)) or [[]] * 7
    payload = b"".join(columns[6])
    offsets = Parts.from_counts([len(data) for data in columns[6]]).offsets
    return FrameLog(*map(np.array, columns[:6]), offsets, np.frombuffer(payload, np.uint8))


@given(st.lists(FRAME, max_size=10))
def test_round_trip(rows):
    sent = log_of(rows)
    got = frames.decode(frames.encode(sent, PlanStamp(1)))
    assert len(got) == len(rows)
    for name in ("time_s", "bus", "address", "ten_bit", "read", "ack", "offsets", "data"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name), name)


def test_a_frame_longer_than_its_bytes_is_refused(stamp):
    message = frames.encode(log_of([(0.0, 1, 2, 0, 0, 0, b"abc")] * 2), stamp)
    at = next(field.offset for field in message.fields if field.name == "length")
    message.data[message.point_step + at] = 4
    with pytest.raises(MessageError, match="length 4 of frame 1 is more than its 3 bytes"):
        frames.decode(message)


def test_what_does_not_fit_its_column_is_not_sent(stamp):
    with pytest.raises(MessageError, match="bus 70000 of frame 0 does not fit"):
        frames.encode(log_of([(0.0, 70_000, 2, 0, 0, 0, b"")]), stamp)
    whole = log_of([(0.0, 1, 2, 0, 0, 0, b"abc")])
    with pytest.raises(MessageError, match="3 bytes are not cut into 1 frames"):
        frames.encode(FrameLog(**(vars(whole) | {"offsets": np.array([0, 2])})), stamp)

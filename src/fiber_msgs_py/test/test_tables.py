# SPDX-License-Identifier: Apache-2.0
"""Tables: faults that every codec over PointCloud2 must refuse, and differences it accepts."""

import array

import numpy as np
import pytest

from fiber_core.errors import FiberError
from fiber_core.frame_log import FrameLog
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import (
    MessageError,
    PlanStamp,
    Stage,
    frames,
    held,
    layout,
    outcome,
    segments,
    targets,
)
from fiber_msgs_py.table import decode_table, encode_table

LOG = FrameLog(
    time_s=np.array([0.0, 0.5]),
    bus=np.array([0, 9]),
    address=np.array([8, 1023]),
    ten_bit=np.array([False, True]),
    read=np.array([False, True]),
    ack=np.array([0, 1]),
    offsets=np.array([0, 3, 4]),
    data=np.array([1, 2, 3, 4], dtype=np.uint8),
)
UNITS = WireUnits()
CODECS = {
    "layout": lambda plane, stamp: (layout.encode(plane, UNITS, stamp), layout.decode),
    "targets": lambda plane, stamp: (
        targets.encode([3, 42], [[0.0, 1.0], [2.0, 3.0]], stamp),
        targets.decode,
    ),
    "segments": lambda plane, stamp: (
        segments.encode(
            [3, 42], WireMotion(UNITS, np.zeros((2, 2)), [0, 1, 1, 2, 3], [1, 2, 3], [1, -1, 1]),
            stamp,
        ),
        lambda message: segments.decode(message, UNITS),
    ),
    "outcome": lambda plane, stamp: (
        outcome.encode(
            [3, 42], [Outcome.REACHED, Outcome.HELD], [Reason.OK, Reason.UNSAFE], [0.0, 1.0], stamp
        ),
        outcome.decode,
    ),
    "held": lambda plane, stamp: (
        held.encode([3, 42], [Reason.UNSAFE] * 2, Stage.PLANNER, stamp),
        held.decode,
    ),
    "frames": lambda plane, stamp: (frames.encode(LOG, stamp), frames.decode),
}  # fmt: skip


@pytest.fixture(params=CODECS)
def sample(request, plane, stamp):
    """Name, valid message and decoder of each table."""
    return request.param, *CODECS[request.param](plane, stamp)


def refused(name, decode, message, *words):
    with pytest.raises(MessageError) as caught:
        decode(message)
    assert str(caught.value).startswith(name)
    for word in words:
        assert str(word) in str(caught.value)


def test_every_missing_field_is_named(sample):
    name, message, decode = sample
    optional = {"theta_outline"}
    for field in list(message.fields):
        message.fields = [other for other in message.fields if other is not field]
        if field.name not in optional:
            expected = "phi outline" if field.name == "phi_outline" else field.name
            with pytest.raises(FiberError, match=expected):
                decode(message)
        message.fields = [*message.fields, field]
    decode(message)


def test_every_wrong_type_and_count_is_named_with_its_value(sample):
    name, message, decode = sample
    for field in message.fields:
        right = field.datatype
        field.datatype = 7  # float32, which no column is
        refused(name, decode, message, field.name, "float32")
        field.datatype = 99
        refused(name, decode, message, field.name, "99")
        field.datatype = right
        right, field.count = field.count, 0
        refused(name, decode, message, field.name, 0)
        field.count = right
        if right == 1 and field.name != "bytes":
            field.count = 2
            refused(name, decode, message, field.name, 2)
            field.count = 1
    decode(message)


def test_sizes_that_contradict_each_other_are_named(sample):
    name, message, decode = sample
    for field, by in (("point_step", -1), ("point_step", 1), ("row_step", 1), ("width", 1)):
        right = getattr(message, field)
        setattr(message, field, right + by)
        with pytest.raises(MessageError, match="point_step|row_step|data"):
            decode(message)
        setattr(message, field, right)
    whole = message.data
    message.data = whole[:-1]
    refused(name, decode, message, "data", len(whole) - 1, len(whole))
    message.data = array.array("B", whole.tobytes() + b"\0")
    refused(name, decode, message, "data", len(whole) + 1)


def test_foreign_frame_byte_order_and_doubled_field_are_refused(sample):
    name, message, decode = sample
    message.header.frame_id = "map"
    refused(name, decode, message, "frame_id", "map")
    message.header.frame_id = "focal_plane"
    message.is_bigendian = True
    refused(name, decode, message, "is_bigendian")
    message.is_bigendian = False
    message.fields = [*message.fields, message.fields[0]]
    refused(name, decode, message, message.fields[0].name, "twice")


def test_a_stamp_survives(sample, stamp):
    assert PlanStamp.of(sample[1]) == stamp


def test_columns_are_found_by_name_at_any_offset_beside_others(stamp):
    rows = np.array(
        [(9, 1.5, 7.0, 1), (8, -2.5, 7.0, 2)],
        dtype=[("noise", "<u1"), ("y", "<f8"), ("more", "<f4"), ("id", "<u4")],
    )
    decoded = decode_table(encode_table(rows, stamp), "t", {"id": "<u4", "y": "<f8"})
    assert decoded["id"].tolist() == [1, 2]
    assert decoded["y"].tolist() == [1.5, -2.5]


def test_decoding_copies_nothing_and_cannot_write(stamp):
    rows = np.zeros(3, dtype=[("id", "<u4")])
    message = encode_table(rows, stamp)
    decoded = decode_table(message, "t", {"id": "<u4"})
    assert np.shares_memory(decoded, np.frombuffer(message.data, np.uint8))
    with pytest.raises(ValueError):
        decoded["id"] = 1


def test_an_empty_table_is_a_table(stamp):
    ids, xy_mm = targets.decode(targets.encode([], np.zeros((0, 2)), stamp))
    assert ids.shape == (0,) and xy_mm.shape == (0, 2)
    held_columns = held.decode(held.encode([], [], Stage.PLANNER, stamp))
    assert [column.shape for column in held_columns] == [(0,)] * 3

# SPDX-License-Identifier: Apache-2.0
"""Damaged messages: every decoder returns a value or raises a MessageError, nothing else."""

import array
import copy
import random
import struct
import warnings

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from sensor_msgs.msg import PointCloud2, PointField

from fiber_core.corridor import JointCorridors
from fiber_core.frame_log import FrameLog
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import (
    Attempt,
    Level,
    MessageError,
    PlanStamp,
    Progress,
    Stage,
    Status,
    corridors,
    diagnostics,
    frames,
    held,
    images,
    joint_states,
    layout,
    lights,
    measured,
    outcome,
    progress,
    segments,
    spots,
    targets,
    trajectory,
    true_places,
    turns,
)
from fiber_msgs_py.lights import SeenLights
from fiber_msgs_py.measured import Measured
from fiber_msgs_py.true_places import TruePlaces

CASES = 700  # for each decoder
SIZES = (0, 1, 2, 3, 7, 255, 2**16, 2**31 - 1, 2**31, 2**32 - 1)
NUMBERS = (0.0, -1.0, 5e-324, 1e300, -1.7e308, 1e19, 2.0**53, np.nan, np.inf, -np.inf)
SIGNALLING_NANS = (b"\x01\0\0\0\0\0\xf0\x7f", b"\x01\0\x80\x7f")  # double and single
TEXTS = (
    "",
    "map",
    "nan",
    "-1",
    "1e999",
    "9" * 30,
    "9" * 5000,
    "p0007/theta",
    "\x00",
    "ü" * 9,
    "id",
)


def both(decode):
    """A decoder, and the stamp that nodes read with it."""
    return lambda message: (PlanStamp.of(message), decode(message))


def cases(plane, stamp):
    """Valid messages by name, each with its decoder."""
    ids, n = plane.ids, plane.n
    units = WireUnits.for_plane(plane)
    offsets = [0, 2, 2, 3, 4, 4, 5]
    wire = WireMotion(units, np.zeros((n, 2), int), offsets, [10, 5, 7, 9, 3], [1, -2, 3, -4, 5])
    walls = np.linspace(0.0, 1.0, n * 2 * 4).reshape(n, 2, 4)
    log = FrameLog(
        time_s=np.array([0.5, 0.7]),
        bus=np.array([0, 1]),
        address=np.array([9, 10]),
        ten_bit=np.array([False, True]),
        read=np.array([True, False]),
        ack=np.array([1, 0]),
        offsets=np.array([0, 2, 5]),
        data=np.arange(5, dtype=np.uint8),
    )
    later = Attempt.first(stamp).next(PlanStamp(stamp.ns + 1), since_ns=stamp.ns)
    xy, still = np.arange(2.0 * n).reshape(n, 2), np.zeros((n, 2))
    motion = SampledMotion([0.0, 0.5, 1.0], np.arange(6.0 * n).reshape(n, 2, 3))
    reached = np.full(n, Outcome.REACHED), np.full(n, Reason.OK), np.linspace(0, 1, n)
    statuses = [Status("planner", Level.OK, "waiting", {"refused": 1}), Status("bus", Level(1), "")]
    return {
        "layout": (layout.encode(plane, units, stamp), both(layout.decode)),
        "targets": (targets.encode(ids, xy, stamp), both(targets.decode)),
        "attempt": (targets.encode_attempt(ids, xy, later), both(targets.decode_attempt)),
        "segments": (
            segments.encode(ids, wire, stamp),
            both(lambda message: segments.decode(message, units)),
        ),
        "corridors": (
            corridors.encode(ids, JointCorridors(np.ones(n), walls, walls + 1), stamp),
            both(corridors.decode),
        ),
        "frames": (frames.encode(log, stamp), both(frames.decode)),
        "held": (
            held.encode(ids, np.full(n, Reason.OK), Stage.PLANNER, stamp),
            both(held.decode),
        ),
        "outcome": (outcome.encode(ids, *reached, stamp), both(outcome.decode)),
        "joint_states": (joint_states.encode(ids, xy, still, 5), both(joint_states.decode)),
        "trajectory": (trajectory.encode(ids, motion, stamp), both(trajectory.decode)),
        "progress": (
            progress.encode(Progress("bridge", 0.5, "moves", later)),
            progress.decode,
        ),
        "diagnostics": (diagnostics.encode(statuses, 5), both(diagnostics.decode)),
        "measured": (
            measured.encode(
                Measured(
                    ids, np.zeros(n, int), xy, xy, still + 0.1, still[:, 0], still[:, 0], still
                ),
                stamp,
            ),
            both(measured.decode),
        ),
        "spots": (spots.encode(xy, xy[:, 0], xy[:, 1], stamp), both(spots.decode)),
        "calibration": (
            spots.encode_calibration(xy, xy, np.zeros(n), stamp),
            both(spots.decode_calibration),
        ),
        "true_places": (true_places.encode(TruePlaces(ids, xy), stamp), both(true_places.decode)),
        "turns": (turns.encode(ids, np.full(n, -1), stamp), both(turns.decode)),
        "lights": (
            lights.encode(SeenLights(xy, np.ones(n, int), np.zeros(n, bool)), stamp),
            both(lights.decode),
        ),
        "images": (images.encode(np.ones((3, 4), np.uint16), stamp), both(images.decode)),
    }


NAMES = (
    "layout targets attempt segments corridors frames held outcome joint_states trajectory "
    "progress diagnostics measured spots calibration true_places turns lights images"
).split()


def decodes(decode, message):
    """Return whether a message is decoded; anything but a MessageError fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a flood of warnings is a fault, too
        try:
            decode(message)
        except MessageError:
            return False
    return True


def damage(message, rng):
    """Change a message in one place."""
    kinds = [damage_header] if hasattr(message, "header") else []
    kinds += {
        "PointCloud2": [damage_sizes, damage_field, damage_field, damage_data, damage_data],
        "Image": [damage_image],
        "JointState": [damage_joints],
        "JointTrajectory": [damage_joints, damage_points],
        "DiagnosticStatus": [damage_status],
        "DiagnosticArray": [lambda message, rng: damage_status(rng.choice(message.status), rng)],
    }[type(message).__name__]
    rng.choice(kinds)(message, rng)


def damage_header(message, rng):
    if rng.random() < 0.3:
        message.header.frame_id = rng.choice(TEXTS)
    message.header.stamp = Time(
        sec=rng.choice([-(2**31), -1, 0, 2**31 - 1]), nanosec=rng.choice([0, 10**9, 2**32 - 1])
    )


def damage_sizes(message, rng):
    for name in rng.sample(["width", "height", "point_step", "row_step"], rng.randint(1, 3)):
        setattr(message, name, rng.choice(SIZES))
    choice = rng.random()
    if choice < 0.2:  # sizes that fit each other
        message.row_step = message.width * message.point_step % 2**32
    elif choice < 0.3:
        message.width, message.row_step, message.data = 0, 0, array.array("B")
    elif choice < 0.4:
        message.is_bigendian = True
    elif choice < 0.5:
        message.data = message.data[: rng.randrange(len(message.data) + 1)]
    elif choice < 0.6:
        message.height, message.width = message.width, message.height


def damage_field(message, rng):
    if not message.fields:
        return
    field = rng.choice(message.fields)
    name = rng.choice(["name", "offset", "datatype", "count", "twice", "gone", "empty"])
    if name == "name":
        field.name = rng.choice([*TEXTS, rng.choice(message.fields).name])
    elif name == "offset":
        field.offset = rng.choice(SIZES)
    elif name == "datatype":
        field.datatype = rng.randrange(256)
    elif name == "count":
        field.count = rng.choice(SIZES)
    elif name == "twice":
        message.fields.append(copy.deepcopy(field))
    elif name == "gone":
        message.fields.remove(field)
    else:  # a table without rows, with a field of any size
        message.width = message.row_step = 0
        message.data = array.array("B")
        field.count, field.offset = rng.choice(SIZES), rng.choice(SIZES)
        message.point_step = rng.choice(SIZES)


def damage_image(message, rng):
    name = rng.choice(["height", "width", "step", "encoding", "is_bigendian", "data"])
    if name == "encoding":
        message.encoding = rng.choice([*TEXTS, "mono8", "mono16", "rgb8"])
    elif name == "is_bigendian":
        message.is_bigendian = rng.randrange(256)
    elif name == "data":
        message.data = message.data[: rng.randrange(len(message.data) + 1)]
    else:
        setattr(message, name, rng.choice(SIZES))


def damage_data(message, rng):
    data = bytearray(message.data)
    if not data:
        return
    if rng.random() < 0.5:
        for _ in range(rng.randint(1, 8)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif message.fields:
        field, row = rng.choice(message.fields), rng.randrange(max(message.width, 1))
        value = struct.pack("<d", rng.choice(NUMBERS))
        if rng.random() < 0.5:
            value = struct.pack("<d", rng.uniform(-1e6, 1e6))
        elif field.datatype == PointField.FLOAT32:
            value = struct.pack("<f", rng.choice([0.0, -1.0, 3e38, np.nan, np.inf]))
        if rng.random() < 0.1:
            value = rng.choice(SIGNALLING_NANS)
        at = row * message.point_step + field.offset
        data[at : at + len(value)] = value[: max(0, len(data) - at)]
    message.data = array.array("B", data)


def damage_joints(message, rng):
    names = message.name if hasattr(message, "name") else message.joint_names
    choice = rng.random()
    if choice < 0.4 and names:
        at = rng.randrange(len(names))
        names[at] = rng.choice([*TEXTS, rng.choice(names), "p9999999999/phi", "p4294967296/phi"])
    elif choice < 0.5:
        names.clear()
    elif choice < 0.6:
        rng.shuffle(names)
    elif hasattr(message, "position"):
        values = getattr(message, rng.choice(["position", "velocity"]))
        damage_values(values, rng)
    else:
        damage_points(message, rng)


def damage_points(message, rng):
    if not message.points:
        return
    point = rng.choice(message.points)
    choice = rng.random()
    if choice < 0.4:
        damage_values(getattr(point, rng.choice(["positions", "velocities"])), rng)
    elif choice < 0.8:
        point.time_from_start.sec = rng.choice([-(2**31), -1, 0, 1, 2**31 - 1])
        point.time_from_start.nanosec = rng.choice([0, 1, 10**9, 2**32 - 1])
    elif choice < 0.9:
        message.points = []
    else:
        message.points = [copy.deepcopy(point) for _ in range(3)]


def damage_values(values, rng):
    if len(values) and rng.random() < 0.6:
        values[rng.randrange(len(values))] = rng.choice(NUMBERS)
    elif rng.random() < 0.5:
        values.append(0.0)
    else:
        del values[rng.randrange(len(values) + 1) :]


def damage_status(message, rng):
    choice = rng.random()
    if choice < 0.3:
        message.level = bytes([rng.randrange(256)])
    elif choice < 0.7 and message.values:
        pair = rng.choice(message.values)
        pair.value = rng.choice([*TEXTS, "inf", "0x10", "1_0", "٣", str(2**63), "-0.0"])
    elif choice < 0.8:
        message.values.append(KeyValue(key="since_ns", value=rng.choice(TEXTS)))
    elif message.values:
        message.values.remove(rng.choice(message.values))


@pytest.mark.parametrize("name", NAMES)
def test_a_damaged_message_is_decoded_or_refused(plane, stamp, name):
    rng = random.Random(f"{name} 13")
    valid, decode = cases(plane, stamp)[name]
    assert decodes(decode, valid)
    refused = 0
    for _ in range(CASES):
        message = copy.deepcopy(valid)
        for _ in range(rng.randint(1, 3)):
            damage(message, rng)
        refused += not decodes(decode, message)
    assert refused > CASES // 4


@pytest.mark.parametrize("name", NAMES[:8])
@pytest.mark.parametrize("empty", [False, True], ids=["rows", "no rows"])
def test_sizes_that_no_array_can_have_are_refused(plane, stamp, name, empty):
    valid, decode = cases(plane, stamp)[name]
    for offset in (2**31, 2**31 - 1, 2**32 - 1, 0):
        for at in range(len(valid.fields)):
            for count in (1, 2**31, 2**32 - 1):
                message = copy.deepcopy(valid)
                message.point_step = 2**32 - 1
                message.fields[at].offset, message.fields[at].count = offset, count
                message.row_step = 0
                if empty:
                    message.width, message.data = 0, array.array("B")
                elif name == "attempt":
                    message.width = 1
                if not (name == "attempt" and empty):  # without rows it is a first attempt
                    assert not decodes(decode, message)


@pytest.mark.parametrize("name", NAMES[:8])
def test_a_stamp_before_the_epoch_is_refused(plane, stamp, name):
    message, decode = cases(plane, stamp)[name]
    message.header.stamp = Time(sec=-1, nanosec=0)
    assert not decodes(decode, message)


def test_a_number_that_is_infinite_only_in_mm_is_refused(stamp):
    message = targets.encode([7], [[1.0, 2.0]], stamp)
    rows = np.frombuffer(message.data, [("id", "<u4"), ("x", "<f8"), ("y", "<f8")]).copy()
    rows["y"] = 1e306
    message.data = array.array("B", rows.tobytes())
    with pytest.raises(MessageError, match="robot 7: y 1e\\+306 is not finite"):
        targets.decode(message)


@pytest.mark.parametrize("level", [4, 99, 255])
def test_a_level_that_does_not_exist_is_refused(level):
    message = DiagnosticStatus(level=bytes([level]), name="other")
    with pytest.raises(MessageError, match=f"level {level} is unknown"):
        Status.of(message)


def test_an_empty_cloud_is_refused_by_every_table():
    for module in (layout, targets, corridors, frames, held, outcome):
        with pytest.raises(MessageError):
            module.decode(PointCloud2())
    with pytest.raises(MessageError):
        segments.decode(PointCloud2(), WireUnits())

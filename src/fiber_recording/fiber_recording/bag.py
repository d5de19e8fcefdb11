# SPDX-License-Identifier: Apache-2.0
"""Write a recording as a rosbag2 folder (mcap), for ros2 bag, RViz, PlotJuggler and Foxglove.

The topics are those of the graph: layout, targets, trajectory, segments, corridors, joint_states
and outcome. Joint states have a period of 0.1 s, as those of the bridge: the latest reading of
each encoder, and the velocity of the executed motion. The topics of the live view are written,
too, with a period of 0.05 s: arms, plane and targets as points.
"""

import argparse
import array
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile

from fiber_core.errors import FiberError
from fiber_msgs_py import (
    PlanStamp,
    Topic,
    corridors,
    joint_states,
    layout,
    outcome,
    segments,
    targets,
    topics,
    trajectory,
)
from fiber_msgs_py.point_clouds import ViewState, arms_cloud, plane_cloud, points_cloud, view_states
from fiber_msgs_py.table import encode_table
from fiber_recording.errors import BagError
from fiber_recording.recording import Recording
from fiber_recording.recording_file import load_recording

if TYPE_CHECKING:  # rosbags has no package in Debian or Ubuntu: it is imported where it is used
    from rosbags.interfaces import Qos
    from rosbags.typesys.store import Typestore

__all__ = ["main", "write_bag"]

_METADATA_VERSION = 9  # of rosbag2 in Jazzy
_PERIOD_NS, _VIEW_PERIOD_NS = 100_000_000, 50_000_000
_SECOND_NS = 1_000_000_000

_Entry = tuple[int, Topic, Any]  # time [ns], topic, ROS message; messages have no common type


def write_bag(folder: Path, recording: Recording) -> None:
    """Write a recording as a rosbag2 folder.

    The motion begins at the stamp of the plan.

    Args:
        folder: the folder to write, which must not exist.
        recording: the recording.

    Raises:
        BagError: the folder exists, or the library rosbags is not installed.
    """
    if importlib.util.find_spec("rosbags") is None:
        raise BagError("bags need the library rosbags: python3 -m pip install rosbags")
    from rosbags import rosbag2, typesys

    if folder.exists():
        raise BagError(f"{folder} exists already: name a folder that does not exist")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    writer = rosbag2.Writer(
        folder, version=_METADATA_VERSION, storage_plugin=rosbag2.StoragePlugin.MCAP
    )
    writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for time_ns, topic, message in sorted(_entries(recording), key=lambda entry: entry[0]):
            type_name = _type_name(message)
            if topic.name not in connections:
                connections[topic.name] = writer.add_connection(
                    f"/{topic.name.lstrip('/')}",
                    type_name,
                    typestore=store,
                    offered_qos_profiles=[_qos(topic.qos)],
                )
            data = store.serialize_cdr(_converted(message, store), type_name)
            writer.write(connections[topic.name], time_ns, data)


def _type_name(message: object) -> str:
    return f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"


def _converted(value: Any, store: "Typestore") -> Any:
    """Return a message, or a value in a message, in the types of rosbags.

    rclpy's serialization pads some messages with uninitialized memory. A strict reader refuses
    these, and two bags of the same recording would differ.
    """
    if isinstance(value, array.array):
        return np.asarray(value)
    if isinstance(value, list):
        return [_converted(entry, store) for entry in value]
    if not hasattr(value, "get_fields_and_field_types"):
        return value
    fields = value.get_fields_and_field_types()
    return store.types[_type_name(value)](
        **{field: _converted(getattr(value, field), store) for field in fields}
    )


def _entries(recording: Recording) -> Iterator[_Entry]:
    problem, plane = recording.problem, recording.problem.plane
    stamp, ids = PlanStamp(recording.about["plan_ns"]), plane.ids
    asked = problem.asked
    yield stamp.ns, topics.LAYOUT, layout.encode(plane, recording.units, stamp)
    fibre = plane.fibre[asked]
    asked_for = targets.encode(ids[asked], problem.targets[asked], stamp, fibre=fibre)
    yield stamp.ns, topics.TARGETS, asked_for
    if recording.planned is not None:
        yield stamp.ns, topics.TRAJECTORY, trajectory.encode(ids, recording.planned, stamp)
    yield stamp.ns, topics.SEGMENTS, segments.encode(ids, recording.motion, stamp)
    if recording.corridors is not None:
        yield stamp.ns, topics.CORRIDORS, corridors.encode(ids, recording.corridors, stamp)
    states = list(_joint_states(recording, stamp))
    yield from states
    end_ns = states[-1][0]
    ended = recording.outcome, recording.reason, recording.error_mm
    yield end_ns, topics.OUTCOME, outcome.encode(ids, *ended, stamp)
    yield from _view(recording, stamp, end_ns)


def _joint_states(recording: Recording, stamp: PlanStamp) -> Iterator[_Entry]:
    ids, units, measured = recording.problem.plane.ids, recording.units, recording.measured
    order = np.argsort(measured.time_us, kind="stable")
    reading_ns = measured.time_us[order] * 1000
    counts = recording.motion.start.copy()
    begin = 0
    for passed_ns in range(0, int(reading_ns.max(initial=0)) + 2 * _PERIOD_NS, _PERIOD_NS):
        end = int(np.searchsorted(reading_ns, passed_ns, side="right"))
        new = order[begin:end]
        counts[measured.row[new]] = measured.counts[new]
        begin, at = end, stamp.ns + passed_ns
        speeds = recording.executed.velocity(passed_ns / _SECOND_NS)
        message = joint_states.encode(ids, units.to_angles(counts), speeds, at)
        yield at, topics.JOINT_STATES, message


def _view(recording: Recording, stamp: PlanStamp, end_ns: int) -> Iterator[_Entry]:
    plane, motion = recording.problem.plane, recording.executed
    asked = recording.problem.targets[recording.problem.asked]
    yield stamp.ns, topics.VIEW_PLANE, encode_table(plane_cloud(plane), stamp)
    yield stamp.ns, topics.VIEW_TARGETS, encode_table(points_cloud(asked, ViewState.REACHED), stamp)
    for at in range(stamp.ns, end_ns + 1, _VIEW_PERIOD_NS):
        time_s = (at - stamp.ns) / _SECOND_NS
        ended = recording.outcome if at == end_ns else None
        states = view_states(plane, motion.velocity(time_s).any(axis=1), ended)
        cloud = arms_cloud(plane, motion(time_s), states)
        yield at, topics.VIEW_ARMS, encode_table(cloud, PlanStamp(at))


def _qos(profile: QoSProfile) -> "Qos":
    from rosbags import interfaces

    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    forever = interfaces.QosTime(2**31 - 1, 2**32 - 1)
    return interfaces.Qos(
        history=interfaces.QosHistory.KEEP_LAST,
        depth=profile.depth,
        reliability=interfaces.QosReliability.RELIABLE,
        durability=interfaces.QosDurability.TRANSIENT_LOCAL
        if latched
        else interfaces.QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=interfaces.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code.

    Args:
        argv: arguments; by default those of the process.
    """
    parser = argparse.ArgumentParser(
        prog="bag", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="recording to read (.npz)")
    parser.add_argument("folder", type=Path, help="rosbag2 folder to write; must not exist")
    args = parser.parse_args(argv)
    try:
        write_bag(args.folder, load_recording(args.recording))
    except FiberError as error:
        print(f"bag: {error}", file=sys.stderr)
        return 1
    print(args.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())

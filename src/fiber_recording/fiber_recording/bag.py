"""A recording as a rosbag2 in mcap, for ros2 bag, RViz, PlotJuggler and Foxglove.

The topics are those of the graph, with the messages it sent: layout, targets, trajectory,
segments, corridors, joint_states and outcome. Encoders are published ten times a second, each robot
with its latest reading, as the bridge does; its speed is that of the motion carried out. What the
viewer would show is there too, twenty times a second: arms, plane and targets as points.
"""

import argparse
import array
import sys
from pathlib import Path

import numpy as np
from rclpy.qos import DurabilityPolicy

try:  # from pip: neither Debian nor Ubuntu packages it, so nothing else may need it
    from rosbags import interfaces, rosbag2, typesys
except ImportError:
    interfaces = rosbag2 = typesys = None

from fiber_client.errors import PlaneError
from fiber_core.errors import FiberError
from fiber_msgs_py import (
    PlanStamp,
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
from fiber_recording import Recording, load_recording

__all__ = ["main", "write_bag"]

_VERSION = 9  # of the rosbag2 metadata: that of Jazzy
_PERIOD_NS, _PICTURE_NS = 100_000_000, 50_000_000
_SECOND = 1_000_000_000


def write_bag(folder: Path, recording: Recording) -> None:
    """Write a recording as a rosbag2 folder, which must not exist.

    Args:
        folder: where.
        recording: what; its GO is at the stamp of the plan.

    Raises:
        PlaneError: the folder exists, or the library rosbags is not installed.
    """
    if rosbag2 is None:
        raise PlaneError("bags need the library rosbags: python3 -m pip install rosbags")
    if folder.exists():
        raise PlaneError(f"{folder} exists already")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    writer = rosbag2.Writer(folder, version=_VERSION, storage_plugin=rosbag2.StoragePlugin.MCAP)
    writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for time_ns, topic, message in sorted(_messages(recording), key=lambda entry: entry[0]):
            kind = _kind(message)
            if topic.name not in connections:
                connections[topic.name] = writer.add_connection(
                    f"/{topic.name.lstrip('/')}",
                    kind,
                    typestore=store,
                    offered_qos_profiles=[_qos(topic.qos)],
                )
            data = store.serialize_cdr(_foreign(message, store), kind)
            writer.write(connections[topic.name], time_ns, data)


def _kind(message) -> str:
    return f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"


def _foreign(value, store):
    """Return a message as rosbags knows it.

    rclpy's own serialization leaves what happened to be in memory behind the last field of
    some messages; a strict reader refuses them, and no two files would be the same.
    """
    if isinstance(value, array.array):
        return np.asarray(value)
    if isinstance(value, list):
        return [_foreign(entry, store) for entry in value]
    if not hasattr(value, "get_fields_and_field_types"):
        return value
    fields = value.get_fields_and_field_types()
    return store.types[_kind(value)](
        **{field: _foreign(getattr(value, field), store) for field in fields}
    )


def _messages(recording):
    problem, plane = recording.problem, recording.problem.plane
    stamp, ids = PlanStamp(recording.about["plan_ns"]), plane.ids
    asked = problem.asked
    yield stamp.ns, topics.LAYOUT, layout.encode(plane, recording.units, stamp)
    yield stamp.ns, topics.TARGETS, targets.encode(ids[asked], problem.targets[asked], stamp)
    if recording.planned is not None:
        yield stamp.ns, topics.TRAJECTORY, trajectory.encode(ids, recording.planned, stamp)
    yield stamp.ns, topics.SEGMENTS, segments.encode(ids, recording.motion, stamp)
    if recording.corridors is not None:
        yield stamp.ns, topics.CORRIDORS, corridors.encode(ids, recording.corridors, stamp)
    for entry in _joint_states(recording, stamp):
        yield entry
        end_ns = entry[0]
    ended = recording.outcome, recording.reason, recording.error_mm
    yield end_ns, topics.OUTCOME, outcome.encode(ids, *ended, stamp)
    yield from _view(recording, stamp, end_ns)


def _joint_states(recording, stamp):
    ids, units, measured = recording.problem.plane.ids, recording.units, recording.measured
    order = np.argsort(measured.time_us, kind="stable")
    time_ns = measured.time_us[order] * 1000
    counts = recording.motion.start.copy()
    begin = 0
    for now in range(0, int(time_ns.max(initial=0)) + 2 * _PERIOD_NS, _PERIOD_NS):
        end = int(np.searchsorted(time_ns, now, side="right"))
        heard = order[begin:end]
        counts[measured.row[heard]] = measured.counts[heard]
        begin, at = end, stamp.ns + now
        speeds = recording.executed.velocity(now / _SECOND)
        yield at, topics.JOINT_STATES, joint_states.encode(ids, units.to_angles(counts), speeds, at)


def _view(recording, stamp, end_ns):
    plane, motion = recording.problem.plane, recording.executed
    asked = recording.problem.targets[recording.problem.asked]
    yield stamp.ns, topics.VIEW_PLANE, encode_table(plane_cloud(plane), stamp)
    yield stamp.ns, topics.VIEW_TARGETS, encode_table(points_cloud(asked, ViewState.REACHED), stamp)
    for at in range(stamp.ns, end_ns + 1, _PICTURE_NS):
        time_s = (at - stamp.ns) / _SECOND
        ended = recording.outcome if at == end_ns else None
        states = view_states(plane, motion.velocity(time_s).any(axis=1), ended)
        yield (
            at,
            topics.VIEW_ARMS,
            encode_table(arms_cloud(plane, motion(time_s), states), PlanStamp(at)),
        )


def _qos(profile):
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


def main(argv=None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="bag", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="recording.npz")
    parser.add_argument("folder", type=Path, help="the bag to write; must not exist")
    args = parser.parse_args(argv)
    try:
        write_bag(args.folder, load_recording(args.recording))
    except FiberError as error:
        print(f"bag: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

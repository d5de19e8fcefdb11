"""A bag says what the recording says, to a library that knows nothing of ours and to ROS."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message

from fiber_bringup.bag import main, write_bag
from fiber_bringup.errors import PlaneError
from fiber_core.motion import SegmentMotion
from fiber_msgs_py import Topic, topics

try:
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    Reader = None

pytestmark = [
    pytest.mark.timeout(900),  # the first plan of all compiles every core
    pytest.mark.skipif(Reader is None, reason="NOT TESTED: bags, because rosbags is missing"),
]


def heard(folder):
    """Messages of a bag by topic, decoded by a library that knows nothing of ours."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found = {}
    with Reader(folder) as reader:
        for connection, time_ns, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def test_a_bag_says_the_same(run, tmp_path):
    write_bag(tmp_path / "bag", run.done)
    found = heard(tmp_path / "bag")
    names = ("layout", "targets", "trajectory", "segments", "margins", "joint_states", "outcome")
    assert set(found) == {f"/focal_plane/{name}" for name in names}
    stamp_ns = run.ended.stamp.ns
    for topic, messages in found.items():
        header = messages[0][1].header
        assert header.frame_id == "focal_plane" and messages[0][0] >= stamp_ns
        if not topic.endswith("joint_states"):
            assert header.stamp.sec * 10**9 + header.stamp.nanosec == stamp_ns
    assert found["/focal_plane/layout"][0][1].width == len(run.before)
    states = [message for _, message in found["/focal_plane/joint_states"]]
    units = run.done.units
    for message, counts in ((states[0], run.before), (states[-1], run.after)):
        assert list(message.name[:2]) == ["p0000/theta", "p0000/phi"]
        np.testing.assert_allclose(message.position.reshape(-1, 2), units.to_angles(counts))
    times = np.diff([time_ns for time_ns, _ in found["/focal_plane/joint_states"]])
    assert (times == 100_000_000).all()
    rows = found["/focal_plane/segments"][0][1]
    moved = SegmentMotion(run.done.decoded.start, *_segments(rows, run.done))
    np.testing.assert_allclose(moved.end, run.done.decoded.end)


def _segments(message, recording):
    kinds = np.dtype({"names": ["id", "joint", "duration", "velocity"],
                      "formats": ["<u4", "u1", "<u4", "<i4"],
                      "offsets": [field.offset for field in message.fields],
                      "itemsize": message.point_step})  # fmt: skip
    rows = np.frombuffer(message.data.tobytes(), kinds)
    rows = rows[rows["duration"] > 0]
    profile = 2 * recording.problem.plane.index_of(rows["id"]) + rows["joint"]
    counts = np.bincount(profile, minlength=2 * len(recording.outcome))
    units = recording.units
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return offsets, rows["duration"] * units.tick_s, rows["velocity"] * units.velocity_rad_s


def test_ros_reads_every_message_of_a_bag(run, tmp_path):
    write_bag(tmp_path / "bag", run.done)
    types = {topic.name: topic.type for topic in vars(topics).values() if isinstance(topic, Topic)}
    with Reader(tmp_path / "bag") as reader:
        for connection, _, data in reader.messages():
            message = deserialize_message(bytes(data), types[connection.topic[1:]])
            assert message.header.frame_id == "focal_plane"


def test_late_listeners_get_what_was_latched(run, tmp_path):
    write_bag(tmp_path / "bag", run.done)
    with Reader(tmp_path / "bag") as reader:
        durability = {
            c.topic.split("/")[-1]: c.ext.offered_qos_profiles[0].durability.name
            for c in reader.connections
        }
    assert durability["layout"] == "TRANSIENT_LOCAL" and durability["targets"] == "VOLATILE"


def test_a_bag_overwrites_nothing(run, tmp_path, capsys):
    with pytest.raises(PlaneError, match="exists"):
        write_bag(tmp_path, run.done)
    assert main([str(tmp_path / "none.npz"), str(tmp_path / "bag")]) == 1
    assert "no recording" in capsys.readouterr().err

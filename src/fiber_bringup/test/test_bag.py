# SPDX-License-Identifier: Apache-2.0
"""A bag holds what the recording holds, read by an independent library and by ROS."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message

from fiber_core.kinematics import forward
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome
from fiber_core.ragged import Parts
from fiber_msgs_py import Topic, topics
from fiber_msgs_py.point_clouds import POINTS, ViewState, arms_cloud
from fiber_recording.bag import main, write_bag
from fiber_recording.errors import BagError
from fiber_recording.recording import Measured

try:
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    Reader = None

pytestmark = [
    pytest.mark.timeout(900),  # the first plan of all compiles every core
    pytest.mark.skipif(Reader is None, reason="NOT TESTED: bags, because rosbags is missing"),
]


VIEW = {f"/{topic.name}" for topic in (topics.VIEW_ARMS, topics.VIEW_PLANE, topics.VIEW_TARGETS)}
TOPICS = {f"/{topic.name}": topic for topic in vars(topics).values() if isinstance(topic, Topic)}


def messages_of(folder):
    """Messages of a bag by topic, decoded by an independent library."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found = {}
    with Reader(folder) as reader:
        for connection, time_ns, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def test_a_bag_holds_what_the_recording_holds(run, tmp_path):
    write_bag(tmp_path / "bag", run.done)
    found = messages_of(tmp_path / "bag")
    names = ("layout", "targets", "trajectory", "segments", "corridors", "joint_states", "outcome")
    assert set(found) == {f"/focal_plane/{name}" for name in names} | VIEW
    stamp_ns = run.ended.stamp_ns
    for topic, messages in found.items():
        header = messages[0][1].header
        assert header.frame_id == "focal_plane" and messages[0][0] >= stamp_ns
        if not topic.endswith(("joint_states", "arms")):
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
    moved = SegmentMotion(run.done.executed.start, *_segments(rows, run.done))
    np.testing.assert_allclose(moved.end, run.done.executed.end)


def test_speeds_keep_their_limits_and_add_up_with_few_encoder_readings(run, tmp_path):
    read = run.done.measured
    seldom = Measured(read.row[::7], read.time_us[::7], read.counts[::7])
    write_bag(tmp_path / "bag", replace(run.done, measured=seldom))
    states = [message for _, message in messages_of(tmp_path / "bag")["/focal_plane/joint_states"]]
    speeds = np.stack([message.velocity.reshape(-1, 2) for message in states])
    limits = run.done.problem.plane.speeds
    assert (np.abs(speeds) <= limits + 1e-6).all() and not speeds[-1].any()
    way = run.done.units.to_angles(run.after - run.before)
    assert (np.abs(0.1 * speeds.sum(axis=0) - way) <= 0.2 * limits).all()


def test_a_bag_shows_the_arms_as_they_moved(run, tmp_path):
    write_bag(tmp_path / "bag", run.done)
    found = messages_of(tmp_path / "bag")
    plane, moved = run.done.problem.plane, run.done.executed
    pictures = found["/focal_plane/view/arms"]
    stamp_ns = run.ended.stamp_ns
    for time_ns, message in pictures:
        rows = np.frombuffer(
            message.data.tobytes(), arms_cloud(plane, moved.start, [0] * plane.n).dtype
        )
        tips = np.stack([rows["x"], rows["y"]], axis=1).reshape(2, plane.n, POINTS, 2)[1, :, -1]
        angles = moved((time_ns - stamp_ns) / 1e9)
        np.testing.assert_allclose(tips * 1e3, forward(plane, angles)[1], atol=1e-3)
    states = rows["state"].reshape(2, plane.n, POINTS)[0, :, 0]
    assert (states[run.done.outcome == Outcome.REACHED] == ViewState.REACHED).all()
    assert (np.diff([time_ns for time_ns, _ in pictures]) == 50_000_000).all()
    assert pictures[-1][0] == found["/focal_plane/outcome"][0][0]


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
    offsets = Parts.from_counts(counts).offsets
    return offsets, rows["duration"] * units.tick_s, rows["velocity"] * units.velocity_rad_s


def test_ros_reads_every_message_of_a_bag(run, tmp_path):
    write_bag(tmp_path / "bag", run.done)
    with Reader(tmp_path / "bag") as reader:
        for connection, _, data in reader.messages():
            message = deserialize_message(bytes(data), TOPICS[connection.topic].type)
            assert message.header.frame_id == "focal_plane"


def test_metadata_are_as_rosbag2_of_jazzy_reads_them(run, tmp_path):
    write_bag(tmp_path / "bag", run.done)
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    about = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert (about["version"], about["storage_identifier"]) == (9, "mcap")
    assert about["compression_mode"] == "", "chunks are compressed; a mode would need a plugin"
    assert about["relative_file_paths"] == [file["path"] for file in about["files"]] == ["bag.mcap"]
    for entry in about["topics_with_message_count"]:
        about_topic = entry["topic_metadata"]
        topic, (offered,) = TOPICS[about_topic["name"]], about_topic["offered_qos_profiles"]
        assert about_topic["type"].split("/")[-1] == topic.type.__name__
        assert about_topic["serialization_format"] == "cdr"
        assert about_topic["type_description_hash"].startswith("RIHS01_")
        assert offered["durability"] == topic.qos.durability.name.lower()
        assert (offered["history"], offered["reliability"]) == ("keep_last", "reliable")
        assert offered["depth"] == topic.qos.depth


def test_a_bag_overwrites_nothing(run, tmp_path, capsys):
    with pytest.raises(BagError, match="exists"):
        write_bag(tmp_path, run.done)
    assert main([str(tmp_path / "none.npz"), str(tmp_path / "bag")]) == 1
    assert "not a recording" in capsys.readouterr().err

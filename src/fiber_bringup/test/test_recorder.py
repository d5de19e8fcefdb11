"""The recorder beside a running graph: what it writes is what happened, and a bag says the same."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from fiber_bringup.bag import main, write_bag
from fiber_bringup.client import PlaneClient
from fiber_bringup.errors import PlaneError
from fiber_bringup.graph import Graph
from fiber_bringup.recorder import recording_name
from fiber_bringup.replay import settled_replay
from fiber_core.clearance import Safety, certify
from fiber_core.fields import random_field
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import Topic, topics
from fiber_viewer import EventKind, load_recording

pytestmark = pytest.mark.timeout(900)  # the first plan of all compiles every core

COMPILE_S, WAIT_S, ROBOTS = 600.0, 60.0, 37


def recorded(client, folder, stamp):
    client.until(lambda: "recorder" in client.times[stamp], WAIT_S, "the recording")
    return load_recording(folder / recording_name(stamp))


def new_targets(client, seed):
    rng = np.random.default_rng(seed)
    drawn = random_field(client.plane, rng, start=client.angles).problem
    return client.plane.ids[drawn.asked], drawn.targets[drawn.asked]


class Run:
    """Two plans of a small plane, one of them stopped on the way, and their recordings."""

    def __init__(self, folder, domain):
        bridge = {"robots": ROBOTS, "time_scale": 0.0}
        recorder = {"folder": str(folder), "seed": 5, "planner": "direct", "preset": "desi"}
        with (
            Graph(bridge=bridge, recorder=recorder, domain=domain) as graph,
            PlaneClient(domain) as client,
        ):
            client.wait_for_graph(COMPILE_S)
            self.plane, self.before = client.plane, client.units.to_counts(client.angles)
            self.targets = new_targets(client, 1)
            self.ended = client.reconfigure(*self.targets, COMPILE_S)
            self.told = settled_replay(client, self.ended, self.before, WAIT_S)
            self.after = client.units.to_counts(client.angles)
            self.done = recorded(client, folder, self.ended.stamp)
            assert graph.running
        with (
            Graph(bridge=bridge | {"time_scale": 0.2}, recorder=recorder, domain=domain),
            PlaneClient(domain) as client,
        ):
            client.wait_for_graph(COMPILE_S)
            stamp = client.send(*new_targets(client, 2))
            client.wait_ready(stamp, WAIT_S)
            client.start(WAIT_S)
            client.until(lambda: client.moving, WAIT_S, "motion")
            client.call(topics.STOP, WAIT_S)
            self.halted = client.wait_end(stamp, WAIT_S)
            self.stopped = recorded(client, folder, stamp)
            self.at_rest = client.units.to_counts(client.angles)


@pytest.fixture(scope="module")
def run(tmp_path_factory, new_domain):
    return Run(tmp_path_factory.mktemp("recordings"), new_domain())


def test_the_motion_is_that_of_the_bytes(run):
    motion = run.done.motion
    for name in ("start", "offsets", "ticks", "velocity"):
        np.testing.assert_array_equal(getattr(motion, name), getattr(run.told.motion, name))
    np.testing.assert_array_equal(motion.start, run.before)
    np.testing.assert_array_equal(motion.end, run.after)
    np.testing.assert_array_equal(run.done.started, run.told.started)
    assert run.done.started.all() and np.diff(motion.offsets).any()


def test_what_was_asked_and_what_became_of_it(run):
    problem = run.done.problem
    np.testing.assert_array_equal(problem.plane.ids[problem.asked], run.targets[0])
    np.testing.assert_allclose(problem.targets[problem.asked], run.targets[1])
    np.testing.assert_array_equal(run.done.outcome, run.ended.outcome)
    np.testing.assert_allclose(run.done.error_mm, run.ended.error_mm)
    about = run.done.about
    assert (about["seed"], about["planner"], about["plan_ns"]) == (5, "direct", run.ended.stamp.ns)
    assert problem.plane.name == "desi" and about["notes"] == []
    assert about["report"]["reached"] == run.ended.count(Outcome.REACHED)


def test_the_certificate_is_that_of_the_motion(run):
    certificate = certify(run.done.problem.plane, run.done.decoded, Safety())
    assert run.done.about["certificate"]["ok"] is certificate.ok is True
    assert run.done.about["report"]["min_clearance_mm"] == certificate.min_gap_mm


def test_planned_curves_begin_and_end_with_the_motion(run):
    planned, motion = run.done.planned, run.done.decoded
    np.testing.assert_allclose(planned.start, motion.start, atol=1e-5)
    np.testing.assert_allclose(planned.end, motion.end, atol=2e-3)


def test_encoders_follow_the_orders(run):
    measured, motion, units = run.done.measured, run.done.decoded, run.done.units
    moving = measured.time_us > 0
    assert moving.sum() > ROBOTS and set(measured.row[moving]) == set(range(ROBOTS))
    exact = np.array(
        [motion(t)[r] for t, r in zip(measured.time_us[moving] * 1e-6, measured.row[moving])]
    )
    off = np.abs(units.to_angles(measured.counts[moving]) - exact)
    # a frame lasts 0.2 ms, a robot starts up to 20 us late: at 3 rad/s less than a milliradian
    assert off.max() < 1e-3


def test_all_frames_are_counted_and_a_go_is_told(run):
    load, events = run.done.load, run.done.events
    assert load.frames.sum() > 3 * ROBOTS and load.bytes.sum() > 20 * ROBOTS
    assert load.edges_s[0] < 0 < load.edges_s[-1]
    assert events.kind.tolist() == [EventKind.GO] and events.time_s[0] == 0.0
    assert not events.bad.any()
    assert run.done.about["codes"]["fault"]["33"] == "memory"


def test_a_stopped_plan_is_recorded_as_far_as_it_went(run):
    stopped = run.stopped
    kinds = stopped.events.kind.tolist()
    assert kinds.count(EventKind.GO) == 1 and kinds.count(EventKind.STOP) >= 1
    at_s = stopped.events.time_s[kinds.index(EventKind.STOP)]
    assert 0 < at_s and stopped.decoded.makespan_s <= at_s
    assert any("stopped at" in note for note in stopped.about["notes"])
    assert (stopped.reason == Reason.STOPPED).any()
    np.testing.assert_array_equal(stopped.outcome, run.halted.outcome)
    # cut at a whole tick: robots stand where the recording leaves them, but for that tick
    off = stopped.units.to_angles(stopped.motion.end - run.at_rest)
    assert np.abs(off).max() < 3.2 * 1.3 * stopped.units.tick_s


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
    names = ("layout", "targets", "trajectory", "segments", "joint_states", "outcome")
    assert set(found) == {f"/focal_plane/{name}" for name in names}
    stamp_ns = run.ended.stamp.ns
    for topic, messages in found.items():
        header = messages[0][1].header
        assert header.frame_id == "focal_plane" and messages[0][0] >= stamp_ns
        if not topic.endswith("joint_states"):
            assert header.stamp.sec * 10**9 + header.stamp.nanosec == stamp_ns
    assert found["/focal_plane/layout"][0][1].width == ROBOTS
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
    counts = np.bincount(profile, minlength=2 * ROBOTS)
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

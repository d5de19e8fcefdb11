# SPDX-License-Identifier: Apache-2.0
"""Messages made to end nodes, sent on every topic of a real graph, at rest and in motion."""

import array
import copy
import time

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import Image, JointState, PointCloud2, PointField
from std_msgs.msg import Header, UInt8MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fiber_bringup.graph import Graph
from fiber_client.client import PlaneClient
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import PlanStamp, Topic, topics
from fiber_msgs_py.callback_guard import take_failures
from fiber_node import RosClient, WaitError

pytestmark = pytest.mark.timeout(900)

COMPILE_S, WAIT_S, ROBOTS = 600.0, 60.0, 19
NODES = {"bridge", "planner", "discretizer", "recorder", "viewer", "metrology"}
ALL_TOPICS = [value for value in vars(topics).values() if isinstance(value, Topic)]
# viewers of others and sectors are not in this graph, and one of two kinds of exposures is heard
UNHEARD = "/view/", "_sector", "camera/spots", "/lights"


def header(sec=0, nanosec=1, frame_id="focal_plane"):
    made = Header(frame_id=frame_id)
    made.stamp.sec, made.stamp.nanosec = sec, nanosec
    return made


def headers():
    yield header()
    yield header(sec=-1)
    yield header(nanosec=2**32 - 1)
    yield header(frame_id="map")


COLUMNS = {
    "layout": {
        "id": 6, "kind": 2, "enabled": 2, "bus": 4, "address": 4, "x": 8, "y": 8, "arm_theta": 8,
        "arm_phi": 8, "arm_radius": 8, "theta_radius": 8, "spacing": 8,
        "envelope": 8, "theta_min": 8,
        "theta_max": 8, "phi_min": 8, "phi_max": 8, "theta_speed": 8, "phi_speed": 8,
        "tick_us": 6, "quantum_prad": 6, "velocity_bits": 2, "duration_bits": 2,
        "phi_outline": 8,
    },
    "targets": {"id": 6, "x": 8, "y": 8},
    "segments": {"id": 6, "joint": 2, "duration": 6, "velocity": 5},
    "held/planner": {"id": 6, "reason": 2, "stage": 2},
    "held/discretizer": {"id": 6, "reason": 2, "stage": 2},
    "outcome": {"id": 6, "outcome": 2, "reason": 2, "error": 8},
    "corridors": {
        "id": 6, "lasts": 7, "theta_low": 7, "theta_high": 7, "phi_low": 7, "phi_high": 7
    },
    "frames": {
        "time": 8, "bus": 4, "address": 4, "ten_bit": 2, "read": 2, "ack": 2, "length": 4,
        "bytes": 2,
    },
}  # fmt: skip
BYTES = {2: 1, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}  # of the datatypes of PointField


def clouds(name):
    """Tables with the columns of a topic, and impossible sizes or values."""
    columns, fields, at = COLUMNS.get(name, {"x": 7}), [], 0
    for column, datatype in columns.items():
        fields.append(PointField(name=column, offset=at, datatype=datatype, count=1))
        at += BYTES[datatype]

    def table(rows, byte=0):
        return PointCloud2(
            header=header(),
            height=1,
            width=rows,
            fields=copy.deepcopy(fields),
            point_step=at,
            row_step=rows * at,
            data=array.array("B", bytes([byte]) * (rows * at)),
        )

    yield PointCloud2()
    for rows, byte in ((0, 0), (1, 0), (3, 0), (1, 255), (2, 127)):
        if (rows, byte) != (1, 0) or name not in ("held/planner", "held/discretizer", "outcome"):
            yield table(rows, byte)
    for offset, count in ((2**31, 1), (0, 2**31 - 1), (2**31 - 1, 2**31)):
        huge = table(0)
        huge.point_step = 2**32 - 1
        huge.fields[-1].offset, huge.fields[-1].count = offset, count
        yield huge
    wrong = table(1)
    wrong.fields[0].datatype = 99
    yield wrong
    twice = table(1)
    twice.fields.append(twice.fields[0])
    yield twice
    short = table(2)
    short.data = short.data[:-1]
    yield short
    for each in headers():
        message = table(1, 255)
        message.header = each
        yield message


def joints():
    for each in headers():
        yield JointState(header=each)
        yield JointState(header=each, name=["p0001/theta"] * 2, position=[np.nan])
        yield JointState(header=each, name=["p0001/theta", "p0001/phi"], position=[np.inf, 1.0])
        yield JointState(header=each, name=["p9999999999/phi", "\x00"])


def trajectories():
    for each in headers():
        yield JointTrajectory(header=each)
        point = JointTrajectoryPoint(positions=[np.nan, 1e300], velocities=[1.0])
        point.time_from_start.sec = -(2**31)
        names = ["p0000/theta", "p0000/phi"]
        yield JointTrajectory(header=each, joint_names=names, points=[point, point])
        yield JointTrajectory(header=each, joint_names=names[:1], points=[point])


def statuses():
    for level in (0, 99, 255):
        for value in ("nan", "-1", "9" * 5000, str(2**63)):
            keys = ("fraction", "stamp_ns", "plan_ns", "attempt", "since_ns", "refused", "frames")
            yield DiagnosticStatus(
                level=bytes([level]),
                name="bridge: bus 0",
                values=[KeyValue(key=key, value=value) for key in keys],
            )


def images():
    for sizes in ((0, 0, 0), (2**32 - 1, 0, 0), (0, 2**32 - 1, 0), (2**32 - 1,) * 3, (4, 4, 8)):
        for encoding in ("mono16", "mono8", "", "rgb8"):
            height, width, step = sizes
            yield Image(header=header(), height=height, width=width, step=step, encoding=encoding)
    for each in headers():
        pixels = array.array("B", [255] * 32)
        yield Image(header=each, height=4, width=4, step=8, encoding="mono16", data=pixels)


def raw():
    for size in (0, 1, 7, 64, 4096):
        yield UInt8MultiArray(data=array.array("B", bytes(size)))
        yield UInt8MultiArray(data=array.array("B", [255] * size))


def killers(topic):
    """Every message made to end the nodes that receive a topic."""
    if topic.type is PointCloud2:
        return list(clouds(topic.name.partition("/")[2]))
    if topic.type is JointState:
        return list(joints())
    if topic.type is JointTrajectory:
        return list(trajectories())
    if topic.type is Time:
        return [Time(), Time(sec=-1), Time(sec=2**31 - 1, nanosec=2**32 - 1)]
    if topic.type is DiagnosticStatus:
        return list(statuses())
    if topic.type is Image:
        return list(images())
    if topic.type is UInt8MultiArray:
        return list(raw())
    assert topic.type is DiagnosticArray, f"no messages made to end nodes for {topic}"
    return [DiagnosticArray(header=each, status=[one]) for each in headers() for one in statuses()]


class Attacker:
    """A plain publisher on every topic; late subscribers get its last messages, too."""

    def __init__(self, ros, client):
        self._client = client
        self._attacks = [(topic.publisher(ros.node), killers(topic)) for topic in ALL_TOPICS]
        used = [each for each, _ in self._attacks if not any(u in each.topic_name for u in UNHEARD)]
        client.wait_for(lambda: all(p.get_subscription_count() for p in used), WAIT_S)

    def attack(self):
        """Send all killers; return how many."""
        for publisher, messages in self._attacks:
            for message in messages:
                publisher.publish(message)
        return sum(len(messages) for _, messages in self._attacks)


def new_targets(client, seed):
    rng = np.random.default_rng(seed)
    drawn = random_field(client.plane, rng, start=client.angles).problem
    return client.plane.ids[drawn.asked], drawn.targets[drawn.asked]


def wait_for_refusals(client):
    """Wait until no refusal has been new for two seconds: a later one would end the next plan."""
    counts, since_s = {}, time.monotonic()

    def quiet():
        nonlocal counts, since_s
        now = {name: client.statuses[name].count("refused") for name in NODES}
        if now != counts:
            counts, since_s = now, time.monotonic()
        return time.monotonic() > since_s + 2.0

    client.wait_for(quiet, WAIT_S, "the last refusal")


def check_alive(graph, client):
    """All nodes publish diagnostics of their own after now, and none has ended."""
    wait_for_refusals(client)
    before = client.statuses
    client.wait_for(
        lambda: all(client.statuses[name] is not before.get(name) for name in NODES), WAIT_S
    )
    assert graph.running
    assert {node.get_name() for node in graph.nodes} == NODES


def test_killers_on_every_topic_end_no_node_and_plans_end_with_outcomes(tmp_path, new_domain):
    domain = new_domain()
    bridge = {"robots": ROBOTS, "time_scale": 0.5}
    parts = {"recorder": {"folder": str(tmp_path)}, "viewer": {}, "metrology": {"pixels": True}}
    with (
        Graph(bridge=bridge, domain=domain, **parts) as graph,
        PlaneClient(domain) as client,
        RosClient("attacker", domain) as ros,
    ):
        client.wait_for_graph(COMPILE_S, also=("recorder",))
        plane = client.plane
        client.reconfigure(*new_targets(client, 1), COMPILE_S)  # compiles
        attacker = Attacker(ros, client)
        assert attacker.attack() > 150
        check_alive(graph, client)
        client.call_service(topics.CONFIGURE, WAIT_S)  # sends the layout again
        client.wait_for_graph(WAIT_S)
        assert np.array_equal(client.plane.ids, plane.ids)

        stamp = client.send_targets(*new_targets(client, 2))
        client.wait_until_ready(stamp, WAIT_S)
        client.start(WAIT_S)
        client.wait_for(lambda: client.moving, WAIT_S, "motion")
        attacker.attack()
        ended = client.wait_for_outcome(stamp, WAIT_S)
        check_alive(graph, client)
        assert np.array_equal(ended.ids, plane.ids)
        assert ended.count(Outcome.REACHED) > ROBOTS // 2

        stamp = client.send_targets(*new_targets(client, 3))
        client.wait_until_ready(stamp, WAIT_S)
        client.start(WAIT_S)
        client.wait_for(lambda: client.moving, WAIT_S, "motion")
        attacker.attack()
        client.call_service(topics.STOP, WAIT_S)
        ended = client.wait_for_outcome(stamp, WAIT_S)
        assert (ended.reason == Reason.STOPPED).any()
        client.wait_for(lambda: "recorder" in client.times[stamp], WAIT_S, "the recording")
        assert (tmp_path / f"plan-{PlanStamp(ended.stamp_ns)}.npz").exists()
        check_alive(graph, client)


def test_after_an_error_in_motion_stop_is_served_and_the_node_lives(new_domain, monkeypatch):
    domain = new_domain()
    bridge = {"robots": ROBOTS, "time_scale": 0.5}
    with Graph(bridge=bridge, domain=domain) as graph, PlaneClient(domain) as client:
        client.wait_for_graph(COMPILE_S)
        stamp = client.send_targets(*new_targets(client, 1))
        client.wait_until_ready(stamp, COMPILE_S)
        with pytest.raises(WaitError), client.stops_on_error(WAIT_S):
            client.start(WAIT_S)
            client.wait_for(lambda: client.moving, WAIT_S, "motion")
            client.wait_for_outcome(stamp, 0.2)
        assert (client.wait_for_outcome(stamp, WAIT_S).reason == Reason.STOPPED).any()

        client.call_service(topics.CLEAR, WAIT_S)
        stamp = client.send_targets(*new_targets(client, 2))
        client.wait_until_ready(stamp, WAIT_S)
        client.start(WAIT_S)
        client.wait_for(lambda: client.moving, WAIT_S, "motion")
        node = next(node for node in graph.nodes if node.get_name() == "bridge")

        def fail(*_):
            raise ZeroDivisionError("a session without care")

        with monkeypatch.context() as patch:
            patch.setattr(node._session, "advance", fail)
            client.wait_for(lambda: "without care" in client.statuses["bridge"].text, WAIT_S)
        client.call_service(topics.STOP, WAIT_S)
        assert (client.wait_for_outcome(stamp, WAIT_S).reason == Reason.STOPPED).any()
        assert graph.running
    assert {type(error) for error in take_failures()} == {ZeroDivisionError}


def test_latched_killers_do_not_end_a_graph_that_starts_later(tmp_path, new_domain):
    domain = new_domain()
    with RosClient("attacker", domain) as ros:
        publishers = [topic.publisher(ros.node) for topic in ALL_TOPICS]
        for topic, publisher in zip(ALL_TOPICS, publishers):
            for message in killers(topic):
                publisher.publish(message)
        parts = {"recorder": {"folder": str(tmp_path)}, "viewer": {}, "metrology": {}}
        with (
            Graph(bridge={"robots": ROBOTS, "time_scale": 0.0}, domain=domain, **parts) as graph,
            PlaneClient(domain) as client,
        ):
            client.wait_for_graph(COMPILE_S, also=("recorder",))
            ended = client.reconfigure(*new_targets(client, 1), COMPILE_S)
            assert ended.count(Outcome.REACHED) > ROBOTS // 2
            check_alive(graph, client)

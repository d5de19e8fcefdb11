# SPDX-License-Identifier: Apache-2.0
"""The URDF of a robot, read by its own rules: its frames are where the kinematics put them."""

import math
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from fiber_client.robot_model import DESCRIPTION, RobotModelNode
from fiber_client.urdf import robot_urdf
from fiber_core.errors import FiberError
from fiber_core.kinematics import forward
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import PlanStamp, layout, topics
from fiber_node import BRIDGE, Claim, RosClient

PLANE = preset("desi_outlines", 19)
ROBOT, FRAME = 7, "north/focal_plane"
WAIT_S = 60.0
VIEWING = Path(__file__).parents[3] / "docs" / "viewing.md"


def numbers(text):
    return [float(each) for each in text.split()]


def frames(text, positions):
    """Place [m] and direction [rad] of every link in the frame of the root, in the plane."""
    root = ET.fromstring(text)
    links = {link.get("name") for link in root.iter("link")}
    joints = {joint.find("child").get("link"): joint for joint in root.iter("joint")}
    (base,) = links - set(joints)

    def frame(link):
        if link == base:
            return 0.0, 0.0, 0.0
        joint = joints[link]
        x, y, turn = frame(joint.find("parent").get("link"))
        dx, dy, dz = numbers(joint.find("origin").get("xyz"))
        assert numbers(joint.find("origin").get("rpy")) == [0, 0, 0] and dz == 0
        x += dx * math.cos(turn) - dy * math.sin(turn)
        y += dx * math.sin(turn) + dy * math.cos(turn)
        if joint.get("type") == "revolute":
            assert numbers(joint.find("axis").get("xyz")) == [0, 0, 1]
            turn += positions[joint.get("name")]
        return x, y, turn

    return base, {link: frame(link) for link in links}


def test_elbow_and_tip_are_where_the_kinematics_put_them():
    text = robot_urdf(PLANE, ROBOT, FRAME)
    rng = np.random.default_rng(4)
    for _ in range(20):
        angles = rng.uniform(-3.0, 3.0, (PLANE.n, 2))
        theta, phi = angles[ROBOT]
        base, found = frames(text, {"p0007/theta": theta, "p0007/phi": phi})
        assert base == FRAME
        elbow, tip = forward(PLANE, angles)
        np.testing.assert_allclose(found["north/p0007/phi_arm"][:2], elbow[ROBOT] / 1e3, atol=1e-9)
        np.testing.assert_allclose(found["north/p0007/tip"][:2], tip[ROBOT] / 1e3, atol=1e-9)
        assert found["north/p0007/tip"][2] == pytest.approx(theta + phi)


def test_limits_speeds_and_boxes_are_those_of_the_plane():
    root = ET.fromstring(robot_urdf(PLANE, ROBOT, FRAME))
    for k, name in enumerate(("theta", "phi")):
        (joint,) = (j for j in root.iter("joint") if j.get("name") == f"p0007/{name}")
        limit = {key: float(value) for key, value in joint.find("limit").attrib.items()}
        assert [limit["lower"], limit["upper"]] == PLANE.limits[ROBOT, k].tolist()
        assert limit["velocity"] == PLANE.speeds[ROBOT, k]
    (arm,) = (link for link in root.iter("link") if link.get("name") == "north/p0007/phi_arm")
    size = np.array(numbers(arm.find("visual/geometry/box").get("size")))[:2] * 1e3
    middle = np.array(numbers(arm.find("visual/origin").get("xyz")))[:2] * 1e3
    corners, radius = PLANE.phi_vertices[ROBOT], PLANE.phi_radius[ROBOT]
    np.testing.assert_allclose(middle - size / 2, corners.min(axis=0) - radius, atol=1e-9)
    np.testing.assert_allclose(middle + size / 2, corners.max(axis=0) + radius, atol=1e-9)


def test_the_description_is_a_parameter_as_the_command_of_the_docs_hands_it_over():
    command = next(line for line in VIEWING.read_text().splitlines() if line.startswith("URDF="))
    text = robot_urdf(PLANE, ROBOT, FRAME)
    echoed = f"{text}\n---\n"  # as `ros2 topic echo --field data` prints it
    script = command[command.rindex("|") + 1 :].removesuffix(')"')
    done = subprocess.run(script, shell=True, input=echoed, capture_output=True, text=True)
    context = Context()
    given = ["--ros-args", "-p", f"robot_description:={done.stdout.rstrip()}"]
    rclpy.init(args=given, context=context)
    node = rclpy.create_node("robot_state_publisher", context=context)
    value = node.declare_parameter("robot_description", "").value
    node.destroy_node()
    context.try_shutdown()
    assert frames(value, dict.fromkeys(("p0007/theta", "p0007/phi"), 0.5)) == frames(
        text, dict.fromkeys(("p0007/theta", "p0007/phi"), 0.5)
    )


def test_a_robot_that_is_not_there_is_an_error():
    with pytest.raises(FiberError, match="robot 99 has no description"):
        robot_urdf(PLANE, 99, FRAME)


def test_a_subscriber_that_comes_later_receives_the_description(new_domain):
    domain, received = new_domain(), []
    with RosClient("peer", domain, namespace="/north") as peer:
        claim = Claim(peer.node, BRIDGE)
        units, now = WireUnits.for_plane(PLANE), PlanStamp(peer.node.get_clock().now().nanoseconds)
        topics.LAYOUT.publisher(peer.node).publish(layout.encode(PLANE, units, now, claim.id))
        first = peer.collect(DESCRIPTION)
        node = peer.add_node(
            lambda **options: RobotModelNode(namespace="/north", **options), robot_model=ROBOT
        )
        peer.wait_for(lambda: first, WAIT_S)
        statuses = peer.collect(topics.DIAGNOSTICS)
        peer.wait_for(lambda: any(f"robot {ROBOT} is" in str(each) for each in statuses), WAIT_S)
        other = preset("desi", 19)  # arms of another shape
        for plane in (PLANE, PLANE, other):  # the bridge repeats it
            units = WireUnits.for_plane(plane)
            node._on_layout(layout.encode(plane, units, now, claim.id))
        peer.wait_for(lambda: first[-1].data == robot_urdf(other, ROBOT, FRAME), WAIT_S)
        assert len(first) == 2
        context = Context()
        rclpy.init(args=[], context=context, domain_id=domain)
        stranger = rclpy.create_node("stranger", context=context)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        stranger.create_subscription(String, "/north/robot_description", received.append, latched)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(stranger)

        def heard():
            executor.spin_once(timeout_sec=0.02)
            return received

        peer.wait_for(heard, WAIT_S)
        executor.shutdown()
        stranger.destroy_node()
        context.try_shutdown()
    assert received[0].data == robot_urdf(other, ROBOT, FRAME)

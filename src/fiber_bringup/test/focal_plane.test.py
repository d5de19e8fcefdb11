# SPDX-License-Identifier: Apache-2.0
"""The launch file under launch_testing: the plane of /north starts, answers, moves, and ends.

`test_launch_testing.py` runs it, and so does `launch_test` with the path of this file.
"""

import tempfile
import time
import unittest

import launch_testing.actions
import launch_testing.asserts
import rclpy
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

WAIT_S = 120.0
WAITS = {
    "bridge": "waits for targets",
    "planner": "waits for a bridge and for targets",
    "discretizer": "waits for a bridge and for trajectories",
    "recorder": "waits for a bridge and for plans",
    "viewer": "waits for a bridge and for subscribers",
}
ROBOTS = 7


def generate_test_description():
    path = [FindPackageShare("fiber_bringup"), "launch", "focal_plane.launch.py"]
    folder = tempfile.mkdtemp(prefix="recordings-")
    arguments = {"robots": str(ROBOTS), "namespace": "north", "folder": folder}
    plane = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution(path)),
        launch_arguments=arguments.items(),
    )
    return LaunchDescription([plane, launch_testing.actions.ReadyToTest()])


class TestPlane(unittest.TestCase):
    """A program that knows the names of topics and services and nothing else."""

    @classmethod
    def setUpClass(cls):
        rclpy.init()
        cls.node = rclpy.create_node("stranger")

    @classmethod
    def tearDownClass(cls):
        cls.node.destroy_node()
        rclpy.shutdown()

    def call(self, kind, name, **fields):
        client = self.node.create_client(kind, name)
        self.assertTrue(client.wait_for_service(WAIT_S), name)
        future = client.call_async(kind.Request(**fields))
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=WAIT_S)
        self.node.destroy_client(client)
        return future.result()

    def test_each_node_says_what_it_waits_for(self, proc_output):
        for words in WAITS.values():
            proc_output.assertWaitFor(words, timeout=WAIT_S, stream="stderr")

    def test_parameters_come_from_the_file_and_the_arguments(self):
        for node in WAITS:
            names = ["use_sim_time"]
            answer = self.call(GetParameters, f"/north/{node}/get_parameters", names=names)
            self.assertFalse(answer.values[0].bool_value)
        answer = self.call(GetParameters, "/north/bridge/get_parameters", names=["robots"])
        self.assertEqual(answer.values[0].integer_value, ROBOTS)

    def test_a_subscriber_with_default_qualities_hears_the_robots(self):
        heard = []
        self.node.create_subscription(
            JointState, "/north/focal_plane/joint_states", heard.append, 10
        )
        end = time.monotonic() + WAIT_S
        while not heard and time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.1)
        joints = [name for name in heard[0].name if name.endswith(("/theta", "/phi"))]
        self.assertEqual(len(joints), 2 * ROBOTS)

    def test_stop_and_clear_are_answered_at_rest(self):
        for name in ("stop", "clear"):
            self.assertTrue(self.call(Trigger, f"/north/focal_plane/{name}").success)


@launch_testing.post_shutdown_test()
class TestEnd(unittest.TestCase):
    """After Ctrl-C."""

    def test_all_processes_end_with_code_0(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info)

# SPDX-License-Identifier: Apache-2.0
"""A node that follows /clock: a missing clock is named, and stamps are those of the clock."""

import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from fiber_node import PlaneNode, Reporter

pytestmark = pytest.mark.timeout(60)


@pytest.fixture
def context(new_domain):
    made = Context()
    rclpy.init(args=[], context=made, domain_id=new_domain())
    yield made
    made.try_shutdown()


def test_a_missing_clock_is_named_within_two_seconds_and_stamps_follow_it(context, capfd):
    use = Parameter("use_sim_time", value=True)
    node = PlaneNode("planner", context=context, parameter_overrides=[use])
    node.parameters.finish()
    begin = time.monotonic()
    Reporter(node, "planner")
    stranger = Node("stranger", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    executor.add_node(stranger)
    received = []
    stranger.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)

    def until(holds):
        while not holds():
            assert time.monotonic() < begin + 20.0
            executor.spin_once(timeout_sec=0.05)

    until(lambda: received and "no time on /clock" in received[-1].status[0].message)
    assert time.monotonic() < begin + 2.0
    assert "no time on /clock, and use_sim_time is set" in capfd.readouterr().err
    assert received[-1].status[0].level == b"\x01"

    clock = stranger.create_publisher(Clock, "/clock", 10)
    time_message = Clock()
    time_message.clock.sec = 77

    def clock_is_followed():
        clock.publish(time_message)
        return received[-1].header.stamp.sec == 77

    until(clock_is_followed)
    executor.shutdown()
    node.destroy_node()
    stranger.destroy_node()

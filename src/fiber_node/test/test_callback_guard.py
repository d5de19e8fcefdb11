# SPDX-License-Identifier: Apache-2.0
"""Exceptions that escape callbacks, and floods of refused messages, on real nodes."""

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from fiber_msgs_py import Level, RateLimit, diagnostics, topics
from fiber_msgs_py.callback_guard import guarded, guarded_service, take_failures
from fiber_node import Reporter, RosClient

WAIT_S = 20.0


@pytest.fixture
def ros(new_domain):
    with RosClient("guarded", new_domain()) as client:
        yield client


def fail(*_):
    raise ZeroDivisionError("a callback without care")


def test_an_exception_in_a_subscription_is_reported_and_the_node_goes_on(ros, capfd):
    received = []

    def observe(message):
        received.append(message)
        fail()

    statuses = ros.collect(topics.DIAGNOSTICS)
    report = Reporter(ros.node, "planner")
    topics.LAYOUT.subscription(ros.node, observe)
    publisher = topics.LAYOUT.publisher(ros.node)
    for number in range(1, 6):
        publisher.publish(PointCloud2())
        ros.wait_for(lambda n=number: len(received) == n, WAIT_S)
    assert [type(error) for error in take_failures()] == [ZeroDivisionError] * 5
    assert report.refused == 1  # one report a second
    ros.wait_for(
        lambda: any(
            status.level is Level.ERROR and "a callback without care" in status.text
            for message in statuses
            for status in diagnostics.decode(message)
        ),
        WAIT_S,
    )
    log = capfd.readouterr().err
    assert log.count("focal_plane/layout: unexpected ZeroDivisionError") == 1
    assert "test_callback_guard.py, line" in log and "Traceback" in log


def test_an_exception_in_a_service_is_answered_as_a_failure(ros):
    topics.STOP.server(ros.node, fail)
    client = topics.STOP.client(ros.node)
    ros.wait_for(client.service_is_ready, WAIT_S)
    for _ in range(2):
        future = client.call_async(Trigger.Request())
        ros.wait_for(future.done, WAIT_S)
        answer = future.result()
        assert not answer.success and "a callback without care" in answer.message
    assert len(take_failures()) == 2


def test_what_fails_because_the_node_ends_is_no_fault(new_domain, capfd):
    context = Context()
    rclpy.init(args=[], context=context, domain_id=new_domain())
    node = Node("bridge", context=context)
    look = guarded(node, "plans", node.get_topic_names_and_types)
    look()
    context.shutdown()  # as a signal does, while a callback is at work
    look()
    stop = guarded_service(node, "stop", lambda *_: node.get_topic_names_and_types())
    answered = stop(Trigger.Request(), Trigger.Response())
    assert not answered.success and answered.message == "stop: the node ends"
    node.destroy_node()
    assert not take_failures() and "unexpected" not in capfd.readouterr().err


def test_a_source_logs_one_line_a_second_with_the_number_left_out():
    now_s = [10.0]
    limit = RateLimit(clock=lambda: now_s[0])
    assert limit.line("layout", "a") == "a"
    assert limit.line("layout", "b") is None and limit.line("layout", "c") is None
    assert limit.line("targets", "d") == "d"
    assert limit.overdue() == []
    now_s[0] += 1.0
    assert limit.line("layout", "e") == "e (2 such lines were left out before)"
    assert limit.line("layout", "f") is None
    now_s[0] += 1.0
    assert limit.overdue() == [("layout", 1)]
    assert limit.line("layout", "g") == "g"


def test_a_flood_of_refused_messages_logs_one_line_and_counts_all(ros, capfd):
    report = Reporter(ros.node, "planner")
    for number in range(1000):
        report.refuse(f"layout refused: number {number}", "layout")
    assert report.refused == 1000
    log = capfd.readouterr().err
    assert 1 <= log.count("layout refused: number") < 20

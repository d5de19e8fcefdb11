# SPDX-License-Identifier: Apache-2.0
"""Topics, their qualities of service, and the stamps that name plans."""

import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import UInt8

from fiber_msgs_py import FRAME_ID, MessageError, PlanStamp, Service, Topic, topics
from fiber_msgs_py.stamps import check_frame, header, ns_from_time, time_from_ns


def test_no_two_topics_share_a_name_and_all_have_a_quality():
    all_topics = [value for value in vars(topics).values() if isinstance(value, Topic)]
    services = [value for value in vars(topics).values() if isinstance(value, Service)]
    names = [entry.name for entry in all_topics + services]
    assert len(set(names)) == len(names) >= 16
    assert all(name.startswith("focal_plane/") for name in names if name != "/diagnostics")
    assert all(t.qos.reliability == ReliabilityPolicy.RELIABLE for t in all_topics)


def test_a_late_subscriber_gets_the_plan():
    for topic in (
        topics.LAYOUT,
        topics.TRAJECTORY,
        topics.SEGMENTS,
        topics.CORRIDORS,
        topics.HELD_BY_PLANNER,
        topics.HELD_BY_DISCRETIZER,
    ):
        assert topic.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL and topic.qos.depth == 1
    # one plan may end as the next begins, and no outcome may be lost for the other
    assert topics.OUTCOME.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert topics.OUTCOME.qos.depth > 1


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_time_round_trip(ns):
    assert ns_from_time(time_from_ns(ns)) == ns
    assert ns_from_time(PlanStamp(ns).to_time()) == ns


@given(st.integers(0, 2**62), st.integers(0, 2**62))
def test_stamps_are_ordered_by_time(a, b):
    end = 2**31 * 10**9
    assert (PlanStamp(a % end) < PlanStamp(b % end)) == (a % end < b % end)


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_a_stamp_travels_in_the_header_and_the_frame_is_always_the_same(ns):
    message = PointCloud2(header=header(PlanStamp(ns)))
    assert PlanStamp.of(message) == PlanStamp(ns)
    assert ns_from_time(message.header.stamp) == ns
    assert message.header.frame_id == FRAME_ID
    check_frame(message, "targets")


@pytest.mark.parametrize("frame", ["map", "", "/focal_plane", "focal_plane/attempt_2"])
def test_another_frame_is_refused(frame):
    message = PointCloud2()
    message.header.frame_id = frame
    with pytest.raises(MessageError, match="frame_id"):
        check_frame(message, "targets")


@pytest.mark.parametrize("ns", [-1, 2**31 * 10**9])
def test_a_number_outside_the_range_of_stamps_is_refused(ns):
    with pytest.raises(MessageError, match=f"ns {ns} does not fit"):
        PlanStamp(ns)


@pytest.mark.parametrize(("sec", "nanosec"), [(-1, 0), (0, 10**9)])
def test_an_impossible_time_is_refused(sec, nanosec):
    with pytest.raises(MessageError, match="is not a valid time"):
        ns_from_time(Time(sec=sec, nanosec=nanosec))


def test_the_messages_check_their_own_fields_in_this_suite():
    with pytest.raises(AssertionError):
        UInt8(data=256)

# SPDX-License-Identifier: Apache-2.0
"""PlaneClient alone: a test publishes what the nodes of the graph would."""

import time

import numpy as np
import pytest

from fiber_client import NodeLost, PlaneClient, PlaneError, PlaneRefusal
from fiber_core.frame_log import FrameLog
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    Attempt,
    Level,
    PlanStamp,
    Progress,
    Status,
    diagnostics,
    frames,
    joint_states,
    layout,
    outcome,
    progress,
    targets,
    topics,
)
from fiber_node import BRIDGE, DISCRETIZER, PLANNER, Claim, RosClient, WaitError

pytestmark = pytest.mark.timeout(120)

WAIT_S = 20.0
PLANE = preset("desi", 7)
UNITS = WireUnits.for_plane(PLANE)
STILL = np.zeros((7, 2))
PLAN = Attempt.first(PlanStamp(1_000))
SECOND = PLAN.next(PlanStamp(1_001), since_ns=900)
OTHER = Attempt.first(PlanStamp(2_000))
TOPICS = (
    topics.LAYOUT, topics.JOINT_STATES, topics.TARGETS, topics.FRAMES, topics.OUTCOME,
    topics.PROGRESS, topics.DIAGNOSTICS,
)  # fmt: skip


class Nodes:
    """The nodes of the graph, as the client sees them."""

    def __init__(self, ros, client):
        self.client, self.node = client, ros.node
        self.claims = {role: Claim(ros.node, role) for role in (BRIDGE, PLANNER, DISCRETIZER)}
        self.session = self.claims[BRIDGE].id
        self.publishers = {topic.name: topic.publisher(ros.node) for topic in TOPICS}
        client.wait_for(
            lambda: all(p.get_subscription_count() for p in self.publishers.values()), WAIT_S
        )

    def publish(self, topic, message):
        self.publishers[topic.name].publish(message)

    def show_plane(self, angles=STILL):
        self.publish(topics.LAYOUT, layout.encode(PLANE, UNITS, PlanStamp(1), self.session))
        states = joint_states.encode(PLANE.ids, angles, STILL, 1, self.session)
        self.publish(topics.JOINT_STATES, states)
        self.client.wait_for(lambda: _has_angles(self), WAIT_S)

    def send_frames(self, attempt):
        self.publish(topics.FRAMES, frames.encode(FRAMES, attempt.stamp))

    def announce(self, attempt, fraction=0.5):
        self.publish(
            topics.PROGRESS, progress.encode(Progress("bridge", fraction, "moves", attempt))
        )

    def end(self, attempt):
        reached = np.full(7, Outcome.REACHED), np.full(7, Reason.OK), np.zeros(7)
        self.publish(
            topics.OUTCOME, outcome.encode(PLANE.ids, *reached, attempt.plan, self.session)
        )

    def refuse(self, stage, attempt, text="robot 9"):
        report = Progress(stage, 1.0, text, attempt, self.session, refused=True)
        self.publish(topics.PROGRESS, progress.encode(report))

    def leave(self, role):
        self.node.destroy_subscription(self.claims[role]._subscription)


FRAMES = FrameLog(
    time_s=np.array([0.5]),
    bus=np.array([0]),
    address=np.array([9]),
    ten_bit=np.array([False]),
    read=np.array([False]),
    ack=np.array([1]),
    offsets=np.array([0, 2]),
    data=np.array([1, 2], dtype=np.uint8),
)


@pytest.fixture
def nodes(new_domain):
    domain = new_domain()
    with RosClient("graph", domain) as ros, PlaneClient(domain) as client:
        yield Nodes(ros, client)


def test_before_a_layout_the_plane_is_an_error_and_not_none(nodes):
    for name in ("plane", "units", "angles"):
        with pytest.raises(PlaneError, match="received yet: wait for the graph"):
            getattr(nodes.client, name)
    nodes.show_plane()
    assert np.array_equal(nodes.client.plane.ids, PLANE.ids)
    assert np.array_equal(nodes.client.angles, STILL)


def _has_angles(nodes):
    return nodes.client.states_of_layout() is not None


def test_wait_for_graph_names_what_is_missing(nodes):
    with pytest.raises(WaitError, match="focal_plane/start, .*layout did not come within 0.2 s"):
        nodes.client.wait_for_graph(0.2)


def test_frames_of_a_later_attempt_are_found_though_they_come_before_its_announcement(nodes):
    client = nodes.client
    nodes.show_plane()
    nodes.publish(topics.TARGETS, targets.encode([1], [[0.0, 0.0]], PLAN.plan))
    nodes.send_frames(PLAN)
    nodes.send_frames(SECOND)
    nodes.end(PLAN)
    client.wait_for(lambda: SECOND.stamp in client.frames and client.outcomes, WAIT_S)
    # the plan has an outcome, and frames whose plan is unknown: it has not ended for the client
    with pytest.raises(WaitError, match=f"outcome of plan {PLAN.plan}"):
        client.wait_for_outcome(PLAN.plan, 0.3)
    nodes.publish(topics.TARGETS, targets.encode_attempt([1], [[0.0, 0.0]], SECOND))
    assert client.wait_for_outcome(PLAN.plan, WAIT_S).count(Outcome.REACHED) == 7
    assert client.attempts(PLAN.plan) == [PLAN.stamp, SECOND.stamp]
    assert client.last_attempt(PLAN.plan) == SECOND.stamp
    assert np.array_equal(client.counts_before[SECOND.stamp], UNITS.to_counts(STILL))


def test_a_client_that_joins_late_learns_of_an_attempt_from_progress(nodes):
    client = nodes.client
    nodes.send_frames(SECOND)
    client.wait_for(lambda: SECOND.stamp in client.frames, WAIT_S)
    nodes.announce(SECOND)
    nodes.end(PLAN)
    client.wait_for_outcome(PLAN.plan, WAIT_S)
    assert client.last_attempt(PLAN.plan) == SECOND.stamp
    assert "bridge" in client.times[PLAN.plan] and SECOND.stamp not in client.times


def test_frames_of_the_next_plan_are_not_taken_for_an_attempt(nodes):
    client = nodes.client
    for attempt in (PLAN, OTHER):
        nodes.send_frames(attempt)
        nodes.announce(attempt)
    client.wait_for(lambda: len(client.frames) == 2, WAIT_S)
    nodes.end(PLAN)
    client.wait_for_outcome(PLAN.plan, WAIT_S)
    assert client.attempts(PLAN.plan) == [PLAN.stamp]
    assert client.last_attempt(PLAN.plan) == PLAN.stamp


def test_a_refusal_of_this_plan_ends_the_wait_and_no_other_does(nodes):
    client = nodes.client
    nodes.show_plane()
    plan = client.send_targets([1], [[0.0, 0.0]])
    nodes.refuse("planner", OTHER)
    nodes.refuse("viewer", Attempt.first(plan))
    for refused in (1, 2):
        status = Status("planner", Level.ERROR, "layout refused", {"refused": refused})
        nodes.publish(topics.DIAGNOSTICS, diagnostics.encode([status], plan.ns + 10**9))
    with pytest.raises(WaitError, match="orders of plan"):
        client.wait_until_ready(plan, 0.3)
    nodes.refuse("planner", Attempt.first(plan), "targets refused: robot 9")
    with pytest.raises(PlaneRefusal, match="planner: targets refused: robot 9"):
        client.wait_until_ready(plan, WAIT_S)


@pytest.mark.parametrize("role", [PLANNER, DISCRETIZER, BRIDGE])
def test_a_wait_for_orders_ends_when_a_node_leaves_the_graph(nodes, role):
    client = nodes.client
    nodes.show_plane()
    plan = client.send_targets([1], [[0.0, 0.0]])
    with pytest.raises(WaitError, match="orders of plan"):
        client.wait_until_ready(plan, 0.5)
    nodes.leave(role)
    begin_s = time.monotonic()
    with pytest.raises(NodeLost, match=f"{role}: the node has left the graph, no orders of plan"):
        client.wait_until_ready(plan, WAIT_S)
    assert time.monotonic() < begin_s + 2.0


def test_a_wait_for_the_outcome_or_an_answer_ends_when_the_bridge_leaves_the_graph(nodes):
    client = nodes.client
    nodes.show_plane()
    plan = client.send_targets([1], [[0.0, 0.0]])
    nodes.leave(PLANNER)  # the orders are with the bridge
    with pytest.raises(WaitError, match="outcome of plan"):
        client.wait_for_outcome(plan, 0.5)
    nodes.leave(BRIDGE)
    with pytest.raises(NodeLost, match="bridge: .* no outcome of plan"):
        client.wait_for_outcome(plan, WAIT_S)
    with pytest.raises(NodeLost, match="no service focal_plane/stop will come"):
        client.call_service(topics.STOP, WAIT_S)


def test_outcomes_and_layouts_of_other_sessions_change_nothing(nodes):
    client = nodes.client
    nodes.show_plane()
    session = nodes.session
    for nodes.session in ("session_" + 24 * "0", None):
        nodes.end(PLAN)
        moved = joint_states.encode(PLANE.ids, STILL + 1.0, STILL, 1, nodes.session)
        nodes.publish(topics.JOINT_STATES, moved)
    nodes.session = session
    nodes.end(OTHER)
    client.wait_for(lambda: client.outcomes, WAIT_S)
    assert set(client.outcomes) == {OTHER.plan} and np.array_equal(client.angles, STILL)


def test_the_last_word_of_a_node_that_is_gone_is_forgotten(nodes):
    client = nodes.client
    # the node of this test is called graph, and has the role of the bridge
    for name, values in (
        ("bridge", {"node": "/graph"}), ("bridge: bus 0", {}), ("planner", {"node": "/gone"})
    ):  # fmt: skip
        status = Status(name, Level.OK, "waiting", values)
        nodes.publish(topics.DIAGNOSTICS, diagnostics.encode([status], 5))
    # a node that was paused comes back without its name: what it said a moment ago counts
    client.wait_for(lambda: "planner" in client.statuses, WAIT_S)
    client.wait_for(lambda: set(client.statuses) == {"bridge", "bridge: bus 0"}, WAIT_S)


def test_malformed_messages_change_nothing_and_do_not_end_the_client(nodes):
    client = nodes.client
    nodes.show_plane()
    lost = diagnostics.encode([Status("planner", Level.OK, "?", {"refused": "many"})], 5)
    lost.status[0].level = bytes([77])
    for topic in TOPICS:
        message = lost if topic is topics.DIAGNOSTICS else topic.type()
        if hasattr(message, "header"):
            message.header.frame_id = "map"
            message.header.stamp.sec = -1
        nodes.publish(topic, message)
    status = Status("planner", Level.OK, "?", {"refused": "many"})
    nodes.publish(topics.DIAGNOSTICS, diagnostics.encode([status], 5))
    client.wait_for(lambda: "planner" in client._statuses, WAIT_S)
    nodes.announce(PLAN)
    client.wait_for(lambda: PLAN.plan in client.times, WAIT_S)
    assert np.array_equal(client.plane.ids, PLANE.ids) and _has_angles(nodes)
    assert not client.frames and not client.outcomes and not client.held


@pytest.mark.parametrize("error", [WaitError("outcome", 1.0), KeyboardInterrupt(), ValueError("?")])
def test_an_error_after_the_start_stops_the_robots(nodes, monkeypatch, error):
    called = []
    monkeypatch.setattr(nodes.client, "call_service", lambda service, _: called.append(service))
    with pytest.raises(type(error)), nodes.client.stops_on_error(WAIT_S):
        raise error
    assert called == [topics.STOP]


def test_a_refused_start_does_not_stop_the_robots_of_another_client(nodes, monkeypatch):
    called = []
    monkeypatch.setattr(nodes.client, "call_service", lambda service, _: called.append(service))
    with pytest.raises(PlaneRefusal), nodes.client.stops_on_error(WAIT_S):
        raise PlaneRefusal("bridge", "robots are moving")
    assert not called


def test_a_failed_stop_does_not_hide_the_error(nodes, capfd):
    with pytest.raises(ValueError, match="the first"), nodes.client.stops_on_error(0.1):
        raise ValueError("the first")
    assert "were not told to stop" in capfd.readouterr().err

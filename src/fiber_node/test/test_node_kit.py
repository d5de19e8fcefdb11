# SPDX-License-Identifier: Apache-2.0
"""The shared parts of nodes, on real nodes in a domain of their own."""

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Empty

from fiber_core.errors import FiberError
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    Attempt,
    Level,
    MessageError,
    PlanStamp,
    Progress,
    diagnostics,
    joint_states,
    layout,
    new_session,
    outcome,
    progress,
    topics,
)
from fiber_node import (
    BRIDGE,
    PLANNER,
    AcceptedAttempts,
    Claim,
    PlaneCache,
    Reporter,
    SessionGate,
    claims,
    run,
)


@pytest.fixture
def graph():
    context = Context()
    rclpy.init(context=context)
    executor = SingleThreadedExecutor(context=context)
    nodes = []

    def node(name, **parameters):
        overrides = [Parameter(key, value=value) for key, value in parameters.items()]
        made = Node(name, context=context, parameter_overrides=overrides)
        nodes.append(made)
        executor.add_node(made)
        return made

    def until(holds, turns=2000):
        for _ in range(turns):
            if holds():
                return
            executor.spin_once(timeout_sec=0.01)
        pytest.fail("waited in vain")

    node.until = until
    yield node
    executor.shutdown()
    for made in nodes:
        made.destroy_node()
    context.try_shutdown()


def test_a_subscription_that_is_new_hears_the_diagnostics_at_once(graph, monkeypatch):
    monkeypatch.setattr("fiber_node.reporter._PERIOD_S", 1e6)
    report = Reporter(graph("node"), "planner")
    report.publish()
    heard = {"early": [], "late": []}
    for name, messages in heard.items():
        topics.DIAGNOSTICS.subscription(graph(name), messages.append)
        graph.until(heard[name].__len__)
        assert diagnostics.decode(messages[0])[0].name == "planner"


def test_a_refusal_reaches_the_diagnostics_at_once(graph):
    received = []
    topics.DIAGNOSTICS.subscription(graph("listener"), received.append)
    node = graph("speaker")
    report = Reporter(node, "planner", lambda: [diagnostics.Status("bus 1", Level.WARN, "noisy")])
    graph.until(lambda: received)
    received.clear()
    report.refuse("robot 7: target is 9 mm away")
    graph.until(lambda: any("robot 7" in s.text for m in received for s in diagnostics.decode(m)))
    own, more = diagnostics.decode(received[-1])
    assert (own.name, own.level, own.values["refused"]) == ("planner", Level.ERROR, "1")
    assert (more.name, more.level) == ("bus 1", Level.WARN)


def test_progress_names_stage_and_plan(graph):
    received = []
    topics.PROGRESS.subscription(graph("listener"), received.append)
    node = graph("speaker")
    report = Reporter(node, "discretizer")
    graph.until(lambda: node.count_subscribers(topics.PROGRESS.name) == 1)
    attempt = Attempt.first(PlanStamp(5))
    graph.until(lambda: received or report.progress(attempt, 0.5, "half") is not None)
    report_received = progress.decode(received[0])
    assert (report_received.stage, report_received.fraction, report_received.text) == (
        "discretizer",
        0.5,
        "half",
    )
    assert report_received.attempt == attempt


PLANE = preset("desi", robots=7)
STILL = np.zeros((7, 2))
OTHER = "session_" + 24 * "0"


class Bridge:
    """A node that says what a bridge would, and a node that caches it."""

    def __init__(self, graph):
        self.graph, self.source, self.node = graph, graph("source"), graph("cache")
        self.refused = []
        self.report = Reporter(self.node, "planner")
        self.gate = SessionGate(self.node, lambda topic, text, _: self.refused.append(text))
        self.cache = PlaneCache(self.gate, self.report)
        self.layouts = topics.LAYOUT.publisher(self.source)
        self.states = topics.JOINT_STATES.publisher(self.source)
        self.claim = Claim(self.source, BRIDGE)
        self.session = self.claim.id

    def publish_layout(self, ns=1):
        units = WireUnits.for_plane(PLANE)
        self.layouts.publish(layout.encode(PLANE, units, PlanStamp(ns), self.session))

    def publish_states(self, ns=1, ids=PLANE.ids, angles=STILL, speeds=STILL):
        self.states.publish(joint_states.encode(ids, angles, speeds, ns, self.session))

    def show(self, layout_ns, states_ns):
        self.publish_layout(layout_ns)
        self.publish_states(states_ns)
        cache = self.cache
        self.graph.until(lambda: (cache._layout_ns, cache._states_ns) == (layout_ns, states_ns))


def test_the_cache_is_complete_only_with_joint_states_of_the_same_robots(graph):
    bridge = Bridge(graph)
    cache = bridge.cache
    with pytest.raises(MessageError, match="layout: not received"):
        _ = cache.state
    bridge.publish_states(ids=PLANE.ids[:3], angles=STILL[:3], speeds=STILL[:3])
    bridge.publish_layout()
    graph.until(lambda: cache._layout is not None and cache._states is not None)
    assert not cache.complete
    turning = STILL.copy()
    turning[4, 1] = 0.1
    bridge.publish_states(2, angles=STILL + 0.5, speeds=turning)
    graph.until(lambda: cache.complete)
    assert cache.state.moving
    np.testing.assert_array_equal(cache.state.angles, STILL + 0.5)
    np.testing.assert_array_equal(cache.state.plane.ids, PLANE.ids)


def test_work_on_an_attempt_waits_for_a_plane_as_new_as_the_bridge_says(graph):
    bridge, done = Bridge(graph), []
    cache, session = bridge.cache, bridge.session
    first = Attempt(PlanStamp(5), PlanStamp(5), 1, since_ns=20, layout_ns=10)
    cache.when_current(first, session, lambda: done.append("first"))
    bridge.show(10, 19)
    assert not done
    bridge.show(10, 20)
    assert done == ["first"]
    second = first.next(PlanStamp(6), since_ns=30)
    cache.when_current(second, session, lambda: done.append("second"))
    bridge.show(29, 30)
    assert done == ["first"]
    bridge.show(30, 30)
    assert done == ["first", "second"]
    # newer work takes the place of work that waits, and is done once
    third = second.next(PlanStamp(7), since_ns=35)
    cache.when_current(third, session, lambda: done.append("third"))
    fourth = Attempt(PlanStamp(8), PlanStamp(8), 1, since_ns=35)
    cache.when_current(fourth, session, lambda: done.append("newer"))
    bridge.show(40, 40)
    assert done == ["first", "second", "newer"]


def test_with_a_new_session_everything_of_the_one_before_is_forgotten(graph):
    bridge, done = Bridge(graph), []
    cache, before = bridge.cache, bridge.session
    bridge.show(50, 50)
    later = Claim(bridge.source, BRIDGE)
    assert later.earlier() == [before] and bridge.claim.earlier() == []
    assert bridge.claim.others() == [later.id]
    bridge.session = later.id
    bridge.publish_layout(10)  # its clock was set back
    graph.until(lambda: cache.session == later.id)
    assert not cache.complete
    attempt = Attempt(PlanStamp(5), PlanStamp(5), 1, since_ns=10, layout_ns=10)
    cache.when_current(attempt, before, lambda: done.append("before"))
    cache.when_current(attempt, later.id, lambda: done.append("now"))
    assert not done
    bridge.show(10, 10)
    assert done == ["now"]


def test_messages_of_a_session_without_a_bridge_are_refused_by_name(graph):
    bridge = Bridge(graph)
    passed, refused = [], []
    gate = SessionGate(bridge.node, lambda topic, text, _: refused.append(text))
    gate.subscription(topics.LAYOUT, passed.append)
    for bridge.session, words in (
        (None, "no session"),
        (OTHER, f"of {OTHER}, is not in the graph"),
    ):
        bridge.refused.clear()
        refused.clear()
        bridge.publish_layout()
        for texts in (bridge.refused, refused):
            graph.until(lambda words=words, texts=texts: any(words in each for each in texts))
    assert bridge.cache._layout is None
    # a message can come before its bridge is seen
    bridge.publish_layout()
    named = topics.NAMESPACE + f"/_bridge_{OTHER}"
    late = []

    def appear():
        if bridge.gate._kept and gate._kept and not late:
            late.append(bridge.source.create_subscription(Empty, named, lambda _: None, 1))
        return bridge.cache._layout is not None

    graph.until(appear)
    assert bridge.cache.session == OTHER
    # the same again, as the bridge repeats it at rest, is no new layout
    graph.until(lambda: passed)
    before = gate._layout
    bridge.publish_layout()
    graph.until(lambda: gate._layout is not before)
    # one that differs passes
    bridge.publish_layout(2)
    graph.until(lambda: len(passed) > 1)
    assert [PlanStamp.of(each).ns for each in passed] == [1, 2]


def test_all_messages_that_came_before_their_bridge_is_seen_pass_in_their_order(graph):
    node, source = graph("late"), graph("source")
    passed, refused = [], []
    gate = SessionGate(node, lambda topic, text, _: refused.append(text))
    gate.subscription(topics.OUTCOME, lambda message: passed.append(PlanStamp.of(message).ns))
    outcomes = topics.OUTCOME.publisher(source)
    graph.until(outcomes.get_subscription_count)
    stranger = new_session(7, bytes(4))
    for ns, session in ((1, OTHER), (2, OTHER), (3, stranger), (4, OTHER)):
        outcomes.publish(outcome.encode([1], [0], [0], [0.0], PlanStamp(ns), session))
    graph.until(lambda: len(gate._kept) == 4)
    claim = topics.NAMESPACE + f"/_bridge_{OTHER}"
    source.create_subscription(Empty, claim, lambda _: None, 1)
    graph.until(lambda: passed)
    outcomes.publish(outcome.encode([1], [0], [0], [0.0], PlanStamp(5), OTHER))
    graph.until(lambda: len(passed) == 4)
    assert passed == [1, 2, 4, 5]
    graph.until(lambda: refused)
    assert refused == [f"outcome refused: its bridge, of {stranger}, is not in the graph"]


def test_work_waits_until_the_bridge_accepts_its_attempt(graph):
    bridge, done = Bridge(graph), []
    accepted = AcceptedAttempts(bridge.node, bridge.gate)
    reports = topics.PROGRESS.publisher(bridge.source)
    # the client of reporter.progress subscribes too
    graph.until(lambda: reports.get_subscription_count() == 1)

    def report(ns, stage=BRIDGE, session=bridge.session, refused=False, since_ns=1):
        attempt = Attempt(PlanStamp(ns), PlanStamp(ns), 1, since_ns)
        reports.publish(progress.encode(Progress(stage, 0.0, "", attempt, session, refused)))

    def work(attempt, session):
        done.append((attempt.stamp.ns, session))

    assert not accepted.when_accepted(PlanStamp(5), work)
    report(5, stage="planner")
    report(5, session=OTHER)
    report(5, since_ns=None)
    report(6)  # before its message
    graph.until(lambda: PlanStamp(6) in accepted._accepted)
    assert not done
    assert accepted.when_accepted(PlanStamp(6), work)
    report(5)
    graph.until(lambda: len(done) == 2)
    assert done == [(6, bridge.session), (5, bridge.session)]
    report(7, refused=True)
    report(7)
    report(8)
    graph.until(lambda: PlanStamp(8) in accepted._accepted)
    for ns in (5, 6, 7):  # each attempt once, and a refused one never
        assert not accepted.when_accepted(PlanStamp(ns), work)
    assert len(done) == 2


def test_a_malformed_layout_is_refused_and_the_old_one_stays(graph):
    bridge = Bridge(graph)
    bridge.publish_layout()
    graph.until(lambda: bridge.cache._layout is not None)
    units = WireUnits.for_plane(PLANE)
    bad = layout.encode(PLANE, units, PlanStamp(1), bridge.session)
    bad.header.frame_id = "map"
    bridge.layouts.publish(bad)
    graph.until(lambda: bridge.report.refused == 1)
    assert bridge.cache._layout[0].n == 7


def test_a_claim_ends_with_its_node(graph):
    node, peer = graph("one"), graph("two")
    claim = Claim(node, PLANNER)
    graph.until(lambda: claims(peer, PLANNER) == [claim.id])
    assert claims(peer, BRIDGE) == []
    node.destroy_subscription(claim._subscription)
    graph.until(lambda: claims(peer, PLANNER) == [])


def test_parameters_that_a_core_refuses_end_the_process_with_code_2():
    def make():
        raise FiberError("gain is -1.0")

    assert run(make, args=[]) == 2


@pytest.mark.parametrize(
    ("given", "code"), [("--help", 0), ("-h", 0), ("robots:=61", 2), ("--robots=61", 2)]
)
def test_a_node_is_not_made_for_help_or_for_arguments_that_ros_does_not_know(given, code, capsys):
    def make():
        """A node that is never made."""
        raise AssertionError

    assert run(make, args=["bridge", given, "--ros-args", "-p", "seed:=3"]) == code
    out, err = capsys.readouterr()
    assert "A node that is never made." in (err if code else out)
    assert (f"unknown arguments: {given}\n" in err) == bool(code)
    assert "-p PARAMETER:=VALUE" in out + err


def test_a_gate_keeps_a_hundred_messages_and_says_why_it_refuses_the_first(graph, monkeypatch):
    node, source, refused = graph("late"), graph("source"), []
    # none is refused for its age on a slow machine
    monkeypatch.setattr("fiber_node.session_gate._UNKNOWN_S", 600.0)
    gate = SessionGate(node, lambda topic, text, message: refused.append((text, message)))
    gate.subscription(topics.OUTCOME, lambda message: None)
    outcomes = topics.OUTCOME.publisher(source)
    graph.until(outcomes.get_subscription_count)
    for ns in range(1, 103):
        outcomes.publish(outcome.encode([1], [0], [0], [0.0], PlanStamp(ns), OTHER))
        graph.until(lambda ns=ns: len(gate._kept) + len(refused) == ns)
    assert [PlanStamp.of(message).ns for _, message in refused] == [1, 2]
    assert all("not seen yet, and 100 later messages wait" in text for text, _ in refused)

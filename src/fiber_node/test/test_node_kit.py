"""The shared parts of nodes, on real nodes in a domain of their own."""

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

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
    progress,
    targets,
    topics,
)
from fiber_node import AttemptListener, PlaneCache, Reporter, run


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


def test_the_cache_is_complete_only_with_joint_states_of_the_same_robots(graph):
    plane, node, source = preset("desi", robots=7), graph("cache"), graph("source")
    cache = PlaneCache(node, Reporter(node, "planner"))
    with pytest.raises(MessageError, match="layout: not received"):
        _ = cache.state
    layouts, states = topics.LAYOUT.publisher(source), topics.JOINT_STATES.publisher(source)
    still = np.zeros((7, 2))
    states.publish(joint_states.encode(plane.ids[:3], still[:3], still[:3], 1))
    layouts.publish(layout.encode(plane, WireUnits.for_plane(plane), PlanStamp(1)))
    graph.until(lambda: cache._layout is not None and cache._states is not None)
    assert not cache.complete
    turning = still.copy()
    turning[4, 1] = 0.1
    states.publish(joint_states.encode(plane.ids, still + 0.5, turning, 2))
    graph.until(lambda: cache.complete)
    assert cache.state.moving
    np.testing.assert_array_equal(cache.state.angles, still + 0.5)
    np.testing.assert_array_equal(cache.state.plane.ids, plane.ids)


def test_work_on_a_later_attempt_waits_for_a_plane_as_new_as_its_targets_say(graph):
    plane, node, source = preset("desi", robots=7), graph("cache"), graph("source")
    cache = PlaneCache(node, Reporter(node, "planner"))
    layouts, states = topics.LAYOUT.publisher(source), topics.JOINT_STATES.publisher(source)
    still, done = np.zeros((7, 2)), []

    def publish_layout(ns):
        layouts.publish(layout.encode(plane, WireUnits.for_plane(plane), PlanStamp(ns)))
        graph.until(lambda: cache._layout_ns == ns)

    def publish_states(ns):
        states.publish(joint_states.encode(plane.ids, still, still, ns))
        graph.until(lambda: cache._states_ns == ns)

    first = Attempt.first(PlanStamp(5))
    second = first.next(PlanStamp(6), since_ns=20)
    cache.when_current(first, lambda: done.append("first"))
    assert done == ["first"]  # nothing to wait for
    publish_layout(10)
    publish_states(10)
    cache.when_current(second, lambda: done.append("second"))
    publish_layout(20)
    publish_states(19)
    assert done == ["first"]
    publish_states(20)
    assert done == ["first", "second"]
    # newer work takes the place of work that waits, and is done once
    third = second.next(PlanStamp(7), since_ns=25)
    cache.when_current(third, lambda: done.append("third"))
    cache.when_current(Attempt.first(PlanStamp(8)), lambda: done.append("newer"))
    publish_layout(30)
    publish_states(30)
    assert done == ["first", "second", "newer"]


def test_work_on_a_trajectory_waits_until_its_attempt_is_announced(graph):
    node, source = graph("discretizer"), graph("source")
    listener, done = AttemptListener(node), []
    plan = Attempt.first(PlanStamp(5))
    second = plan.next(PlanStamp(6), since_ns=20)
    # in a graph without targets a stamp names a plan
    assert listener.when_announced(PlanStamp(4), done.append)
    assert done == [Attempt.first(PlanStamp(4))]

    asks = topics.TARGETS.publisher(source)
    reports = topics.PROGRESS.publisher(source)
    graph.until(lambda: node.count_publishers(topics.TARGETS.name) == 1)
    graph.until(lambda: asks.get_subscription_count() == reports.get_subscription_count() == 1)
    assert not listener.when_announced(second.stamp, done.append)  # overtook its targets
    asks.publish(targets.encode([1], [[0.0, 0.0]], plan.plan))
    asks.publish(targets.encode_attempt([1], [[0.0, 0.0]], second))
    graph.until(lambda: len(done) == 2)
    assert done[1] == second
    assert listener.when_announced(plan.stamp, done.append) and done[2] == plan

    # the progress of a stage announces an attempt as well; newer work takes the place of older
    third = second.next(PlanStamp(7), since_ns=30)
    assert not listener.when_announced(PlanStamp(99), done.append)
    assert not listener.when_announced(third.stamp, done.append)
    reports.publish(progress.encode(Progress("planner", 0.0, "begins", third)))
    graph.until(lambda: len(done) == 4)
    assert done[3] == third


def test_a_malformed_layout_is_refused_and_the_old_one_stays(graph):
    plane, node, source = preset("desi", robots=7), graph("cache"), graph("source")
    report = Reporter(node, "planner")
    cache = PlaneCache(node, report)
    layouts = topics.LAYOUT.publisher(source)
    good = layout.encode(plane, WireUnits.for_plane(plane), PlanStamp(1))
    layouts.publish(good)
    graph.until(lambda: cache._layout is not None)
    good.header.frame_id = "map"
    layouts.publish(good)
    graph.until(lambda: report.refused == 1)
    assert cache._layout[0].n == 7


def test_parameters_that_a_core_refuses_end_the_process_with_code_2():
    def make():
        raise FiberError("gain is -1.0")

    assert run(make, args=[]) == 2

# SPDX-License-Identifier: Apache-2.0
"""The bridge node by itself: the tests send orders and call services."""

import re
from dataclasses import replace

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rest_of_graph import COUNTS, PLANE, UNITS, WAIT_S, Rest, problem_file, turning

from fiber_bus_bridge import BridgeError
from fiber_bus_bridge.node import BridgeNode
from fiber_bus_bridge.wire import Opcode
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion
from fiber_msgs_py import (
    PlanStamp,
    Progress,
    Stage,
    frames,
    held,
    joint_states,
    layout,
    progress,
    session_of,
    targets,
    topics,
)
from fiber_msgs_py.table import encode_table
from fiber_node import DISCRETIZER, PLANNER, RosClient

pytestmark = pytest.mark.timeout(600)


def test_the_bridge_publishes_its_plane_and_the_encoders(rest):
    rest.until(lambda: rest.received[topics.LAYOUT.name])
    plane, units = layout.decode(rest.received[topics.LAYOUT.name][-1])
    assert units == UNITS and np.array_equal(plane.ids, PLANE.ids)
    np.testing.assert_allclose(plane.centers, PLANE.centers, rtol=1e-12)
    assert np.array_equal(rest.counts(), COUNTS)


def test_orders_wait_for_start_and_are_executed_to_the_last_quantum(rest):
    rest.ready(9)
    assert np.array_equal(rest.counts(), COUNTS) and not rest.received[topics.OUTCOME.name]
    answer = rest.call(topics.START)
    assert answer.success and "7 robots started" in answer.message
    result, reason, error_mm = rest.end(9)
    assert np.all(result == Outcome.REACHED) and np.all(reason == Reason.OK)
    rest.until(lambda: np.array_equal(rest.counts(), turning().end))
    assert error_mm.max() < 1e-6
    logs = [(PlanStamp.of(m).ns, frames.decode(m)) for m in rest.received[topics.FRAMES.name]]
    assert {ns for ns, _ in logs} == {9}
    opcodes = {int(data) >> 4 for _, log in logs for data in log.data[log.offsets[:-1]]}
    assert Opcode.LOAD in opcodes and any(np.any(log.read) for _, log in logs)


def test_the_encoders_are_told_twenty_times_in_a_second_of_motion(rest, monkeypatch):
    # counted where they are published: a reader that is late has the newest alone
    publisher, told = rest.bridge._outgoing._joint_states, []
    publish = publisher.publish
    monkeypatch.setattr(publisher, "publish", lambda each: told.append(each) or publish(each))
    rest.ready(9, turning(ticks=200))
    assert rest.call(topics.START).success
    rest.end(9)
    moving = [each for each in told if joint_states.decode(each)[2].any()]
    assert len(moving) >= 19 * 200e-6 * UNITS.tick_us


def test_a_stop_waits_for_a_hundredth_of_a_second_of_the_buses_at_most(rest, monkeypatch):
    session, until_s = rest.bridge._session, []
    advance = session.advance
    monkeypatch.setattr(session, "advance", lambda t: until_s.append(t) or advance(t))
    rest.ready(9, turning(ticks=200))
    assert rest.call(topics.START).success
    rest.end(9)
    assert len(until_s) > 50 and np.diff(until_s).max() < 0.0101


def test_a_tick_that_a_stop_waits_for_publishes_nothing(rest, monkeypatch):
    bridge, told = rest.bridge, []
    advance, publish = bridge._session.advance, bridge._outgoing.publish_encoders

    def advance_as_a_stop_comes(t):
        advance(t)
        told.clear()
        bridge._stop_requested.set()

    rest.ready(9, turning(ticks=200))
    monkeypatch.setattr(bridge._session, "advance", advance_as_a_stop_comes)
    monkeypatch.setattr(bridge._outgoing, "publish_encoders", lambda: told.append(1) or publish())
    assert rest.call(topics.START).success
    rest.until(bridge._stop_requested.is_set)
    assert not told
    assert rest.call(topics.STOP).success and told
    rest.end(9)


def test_a_capture_is_written_of_each_plan(tmp_path):
    pytest.importorskip("vcd", reason="pyvcd is not installed: no captures")
    with RosClient("rest") as peer:
        rest = Rest(peer, problem_file(tmp_path), capture=str(tmp_path / "capture"))
        rest.ready(9)
        assert rest.call(topics.START).success
        rest.end(9)
        folder = tmp_path / "capture" / str(PlanStamp(9))
        rest.until(lambda: (folder / "buses.pcap").exists())
        assert (folder / "buses.vcd").stat().st_size > 10_000


def test_the_first_reason_received_for_a_robot_is_kept(rest):
    tips = PLANE.centers + [2.0, 0.0]
    rest.ask(9, PLANE.ids, tips)
    reasons = [Reason.GOAL_BLOCKED, Reason.UNREACHABLE]
    rest.held.publish(held.encode([2, 5], reasons, Stage.PLANNER, PlanStamp(9)))
    rest.until(lambda: rest.held.wait_for_all_acked())
    rest.ready(9)
    assert rest.call(topics.START).success
    result, reason, error_mm = rest.end(9)
    assert not np.any(result == Outcome.REACHED)
    assert (reason[2], reason[5]) == (Reason.GOAL_BLOCKED, Reason.UNREACHABLE)
    assert np.all(error_mm > 0.1)


def test_a_robot_with_a_target_and_without_orders_is_held_as_not_planned(rest):
    rest.ask(9, [6], [PLANE.centers[6] + 3.0])
    nothing = WireMotion(UNITS, COUNTS, np.zeros(15), [], [])
    rest.ready(9, nothing)
    assert rest.call(topics.START).success
    result, reason, _ = rest.end(9)
    assert np.all(result == Outcome.HELD)
    assert reason.tolist() == [Reason.NO_TARGET] * 6 + [Reason.NOT_PLANNED]


@pytest.mark.parametrize("service", ["START", "HOME", "CONFIGURE", "CLEAR", "STOP"])
@pytest.mark.parametrize(
    ("state", "allowed"),
    [("IDLE", {"HOME", "CONFIGURE", "CLEAR", "STOP"}), ("READY", {"START", "CLEAR", "STOP"})],
)
def test_services_answer_according_to_the_state(rest, state, allowed, service):
    if state == "READY":
        rest.ready(9)
    answer = rest.call(getattr(topics, service))
    assert answer.success == (service in allowed), answer.message
    if not answer.success:
        assert f"cannot {service.lower()} while {state}" in answer.message
        rest.until(lambda: answer.message in rest.status().text)
        assert np.array_equal(rest.counts(), COUNTS)


def test_orders_for_an_unknown_robot_are_refused_with_its_id(rest):
    rest.ask_ends(9)
    rest.order(9, ids=PLANE.ids + 90)
    rest.until(lambda: "robot 90" in rest.status().text)
    assert not rest.call(topics.START).success
    assert np.array_equal(rest.counts(), COUNTS)


def test_orders_that_come_again_or_without_targets_are_dropped_with_a_message(rest):
    rest.ready(20)
    rest.order(20, turning(ticks=10))
    rest.until(lambda: "the plan has orders already, or has ended" in rest.status().text)
    rest.order(19)
    rest.until(lambda: "no targets with this stamp were accepted" in rest.status().text)
    assert rest.call(topics.START).success
    rest.end(20)
    rest.until(lambda: np.array_equal(rest.counts(), turning().end))


def test_the_bridge_answers_after_a_stop_while_a_tick_is_due(tmp_path):
    with RosClient("rest") as peer:
        rest = Rest(peer, problem_file(tmp_path), time_scale=1.0)
        rest.ready(9)
        assert rest.call(topics.START).success
        ticks = min(rest.bridge.timers, key=lambda timer: timer.timer_period_ns)
        stop = next(s for s in rest.bridge.services if s.service_name.endswith("stop"))
        waits = rest.bridge.executor.wait_for_ready_callbacks
        while (due := waits(timeout_sec=WAIT_S))[1] is not ticks:
            due[0]()
        # as in another thread: after the tick is found to be due, and before it is taken
        assert stop.callback(stop.srv_type.Request(), stop.srv_type.Response()).success
        due[0]()
        assert due[0].exception() is None
        assert rest.call(topics.CLEAR).success


def test_impossible_parameters_end_the_bridge(tmp_path):
    path = problem_file(tmp_path)
    with RosClient("rest") as peer:
        with pytest.raises(BridgeError, match="time_scale is -1.0, expected a number from 0"):
            peer.add_node(BridgeNode, problem=path, time_scale=-1.0)
        with pytest.raises(BridgeError, match="time_scale is inf, expected a number from 0"):
            peer.add_node(BridgeNode, problem=path, time_scale=float("inf"))
        with pytest.raises(BridgeError, match="grace_s is nan, expected a number from 0 to 3600"):
            peer.add_node(BridgeNode, **{"problem": path, "session.grace_s": float("nan")})
        with pytest.raises(BridgeError, match="attempts is 0, expected a whole number from 1"):
            peer.add_node(BridgeNode, problem=path, attempts=0)
        with pytest.raises(BridgeError, match="robots is -4"):
            peer.add_node(BridgeNode, robots=-4)


STAMP_S = 1_000_000_000


def refusal(rest, ns):
    """The text with which the bridge refuses a plan, which ends with an outcome of every robot."""

    def refusals():
        return [p for p in rest.answers(ns) if p.refused and p.stage == "bridge"]

    rest.until(refusals)
    refused = refusals()[0]
    assert refused.session == rest.session
    result, reason, _ = rest.end(ns)
    assert np.all(result == Outcome.HELD)
    assert set(reason.tolist()) <= {Reason.PLAN_REFUSED, Reason.NO_TARGET, Reason.NOT_PLANNED}
    return refused.text


def test_accepted_targets_are_answered_with_joint_states_that_are_as_new(rest):
    answer = rest.ask_ends(9)
    assert not answer.refused and answer.session == rest.session
    attempt = answer.attempt
    rest.until(
        lambda: PlanStamp.of(rest.received[topics.JOINT_STATES.name][-1]).ns >= attempt.since_ns
    )
    assert PlanStamp.of(rest.received[topics.LAYOUT.name][-1]).ns == attempt.layout_ns
    of_bridge = (topics.LAYOUT, topics.JOINT_STATES)
    assert {session_of(m) for t in of_bridge for m in rest.received[t.name]} == {rest.session}


BAD_TARGETS = {
    "unknown": ([1, 99], [[0.0, 0.0], [1.0, 2.0]], r"robot 99: no such robot, target \[1.0, 2.0\]"),
    "not finite": ([1, 3], [[0.0, 0.0], [1.0, np.nan]], "robot 3: y nan is not finite"),
    "twice": ([3, 3], [[0.0, 0.0], [1.0, 1.0]], "robot 3: id 3 appears twice"),
}


@pytest.mark.parametrize("name", BAD_TARGETS)
def test_a_plan_with_refused_targets_has_an_outcome_and_takes_no_stamp(rest, name):
    ids, xy_mm, words = BAD_TARGETS[name]
    rows = np.zeros(len(ids), dtype=[("id", "<u4"), ("x", "<f8"), ("y", "<f8")])
    rows["id"], (rows["x"], rows["y"]) = ids, np.transpose(xy_mm) * 1e-3
    rest.targets.publish(encode_table(rows, PlanStamp(20), rest.session))
    assert re.search(words, refusal(rest, 20))
    rest.ready(19)
    assert rest.call(topics.START).success
    rest.end(19)


def test_targets_sent_while_stopped_end_at_once(rest):
    assert rest.call(topics.STOP).success
    assert rest.ask(9, PLANE.ids, PLANE.centers + 3.0).refused
    assert "no plan is accepted while STOPPED: clear first" in refusal(rest, 9)
    result, reason, error_mm = rest.end(9)
    assert np.all(reason == Reason.PLAN_REFUSED) and np.all(error_mm > 1)


def test_a_stamp_of_the_future_is_refused_and_forgotten(rest):
    now_ns = rest.bridge.get_clock().now().nanoseconds
    assert rest.ask_ends(now_ns + 3600 * STAMP_S).refused
    assert "its stamp is 3600 s ahead of the bridge's clock" in refusal(
        rest, now_ns + 3600 * STAMP_S
    )
    # a clock that is not more than a minute ahead is believed
    assert not rest.ask_ends(now_ns + 50 * STAMP_S).refused
    assert rest.ask_ends(now_ns).refused
    assert "is not older; after a change of the clock call clear" in refusal(rest, now_ns)
    assert rest.call(topics.CLEAR).success
    assert not rest.ask_ends(now_ns + 1).refused


def test_the_stamp_zero_means_now(rest):
    before_ns = rest.bridge.get_clock().now().nanoseconds
    sent = rest.received[topics.TARGETS.name]
    message = targets.encode(PLANE.ids, PLANE.centers + 3.0, PlanStamp(0), rest.session)
    rest.targets.publish(message)
    rest.until(lambda: len(sent) == 2)
    ns = max(PlanStamp.of(m).ns for m in sent)
    assert ns >= before_ns and not rest.answer(ns).refused
    rest.ready(ns)
    assert rest.call(topics.START).success
    assert np.all(rest.end(ns)[1] == Reason.OFF_TARGET)


def test_targets_and_orders_of_another_session_or_of_none_are_refused_by_name(rest):
    session, other = rest.session, "session_" + 24 * "0"
    for rest.session, words in ((other, f"of {other}, the"), (None, "of no session, the")):
        answer = rest.ask_ends(9)
        assert answer.refused and f"{words} bridge has opened {session}" in answer.text
        rest.received[topics.PROGRESS.name].clear()
        rest.bridge._attempts._accepted._foreign_s = 0.0  # the next is answered, too
    rest.session = session
    rest.ask_ends(10)
    for rest.session in (other, None):
        rest.order(10)
        of = rest.session or "no session"
        rest.until(lambda of=of: f"segments: of {of}, the bridge" in rest.status().text)
    assert not rest.received[topics.OUTCOME.name]
    rest.session = session
    rest.ready(10)
    assert rest.call(topics.START).success
    assert np.all(rest.end(10)[0] == Outcome.REACHED)


def test_orders_that_begin_elsewhere_are_refused_and_their_plan_ends(rest):
    rest.ask_ends(9)
    start = COUNTS + [1000, 0]
    motion = turning()
    rest.order(9, WireMotion(UNITS, start, motion.offsets, motion.ticks, motion.velocity))
    assert "robot 0: orders begin at" in refusal(rest, 9)
    assert np.array_equal(rest.counts(), COUNTS)


@pytest.mark.parametrize("service", ["HOME", "CONFIGURE", "CLEAR", "STOP"])
def test_a_plan_without_orders_hinders_no_service_and_ends_with_it(rest, service):
    rest.ask_ends(9)
    assert rest.call(getattr(topics, service)).success
    result, reason, _ = rest.end(9)
    expected = Reason.STOPPED if service == "STOP" else Reason.NOT_PLANNED
    assert np.all(result == Outcome.HELD) and np.all(reason == expected)
    rest.order(9)  # late
    rest.until(lambda: "has ended" in rest.status().text)


@pytest.mark.parametrize("role", [PLANNER, DISCRETIZER])
def test_a_plan_ends_when_a_stage_refuses_it_or_leaves_the_graph(rest, role):
    answer = rest.ask_ends(9)
    reports = topics.PROGRESS.publisher(rest.peer.node)
    refused = Progress(role, 1.0, "in vain", answer.attempt, rest.session, refused=True)
    rest.until(reports.get_subscription_count)
    reports.publish(progress.encode(replace(refused, session="session_" + 24 * "0")))
    reports.publish(progress.encode(refused))
    assert f"plan {PlanStamp(9)} ended without orders: {role}: in vain" in refusal(rest, 9)
    rest.ask_ends(10)
    rest.peer.node.destroy_subscription(rest.stages[role]._subscription)
    rest.until(lambda: any(each.refused for each in rest.answers(10)))
    assert f"the {role} is not in the graph" in refusal(rest, 10)


def test_a_second_bridge_of_the_plane_refuses_and_the_first_goes_on(rest, tmp_path):
    with pytest.raises(BridgeError, match=f"in the graph already, of {rest.session}: end it first"):
        BridgeNode(
            context=rest.peer.node.context,
            parameter_overrides=[Parameter("problem", value=problem_file(tmp_path))],
        )
    rest.ready(9)
    assert rest.call(topics.START).success
    assert np.all(rest.end(9)[0] == Outcome.REACHED)


def test_a_restarted_bridge_takes_no_orders_of_an_earlier_one(rest, tmp_path):
    rest.ready(9)
    first = rest.session
    rest.peer.remove_node(rest.bridge)
    rest.received[topics.OUTCOME.name].clear()
    rest.received[topics.LAYOUT.name].clear()
    rest.bridge = rest.peer.add_node(BridgeNode, problem=problem_file(tmp_path), time_scale=0.0)
    rest.until(lambda: rest.received[topics.LAYOUT.name])
    assert session_of(rest.received[topics.LAYOUT.name][-1]) != first
    # the orders are latched: the new bridge receives them
    rest.until(lambda: f"segments: of {first}" in rest.status().text)
    answer = rest.call(topics.START)
    assert not answer.success and "cannot start while IDLE" in answer.message
    assert rest.call(topics.CONFIGURE).success
    assert rest.call(topics.HOME).success
    rest.until(lambda: rest.received[topics.OUTCOME.name])
    assert np.array_equal(rest.counts()[:, 0], COUNTS[:, 0])

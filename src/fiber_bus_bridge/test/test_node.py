"""The bridge node by itself: the tests send orders and call services."""

import numpy as np
import pytest
from rest_of_graph import COUNTS, PLANE, UNITS, WAIT_S, Rest, problem_file, turning

from fiber_bus_bridge import BridgeError
from fiber_bus_bridge.node import BridgeNode
from fiber_bus_bridge.wire import Opcode
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion
from fiber_msgs_py import (
    PlanStamp,
    Stage,
    frames,
    held,
    layout,
    targets,
    topics,
)
from fiber_node import RosClient

pytestmark = pytest.mark.timeout(600)


@pytest.fixture
def rest(tmp_path):
    with RosClient("rest") as peer:
        yield Rest(peer, problem_file(tmp_path))


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
    rest.targets.publish(targets.encode(PLANE.ids, tips, PlanStamp(9)))
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
    rest.targets.publish(targets.encode([6], [PLANE.centers[6] + 3.0], PlanStamp(9)))
    rest.until(lambda: rest.targets.wait_for_all_acked())
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
    rest.order(9, ids=PLANE.ids + 90)
    rest.until(lambda: "robot 90" in rest.status().text)
    assert not rest.call(topics.START).success
    assert np.array_equal(rest.counts(), COUNTS)


def test_older_orders_are_dropped_with_a_message(rest):
    rest.ready(20)
    rest.order(19)
    rest.until(lambda: f"{PlanStamp(19)} dropped" in rest.status().text)


def test_newer_orders_replace_those_that_wait(rest):
    rest.targets.publish(targets.encode(PLANE.ids, PLANE.centers + 3.0, PlanStamp(20)))
    rest.until(lambda: rest.targets.wait_for_all_acked())
    rest.ready(20)
    rest.ready(21, turning(ticks=10))
    result, reason, _ = rest.end(20)
    assert np.all(result == Outcome.HELD) and np.all(reason == Reason.STOPPED)
    assert rest.call(topics.START).success
    rest.end(21)
    rest.until(lambda: np.array_equal(rest.counts(), turning(ticks=10).end))


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

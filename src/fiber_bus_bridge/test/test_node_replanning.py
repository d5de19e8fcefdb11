# SPDX-License-Identifier: Apache-2.0
"""Replanning around a robot that cannot be commanded; a test plays planner and operator.

Robot 0 is stretched towards robot 4, which passes after robot 0 has folded.
"""

import sys
import threading

import numpy as np
import pytest
from rest_of_graph import PLANE, START, UNITS, WAIT_S, Rest, problem_file

import fiber_bus_bridge.node.hardware
from fiber_core.kinematics import forward
from fiber_core.outcomes import Outcome, Reason
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion
from fiber_msgs_py import FRAME_ID, PlanStamp, joint_states, layout, targets, topics
from fiber_node import BRIDGE, Claim, RosClient

pytestmark = pytest.mark.timeout(600)

ALL = PLANE.ids.tolist()
STANDING = START.copy()
STANDING[0], STANDING[4] = (0.0, 0.0), (np.pi, 3.0)
BEGIN = UNITS.to_counts(STANDING)
FOLD, WAIT, TURN, UNFOLD = (270, 7000), (300, 0), (270, -3730), (270, -6100)


def orders(start, profiles):
    """Orders from lists of (ticks, velocity) by robot and joint."""
    lists = [profiles.get((robot, joint), []) for robot in range(7) for joint in range(2)]
    offsets = Parts.from_counts([len(each) for each in lists]).offsets
    table = np.array([segment for each in lists for segment in each], dtype=np.int64)
    return WireMotion(UNITS, start, offsets, *table.reshape(-1, 2).T)


OTHERS = {(robot, 0): [(50, 700)] for robot in (1, 2, 3, 5, 6)}
FIRST = orders(
    BEGIN,
    {(0, 0): [TURN], (0, 1): [FOLD], (4, 1): [WAIT, UNFOLD], (4, 0): [WAIT, WAIT, TURN]} | OTHERS,
)
ENDS_MM = forward(PLANE, UNITS.to_angles(FIRST.end))[1]
AROUND = {(4, 0): [TURN], (4, 1): [WAIT, UNFOLD]}  # the same end, clear of robot 0 where it is


class Scene(Rest):
    """A bridge with a plan in whose first attempt robot 0 cannot be commanded."""

    def __init__(self, peer, path, made, **parameters):
        super().__init__(peer, path, **parameters)
        self.robots = made[-1].positioners

    def first_attempt(self):
        self.until(lambda: self.bridge.count_subscribers(topics.TARGETS.name) == 2)
        self.ask(9, ALL, ENDS_MM)
        self.ready(9, FIRST)
        self.robots.power([0], False, 0.0)
        answer = self.call(topics.START)
        assert answer.success and "5 robots started" in answer.message

    def second_targets(self):
        """Wait for targets of the second attempt, layout and encoders; return the targets."""
        self.until(lambda: self.asked_in(2))
        (message,) = self.asked_in(2)
        needed = [self.received[topic.name] for topic in (topics.LAYOUT, topics.JOINT_STATES)]
        since_ns = targets.decode_attempt(message).since_ns
        self.until(lambda: all(PlanStamp.of(messages[-1]).ns >= since_ns for messages in needed))
        return message

    def asked_in(self, attempt):
        received = self.received[topics.TARGETS.name]
        return [m for m in received if targets.decode_attempt(m).number == attempt]

    def second(self):
        now = FIRST.end.copy()
        now[[0, 4]] = BEGIN[[0, 4]]
        return orders(now, AROUND)

    def outcomes(self):
        return [PlanStamp.of(m) for m in self.received[topics.OUTCOME.name]]


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """Function that makes a scene; parameters are those of the bridge."""
    path = problem_file(tmp_path, STANDING)
    made, build = [], fiber_bus_bridge.node.hardware.simulated_buses
    monkeypatch.setattr(
        fiber_bus_bridge.node.hardware,
        "simulated_buses",
        lambda *given: made.append(build(*given)) or made[-1],
    )
    with RosClient("rest") as peer:
        yield lambda **parameters: Scene(peer, path, made, **parameters)


def test_a_robot_held_because_of_another_is_replanned_and_arrives(scene):
    rest = scene()
    rest.first_attempt()
    message = rest.second_targets()
    ids, xy_mm = targets.decode(message)
    assert ids.tolist() == ALL[1:]
    np.testing.assert_allclose(xy_mm, ENDS_MM[1:], atol=1e-9)
    # published for the planner: robot 0 is not enabled, and all robots rest
    plane, _ = layout.decode(rest.received[topics.LAYOUT.name][-1])
    assert plane.enabled.tolist() == [False] + [True] * 6
    states = joint_states.decode(rest.received[topics.JOINT_STATES.name][-1])
    assert np.array_equal(UNITS.to_counts(states[1]), rest.second().start) and not states[2].any()
    assert not rest.outcomes()

    rest.order(9, rest.second(), attempt=2)  # without a call of start
    result, reason, error_mm = rest.end(9)
    assert result.tolist() == [Outcome.HELD] + [Outcome.REACHED] * 6
    assert reason.tolist() == [Reason.NO_REPLY] + [Reason.OK] * 6
    assert np.all(error_mm[1:] < 1e-6) and error_mm[0] > 1
    rest.until(lambda: np.array_equal(rest.counts()[1:], FIRST.end[1:]))
    assert np.array_equal(rest.counts()[0], BEGIN[0])
    assert rest.outcomes() == [PlanStamp(9)]
    stamps = {PlanStamp.of(m) for m in rest.received[topics.FRAMES.name]}
    assert stamps == {PlanStamp(9), rest.stamp_of(9, 2)}
    with_header = [m for some in rest.received.values() for m in some if hasattr(m, "header")]
    assert {m.header.frame_id for m in with_header} == {FRAME_ID}
    rest.until(lambda: rest.status().values.get("attempts") == "2")


def test_no_robot_of_a_later_attempt_moves_once_an_earlier_bridge_is_there(scene, monkeypatch):
    """A bridge that was paused comes back with the claim that it had before."""
    rest = scene()
    rest.first_attempt()
    rest.second_targets()
    monkeypatch.setattr(sys.modules[Claim.__module__], "new_session", lambda *_: "session_0")
    Claim(rest.peer.node, BRIDGE)
    rest.until(lambda: rest.bridge._claim.earlier())
    rest.order(9, rest.second(), attempt=2)
    result, _, _ = rest.end(9)
    assert result[4] == Outcome.HELD and result[0] == Outcome.HELD
    assert np.array_equal(rest.counts(), rest.second().start)
    rest.until(lambda: "no robot is started: another bridge" in rest.status().text)


def test_there_is_no_second_attempt_where_one_is_allowed(scene):
    rest = scene(attempts=1)
    rest.first_attempt()
    result, reason, _ = rest.end(9)
    assert (result[4], reason[4]) == (Outcome.HELD, Reason.UNSAFE_AS_LOADED)
    rest.ask(20, ALL, ENDS_MM)
    rest.until(lambda: PlanStamp.of(rest.received[topics.TARGETS.name][-1]) == PlanStamp(20))
    assert not rest.asked_in(2)


def test_a_stop_during_replanning_ends_the_plan(scene):
    rest = scene()
    rest.first_attempt()
    rest.second_targets()
    before = rest.counts()
    assert rest.call(topics.STOP).success
    result, reason, _ = rest.end(9)
    assert (
        result.tolist()
        == [Outcome.HELD] + [Outcome.REACHED] * 3 + [Outcome.HELD] + [Outcome.REACHED] * 2
    )
    assert (reason[0], reason[4]) == (Reason.NO_REPLY, Reason.UNSAFE_AS_LOADED)
    rest.order(9, rest.second(), attempt=2)
    rest.until(lambda: "dropped: this attempt has ended" in rest.status().text)
    assert rest.call(topics.CLEAR).success
    assert not rest.call(topics.START).success
    assert np.array_equal(rest.counts(), before) and rest.outcomes() == [PlanStamp(9)]


def test_a_stop_during_the_second_start_ends_the_plan(scene):
    rest = scene(attempts=3)
    rest.first_attempt()
    rest.second_targets()
    session, stop = rest.bridge._session, None
    certify = session.protocol.certify
    handler = next(s for s in rest.bridge.services if s.service_name.endswith("stop"))

    def while_certified(*arguments):
        nonlocal stop
        if stop is None:
            empty = handler.srv_type.Request(), handler.srv_type.Response()
            stop = threading.Thread(target=handler.callback, args=empty)
            stop.start()
            assert rest.bridge._stop_requested.wait(WAIT_S)
        return certify(*arguments)

    session.protocol.certify = while_certified
    before = rest.counts()
    rest.order(9, rest.second(), attempt=2)
    result, reason, _ = rest.end(9)
    stop.join(WAIT_S)
    assert (result[4], reason[4]) == (Outcome.HELD, Reason.STOPPED)
    assert np.array_equal(rest.counts(), before)
    assert not rest.asked_in(3) and rest.outcomes() == [PlanStamp(9)]


def test_a_stop_during_the_second_motion_ends_the_plan(scene):
    rest = scene(attempts=3, time_scale=1.0)
    rest.first_attempt()
    rest.second_targets()
    rest.order(9, rest.second(), attempt=2)

    def moving():
        return joint_states.decode(rest.received[topics.JOINT_STATES.name][-1])[2].any()

    second = rest.stamp_of(9, 2)
    rest.until(lambda: second in map(PlanStamp.of, rest.received[topics.FRAMES.name]))
    rest.until(moving)
    assert rest.call(topics.STOP).success
    result, reason, _ = rest.end(9)
    assert (result[4], reason[4]) == (Outcome.HELD, Reason.STOPPED)
    assert result[[1, 2, 3, 5, 6]].tolist() == [Outcome.REACHED] * 5
    assert not rest.asked_in(3) and rest.outcomes() == [PlanStamp(9)]


@pytest.mark.parametrize("service", ["CLEAR", "HOME", "CONFIGURE"])
def test_other_services_during_replanning_end_the_plan(scene, service):
    rest = scene()
    rest.first_attempt()
    rest.second_targets()
    assert rest.call(getattr(topics, service)).success
    result, reason, _ = rest.end(9)
    assert (result[4], reason[4]) == (Outcome.HELD, Reason.UNSAFE_AS_LOADED)
    assert rest.outcomes().count(PlanStamp(9)) == 1


def test_new_targets_end_the_plan_and_are_executed(scene):
    rest = scene()
    rest.first_attempt()
    rest.second_targets()
    rest.ask(20, ALL, ENDS_MM)
    _, reason, _ = rest.end(9)
    assert reason[4] == Reason.UNSAFE_AS_LOADED
    rest.ready(20, rest.second())
    assert rest.call(topics.START).success
    result, reason, _ = rest.end(20)
    assert result.tolist() == [Outcome.HELD] + [Outcome.REACHED] * 6
    # a failed robot is not tried until clear or configure
    assert reason[0] == Reason.NOT_PLANNED


def test_a_plan_ends_when_no_orders_come_in_time(scene):
    rest = scene(attempt_timeout_s=0.2)
    rest.first_attempt()
    rest.second_targets()
    _, reason, _ = rest.end(9)
    assert reason[4] == Reason.UNSAFE_AS_LOADED
    rest.until(lambda: "no orders within 0.2 s" in rest.status().text)


def test_refused_orders_of_the_second_attempt_end_the_plan(scene):
    rest = scene()
    rest.first_attempt()
    rest.second_targets()
    rest.order(9, rest.second(), ids=PLANE.ids + 90, attempt=2)
    _, reason, _ = rest.end(9)
    assert reason[4] == Reason.UNSAFE_AS_LOADED
    rest.until(lambda: "robot 90" in rest.status().text)


def test_a_failed_robot_is_left_out_until_clear(scene):
    rest = scene(attempts=1)
    rest.first_attempt()
    rest.end(9)

    def enabled():
        return layout.decode(rest.received[topics.LAYOUT.name][-1])[0].enabled.tolist()

    rest.until(lambda: enabled() == [False] + [True] * 6)
    assert rest.call(topics.CLEAR).success
    rest.until(lambda: enabled() == [True] * 7)

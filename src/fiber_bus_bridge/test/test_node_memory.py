# SPDX-License-Identifier: Apache-2.0
"""The bridge remembers its robots over a restart, and believes no place that is not vouched for."""

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rest_of_graph import COUNTS, PLANE, UNITS, turning

from fiber_bus_bridge import BridgeError, SessionState
from fiber_bus_bridge.left_plan import LeftPlan, load_left_plan, save_left_plan
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.robot_memory import RobotMemory, load_memory, save_memory
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion
from fiber_msgs_py import PlanStamp, session_of, topics

pytestmark = pytest.mark.timeout(600)

QUANTUM = UNITS.quantum_prad


def some_memory():
    rng = np.random.default_rng(1)
    flags = rng.random((2, 7)) < 0.5
    return RobotMemory(
        rng.integers(-(2**31) + 1, 2**31, (7, 2)), *flags, rng.integers(-1, 9, 7),
        rng.choice([int(reason) for reason in Reason], 7), np.array([5]), True, True,
    )  # fmt: skip


def test_the_file_gives_back_what_was_saved(tmp_path):
    path, memory = tmp_path / "a" / "robots.json", some_memory()
    assert load_memory(path, PLANE, QUANTUM, 1) is None
    save_memory(path, memory, PLANE, QUANTUM)
    assert load_memory(path, PLANE, QUANTUM, 1).same(memory)
    assert [each.name for each in path.parent.iterdir()] == ["robots.json"]


def test_a_damaged_file_or_one_of_another_plane_is_refused_by_name(tmp_path):
    path = tmp_path / "robots.json"
    save_memory(path, some_memory(), PLANE, QUANTUM)
    with pytest.raises(BridgeError, match=r"robots\.json: plane differs"):
        load_memory(path, PLANE.permuted(np.arange(6)), QUANTUM, 1)
    with pytest.raises(BridgeError, match="quantum_prad differs"):
        load_memory(path, PLANE, QUANTUM + 1, 1)
    text, rng = path.read_text(), np.random.default_rng(2)
    for _ in range(200):
        at = int(rng.integers(len(text)))
        damaged = text[:at] + str(rng.integers(10)) * int(rng.integers(0, 3)) + text[at + 1 :]
        path.write_text(damaged)
        if json.loads(text) == _parsed(damaged):
            continue
        with pytest.raises(BridgeError, match=r"robots\.json"):
            load_memory(path, PLANE, QUANTUM, 1)


def _parsed(text):
    try:
        return json.loads(text)
    except ValueError:
        return None


@pytest.fixture
def peer_log(capfd):
    """Returns what the nodes of this process have logged."""
    return lambda: capfd.readouterr().err


def test_before_a_go_the_file_says_that_the_robots_may_be_anywhere(night):
    night.ready(9, turning(ticks=300))
    assert not load_memory(night.path, PLANE, QUANTUM, 1).lost.any()
    assert night.call(topics.START).success
    assert load_memory(night.path, PLANE, QUANTUM, 1).lost.all()
    assert night.call(topics.STOP).success
    night.end(9)
    memory = load_memory(night.path, PLANE, QUANTUM, 1)
    assert not memory.lost.any() and np.array_equal(memory.counts, night.counts())


def test_without_a_place_on_disk_no_robot_is_started(night, monkeypatch):
    night.ready(9)

    def full(*_):
        raise BridgeError("no space left on device")

    monkeypatch.setattr("fiber_bus_bridge.node.remembered.save_memory", full)
    night.call(topics.START)
    result, reason, _ = night.end(9)
    assert set(reason.tolist()) <= {Reason.STOPPED, Reason.OK}
    assert np.array_equal(night.counts(), COUNTS)
    night.until(lambda: "no space left on device" in night.status().text)


def test_a_stop_that_the_bridge_does_not_survive_still_waits_for_an_operator(night, monkeypatch):
    night.ready(9, turning(ticks=300))
    assert night.call(topics.START).success
    assert load_memory(night.path, PLANE, QUANTUM, 1).moving
    with monkeypatch.context() as patch:  # the bridge dies before it can write the file
        patch.setattr("fiber_bus_bridge.node.remembered.Remembered.save", lambda *_, **__: None)
        assert night.call(topics.STOP).success
        night.restart()
    assert night.bridge._session.state is SessionState.STOPPED
    assert night.call(topics.CLEAR).success
    assert [each.name for each in night.path.parent.glob("robots*")] == ["robots.json"]
    night.restart()
    assert night.bridge._session.state is SessionState.IDLE


def test_stop_does_not_wait_for_a_slow_disk(night, monkeypatch):
    night.ready(9, turning(ticks=1000))
    assert night.call(topics.START).success
    disk_s, written = 20.0, threading.Event()
    touch, go_on = Path.touch, threading.Event()

    def slow(path, *given):
        go_on.wait(disk_s)
        touch(path, *given)
        written.set()

    monkeypatch.setattr(Path, "touch", slow)
    try:
        assert night.call(topics.STOP).success
        assert night.bridge._session.state is SessionState.STOPPED and not written.is_set()
        night.until(lambda: "the stop is not noted" in night.status().text)
        assert "the next bridge takes the stop for its own" in night.status().text
    finally:
        go_on.set()
    assert written.wait(disk_s)


def test_stop_is_sent_and_noted_where_no_thread_can_be_started(night, monkeypatch):
    night.ready(9, turning(ticks=1000))
    assert night.call(topics.START).success

    def refuse(_):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        patch.setattr("fiber_bus_bridge.node.remembered.Remembered.save", lambda *_, **__: None)
        assert night.call(topics.STOP).success
    assert night.bridge._session.state is SessionState.STOPPED
    assert night.path.with_name("robots.json.stop").exists()


def test_a_stop_that_cannot_be_noted_is_sent_and_says_what_is_left(night, monkeypatch):
    night.ready(9, turning(ticks=1000))
    assert night.call(topics.START).success

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(Path, "touch", full)
    assert night.call(topics.STOP).success
    assert night.bridge._session.state is SessionState.STOPPED
    night.until(lambda: "no space left on device: if the bridge dies" in night.status().text)


def unfolding(ticks, counts=COUNTS):
    """Orders that turn every phi, which moves fibres off their places at once."""
    offsets = np.repeat(np.arange(8), 2)[:-1]
    return WireMotion(UNITS, counts, offsets, np.full(7, ticks), np.full(7, -700))


def outcomes_of(night, ns):
    return [m for m in night.received[topics.OUTCOME.name] if PlanStamp.of(m).ns == ns]


@pytest.mark.parametrize("dies_again", [False, True])
def test_the_next_bridge_tells_how_a_plan_ended_whose_bridge_died(night, monkeypatch, dies_again):
    night.ready(9, unfolding(ticks=300))
    assert night.call(topics.START).success
    night.restart()
    result, reason, _ = night.end(9)
    assert night.session == session_of(outcomes_of(night, 9)[0]), "it is of the new bridge"
    assert set(result.tolist()) == {Outcome.HELD} and set(reason.tolist()) == {Reason.NO_HEARTBEAT}
    before = outcomes_of(night, 9)[0].data
    if dies_again:
        night.restart()
        night.end(9)
    assert [message.data for message in outcomes_of(night, 9)] == [before]
    night.ask(20, PLANE.ids, PLANE.centers + 3.0)  # and the plane is used as ever
    night.ready(20, unfolding(10, night.counts()))
    assert night.call(topics.START).success
    night.end(20)
    night.restart()
    night.ask(30, PLANE.ids, PLANE.centers + 3.0)
    assert not outcomes_of(night, 9) and not outcomes_of(night, 20), "each was told in its time"


def test_a_bridge_that_dies_before_it_tells_has_noted_what_its_configuration_deleted(
    night, monkeypatch
):
    night.ready(9, unfolding(ticks=300))
    assert night.call(topics.START).success
    night.jam(5)
    with monkeypatch.context() as patch:  # it configures and clears the robots, and dies
        patch.setattr("fiber_bus_bridge.node.kept_plan.KeptPlan.tell", lambda _: None)
        night.restart()
    assert (night.robots.memory["fault"] == 0).all() and not outcomes_of(night, 9)
    night.restart()
    result, reason, _ = night.end(9)
    assert result[5] == Outcome.FAILED and reason[5] == Reason.STALLED
    assert set(reason[PLANE.ids != 5].tolist()) == {Reason.NO_HEARTBEAT}


def test_a_bridge_that_dies_once_it_has_cleared_for_another_attempt_has_noted_the_first(
    night, monkeypatch
):
    night.given |= {"attempts": 2, "session__resumes": 0}
    night.restart()
    night.ready(9, unfolding(ticks=300))
    assert night.call(topics.START).success
    night.jam(5)
    night.until(lambda: [m for m in night.received[topics.TARGETS.name] if PlanStamp.of(m).ns > 9])
    assert (night.robots.memory["fault"] == 0).all(), "they are cleared"
    night.restart()
    result, reason, _ = night.end(9)
    assert result[5] == Outcome.FAILED and reason[5] == Reason.STALLED
    assert set(reason[PLANE.ids != 5].tolist()) == {Reason.OTHER_FAILED}


def test_without_a_note_of_the_first_attempt_there_is_no_other(night, monkeypatch):
    night.given |= {"attempts": 2, "session__resumes": 0}
    night.restart()
    night.ready(9, unfolding(ticks=300))
    assert night.call(topics.START).success

    def full(*_):
        raise BridgeError("no space left on device")

    monkeypatch.setattr("fiber_bus_bridge.node.kept_plan.save_left_plan", full)
    night.jam(5)
    result, reason, _ = night.end(9)
    assert result[5] == Outcome.FAILED and reason[5] == Reason.STALLED
    assert all(PlanStamp.of(m).ns == 9 for m in night.received[topics.TARGETS.name])


def test_what_was_known_before_the_go_and_what_the_robots_say_are_told(night):
    night.robots.power([3], False, 0.0)
    night.ready(9, unfolding(300))
    assert night.call(topics.START).success
    night.robots.power([5], False, night.bridge._session.transactions.now_s)
    night.restart()
    result, reason, _ = night.end(9)
    assert result[3] == Outcome.HELD and reason[3] == Reason.NO_REPLY
    assert result[5] == Outcome.FAILED and reason[5] == Reason.NO_REPLY
    others = ~np.isin(PLANE.ids, (3, 5))
    assert set(reason[others].tolist()) == {Reason.NO_HEARTBEAT}


def test_robots_that_arrived_while_no_bridge_was_there_have_reached_their_targets(night):
    night.ready(9, unfolding(50))
    assert night.call(topics.START).success
    with pytest.MonkeyPatch.context() as patch:  # the bridge dies as it would say so
        patch.setattr("fiber_bus_bridge.node.publishers.Publishers.publish_outcome", lambda *_: 0)
        patch.setattr("pathlib.Path.unlink", lambda *_, **__: None)
        night.until(lambda: night.bridge._session.state is SessionState.IDLE)
    night.restart()
    assert set(night.end(9)[0].tolist()) == {Outcome.REACHED}


def test_a_damaged_file_of_a_plan_is_refused_by_name(night):
    path = night.path.with_name("robots.json.plan")
    plan = LeftPlan(
        9, np.full((7, 2), np.nan), np.full(7, -1), np.ones(7, dtype=bool),
        PlanResult(np.ones(7, dtype=int), np.ones(7, dtype=int), np.full(7, np.nan)),
    )  # fmt: skip
    save_left_plan(path, plan, PLANE)
    assert load_left_plan(path, PLANE).result.reason.tolist() == [1] * 7
    with pytest.raises(BridgeError, match=r"robots\.json\.plan: it is of another plane"):
        load_left_plan(path, PLANE.permuted(np.arange(6)))
    text, rng = path.read_text(), np.random.default_rng(2)
    for _ in range(200):
        at = int(rng.integers(len(text)))
        path.write_text(text[:at] + str(rng.integers(10)) + text[at + 1 :])
        if path.read_text() != text and _parsed(path.read_text()) != _parsed(text):
            with pytest.raises(BridgeError, match=r"robots\.json\.plan"):
                load_left_plan(path, PLANE)
    path.write_text(text[:-9])
    night.restart()
    night.until(lambda: "how that plan ended is not told" in night.status().text)


def test_vouching_at_the_start_has_no_effect_and_is_named(peer_log, night):
    night.path.write_text("{")
    night.robots.power([0], False, 0.0)
    night.given["vouched"] = [0]
    night.restart()
    night.until(lambda: "place unknown" in night.left_out().get("robot 0", ""))
    assert "vouched is [0] at the start and has no effect" in peer_log()


def test_all_robots_at_unknown_places_are_named_however_many(night, monkeypatch):
    monkeypatch.setattr("fiber_bus_bridge.node.publishers._NAMED", 2)
    night.path.write_text("{")
    night.robots.power([0, 2, 3, 5], False, 0.0)
    night.restart()
    night.until(lambda: "place unknown" in night.left_out().get("robot 2", ""))
    left_out = night.left_out()
    assert "place unknown" in left_out["robot 0"] and "robot 3" not in left_out
    assert left_out["further place unknown"] == "3 5"


def test_an_operator_vouches_for_a_robot_whose_place_is_not_known(night):
    night.path.write_text("{")
    night.robots.power([0], False, 0.0)
    night.restart()
    night.until(lambda: "place unknown" in night.left_out().get("robot 0", ""))
    assert json.loads(night.path.read_text())["lost"][0] == 1
    near = np.hypot(*(PLANE.centers - PLANE.centers[0]).T) < 12.0
    neighbours = near & (PLANE.ids != 0)
    assert neighbours.any()
    night.ask(9, PLANE.ids, PLANE.centers + 3.0)
    night.ready(9)
    night.call(topics.START)
    assert np.all(night.end(9)[1][neighbours] == Reason.PLACE_UNKNOWN)

    # an operator has looked where robot 0 is
    assert night.bridge.set_parameters([Parameter("vouched", value=[0])])[0].successful
    night.until(lambda: "place" not in str(night.left_out().get("robot 0")))
    assert not load_memory(night.path, PLANE, QUANTUM, 1).lost.any()
    bad = night.bridge.set_parameters([Parameter("vouched", value=[99])])[0]
    again = night.bridge.set_parameters([Parameter("vouched", value=[0])])[0]
    assert (
        not again.successful and "robot 0 cannot be vouched for: its place is known" in again.reason
    )
    assert not bad.successful and "robot 99 cannot be vouched for" in bad.reason
    counts, motion = night.counts(), turning(ticks=300)
    night.ready(20, type(motion)(UNITS, counts, motion.offsets, motion.ticks, motion.velocity))
    assert night.call(topics.START).success
    night.end(20)
    night.until(lambda: (night.counts()[neighbours] != counts[neighbours]).any(axis=1).all())


def test_failed_robots_and_places_survive_a_restart(night):
    night.robots.power([3], False, 0.0)
    night.ask(9, PLANE.ids, PLANE.centers + 3.0)
    night.ready(9)
    assert night.call(topics.START).success
    night.end(9)
    night.until(lambda: night.left_out().get("robot 3") == "no_reply")
    memory = load_memory(night.path, PLANE, QUANTUM, 1)
    assert memory.failed[3] == Reason.NO_REPLY and not memory.lost.any()
    counts = night.counts()
    night.restart()
    night.until(lambda: night.left_out().get("robot 3") == "no_reply")
    assert np.array_equal(night.counts(), counts)
    # it rested when it fell silent, so its place is known, and its neighbours move
    motion = turning()
    night.ready(20, type(motion)(UNITS, counts, motion.offsets, motion.ticks, motion.velocity))
    assert night.call(topics.START).success
    night.end(20)
    others = PLANE.ids != 3
    night.until(lambda: (night.counts()[others] != counts[others]).any(axis=1).all())

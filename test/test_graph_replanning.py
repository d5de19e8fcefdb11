# SPDX-License-Identifier: Apache-2.0
"""The whole graph when robots cannot be commanded: the others are planned again around them."""

import numpy as np
import pytest

import fiber_bus_bridge.node.hardware
from fiber_bringup.graph import Graph
from fiber_bus_bridge.simulation import EVENT, Event, Faults, SimulatedBuses
from fiber_client.client import PlaneClient
from fiber_client.disable import DisabledRobots
from fiber_client.vouch import vouch
from fiber_core.clearance import Safety, certify
from fiber_core.kinematics import forward
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import FRAME_ID, PlanStamp, progress, session_of, targets, topics
from fiber_recording import load_recording
from fiber_recording.node import recording_name
from fiber_recording.replay import replay
from fiber_recording.settled_replay import settled_replay

pytestmark = pytest.mark.timeout(900)  # the first plan of all compiles every core

COMPILE_S, WAIT_S = 600.0, 60.0
LOST = [6, 19, 33, 52]  # where these stand, others cannot pass as planned in the first attempt
DERIVED = (
    topics.TARGETS, topics.HELD_BY_PLANNER, topics.TRAJECTORY, topics.HELD_BY_DISCRETIZER,
    topics.SEGMENTS, topics.CORRIDORS, topics.FRAMES,
)  # fmt: skip
# every topic whose messages have a header
STAMPED = (
    *DERIVED, topics.LAYOUT, topics.JOINT_STATES, topics.OUTCOME, topics.DIAGNOSTICS,
    topics.VIEW_ARMS, topics.VIEW_PLANE, topics.VIEW_TARGETS,
)  # fmt: skip

IN_SESSION = (
    topics.LAYOUT, topics.JOINT_STATES, topics.TARGETS, topics.TRAJECTORY, topics.SEGMENTS,
    topics.OUTCOME,
)  # fmt: skip


@pytest.fixture
def graph(problem_file, new_domain, monkeypatch):
    """Function that starts a graph with faults; returns a client and the simulated robots."""
    made, build, open_now = [], fiber_bus_bridge.node.hardware.simulated_buses, []

    def start(events=(), recorder=None, viewer=None, **bridge):
        def with_faults(*given):
            plain = build(*given)
            faults = Faults(events=np.array(list(events), dtype=EVENT))
            made.append(SimulatedBuses(plain.positioners, plain.timing, faults))
            return made[-1]

        monkeypatch.setattr(fiber_bus_bridge.node.hardware, "simulated_buses", with_faults)
        domain = new_domain()
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))  # for commands
        parameters = {"problem": problem_file, "time_scale": 0.0} | bridge
        open_now.append(Graph(bridge=parameters, recorder=recorder, viewer=viewer, domain=domain))
        open_now[-1].__enter__()
        open_now.append(PlaneClient(domain))
        open_now[-1].wait_for_graph(COMPILE_S)
        return open_now[-1], made[-1].positioners

    yield start
    for each in reversed(open_now):
        each.__exit__(None, None, None)


def send_targets(client, problem):
    stamp = client.send_targets(problem.plane.ids[problem.asked], problem.targets[problem.asked])
    client.wait_until_ready(stamp, COMPILE_S)
    return stamp


def check_both_attempts(client, problem, stamp, before):
    """All other robots arrive in the second attempt, and the bytes of both attempts are safe."""
    ended = client.wait_for_outcome(stamp, WAIT_S)
    asked, lost = problem.asked, np.isin(problem.plane.ids, LOST)
    assert np.array_equal(ended.ids, problem.plane.ids) and set(client.outcomes) == {stamp}
    assert np.all(ended.outcome[asked & ~lost] == Outcome.REACHED)
    assert np.all(ended.outcome[lost] == Outcome.HELD)
    first, second = client.attempts(stamp)
    assert first == stamp < second == client.last_attempt(stamp)
    moved = np.zeros(problem.plane.n, dtype=bool)
    for attempt in (stamp, second):
        start = before if attempt == stamp else client.counts_before[second]
        replayed = replay(client.plane, client.units, start, client.frames[attempt])
        assert certify(client.plane, replayed.motion.decoded(), Safety()).ok
        moves = (replayed.motion.end != start).any(axis=1)
        assert moves.any() and not moves[lost].any()
        if attempt == stamp:
            np.testing.assert_array_equal(replayed.motion.end, client.counts_before[second])
            waited = asked & ~lost & ~moves
            assert waited.any()
        else:
            assert moves[waited].all()
            end = replayed.motion.end
        moved |= moves
    client.wait_for(
        lambda: np.array_equal(client.units.to_counts(client.angles), end), WAIT_S, "all at the end"
    )
    off_mm = np.hypot(*(forward(problem.plane, client.angles)[1] - problem.targets).T)
    assert np.all(off_mm[asked & ~lost] <= 0.1) and np.array_equal(moved, asked & ~lost)
    return ended


def test_absent_robots_become_obstacles_and_the_others_arrive(graph, problem, tmp_path):
    client, robots = graph(recorder={"folder": str(tmp_path)}, viewer={})
    received = {topic.name: client.collect(topic) for topic in STAMPED}
    reports = client.collect(topics.PROGRESS)
    before = client.units.to_counts(client.angles)
    stamp = send_targets(client, problem)
    robots.power(LOST, False, 0.0)
    client.start(WAIT_S)
    ended = check_both_attempts(client, problem, stamp, before)
    assert np.all(ended.of(LOST).reason == Reason.NO_REPLY)
    stamps = client.attempts(stamp)
    for topic in DERIVED:
        client.wait_for(
            lambda messages=received[topic.name]: set(map(PlanStamp.of, messages)) == set(stamps),
            WAIT_S,
            f"both attempts on {topic.name}",
        )
    asked = received[topics.TARGETS.name]
    attempts = [targets.decode_attempt(message) for message in asked]
    assert [(each.stamp, each.plan, each.number) for each in attempts] == [
        (stamps[0], stamp, 1), (stamps[1], stamp, 2),
    ]  # fmt: skip
    assert not set(targets.decode(asked[1])[0]) & set(LOST)
    client.wait_for(lambda: all(received.values()), WAIT_S, "messages on all topics")
    assert [PlanStamp.of(message) for message in received[topics.OUTCOME.name]] == [stamp]
    announced = {progress.decode(message).attempt for message in reports}
    names = {(each.stamp, each.plan, each.number) for each in announced}
    assert {(each.stamp, each.plan, each.number) for each in attempts} <= names
    assert {session_of(m) for t in IN_SESSION for m in received[t.name]} == {client.session}
    # a filter of a bag by frame finds every message, and the frame is that of tf and RViz
    for name, messages in received.items():
        assert {message.header.frame_id for message in messages} == {FRAME_ID}, name
    assert client.plane.ids[~client.plane.enabled].tolist() == sorted([3, 17, 40, *LOST])

    client.wait_for_recording(stamp, WAIT_S)
    recording = load_recording(tmp_path / recording_name(stamp))
    assert recording.about["attempts"] == 2 and "2 attempts" in recording.about["notes"][0]
    starts = [phase.motion.start for phase in recording.phases]
    np.testing.assert_array_equal(starts, [before, client.counts_before[stamps[1]]])
    np.testing.assert_array_equal(recording.outcome, ended.outcome)
    assert recording.about["certificate"]["ok"]
    assert recording.problem.asked.sum() == problem.asked.sum()


def test_robots_whose_memory_fails_at_the_load_become_obstacles(graph, problem):
    # every 20 us another bit of the stored order flips
    ticks = np.arange(0.0, 0.5, 20e-6)
    events = [(row, t, Event.FLIP, k) for row in LOST for k, t in enumerate(ticks)]
    client, _ = graph(events)
    before = client.units.to_counts(client.angles)
    stamp = send_targets(client, problem)
    client.start(WAIT_S)
    ended = check_both_attempts(client, problem, stamp, before)
    assert np.all(ended.of(LOST).reason == Reason.NOT_VERIFIED)


def test_with_one_attempt_lost_robots_are_left_out_of_later_plans_until_clear(graph, problem):
    client, robots = graph(attempts=1)
    stamp = send_targets(client, problem)
    robots.power(LOST, False, 0.0)
    client.start(WAIT_S)
    ended = client.wait_for_outcome(stamp, WAIT_S)
    waited = ended.ids[ended.reason == Reason.UNSAFE_AS_LOADED]
    assert len(waited) and client.last_attempt(stamp) == stamp
    client.wait_for(lambda: not client.plane.enabled[LOST].any(), WAIT_S, "their layout")

    stamp = send_targets(client, problem)
    client.start(WAIT_S)
    again = client.wait_for_outcome(stamp, WAIT_S)
    assert np.all(again.of(waited).outcome == Outcome.REACHED)
    # they keep the reason for which they failed
    assert np.all(again.of(LOST).reason == Reason.NO_REPLY)
    client.call_service(topics.CLEAR, WAIT_S)
    client.wait_for(lambda: client.plane.enabled[LOST].all(), WAIT_S, "all in the layout again")


def test_robots_that_configure_does_not_find_are_left_out_of_plans(graph, problem):
    client, robots = graph()
    robots.power(LOST, False, 0.0)
    client.call_service(topics.CONFIGURE, WAIT_S)
    client.wait_for(lambda: not client.plane.enabled[LOST].any(), WAIT_S, "their layout")
    stamp = send_targets(client, problem)
    client.start(WAIT_S)
    ended = client.wait_for_outcome(stamp, WAIT_S)
    others = ended.of(np.setdiff1d(problem.plane.ids[problem.asked], LOST))
    assert np.all(others.outcome == Outcome.REACHED) and client.last_attempt(stamp) == stamp
    assert np.all(ended.of(LOST).reason == Reason.NOT_ACKNOWLEDGED)
    client.wait_for(
        lambda: "4 not found" in client.statuses["bridge: left out"].text,
        WAIT_S,
        "diagnostics of that",
    )
    robots.power(LOST, True, 0.0)
    client.call_service(topics.CONFIGURE, WAIT_S)
    client.wait_for(lambda: client.plane.enabled[LOST].all(), WAIT_S, "all in the layout again")


def test_robots_stopped_for_a_lost_robot_continue_in_the_next_attempt(graph, problem):
    # without resumes the bridge stops the plan, and clears by itself as no operator has stopped it
    silent = 30
    client, _ = graph([(silent, 1.0, Event.POWER, 0)], **{"session.resumes": 0})
    before = client.units.to_counts(client.angles)
    stamp = send_targets(client, problem)
    client.start(WAIT_S)
    ended = client.wait_for_outcome(stamp, WAIT_S)
    assert [stamp, client.last_attempt(stamp)] == client.attempts(stamp)
    assert (ended.outcome[silent], ended.reason[silent]) == (
        Outcome.FAILED,
        Reason.NO_REPLY,
    )
    # where it stopped is not known: robots that could touch it stay
    others = problem.asked & (problem.plane.ids != silent)
    assert set(ended.reason[others]) == {Reason.OK, Reason.PLACE_UNKNOWN}
    assert (ended.outcome == Outcome.REACHED).sum() > 40
    replayed = settled_replay(client, ended, before, WAIT_S)
    assert (replayed.motion.end != replayed.motion.start).any(axis=1).sum() > 40
    near_mm = np.hypot(*(problem.plane.centers - problem.plane.centers[silent]).T)
    assert near_mm[ended.reason == Reason.PLACE_UNKNOWN].max() < 13


def test_an_operator_vouches_for_robots_that_were_never_read(graph, problem, capsys):
    client, _ = graph([(row, 0.0, Event.POWER, 0) for row in LOST])
    assert vouch(["--list"]) == 0
    named = capsys.readouterr().out.splitlines()[1:]
    assert [int(line.split()[0]) for line in named] == LOST
    tips = forward(problem.plane, client.angles)[1][LOST]
    shown = np.array([line.split()[3:] for line in named], dtype=float)
    np.testing.assert_allclose(shown, tips, atol=0.006)

    asked, lost = problem.asked, np.isin(problem.plane.ids, LOST)
    stamp = send_targets(client, problem)
    client.start(WAIT_S)
    ended = client.wait_for_outcome(stamp, WAIT_S)
    waited = ended.ids[ended.reason == Reason.PLACE_UNKNOWN]
    assert len(waited) > 4 and not np.isin(waited, LOST).any()
    assert vouch(["1"]) == 1
    assert "robot 1 cannot be vouched for: its place is known" in capsys.readouterr().err
    assert vouch([*map(str, LOST)]) == 0
    assert vouch(["--list"]) == 0
    assert "the places of all robots are known" in capsys.readouterr().out
    stamp = send_targets(client, problem)
    client.start(WAIT_S)
    ended = client.wait_for_outcome(stamp, WAIT_S)
    assert np.all(ended.outcome[asked & ~lost] == Outcome.REACHED)


def test_robots_disabled_after_they_were_planned_for_are_planned_around(graph, problem):
    client, _ = graph()
    before = client.units.to_counts(client.angles)
    stamp = send_targets(client, problem)
    DisabledRobots(client, WAIT_S).write(LOST, "in repair")
    client.start(WAIT_S)
    ended = check_both_attempts(client, problem, stamp, before)
    assert np.all(ended.of(LOST).reason == Reason.DISABLED)

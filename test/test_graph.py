# SPDX-License-Identifier: Apache-2.0
"""The whole graph in one process, used through its topics and services only."""

import numpy as np
import pytest

from fiber_bringup.graph import Graph
from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneRefusal
from fiber_core.clearance import Safety, certify
from fiber_core.fields import random_field
from fiber_core.kinematics import forward
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import PlanStamp, joint_states, targets, topics
from fiber_msgs_py.table import encode_table
from fiber_recording.replay import replay
from fiber_recording.settled_replay import settled_replay

pytestmark = pytest.mark.timeout(900)  # the first plan of all compiles every core

COMPILE_S, WAIT_S = 600.0, 60.0
TOLERANCE_MM = 0.1  # the bridge's default


@pytest.fixture(scope="module")
def fast(problem_file, new_domain):
    """A graph that simulates motions as fast as it can, and a client."""
    domain = new_domain()
    bridge = {"problem": problem_file, "time_scale": 0.0}
    with Graph(bridge=bridge, domain=domain) as graph, PlaneClient(domain) as client:
        client.wait_for_graph(COMPILE_S)
        check_good_plan(client, 0, COMPILE_S)
        yield client
        assert graph.running, "a node has died"


@pytest.fixture
def client(fast):
    """The client, without orders from the test before."""
    yield fast
    fast.call_service(topics.CLEAR, WAIT_S)


def new_targets(client, seed):
    """Random targets that all robots can reach from where they are."""
    rng = np.random.default_rng(seed)
    drawn = random_field(client.plane, rng, start=client.angles).problem
    return client.plane.ids[drawn.asked], drawn.targets[drawn.asked]


def check_good_plan(client, seed, timeout_s=WAIT_S):
    """Take the plane to new targets; return the outcome and the replay of the frames."""
    before = client.units.to_counts(client.angles)
    ids, xy_mm = new_targets(client, seed)
    ended = client.reconfigure(ids, xy_mm, timeout_s)
    replayed = settled_replay(client, ended, before, WAIT_S)
    assert replayed.started.any() and (ended.of(ids).outcome == Outcome.REACHED).mean() > 0.5
    return ended, replayed


def test_every_robot_has_one_outcome_that_agrees_with_its_encoders(client, problem):
    plane, before = client.plane, client.angles
    # disabled robots get targets as well, three others get none
    asked_mm = np.where(problem.asked[:, None], problem.targets, plane.centers + [2.0, 0.0])
    ids, xy_mm = plane.ids[:-3], asked_mm[:-3]
    ended = client.reconfigure(ids, xy_mm, WAIT_S)
    replayed = settled_replay(client, ended, client.units.to_counts(before), WAIT_S)

    assert np.array_equal(ended.ids, plane.ids)
    error_mm = np.hypot(*(forward(plane, client.angles)[1] - asked_mm).T)[:-3]
    of_asked = ended.of(ids)
    np.testing.assert_allclose(of_asked.error_mm, error_mm, atol=1e-6)
    reached = of_asked.outcome == Outcome.REACHED
    assert reached.mean() > 0.7
    assert np.all(error_mm[reached] <= TOLERANCE_MM)
    assert np.all((of_asked.reason == Reason.OK) == reached)
    disabled = ~plane.enabled[:-3]
    assert np.all(of_asked.reason[disabled] == Reason.DISABLED)
    assert np.all(of_asked.outcome[~reached] == Outcome.HELD)
    assert np.all(ended.reason[-3:] == Reason.NO_TARGET)

    # the robots that moved are those that the bytes started, and the bytes are safe
    assert np.array_equal(client.angles[~replayed.started], before[~replayed.started])
    assert np.all(client.angles[replayed.started] != before[replayed.started], axis=1).any()
    assert not replayed.started[~plane.enabled].any()
    assert certify(plane, replayed.motion.decoded(), Safety()).ok


def test_every_derived_message_carries_the_stamp_of_the_targets(client):
    derived = {
        topic.name: client.collect(topic)
        for topic in (
            topics.HELD_BY_PLANNER,
            topics.TRAJECTORY,
            topics.HELD_BY_DISCRETIZER,
            topics.SEGMENTS,
            topics.FRAMES,
            topics.OUTCOME,
        )
    }
    ended, _ = check_good_plan(client, 1)

    def missing():
        return [
            name
            for name, heard in derived.items()
            if all(PlanStamp.of(message) < PlanStamp(ended.stamp_ns) for message in heard)
        ]

    client.wait_for(lambda: not missing(), WAIT_S, lambda: f"this plan on {missing()}")
    for name, heard in derived.items():
        stamps = {PlanStamp.of(message) for message in heard}
        assert {stamp for stamp in stamps if stamp >= PlanStamp(ended.stamp_ns)} == {
            PlanStamp(ended.stamp_ns)
        }, name
    assert {"sent", "planner", "discretizer", "bridge", "ended"} <= set(
        client.times[PlanStamp(ended.stamp_ns)]
    )


def test_home_folds_the_robots(client):
    ended = client.home(WAIT_S)
    client.wait_for(lambda: not client.moving, WAIT_S)
    folded = ended.outcome == Outcome.REACHED
    client.wait_for(
        lambda: np.allclose(client.angles[folded, 1], client.plane.limits[folded, 1, 1], atol=1e-2),
        WAIT_S,
        "encoders at their upper limit",
    )
    assert folded.sum() > client.plane.n / 2
    check_good_plan(client, 2)


def table_of(client, stamp, ids, x, y):
    rows = np.zeros(len(ids), dtype=[("id", "<u4"), ("x", "<f8"), ("y", "<f8")])
    rows["id"], rows["x"], rows["y"] = ids, x, y
    return encode_table(rows, stamp, client.session)


def without_x(client, stamp):
    message = table_of(client, stamp, [1, 2], [0.0, 0.0], [0.0, 0.0])
    message.fields = [field for field in message.fields if field.name != "x"]
    return message


def cut_short(client, stamp):
    message = table_of(client, stamp, [1, 2], [0.0, 0.0], [0.0, 0.0])
    message.data = message.data[:-3]
    return message


def in_another_frame(client, stamp):
    message = table_of(client, stamp, [1], [0.0], [0.0])
    message.header.frame_id = "map"
    return message


def of(ids, x, y):
    return lambda client, stamp: table_of(client, stamp, ids, x, y)


BAD_TABLES = {
    "missing field": (without_x, "x is missing"),
    "wrong size": (cut_short, "size of data is 37 bytes, expected 40"),
    "another frame": (in_another_frame, "frame_id 'map'"),
    "nan": (of([1, 7], [0.0, np.nan], [0.0, 0.0]), "robot 7: x nan"),
    "unknown": (of([1, 4242], [0.0, 0.25], [0.0, 0.5]), r"robot 4242.*\[250.0"),
    "twice": (of([5, 5], [0.0, 0.0], [0.0, 0.0]), "robot 5: id 5"),
    "stale": (
        lambda client, _: table_of(client, PlanStamp(1), [1], [0.0], [0.0]),
        "targets 0.000000001 refused: plan .* is not older",
    ),
    "future": (
        lambda client, stamp: table_of(
            client, PlanStamp(stamp.ns + 3600 * 10**9), [1], [0.0], [0.0]
        ),
        "its stamp is 3600 s ahead",
    ),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_a_bad_table_is_refused_and_nothing_moves(client, name):
    make, said = BAD_TABLES[name]
    check_good_plan(client, 3)
    before = client.angles
    trajectories = client.collect(topics.TRAJECTORY)
    stamp = PlanStamp(client.node.get_clock().now().nanoseconds)
    bad = client.send_message(make(client, stamp))
    with pytest.raises(PlaneRefusal, match=said):
        client.wait_until_ready(bad, WAIT_S)
    with pytest.raises(PlaneRefusal, match="cannot start while IDLE"):
        client.start(WAIT_S)
    assert np.array_equal(client.angles, before) and not client.moving
    # the plan has ended, like every plan of this session
    ended = client.wait_for_outcome(bad, WAIT_S)
    assert np.all(ended.outcome == Outcome.HELD) and Reason.PLAN_REFUSED in ended.reason
    ended, _ = check_good_plan(client, 4)
    assert bad not in {PlanStamp.of(message) for message in trajectories}
    assert PlanStamp(ended.stamp_ns) in client.outcomes


def test_the_client_itself_refuses_to_send_a_bad_table(client):
    with pytest.raises(targets.MessageError, match="robot 7: x, y .* nan"):
        client.send_targets([1, 7], [[0.0, 0.0], [np.nan, 0.0]])


@pytest.mark.usefixtures("fast")
def test_during_a_motion_only_stop_is_accepted(problem_file, new_domain):
    domain = new_domain()
    bridge = {"problem": problem_file, "time_scale": 1.0}
    with Graph(bridge=bridge, domain=domain) as graph, PlaneClient(domain) as client:
        client.wait_for_graph(WAIT_S)
        before = client.angles
        ids, xy_mm = new_targets(client, 5)
        stamp = client.send_targets(ids, xy_mm)
        client.wait_until_ready(stamp, WAIT_S)
        client.start(WAIT_S)
        client.wait_for(lambda: client.moving, WAIT_S, "motion")

        # targets, and every service but stop, are refused
        with pytest.raises(PlaneRefusal, match="moving"):
            client.wait_until_ready(client.send_targets(ids, xy_mm), WAIT_S)
        for service in (topics.START, topics.HOME, topics.CLEAR, topics.CONFIGURE):
            with pytest.raises(PlaneRefusal, match="while MOVING: wait for the end, or stop"):
                client.call_service(service, WAIT_S)
        assert stamp not in client.outcomes, "the motion was over before it could be disturbed"

        client.call_service(topics.STOP, WAIT_S)
        ended = client.wait_for_outcome(stamp, WAIT_S)
        client.wait_for(lambda: not client.moving, WAIT_S, "rest")
        stopped = ended.reason == Reason.STOPPED
        assert stopped.any() and not ended.count(Outcome.FAILED)
        replayed = replay(
            client.plane, client.units, client.units.to_counts(before), client.frames[stamp]
        )
        ordered = replayed.motion.decoded().end
        there = client.angles
        travel = np.abs(ordered - before)[stopped]
        gone = np.abs(there - before)[stopped]
        assert np.all(gone <= travel.max()) and np.any(gone > 1e-3)
        assert np.all(np.any(there[stopped] != ordered[stopped], axis=1))

        with pytest.raises(PlaneRefusal, match="while STOPPED: clear first"):
            client.start(WAIT_S)
        client.call_service(topics.CLEAR, WAIT_S)
        assert np.array_equal(client.angles, there)
        check_good_plan(client, 6)
        assert graph.running


@pytest.mark.usefixtures("fast")
def test_two_domains_do_not_see_each_other_and_send_the_same_bytes(
    problem, problem_file, new_domain
):
    domains = [new_domain(), new_domain()]
    bridge = {"problem": problem_file, "time_scale": 0.0}
    ids, xy_mm = problem.plane.ids[problem.asked], problem.targets[problem.asked]
    with (
        Graph(bridge=bridge, domain=domains[0]),
        Graph(bridge=bridge, domain=domains[1]),
        PlaneClient(domains[0]) as one,
        PlaneClient(domains[1]) as other,
    ):
        one.wait_for_graph(WAIT_S)
        other.wait_for_graph(WAIT_S)
        before = one.units.to_counts(one.angles)
        first = one.reconfigure(ids, xy_mm, WAIT_S)
        replayed = settled_replay(one, first, before, WAIT_S)
        assert replayed.started.any()
        # the other plane has not moved, and has received no plan
        assert np.array_equal(other.units.to_counts(other.angles), before)
        second = other.reconfigure(ids, xy_mm, WAIT_S)
        replayed_again = settled_replay(other, second, before, WAIT_S)
        assert set(one.outcomes) == set(one.frames) == {PlanStamp(first.stamp_ns)}
        assert set(other.outcomes) == set(other.frames) == {PlanStamp(second.stamp_ns)}
    for name in ("offsets", "ticks", "velocity"):
        assert np.array_equal(
            getattr(replayed.motion, name), getattr(replayed_again.motion, name)
        ), name
    assert np.array_equal(first.outcome, second.outcome)


def test_a_bag_that_is_played_into_its_own_open_session_moves_no_robot(client):
    """The hardest bag: every message of it carries the id that the graph accepts."""
    chain = (
        topics.LAYOUT, topics.JOINT_STATES, topics.TARGETS, topics.PROGRESS, topics.TRAJECTORY,
        topics.SEGMENTS, topics.OUTCOME,
    )  # fmt: skip
    heard = [client.collect(topic) for topic in chain]
    check_good_plan(client, 31)
    bag = [(at, message) for at, messages in enumerate(heard) for message in messages]
    assert {at for at, _ in bag} == set(range(len(chain)))
    check_good_plan(client, 32)  # the robots are elsewhere now, and the session is the same
    client.wait_for(lambda: not client.moving, WAIT_S)
    counts, ended = client.units.to_counts(client.angles), set(client.outcomes)
    # the client hears the bag too, and remembers only so many plans
    ended |= {PlanStamp.of(message) for message in heard[chain.index(topics.OUTCOME)]}

    players = [topic.publisher(client._ros.node) for topic in chain]
    client.wait_for(lambda: all(each.get_subscription_count() for each in players), WAIT_S)
    for _ in range(2):
        for at, message in bag:
            players[at].publish(message)
        with pytest.raises(PlaneRefusal):
            client.call_service(topics.START, WAIT_S)
    for player in players:
        client._ros.node.destroy_publisher(player)

    # what the bridge reads from the robots themselves
    client.call_service(topics.CLEAR, WAIT_S)
    states = client.collect(topics.JOINT_STATES)
    client.wait_for(lambda: len(states) > 1, WAIT_S)
    assert np.array_equal(client.units.to_counts(joint_states.decode(states[-1])[1]), counts)
    assert set(client.outcomes) <= ended
    # and the next plan begins where the robots are, not where the bag says
    check_good_plan(client, 33)

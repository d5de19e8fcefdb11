# SPDX-License-Identifier: Apache-2.0
"""The discretizer node, with the rest of the graph played by the test."""

import numpy as np
import pytest

from fiber_core.clearance import Safety, certify
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_discretizer.node import DiscretizerNode
from fiber_msgs_py import (
    Attempt,
    PlanStamp,
    Progress,
    Stage,
    corridors,
    diagnostics,
    held,
    joint_states,
    layout,
    progress,
    segments,
    session_of,
    topics,
    trajectory,
)
from fiber_node import BRIDGE, DISCRETIZER, Claim, RosClient, SessionGate

pytestmark = pytest.mark.timeout(600)

WAIT_S = 300.0  # the first plan compiles
PLANE = preset("desi", 7)
UNITS = WireUnits.for_plane(PLANE)
# folded, where arms are clear of each other whatever theta is
COUNTS = UNITS.to_counts(np.stack([np.linspace(-1.0, 1.0, 7), np.full(7, 3.1)], axis=1))
START = UNITS.to_angles(COUNTS)


def turning(start=START):
    """Every theta turns by 1 rad in 1 s, at first slowly."""
    share = np.array([0.0, 0.2, 1.0])
    way = np.multiply.outer(np.tile([1.0, 0.0], (7, 1)), share)
    return SampledMotion([0.0, 0.5, 1.0], start[:, :, None] + way)


class Rest:
    """The rest of the graph, as the discretizer sees it."""

    def __init__(self, peer):
        self.peer = peer
        self.held = peer.collect(topics.HELD_BY_DISCRETIZER)
        self.segments = peer.collect(topics.SEGMENTS)
        self.diagnostics = peer.collect(topics.DIAGNOSTICS)
        self.layout = topics.LAYOUT.publisher(peer.node)
        self.states = topics.JOINT_STATES.publisher(peer.node)
        self.trajectory = topics.TRAJECTORY.publisher(peer.node)
        self.progress = topics.PROGRESS.publisher(peer.node)
        self.reports = peer.collect(topics.PROGRESS)
        self.session = Claim(peer.node, BRIDGE).id
        peer.add_node(DiscretizerNode)
        peer.wait_for(
            lambda: self.diagnostics and self.progress.get_subscription_count() > 1, WAIT_S
        )

    def show_plane(self, border_skews_s=None):
        still = np.zeros((7, 2))
        self.layout.publish(
            layout.encode(PLANE, UNITS, PlanStamp(1), self.session, border_skews_s=border_skews_s)
        )
        self.states.publish(joint_states.encode(PLANE.ids, START, still, 1, self.session))
        self.peer.wait_for(lambda: self.status().values.get("robots") == "7", WAIT_S)

    def status(self):
        return diagnostics.decode(self.diagnostics[-1])[0]

    def send(self, ns, ids=PLANE.ids, motion=None, change=lambda message: None):
        """Accept a plan as the bridge would, and send its trajectory."""
        attempt = Attempt(PlanStamp(ns), PlanStamp(ns), 1, 1, 1)
        answer = Progress(BRIDGE, 0.0, "", attempt, self.session)
        self.progress.publish(progress.encode(answer))
        message = trajectory.encode(ids, motion or turning(), PlanStamp(ns), self.session)
        change(message)
        self.trajectory.publish(message)
        return message

    def discretize(self, *plan):
        """Send a trajectory; return the held and the motion that come back, all of its stamp."""
        return self.answers(self.send(*plan))

    def answers(self, message):
        self.peer.wait_for(lambda: self.segments and self.held, WAIT_S, "segments")
        answers = self.segments + self.held
        assert {PlanStamp.of(m) for m in answers} == {PlanStamp.of(message)}
        ids, reason, stage = held.decode(self.held[0])
        assert np.all(stage == Stage.DISCRETIZER)
        robots, motion = segments.decode(self.segments[0], UNITS)
        assert np.array_equal(robots, PLANE.ids)
        assert np.array_equal(motion.start, COUNTS) and session_of(self.segments[0]) == self.session
        return dict(zip(ids.tolist(), reason.tolist())), motion

    def wait_refusal(self, word):
        self.peer.wait_for(
            lambda: word in self.status().text, WAIT_S, f"a refusal that says {word}"
        )
        assert not self.held and not self.segments
        self.peer.wait_for(self.refusals, WAIT_S)
        assert [(p.stage, p.attempt.plan.ns, p.session) for p in self.refusals()] == [
            (DISCRETIZER, 9, self.session)
        ]

    def refusals(self):
        return [p for p in map(progress.decode, self.reports) if p.refused and p.stage != BRIDGE]


@pytest.fixture
def rest():
    with RosClient("rest") as peer:
        yield Rest(peer)


def test_a_trajectory_becomes_certified_segments_that_end_where_it_ends(rest):
    rest.show_plane()
    why, motion = rest.discretize(9)
    assert not why
    decoded = motion.decoded()
    np.testing.assert_allclose(decoded.end, turning().end, atol=1e-3)
    assert certify(PLANE, decoded, Safety()).ok
    assert np.all(decoded.counts[:, 0] >= 1) and not decoded.counts[:, 1].any()


def test_corridors_are_published_while_there_is_a_subscription(rest):
    rest.show_plane()
    rest.discretize(9)
    received = rest.peer.collect(topics.CORRIDORS)
    rest.peer.wait_for(lambda: rest.peer.node.count_publishers("focal_plane/corridors"), WAIT_S)
    rest.segments.clear()
    rest.held.clear()
    _, motion = rest.discretize(10)
    rest.peer.wait_for(lambda: received, WAIT_S, "corridors")
    # without a subscription no corridors of the first plan were made
    assert [PlanStamp.of(message) for message in received] == [PlanStamp(10)]
    ids, found = corridors.decode(received[0])
    assert np.array_equal(ids, PLANE.ids)
    end = motion.decoded().end
    assert np.all(found.low[:, :, -1] <= end + 1e-6) and np.all(end <= found.high[:, :, -1] + 1e-6)


def test_a_plan_ends_when_its_bridge_gives_no_sign_of_life(rest, monkeypatch):
    rest.show_plane()
    rest.discretize(8)
    rest.segments.clear()
    rest.held.clear()
    # as the middleware may not tell of a bridge that lives
    monkeypatch.setattr(SessionGate, "is_open", lambda self, session: False)
    rest.send(9)
    rest.wait_refusal("its bridge")


def test_robots_that_are_not_in_the_trajectory_rest(rest):
    rest.show_plane()
    some = SampledMotion(turning().time_s, turning().angles[2:4])
    why, motion = rest.discretize(9, PLANE.ids[2:4], some)
    moves = motion.decoded().counts.any(axis=1)
    assert not why and np.array_equal(np.flatnonzero(moves), [2, 3])


def test_a_robot_that_stands_elsewhere_is_held_and_the_others_go(rest):
    rest.show_plane()
    start = START.copy()
    start[4, 0] += 0.2
    why, motion = rest.discretize(9, PLANE.ids, turning(start))
    assert why == {4: Reason.BAD_TRAJECTORY}
    assert np.array_equal(motion.decoded().counts.any(axis=1), PLANE.ids != 4)


def test_a_trajectory_of_another_plane_is_refused(rest):
    rest.show_plane()
    rest.send(9, PLANE.ids + 90)
    rest.wait_refusal("robot 90 of the trajectory is not in the layout")


def test_a_trajectory_is_refused_where_sectors_need_larger_skews_than_are_certified(rest):
    rest.show_plane((2e-3, 30e-3))
    rest.send(9)
    kept_s = Safety.border_stop_skew_s
    text = f"safety.border_stop_skew_s is {kept_s:g} s, the terms of the sectors need 0.03 s"
    rest.wait_refusal(text)


def test_a_value_that_is_not_finite_is_refused_by_robot(rest):
    rest.show_plane()

    def break_it(message):
        message.points[1].positions[2 * 3 + 1] = float("nan")

    rest.send(9, change=break_it)
    rest.wait_refusal("robot 3")
    assert "nan is not finite" in rest.status().text


def test_a_trajectory_that_comes_before_the_layout_waits_for_it(rest):
    message = rest.send(9)
    rest.peer.wait_for(lambda: message is not None and rest.status().text, WAIT_S)
    rest.show_plane()
    why, _ = rest.answers(message)
    assert not why
    assert not rest.refusals()


def test_a_trajectory_of_another_session_or_of_none_is_refused_by_name(rest):
    rest.show_plane()
    session = rest.session
    for other in ("session_" + 24 * "0", None):
        rest.trajectory.publish(trajectory.encode(PLANE.ids, turning(), PlanStamp(8), other))
        word = "no session" if other is None else f"its bridge, of {other}, is not in the graph"
        rest.peer.wait_for(lambda word=word: word in rest.status().text, WAIT_S, word)
    assert rest.session == session and not rest.segments


def test_only_trajectories_of_accepted_plans_are_discretized_and_each_once(rest):
    rest.show_plane()
    rest.trajectory.publish(trajectory.encode(PLANE.ids, turning(), PlanStamp(7), rest.session))
    rest.peer.wait_for(lambda: "waits until the bridge accepts" in rest.status().text, WAIT_S)
    rest.discretize(20)
    rest.send(20)
    rest.send(19)  # the bridge alone judges the order of stamps
    rest.peer.wait_for(lambda: len(rest.segments) == 2 == len(rest.held), WAIT_S)
    assert [PlanStamp.of(m).ns for m in rest.segments] == [20, 19]

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
    PlanStamp,
    Stage,
    corridors,
    diagnostics,
    held,
    joint_states,
    layout,
    segments,
    topics,
    trajectory,
)
from fiber_node import RosClient

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
        peer.add_node(DiscretizerNode)
        peer.wait_for(lambda: self.diagnostics, WAIT_S)

    def show_plane(self):
        self.layout.publish(layout.encode(PLANE, UNITS, PlanStamp(1)))
        self.states.publish(joint_states.encode(PLANE.ids, START, np.zeros((7, 2)), 1))
        self.peer.wait_for(lambda: self.status().values.get("robots") == "7", WAIT_S)

    def status(self):
        return diagnostics.decode(self.diagnostics[-1])[0]

    def discretize(self, message):
        """Send a trajectory; return the held and the motion that come back, all of its stamp."""
        self.trajectory.publish(message)
        self.peer.wait_for(lambda: self.segments and self.held, WAIT_S, "segments")
        answers = self.segments + self.held
        assert {PlanStamp.of(m) for m in answers} == {PlanStamp.of(message)}
        ids, reason, stage = held.decode(self.held[0])
        assert np.all(stage == Stage.DISCRETIZER)
        table = segments.decode(self.segments[0])
        assert np.array_equal(table.ids, PLANE.ids)
        return dict(zip(ids.tolist(), reason.tolist())), table.motion(UNITS, COUNTS)

    def wait_refusal(self, word):
        self.peer.wait_for(
            lambda: word in self.status().text, WAIT_S, f"a refusal that says {word}"
        )
        assert not self.held and not self.segments


@pytest.fixture
def rest():
    with RosClient("rest") as peer:
        yield Rest(peer)


def test_a_trajectory_becomes_certified_segments_that_end_where_it_ends(rest):
    rest.show_plane()
    why, motion = rest.discretize(trajectory.encode(PLANE.ids, turning(), PlanStamp(9)))
    assert not why
    decoded = motion.decoded()
    np.testing.assert_allclose(decoded.end, turning().end, atol=1e-3)
    assert certify(PLANE, decoded, Safety()).ok
    assert np.all(decoded.counts[:, 0] >= 1) and not decoded.counts[:, 1].any()


def test_corridors_are_published_while_there_is_a_subscription(rest):
    rest.show_plane()
    rest.discretize(trajectory.encode(PLANE.ids, turning(), PlanStamp(9)))
    received = rest.peer.collect(topics.CORRIDORS)
    rest.peer.wait_for(lambda: rest.peer.node.count_publishers("focal_plane/corridors"), WAIT_S)
    rest.segments.clear()
    rest.held.clear()
    _, motion = rest.discretize(trajectory.encode(PLANE.ids, turning(), PlanStamp(10)))
    rest.peer.wait_for(lambda: received, WAIT_S, "corridors")
    # without a subscription no corridors of the first plan were made
    assert [PlanStamp.of(message) for message in received] == [PlanStamp(10)]
    ids, found = corridors.decode(received[0])
    assert np.array_equal(ids, PLANE.ids)
    end = motion.decoded().end
    assert np.all(found.low[:, :, -1] <= end + 1e-6) and np.all(end <= found.high[:, :, -1] + 1e-6)


def test_robots_that_are_not_in_the_trajectory_rest(rest):
    rest.show_plane()
    some = SampledMotion(turning().time_s, turning().angles[2:4])
    why, motion = rest.discretize(trajectory.encode(PLANE.ids[2:4], some, PlanStamp(9)))
    moves = motion.decoded().counts.any(axis=1)
    assert not why and np.array_equal(np.flatnonzero(moves), [2, 3])


def test_a_robot_that_stands_elsewhere_is_held_and_the_others_go(rest):
    rest.show_plane()
    start = START.copy()
    start[4, 0] += 0.2
    why, motion = rest.discretize(trajectory.encode(PLANE.ids, turning(start), PlanStamp(9)))
    assert why == {4: Reason.BAD_TRAJECTORY}
    assert np.array_equal(motion.decoded().counts.any(axis=1), PLANE.ids != 4)


def test_a_trajectory_of_another_plane_is_refused(rest):
    rest.show_plane()
    other = trajectory.encode(PLANE.ids + 90, turning(), PlanStamp(9))
    rest.trajectory.publish(other)
    rest.wait_refusal("robot 90 of the trajectory is not in the layout")


def test_a_value_that_is_not_finite_is_refused_by_robot(rest):
    rest.show_plane()
    message = trajectory.encode(PLANE.ids, turning(), PlanStamp(9))
    message.points[1].positions[2 * 3 + 1] = float("nan")
    rest.trajectory.publish(message)
    rest.wait_refusal("robot 3")
    assert "nan is not finite" in rest.status().text


def test_a_trajectory_before_the_layout_is_refused_and_comes_through_later(rest):
    message = trajectory.encode(PLANE.ids, turning(), PlanStamp(9))
    rest.trajectory.publish(message)
    rest.wait_refusal("layout: not received yet")
    rest.show_plane()
    why, _ = rest.discretize(message)
    assert not why


def test_an_older_trajectory_is_dropped_with_a_message(rest):
    rest.show_plane()
    rest.discretize(trajectory.encode(PLANE.ids, turning(), PlanStamp(20)))
    rest.trajectory.publish(trajectory.encode(PLANE.ids, turning(), PlanStamp(19)))
    rest.peer.wait_for(lambda: f"{PlanStamp(19)} dropped" in rest.status().text, WAIT_S)
    assert len(rest.segments) == len(rest.held) == 1

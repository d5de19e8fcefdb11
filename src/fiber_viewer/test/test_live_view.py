# SPDX-License-Identifier: Apache-2.0
"""The live view shows arms in their places, and costs nothing without a subscriber."""

import subprocess
import sys

import numpy as np
import pytest
from rclpy.parameter import Parameter
from visualization_msgs.msg import Marker

from fiber_core import kinematics
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import FRAME_ID, PlanStamp, joint_states, layout, outcome, targets, topics
from fiber_msgs_py.point_clouds import POINTS, ViewState, arms_cloud, plane_cloud, view_states
from fiber_node import BRIDGE, Claim, RosClient
from fiber_viewer.node import WATCHED, ViewerNode
from fiber_viewer.outlines import outlines

N, WAIT_S = 12, 20.0


@pytest.fixture
def plane():
    return preset("desi_outlines", N).with_enabled(np.arange(N) != 4)


@pytest.fixture
def angles():
    return np.random.default_rng(2).uniform(0.2, 2.5, (N, 2))


def points(rows):
    return np.stack([rows["x"], rows["y"]], axis=1)


def test_points_run_along_both_arms_in_metres(plane, angles):
    states = np.arange(N) % len(ViewState)
    rows = arms_cloud(plane, angles, states)
    elbow, tip = kinematics.forward(plane, angles)
    links = points(rows).reshape(2, N, POINTS, 2) * 1e3
    for link, (begin, end) in zip(links, ((plane.centers, elbow), (elbow, tip))):
        np.testing.assert_allclose(link[:, 0], begin, atol=1e-3)
        np.testing.assert_allclose(link[:, -1], end, atol=1e-3)
        np.testing.assert_allclose(link[:, 2], 0.6 * begin + 0.4 * end, atol=1e-3)
    assert (rows["z"] == 0).all()
    assert len(set(rows["rgb"])) == len(ViewState)
    np.testing.assert_array_equal(rows["state"].reshape(2, N, POINTS)[1, :, 3], states)


def test_a_disabled_robot_has_that_state_and_a_moving_robot_has_no_outcome(plane):
    moving = np.zeros(N, dtype=bool)
    moving[[1, 4]] = True
    ended = np.full(N, Outcome.REACHED)
    ended[2], ended[3] = Outcome.HELD, Outcome.FAILED
    states = view_states(plane, moving, ended)
    assert states[:5].tolist() == [
        ViewState.REACHED, ViewState.MOVING, ViewState.HELD, ViewState.FAILED, ViewState.DISABLED
    ]  # fmt: skip
    assert (np.delete(view_states(plane, moving), [1, 4]) == ViewState.RESTING).all()


def test_an_outline_has_the_radius_of_the_core(plane, angles):
    for row in (0, 7):
        phi, theta = outlines(plane, row, angles)
        elbow = kinematics.forward(plane, angles)[0][row]
        reach = np.linalg.norm(plane.phi_vertices[row], axis=1).max() + plane.phi_radius[row]
        assert np.linalg.norm(phi - elbow, axis=1).max() == pytest.approx(reach, rel=0.02)
        np.testing.assert_allclose(phi[0], phi[-1])
        assert np.isfinite(theta).all()


class Scene:
    """A viewer, and a client that publishes all topics the viewer subscribes to."""

    def __init__(self, peer, plane):
        self.peer, self.plane = peer, plane
        self.viewer = peer.add_node(ViewerNode, watch=[int(plane.ids[3])])
        self.publishers = {
            topic.name: topic.publisher(peer.node)
            for topic in (topics.LAYOUT, topics.JOINT_STATES, topics.TARGETS, topics.OUTCOME)
        }
        self.session = Claim(peer.node, BRIDGE).id
        units = WireUnits.for_plane(plane)
        subscribers = self.publishers[topics.TARGETS.name].get_subscription_count
        peer.wait_for(lambda: subscribers() == 1, WAIT_S, "the viewer")
        self.publish(topics.LAYOUT, layout.encode(plane, units, PlanStamp(1), self.session))

    def publish(self, topic, message):
        self.publishers[topic.name].publish(message)

    def move(self, angles, speeds, time_ns):
        self.publish(
            topics.JOINT_STATES,
            joint_states.encode(self.plane.ids, angles, speeds, time_ns, self.session),
        )

    @property
    def pictures(self):
        return self.viewer._report.counters["pictures"]


@pytest.fixture
def scene(plane, new_domain):
    with RosClient("scene", new_domain()) as peer:
        yield Scene(peer, plane)


def spun(peer, slices):
    """Run callbacks for a number of periods of the viewer's timer."""
    periods = []
    timer = peer.node.create_timer(0.05, lambda: periods.append(1))
    peer.wait_for(lambda: len(periods) >= slices, WAIT_S)
    peer.node.destroy_timer(timer)


def test_without_subscribers_it_does_not_subscribe_to_joint_states(scene, plane, angles):
    peer = scene.peer
    peer.wait_for(lambda: scene.viewer._plane is not None, WAIT_S)
    scene.move(angles, np.ones((N, 2)), 1)
    spun(peer, 8)
    assert scene.pictures == 0
    assert scene.publishers[topics.JOINT_STATES.name].get_subscription_count() == 0


def test_with_a_subscriber_it_shows_arms_until_no_robot_moves(scene, plane, angles):
    peer, speeds = scene.peer, np.full((N, 2), 0.5)
    seen = []
    listening = topics.VIEW_ARMS.subscription(peer.node, seen.append)
    latched = peer.collect(topics.VIEW_PLANE)
    scene.move(angles, speeds, 1)
    peer.wait_for(lambda: len(seen) >= 3, WAIT_S, "pictures of moving arms")
    for message in seen:
        rows = np.frombuffer(message.data, arms_cloud(plane, angles, np.zeros(N, int)).dtype)
        tips = points(rows).reshape(2, N, POINTS, 2)[1, :, -1] * 1e3
        reach = 0.5 * 0.15 * (2 * plane.arms[:, 1] + plane.arms[:, 0])  # extrapolated
        exact = kinematics.forward(plane, angles)[1]
        assert (np.linalg.norm(tips - exact, axis=1) <= reach + 1e-3).all()
    assert rows["state"].reshape(2, N, POINTS)[0, :, 0].tolist().count(ViewState.MOVING) == N - 1
    assert len(latched) == 1 and latched[0].width == N
    np.testing.assert_allclose(
        points(np.frombuffer(latched[0].data, plane_cloud(plane).dtype)) * 1e3,
        plane.centers,
        atol=1e-3,
    )
    scene.move(angles, 0 * speeds, 2)
    peer.wait_for(lambda: scene.viewer._states[3] == 2, WAIT_S)
    spun(peer, 4)
    count = scene.pictures
    spun(peer, 8)
    assert scene.pictures == count, "no robot moves, and pictures are still published"
    ended = np.full(N, Outcome.FAILED)
    errors = np.zeros(N)
    scene.publish(
        topics.OUTCOME,
        outcome.encode(plane.ids, ended, ended * 0, errors, PlanStamp(3), scene.session),
    )
    peer.wait_for(lambda: scene.pictures > count, WAIT_S, "a picture of the outcome")
    peer.node.destroy_subscription(listening)
    joint_states_subscribers = scene.publishers[topics.JOINT_STATES.name].get_subscription_count
    peer.wait_for(lambda: joint_states_subscribers() == 0, WAIT_S, "the viewer to stop listening")


def watched(message):
    """Return the robots with outlines in a message, which must delete all earlier outlines."""
    assert message.markers[0].action == Marker.DELETEALL
    assert {marker.header.frame_id for marker in message.markers} == {FRAME_ID}
    return {marker.ns for marker in message.markers[1:]}


def test_at_rest_it_publishes_for_a_new_subscriber_and_a_new_robot(scene, plane, angles):
    peer, seen = scene.peer, scene.peer.collect(topics.VIEW_ARMS)
    scene.move(angles, 0 * angles, 1)
    peer.wait_for(lambda: seen, WAIT_S, "arms at rest")
    spun(peer, 8)
    outlined = peer.collect(WATCHED)
    peer.wait_for(lambda: outlined, WAIT_S, "outlines for a later subscriber")
    other = [int(plane.ids[7])]
    scene.viewer.set_parameters([Parameter("watch", value=other)])
    peer.wait_for(
        lambda: watched(outlined[-1]) == {str(other[0])}, WAIT_S, "the outlines of the other robot"
    )


def test_only_watched_robots_have_outlines(scene, plane, angles):
    peer = scene.peer
    seen, shown = peer.collect(WATCHED), peer.collect(topics.VIEW_TARGETS)
    scene.move(angles, 0 * angles, 1)
    peer.wait_for(lambda: seen, WAIT_S)
    assert watched(seen[-1]) == {str(plane.ids[3])}
    line = np.array([[p.x, p.y] for p in seen[-1].markers[1].points])
    np.testing.assert_allclose(line * 1e3, outlines(plane, 3, angles)[0], atol=1e-9)
    xy_mm = np.array([[1.0, 2.0], [3.0, 4.0]])
    scene.publish(topics.TARGETS, targets.encode(plane.ids[:2], xy_mm, PlanStamp(5), scene.session))
    peer.wait_for(lambda: shown, WAIT_S)
    rows = np.frombuffer(shown[-1].data, plane_cloud(plane).dtype)
    np.testing.assert_allclose(points(rows) * 1e3, xy_mm, atol=1e-4)


def test_the_node_loads_no_library_of_figures():
    # it takes a second, for which a restarted viewer would be missing
    code = "import sys, fiber_viewer.node; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

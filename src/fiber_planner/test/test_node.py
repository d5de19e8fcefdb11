"""The planner node alone: a test plays the rest of the graph."""

import numpy as np
import pytest

from fiber_core.fields import random_problem
from fiber_core.kinematics import forward
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    PlanStamp,
    Stage,
    diagnostics,
    held,
    joint_states,
    layout,
    targets,
    topics,
    trajectory,
)
from fiber_node import RosClient
from fiber_planner import PlannerError, parameters_of
from fiber_planner.node import PlannerNode

pytestmark = pytest.mark.timeout(600)

WAIT_S = 300.0  # the first plan compiles
PLANE = preset("desi", 7).with_enabled(np.arange(7) != 5)
UNITS = WireUnits.for_plane(PLANE)
PROBLEM = random_problem(PLANE, np.random.default_rng(2))
IDS, XY_MM = PLANE.ids[PROBLEM.asked], PROBLEM.targets[PROBLEM.asked]


class Rest:
    """The rest of the graph, as the planner sees it."""

    def __init__(self, peer, **parameters):
        self.peer = peer
        self.held = peer.collect(topics.HELD_BY_PLANNER)
        self.trajectories = peer.collect(topics.TRAJECTORY)
        self.diagnostics = peer.collect(topics.DIAGNOSTICS)
        self.layout = topics.LAYOUT.publisher(peer.node)
        self.states = topics.JOINT_STATES.publisher(peer.node)
        self.targets = topics.TARGETS.publisher(peer.node)
        self.planner = peer.add_node(PlannerNode, **parameters)
        peer.wait_for(lambda: self.targets.get_subscription_count() and self.diagnostics, WAIT_S)

    def show_plane(self, velocity=0.0):
        speeds = np.full_like(PROBLEM.start, velocity)
        self.layout.publish(layout.encode(PLANE, UNITS, PlanStamp(1)))
        self.states.publish(joint_states.encode(PLANE.ids, PROBLEM.start, speeds, 1))
        self.peer.wait_for(lambda: self.status().values.get("robots") == "7", WAIT_S)

    def status(self):
        return diagnostics.decode(self.diagnostics[-1])[0]

    def ask(self, ns, ids=IDS, xy_mm=XY_MM):
        self.targets.publish(targets.encode(ids, xy_mm, PlanStamp(ns)))

    def wait_refusal(self, word):
        self.peer.wait_for(
            lambda: word in self.status().text, WAIT_S, f"a refusal that says {word}"
        )
        assert not self.held and not self.trajectories


@pytest.fixture
def rest():
    with RosClient("rest") as peer:
        yield Rest(peer)


def test_targets_become_one_trajectory_from_where_the_encoders_are(rest):
    rest.show_plane()
    ids, xy_mm = np.append(IDS, 5), np.vstack([XY_MM, [PLANE.centers[5] + 1.0]])
    xy_mm[0] = PLANE.centers[ids[0]] + [40.0, 0.0]
    rest.ask(9, ids, xy_mm)
    rest.peer.wait_for(lambda: rest.trajectories and rest.held, WAIT_S, "a plan")
    assert {PlanStamp.of(m) for m in rest.trajectories + rest.held} == {PlanStamp(9)}

    held_ids, reason, stage = held.decode(rest.held[0])
    why = dict(zip(held_ids.tolist(), reason.tolist()))
    assert why[5] == Reason.DISABLED and why[ids[0]] == Reason.UNREACHABLE
    assert np.all(stage == Stage.PLANNER)

    moved, motion, velocities = trajectory.decode(rest.trajectories[0])
    assert np.array_equal(moved, PLANE.ids) and velocities is not None
    np.testing.assert_array_equal(motion.start, PROBLEM.start)
    off = np.hypot(*(forward(PLANE, motion.end)[1][ids] - xy_mm).T)
    arrives = ~np.isin(ids, held_ids)
    assert arrives.sum() >= 3 and np.all(off[arrives] <= 0.1)
    assert np.array_equal(motion.end[5], PROBLEM.start[5])


def test_targets_before_the_layout_are_refused(rest):
    rest.ask(9)
    rest.wait_refusal("layout: not received yet")
    rest.show_plane()
    rest.ask(10)
    rest.peer.wait_for(lambda: rest.trajectories, WAIT_S)


def test_targets_while_robots_move_are_refused(rest):
    rest.show_plane(velocity=0.1)
    rest.ask(9)
    rest.wait_refusal("robots are moving")


def test_a_robot_the_plane_does_not_have_is_refused_by_name(rest):
    rest.show_plane()
    rest.ask(9, [1, 99], [[0.0, 0.0], [1.0, 2.0]])
    rest.wait_refusal("robot 99: no such robot, target [1.0, 2.0]")


def test_an_older_table_is_dropped_and_says_so(rest):
    rest.show_plane()
    rest.ask(20)
    rest.peer.wait_for(lambda: rest.trajectories and rest.held, WAIT_S)
    rest.ask(20)
    rest.ask(19)
    rest.peer.wait_for(lambda: f"{PlanStamp(19)} dropped" in rest.status().text, WAIT_S)
    assert len(rest.trajectories) == len(rest.held) == 1
    assert rest.status().values["dropped"] == "2"


def test_it_declares_the_parameters_of_every_planner_and_uses_those_of_the_one_chosen():
    with RosClient("rest") as peer:
        node = peer.add_node(PlannerNode, planner="direct", direct__seed=4)
        assert node.get_parameter("direct.seed").value == 4
        assert node.planner().parameters == parameters_of("direct")(seed=4)
        assert node.get_parameter("dnf.lambda1").value == parameters_of("dnf")().lambda1
        with pytest.raises(PlannerError, match="'fastest'"):
            peer.add_node(PlannerNode, planner="fastest")

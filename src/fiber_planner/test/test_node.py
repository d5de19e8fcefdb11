# SPDX-License-Identifier: Apache-2.0
"""The planner node alone: a test plays the rest of the graph."""

import numpy as np
import pytest

from fiber_core.clearance import Safety
from fiber_core.drive.named import with_drive
from fiber_core.fields import random_problem
from fiber_core.kinematics import forward
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    Attempt,
    PlanStamp,
    Progress,
    Stage,
    diagnostics,
    held,
    joint_states,
    layout,
    progress,
    session_of,
    targets,
    topics,
    trajectory,
)
from fiber_node import BRIDGE, PLANNER, Claim, RosClient, claims
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
        self.progress = topics.PROGRESS.publisher(peer.node)
        self.reports = peer.collect(topics.PROGRESS)
        self.session = Claim(peer.node, BRIDGE).id
        self.planner = peer.add_node(PlannerNode, **parameters)
        peer.wait_for(
            lambda: (
                self.targets.get_subscription_count()
                and self.progress.get_subscription_count() > 1
                and self.diagnostics
            ),
            WAIT_S,
        )

    def show_plane(self, velocity=0.0, ns=1, border_skews_s=None):
        speeds = np.full_like(PROBLEM.start, velocity)
        self.layout.publish(
            layout.encode(PLANE, UNITS, PlanStamp(ns), self.session, border_skews_s=border_skews_s)
        )
        self.states.publish(joint_states.encode(PLANE.ids, PROBLEM.start, speeds, ns, self.session))
        self.peer.wait_for(lambda: self.status().values.get("robots") == "7", WAIT_S)

    def status(self):
        return diagnostics.decode(self.diagnostics[-1])[0]

    def ask(self, ns, ids=IDS, xy_mm=XY_MM, since_ns=1):
        """Send targets, and accept them as the bridge would."""
        self.targets.publish(targets.encode(ids, xy_mm, PlanStamp(ns), self.session))
        self.answer(ns, since_ns)

    def answer(self, ns, since_ns=1, refused=False):
        attempt = Attempt(PlanStamp(ns), PlanStamp(ns), 1, since_ns, 1)
        answer = Progress(BRIDGE, 0.0, "", attempt, self.session, refused)
        self.progress.publish(progress.encode(answer))

    def wait_refusal(self, word, ns):
        self.peer.wait_for(
            lambda: word in self.status().text, WAIT_S, f"a refusal that says {word}"
        )
        assert not self.held and not self.trajectories
        self.peer.wait_for(self.refusals, WAIT_S)
        assert [(p.stage, p.attempt.plan.ns, p.session) for p in self.refusals()] == [
            (PLANNER, ns, self.session)
        ]

    def refusals(self):
        return [p for p in map(progress.decode, self.reports) if p.refused and p.stage != BRIDGE]


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
    assert session_of(rest.trajectories[0]) == rest.session

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


def test_targets_wait_for_the_layout_and_for_joint_states_as_new_as_the_bridge_says(rest):
    rest.ask(9, since_ns=5)
    rest.show_plane(ns=4)
    rest.peer.wait_for(lambda: rest.status().values.get("robots") == "7", WAIT_S)
    assert not rest.trajectories
    rest.show_plane(ns=5)
    rest.peer.wait_for(lambda: rest.trajectories, WAIT_S)


def test_targets_while_robots_move_are_refused(rest):
    rest.show_plane(velocity=0.1)
    rest.ask(9)
    rest.wait_refusal("robots are moving", 9)


def test_targets_are_refused_where_sectors_need_larger_skews_than_the_planner_keeps(rest):
    rest.show_plane(border_skews_s=(2e-3, 30e-3))
    rest.ask(9)
    kept_s = Safety.border_stop_skew_s
    text = f"direct.border_stop_skew_s is {kept_s:g} s, the terms of the sectors need 0.03"
    rest.wait_refusal(text, 9)


def test_a_robot_the_plane_does_not_have_is_refused_by_name(rest):
    rest.show_plane()
    rest.ask(9, [1, 99], [[0.0, 0.0], [1.0, 2.0]])
    rest.wait_refusal("robot 99: no such robot, target [1.0, 2.0]", 9)


def test_only_targets_that_the_bridge_accepts_are_planned_and_each_once(rest):
    rest.show_plane()
    for ns in (7, 8):
        rest.targets.publish(targets.encode(IDS, XY_MM, PlanStamp(ns), rest.session))
    rest.answer(8, refused=True)
    rest.answer(8)  # too late
    rest.ask(20)
    rest.ask(20)
    rest.ask(6)  # the bridge alone judges the order of stamps
    rest.peer.wait_for(lambda: len(rest.trajectories) == 2 == len(rest.held), WAIT_S)
    assert [PlanStamp.of(m).ns for m in rest.trajectories] == [20, 6]


def test_an_acceptance_of_another_session_is_none(rest):
    rest.show_plane()
    session, rest.session = rest.session, "session_" + 24 * "0"
    rest.ask(9)
    rest.session = session
    rest.ask(10)
    rest.peer.wait_for(lambda: rest.trajectories, WAIT_S)
    assert PlanStamp.of(rest.trajectories[0]).ns == 10


def test_a_later_planner_stays_out_until_the_earlier_one_is_gone(rest):
    rest.show_plane()
    peer = rest.peer
    peer.wait_for(lambda: claims(peer.node, PLANNER), WAIT_S)
    second = peer.add_node(PlannerNode)
    peer.wait_for(lambda: len(claims(peer.node, PLANNER)) == 2, WAIT_S)
    trajectories = len(rest.trajectories)
    rest.ask(9)
    left = "left to the planner that was here before"
    peer.wait_for(lambda: left in second.reporter._text, WAIT_S)
    peer.wait_for(lambda: len(rest.trajectories) > trajectories, WAIT_S)
    assert len(rest.trajectories) == trajectories + 1


def test_it_declares_the_parameters_of_every_planner_and_uses_those_of_the_one_chosen():
    with RosClient("rest") as peer:
        node = peer.add_node(PlannerNode, planner="direct", direct__seed=4)
        assert node.get_parameter("direct.seed").value == 4
        plane = preset("desi_petals", 30)
        assert node.planner(plane).parameters == parameters_of("direct")(seed=4)
        assert node.planner(with_drive(plane, "desi")).parameters == parameters_of("scheduled")()
        assert node.get_parameter("dnf.lambda1").value == parameters_of("dnf")().lambda1
        with pytest.raises(PlannerError, match="'fastest'"):
            peer.add_node(PlannerNode, planner="fastest")

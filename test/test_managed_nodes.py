# SPDX-License-Identifier: Apache-2.0
"""Planner, discretizer and bridge as managed nodes, as `ros2 lifecycle` and a manager see them."""

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger
from stranger import Stranger

from fiber_bringup.graph import Graph
from fiber_client import PlaneClient
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome, Reason
from fiber_node import WaitError

pytestmark = pytest.mark.timeout(300)

WAIT_S, COMPILE_S = 60.0, 240.0
NODES = ("planner", "discretizer", "bridge")


class Manager(Stranger):
    """What `ros2 lifecycle set` and `get` do."""

    def set(self, node, transition):
        wanted = Transition(label=transition)
        return self.call(ChangeState, f"/{node}/change_state", transition=wanted).success

    def state(self, node):
        return self.call(GetState, f"/{node}/get_state").current_state.label

    def states(self):
        return {node: self.state(node) for node in NODES}


@pytest.fixture
def place(new_domain):
    return new_domain()


@pytest.fixture
def manager(place):
    with Manager(place) as manager:
        yield manager


def field(client, seed):
    """Ids and targets of all robots that are enabled."""
    rng = np.random.default_rng(seed)
    problem = random_field(client.plane, rng, start=client.angles).problem
    return client.plane.ids[problem.asked], problem.targets[problem.asked]


def plan_and_move(place, seed, disabled=()):
    with PlaneClient(place) as client:
        client.wait_for_graph(COMPILE_S)
        assert client.plane.ids[~client.plane.enabled].tolist() == list(disabled)
        return client.reconfigure(*field(client, seed), COMPILE_S)


def test_nodes_wait_for_their_transitions_and_then_carry_out_a_plan(place, manager):
    waits = {"autostart": False}
    bridge = {"robots": 7, "time_scale": 0.0, "disabled": [2]} | waits
    with Graph(planner=waits, discretizer=waits, bridge=bridge, domain=place) as graph:
        layouts = manager.collect(PointCloud2, "/focal_plane/layout")
        assert set(manager.states().values()) == {"unconfigured"}
        # parameters are there before anything is asked of the hardware
        names = ["robots", "disabled", "session.tolerance_mm"]
        answer = manager.call(GetParameters, "/bridge/get_parameters", names=names)
        assert all(v.type != ParameterType.PARAMETER_NOT_SET for v in answer.values)
        assert not manager.set("planner", "activate")  # not before it is configured
        assert not manager.set("bridge", "no such transition")
        for node in NODES:
            assert manager.set(node, "configure")
        manager.wait_for(lambda: layouts)
        assert set(manager.states().values()) == {"inactive"}
        with PlaneClient(place) as client:
            with pytest.raises(WaitError, match="to be activated, it is inactive"):
                client.wait_for_graph(2.0)
        answer = manager.call(Trigger, "/focal_plane/start")
        assert not answer.success and "the bridge is inactive: activate it first" in answer.message
        for node in NODES:
            assert manager.set(node, "activate") and not manager.set(node, "activate")
        assert plan_and_move(place, 1, disabled=[2]).count(Outcome.REACHED) >= 5

        # all that configure made goes with cleanup, and can be made again
        layouts.clear()
        for node in NODES:
            assert manager.set(node, "deactivate") and manager.set(node, "cleanup")
        assert set(manager.states().values()) == {"unconfigured"}
        manager.wait_for(lambda: not manager.node.count_publishers("/focal_plane/layout"))
        manager.wait_for(lambda: not manager.node.count_subscribers("/focal_plane/targets"))
        for node in NODES:
            assert manager.set(node, "configure") and manager.set(node, "activate")
        assert plan_and_move(place, 2, disabled=[2]).count(Outcome.REACHED) >= 5
        for node in NODES:
            assert manager.set(node, "shutdown")
        assert set(manager.states().values()) == {"finalized"}
        assert graph.running, "a node has died"


def test_a_bridge_that_is_deactivated_in_motion_stops_its_robots_first(place, manager):
    with Graph(bridge={"robots": 19, "time_scale": 0.2}, domain=place) as graph:
        states = manager.collect(JointState, "/focal_plane/joint_states")
        assert set(manager.states().values()) == {"active"}
        with PlaneClient(place) as client:
            client.wait_for_graph(COMPILE_S)
            stamp = client.send_targets(*field(client, 3))
            client.wait_until_ready(stamp, COMPILE_S)
            client.start(WAIT_S)
            manager.wait_for(lambda: states and any(states[-1].velocity))
            assert manager.set("bridge", "deactivate") and manager.state("bridge") == "inactive"
            outcome = client.wait_for_outcome(stamp, WAIT_S)
            assert Reason.STOPPED in outcome.reason
            manager.wait_for(lambda: not any(states[-1].velocity))
            rest = list(states[-1].position)
            assert not manager.call(Trigger, "/focal_plane/start").success
            assert manager.set("bridge", "activate")
            assert manager.call(Trigger, "/focal_plane/clear").success
            assert list(states[-1].position) == rest
        assert plan_and_move(place, 4).count(Outcome.REACHED) >= 15
        assert graph.running, "a node has died"


@pytest.mark.parametrize("node", ["planner", "discretizer"])
def test_a_stage_that_is_deactivated_ends_its_work_and_the_plan(place, manager, node):
    slow = {"planner": "dnf", "dnf.dt_s": 1e-5, "dnf.horizon_s": 9.0} if node == "planner" else {}
    with Graph(planner=slow, bridge={"robots": 7, "time_scale": 0.0}, domain=place) as graph:
        with PlaneClient(place) as client:
            client.wait_for_graph(COMPILE_S)
            if node == "discretizer":
                assert manager.set(node, "deactivate")
            stamp = client.send_targets(*field(client, 5))
            if node == "planner":
                client.wait_for(lambda: "s of motion" in client.statuses[node].text, COMPILE_S)
                assert manager.set(node, "deactivate")
            outcome = client.wait_for_outcome(stamp, WAIT_S)
            assert set(outcome.reason.tolist()) == {Reason.NOT_PLANNED}
            text = f"the {node} is not in the graph"
            client.wait_for(lambda: text in client.statuses["bridge"].text, WAIT_S)
        assert graph.running, "a node has died"


def test_a_bridge_that_cannot_be_configured_says_why_and_can_be_tried_again(place, manager):
    both = {"autostart": False, "plant": "none", "devices": ["/dev/i2c-none"], "robots": 7}
    with Graph(bridge=both, domain=place) as graph:
        for _ in range(2):
            assert not manager.set("bridge", "configure")
            assert manager.state("bridge") == "unconfigured"
        assert "devices need the parameter problem" in str(graph.nodes[0]._refusal)

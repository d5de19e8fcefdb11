# SPDX-License-Identifier: Apache-2.0
"""The action and the service of the gateway, used by a plain rclpy client through types only."""

import importlib.util
import os
import signal
import subprocess
import sys

import interfaces
import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient, get_action_names_and_types
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger
from stranger import Stranger

from fiber_bringup.graph import Graph
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome, Reason

BUILT = importlib.util.find_spec("fiber_interfaces") is not None
if BUILT:
    from fiber_interfaces.action import Reconfigure
    from fiber_interfaces.srv import Start

pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(
        not BUILT, reason="NOT TESTED: the gateway; fiber_interfaces is not built (no compiler?)"
    ),
]
WAIT_S = 120.0


class Caller(Stranger):
    """A stranger that knows the interfaces, too."""

    def __init__(self, domain):
        super().__init__(domain, WAIT_S)
        self.action = ActionClient(self.node, Reconfigure, "focal_plane/reconfigure")
        self.start = self.node.create_client(Start, "focal_plane/start_plan")
        self.feedback, self.velocities, self.reasons = [], None, set()
        latest = QoSProfile(depth=1)
        for kind, topic, hear in (
            (JointState, "joint_states", self._on_joint_states),
            (PointCloud2, "outcome", self._on_outcome),
        ):
            self.node.create_subscription(kind, f"focal_plane/{topic}", hear, latest)
        self.clear = self.node.create_client(Trigger, "focal_plane/clear")
        assert self.action.wait_for_server(WAIT_S)
        assert all(each.wait_for_service(WAIT_S) for each in (self.start, self.clear))

    def _on_joint_states(self, message):
        self.velocities = np.array(message.velocity)

    def _on_outcome(self, message):
        (offset,) = (field.offset for field in message.fields if field.name == "reason")
        rows = np.frombuffer(message.data, np.uint8).reshape(-1, message.point_step)
        self.reasons = set(rows[:, offset].tolist())

    @property
    def moving(self):
        return self.velocities is not None and self.velocities.any()

    def send(self, **fields):
        self.feedback.clear()
        goal = Reconfigure.Goal(**fields)
        return self.result_of(
            self.action.send_goal_async(goal, lambda m: self.feedback.append(m.feedback))
        )

    def run(self, **fields):
        answer = self.result_of(self.send(**fields).get_result_async())
        return answer.status, answer.result

    def start_plan(self, plan):
        return self.result_of(self.start.call_async(Start.Request(plan=plan)))


@pytest.fixture(scope="module")
def gateway(problem_file, new_domain):
    """A graph whose robots take two seconds, and the gateway as a process."""
    domain = new_domain()
    bridge = {"problem": problem_file, "time_scale": 1.0}
    program = "from fiber_client.gateway import main; raise SystemExit(main())"
    with Graph(bridge=bridge, domain=domain) as graph:
        process = subprocess.Popen(
            [sys.executable, "-c", program], env=os.environ | {"ROS_DOMAIN_ID": str(domain)}
        )
        process.domain = domain
        yield process
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
        assert graph.running, "a node has died"


@pytest.fixture
def stranger(gateway):
    with Caller(gateway.domain) as stranger:
        yield stranger
        stranger.result_of(stranger.clear.call_async(Trigger.Request()))  # after a stop


@pytest.fixture(scope="module")
def goals(problem):
    """Goals with targets of several fields."""
    rng, found = np.random.default_rng(5), []
    for _ in range(4):
        field = random_field(problem.plane, rng, start=problem.start).problem
        x_m, y_m = 1e-3 * field.targets[field.asked].T
        ids = problem.plane.ids[field.asked].tolist()
        found.append({"ids": ids, "x": x_m.tolist(), "y": y_m.tolist(), "timeout": WAIT_S})
    return found


def test_a_goal_takes_the_robots_to_their_targets_and_tells_how_far_it_is(stranger, goals):
    status, result = stranger.run(**goals[0])
    assert status == GoalStatus.STATUS_SUCCEEDED, result.message
    assert list(result.ids) == goals[0]["ids"] and result.plan.sec > 0
    reached = np.array(result.outcome) == Reconfigure.Result.OUTCOME_REACHED
    assert reached.mean() > 0.5 and f"{reached.sum()} of {len(reached)}" in result.message
    assert (np.array(result.error)[reached] < 1e-4).all()
    assert {f.stage for f in stranger.feedback} >= {"planner", "discretizer", "bridge"}
    moving = [f.fraction for f in stranger.feedback if f.text == "robots are moving"]
    assert len(moving) > 3 and moving == sorted(moving) and 0 <= moving[0] < moving[-1] <= 1


def test_a_plan_is_started_by_its_id_and_by_no_other(stranger, goals):
    status, result = stranger.run(**goals[1], plan_only=True)
    assert status == GoalStatus.STATUS_SUCCEEDED and len(result.outcome) == 0
    other = type(result.plan)(sec=result.plan.sec - 1, nanosec=result.plan.nanosec)
    refused = stranger.start_plan(other)
    assert not refused.success and f"plan {other.sec}" in refused.message
    assert f"plan {result.plan.sec}" in refused.message and not stranger.moving
    started = stranger.start_plan(result.plan)
    assert started.success, started.message
    stranger.wait_for(lambda: stranger.moving)
    stranger.wait_for(lambda: not stranger.moving)
    again = stranger.start_plan(result.plan)
    assert not again.success


def test_cancel_stops_the_robots_and_no_second_goal_is_taken_meanwhile(stranger, goals):
    goal = stranger.send(**goals[2])
    stranger.wait_for(lambda: stranger.moving)
    assert not stranger.send(**goals[3]).accepted
    assert not stranger.start_plan(type(goal.stamp)(sec=1)).success
    ended = goal.get_result_async()
    stranger.result_of(goal.cancel_goal_async())
    answer = stranger.result_of(ended)
    assert answer.status == GoalStatus.STATUS_CANCELED, answer.result.message
    assert list(answer.result.ids) == goals[2]["ids"]
    assert Reconfigure.Result.REASON_STOPPED in answer.result.reason
    stranger.wait_for(lambda: not stranger.moving)


def test_a_goal_that_is_canceled_before_its_motion_moves_no_robot(stranger, goals):
    goal = stranger.send(**goals[2])
    stranger.result_of(goal.cancel_goal_async())
    answer = stranger.result_of(goal.get_result_async())
    assert answer.status == GoalStatus.STATUS_CANCELED, answer.result.message
    assert not stranger.moving
    assert not any(f.text == "robots are moving" for f in stranger.feedback)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"x": [0.1]}, "as many targets as ids"),
        ({"y": [float("nan")] * 61}, "as many targets as ids"),
        ({"timeout": 0.0}, "timeout must be"),
        ({"ids": [3, 3], "x": [0.0, 0.1], "y": [0.0, 0.1]}, "robot 3"),
    ],
)
def test_a_goal_with_bad_values_is_aborted_with_the_reason(stranger, goals, change, text):
    status, result = stranger.run(**goals[0] | change)
    assert status == GoalStatus.STATUS_ABORTED
    assert text in result.message and not stranger.moving


def test_the_page_of_interfaces_has_what_the_gateway_serves(gateway, stranger):
    def served():
        if ("gateway", "/") not in stranger.node.get_node_names_and_namespaces():
            return set()
        names = stranger.node.get_service_names_and_types_by_node("gateway", "/")
        return {name.lstrip("/") for name, _ in names if "focal_plane" in name and "/_" not in name}

    stranger.wait_for(lambda: served())
    found = interfaces.actions_and_services()
    actions = {name.lstrip("/") for name, _ in get_action_names_and_types(stranger.node)}
    assert set(found) == served() | actions
    for name, kinds in (
        ("focal_plane/reconfigure", (Reconfigure.Goal, Reconfigure.Result, Reconfigure.Feedback)),
        ("focal_plane/start_plan", (Start.Request, Start.Response)),
    ):
        fields = [set(part) for part in found[name][1].values()]
        assert fields == [set(kind.get_fields_and_field_types()) for kind in kinds]


def test_the_end_of_the_gateway_stops_the_robots_of_its_goal(gateway, stranger, goals):
    stranger.send(**goals[3])
    stranger.wait_for(lambda: stranger.moving)
    gateway.terminate()
    gateway.terminate()  # as `timeout` and shells do
    assert gateway.wait(30) == 0
    stranger.wait_for(lambda: not stranger.moving)
    stranger.wait_for(lambda: int(Reason.STOPPED) in stranger.reasons)


def test_the_constants_are_the_codes_of_the_project():
    for prefix, codes in (("OUTCOME", Outcome), ("REASON", Reason)):
        names = {n for n in dir(Reconfigure.Result) if n.startswith(prefix)}
        assert names == {f"{prefix}_{code.name}" for code in codes}
        assert all(getattr(Reconfigure.Result, f"{prefix}_{c.name}") == c for c in codes)

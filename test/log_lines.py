# SPDX-License-Identifier: Apache-2.0
"""What an operator reads in the log: of each node what it waits for, of each call its effect.

Run by `test_log_lines.py` in a process of its own: rcl publishes on /rosout for the first node of
a name in a process, and not for a later one.
"""

import numpy as np
import pytest
from rcl_interfaces.msg import Log, LoggerLevel
from rcl_interfaces.srv import SetLoggerLevels
from rclpy.logging import LoggingSeverity, get_logger
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from stranger import Stranger

from fiber_bringup.graph import Graph
from fiber_client import PlaneClient
from fiber_core.fields import random_field

pytestmark = pytest.mark.timeout(300)

COMPILE_S = 240.0
NODES = ("planner", "discretizer", "bridge", "recorder", "viewer")
ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Operator(Stranger):
    """Reads /rosout."""

    def __init__(self, domain):
        super().__init__(domain)
        self.lines = self.collect(Log, "/rosout", ROSOUT)

    def of(self, node, level):
        return [m.msg for m in self.lines if m.name == node and m.level == int(level)]

    def read(self, node, words, level=LoggingSeverity.INFO):
        self.wait_for(lambda: any(words in line for line in self.of(node, level)), 30.0)


@pytest.fixture(scope="module")
def graph(new_domain, tmp_path_factory):
    folder, domain = str(tmp_path_factory.mktemp("recordings")), new_domain()
    given = {"bridge": {"robots": 7, "time_scale": 0.0}, "recorder": {"folder": folder}}
    with Graph(**given, viewer={}, domain=domain) as graph:
        yield domain
        assert graph.running, "a node has died"
    for node in NODES:  # the levels belong to this process
        get_logger(node).set_level(LoggingSeverity.UNSET)


@pytest.fixture(scope="module")
def operator(graph):
    with Operator(graph) as operator:
        yield operator


@pytest.mark.parametrize("node", NODES)
def test_a_node_says_with_what_settings_it_starts_and_what_it_waits_for(operator, node):
    operator.read(node, "settings: ")
    operator.read(node, "waits for ")
    if node != "bridge":
        operator.read(node, "the plane has come")


def test_the_decisions_on_a_plan_are_read_in_debug_lines(operator, graph):
    for node in NODES:
        levels = [LoggerLevel(name=node, level=int(LoggingSeverity.DEBUG))]
        answer = operator.call(SetLoggerLevels, f"/{node}/set_logger_levels", levels=levels)
        assert answer.results[0].successful
    operator.collect(PointCloud2, "/focal_plane/view/arms")
    with PlaneClient(graph) as client:
        client.wait_for_graph(COMPILE_S)
        rng = np.random.default_rng(1)
        problem = random_field(client.plane, rng, start=client.angles).problem
        stamp = client.send_targets(client.plane.ids, problem.targets)
        client.wait_until_ready(stamp, COMPILE_S)
        client.start(COMPILE_S)
        client.wait_for_outcome(stamp, COMPILE_S)
    for node, words in (
        ("bridge", f"plan {stamp}: targets accepted"),
        ("planner", f"plan {stamp}: accepted by the bridge"),
        ("planner", f"plan {stamp}: planning begins"),
        ("planner", f"plan {stamp}: 7 targets, planner direct"),
        ("planner", f"plan {stamp}: planning has ended"),
        ("discretizer", f"plan {stamp}: profiles of 7 robots"),
        ("bridge", f"plan {stamp}: ended; 0 robots could be tried again"),
        ("recorder", f"plan {stamp} has ended: waits for the last frames"),
        ("viewer", "there are subscribers"),
    ):
        operator.read(node, words, LoggingSeverity.DEBUG)


def test_every_call_of_a_service_is_read_with_its_effect(operator):
    for service, level in (
        ("start", LoggingSeverity.ERROR),  # no orders wait
        ("stop", LoggingSeverity.INFO),  # at rest
        ("home", LoggingSeverity.ERROR),  # stopped
        ("clear", LoggingSeverity.INFO),
        ("configure", LoggingSeverity.INFO),
    ):
        answer = operator.call(Trigger, f"/focal_plane/{service}")
        assert answer.message and answer.success == (level == LoggingSeverity.INFO), service
        word = "" if answer.success else " refused"
        operator.read("bridge", f"service {service}{word}: {answer.message}", level)

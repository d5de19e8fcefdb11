# SPDX-License-Identifier: Apache-2.0
"""Two planes in one ROS domain, as an operator meets them: names, parameters, answers, stops.

The observer is a plain rclpy node that knows topic names and message types and nothing else of this
project. The planes are small; one graph in /north and one in /south serve all tests.
"""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from fiber_bringup.graph import Graph
from fiber_client import DisabledRobots, PlaneClient
from fiber_client.disable import disable, enable
from fiber_client.reconfigure import main as reconfigure
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome
from fiber_msgs_py import outcome as outcome_table
from fiber_msgs_py import targets as target_table
from fiber_msgs_py.stamps import PlanStamp
from fiber_node import WaitError

pytestmark = pytest.mark.timeout(300)

WAIT_S, COMPILE_S = 60.0, 240.0
NORTH = ["--ros-args", "-r", "__ns:=/north"]
SOUTH = ["--ros-args", "-r", "__ns:=/south"]
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NODES = ("planner", "discretizer", "recorder", "viewer")
SCRIPT = "import sys; from fiber_client.reconfigure import main; sys.exit(main())"


class Observer:
    """A node of a stranger."""

    def __init__(self, domain):
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("observer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.statuses, self.latest = {}, {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        for plane in ("north", "south"):
            for topic, kind in (
                ("layout", PointCloud2), ("joint_states", JointState), ("outcome", PointCloud2),
                ("segments", PointCloud2),  # kept, as targets are not
            ):  # fmt: skip
                name = f"/{plane}/focal_plane/{topic}"
                self.node.create_subscription(kind, name, self._keep(name), LATCHED)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def _keep(self, name):
        return lambda message: self.latest.__setitem__(name, message)

    def _on_diagnostics(self, message):
        for status in message.status:
            self.statuses[status.name] = status

    def until(self, holds, timeout_s=WAIT_S):
        end = time.monotonic() + timeout_s
        while not holds():
            assert time.monotonic() < end, "waited in vain"
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, kind, name, timeout_s=WAIT_S, **fields):
        """The answer of a service, and the time that it took [s]."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        begin = time.monotonic()
        future = client.call_async(kind.Request(**fields))
        self.until(future.done, timeout_s)
        took = time.monotonic() - begin
        self.node.destroy_client(client)
        return future.result(), took

    def set(self, node, **values):
        parameters = [
            Parameter(name.replace("__", "."), value=v).to_parameter_msg()
            for name, v in values.items()
        ]
        answer, _ = self.call(SetParameters, f"{node}/set_parameters", parameters=parameters)
        return answer.results

    def angles(self, plane):
        return np.array(self.latest[f"/{plane}/focal_plane/joint_states"].position)

    def stamp(self, plane, topic):
        message = self.latest.get(f"/{plane}/focal_plane/{topic}")
        return None if message is None else PlanStamp.of(message)

    def heard(self, plane, topic, since):
        stamp = self.stamp(plane, topic)
        return stamp is not None and stamp > since

    def moving(self, plane):
        return bool(np.any(self.latest[f"/{plane}/focal_plane/joint_states"].velocity))


@pytest.fixture(scope="module")
def place(new_domain):
    """ROS domain of the two planes."""
    return new_domain()


@pytest.fixture(scope="module")
def planes(place, tmp_path_factory):
    """The graphs: that in the south has a bridge and a recorder with other names."""
    folder = str(tmp_path_factory.mktemp("recordings"))
    others = ["-r", "bridge:__node:=bus_bridge", "-r", "recorder:__node:=tape"]
    with (
        Graph(
            bridge={"robots": 19}, recorder={"folder": folder}, viewer={}, domain=place, args=NORTH
        ) as north,
        Graph(
            bridge={"robots": 7, "time_scale": 0},
            recorder={"folder": folder},
            domain=place,
            args=SOUTH + others,
        ) as south,
    ):
        yield north, south
        assert north.running and south.running


@pytest.fixture(scope="module")
def observer(planes, place):
    made = Observer(place)
    made.until(lambda: len(made.latest) >= 4)
    yield made
    made.close()


@pytest.fixture
def in_place(place, monkeypatch):
    """Commands find the domain in the environment, as in a terminal."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(place))


def test_a_command_in_a_namespace_moves_its_own_plane(observer, in_place, capsys):
    south = observer.angles("south")
    north = observer.angles("north")
    assert reconfigure(["random:1", "--json", "--timeout", str(COMPILE_S), *NORTH]) == 0
    assert '"asked": 19' in capsys.readouterr().out
    observer.until(lambda: "/north/focal_plane/outcome" in observer.latest)
    observer.until(lambda: not observer.moving("north"))
    assert np.abs(observer.angles("north") - north).max() > 0.1
    assert np.array_equal(observer.angles("south"), south)
    assert "/south/focal_plane/outcome" not in observer.latest


def test_the_environment_names_a_namespace_too(in_place, monkeypatch, observer):
    monkeypatch.setenv("ROS_NAMESPACE", "/south")
    with PlaneClient(args=[]) as client:
        client.wait_for_graph(WAIT_S, also=("recorder",))
        assert client.plane.n == 7
        assert set(client.statuses) >= {"planner", "discretizer", "bridge", "recorder"}


def test_robots_of_a_renamed_bridge_are_disabled_and_enabled(observer, in_place, capsys):
    assert disable(["3", "--why", "arm bent", *SOUTH]) == 0
    assert "disabled: 3" in capsys.readouterr().out
    with PlaneClient(args=NORTH) as north, PlaneClient(namespace="south", args=[]) as south:
        assert DisabledRobots(north, WAIT_S).read() == []
        assert DisabledRobots(south, WAIT_S).read() == [3]
        assert DisabledRobots(south, WAIT_S).reasons() == {3: "arm bent"}
    assert enable(["--all", *SOUTH]) == 0


def test_diagnostics_and_frames_tell_whose_they_are(observer):
    wanted = {f"{plane}/{name}" for plane in ("north", "south") for name in ("planner", "bridge")}
    observer.until(lambda: wanted <= set(observer.statuses))
    assert all(name.startswith(("north/", "south/")) for name in observer.statuses)
    status = observer.statuses["south/bridge"]
    values = values_of(observer, "south/bridge")
    assert status.hardware_id == "south/focal_plane" and values["node"] == "/south/bus_bridge"
    buses = [s for name, s in observer.statuses.items() if name.startswith("north/bridge: bus ")]
    assert buses and all(bus.hardware_id.startswith("north/i2c-") for bus in buses)
    for plane in ("north", "south"):
        for topic in ("layout", "joint_states"):
            message = observer.latest[f"/{plane}/focal_plane/{topic}"]
            assert message.header.frame_id == f"{plane}/focal_plane"


@pytest.mark.parametrize("node", ["/north/bridge", *(f"/north/{name}" for name in NODES)])
def test_every_parameter_has_a_sentence_and_a_value_and_no_senseless_value_is_taken(observer, node):
    names = list(observer.call(ListParameters, f"{node}/list_parameters")[0].result.names)
    answer, _ = observer.call(DescribeParameters, f"{node}/describe_parameters", names=names)
    values, _ = observer.call(GetParameters, f"{node}/get_parameters", names=names)
    for about, value in zip(answer.descriptors, values.values):
        if about.name in ("use_sim_time", "start_type_description_service"):
            continue
        text = about.description
        assert text[:1].isupper() and text.endswith("."), (about.name, text)
        unit = about.name.rpartition("_")[2]
        if unit in ("mm", "rad", "s", "ppm", "ms", "hz"):
            assert "[" in text, (about.name, text)
        assert value.type != ParameterType.PARAMETER_NOT_SET, about.name
        if value.type == ParameterType.PARAMETER_DOUBLE:
            assert np.isfinite(value.double_value) and about.floating_point_range, about.name
            result = observer.set(node, **{about.name: float("nan")})[0]
            assert not result.successful and result.reason, about.name
        if value.type == ParameterType.PARAMETER_INTEGER and not about.additional_constraints:
            assert about.integer_range, about.name
            assert not observer.set(node, **{about.name: -2})[0].successful, about.name


def send(observer, plane, seed):
    """Targets for all robots of a plane, as a stranger with a table of its own sends them."""
    with PlaneClient(namespace=plane, args=[]) as client:
        client.wait_for_graph(WAIT_S)
        drawn = random_field(client.plane, np.random.default_rng(seed), start=client.angles)
        ids, xy_mm, session = client.plane.ids, drawn.problem.targets, client.session
    publisher = observer.node.create_publisher(PointCloud2, f"/{plane}/focal_plane/targets", 10)
    observer.until(lambda: publisher.get_subscription_count() >= 3)
    now = PlanStamp(time.time_ns())
    publisher.publish(target_table.encode(ids, xy_mm, now, session))
    return now


def values_of(observer, name):
    return {pair.key: pair.value for pair in observer.statuses[name].values}


def text_of(observer, name):
    return observer.statuses[name].message if name in observer.statuses else ""


def test_nodes_answer_while_one_plans_and_stop_ends_the_planning(observer, in_place):
    # steps of a microsecond: planning takes minutes
    results = observer.set("/north/planner", planner="dnf", dnf__dt_s=1e-5, dnf__horizon_s=9.0)
    assert all(result.successful for result in results)
    stamp = send(observer, "north", 3)
    observer.until(lambda: "s of motion" in text_of(observer, "north/planner"))
    slowest = 0.0
    for _ in range(10):
        for node in ("/north/bridge", *(f"/north/{name}" for name in NODES)):
            answer, took = observer.call(
                GetParameters, f"{node}/get_parameters", names=["use_sim_time"]
            )
            assert answer.values
            slowest = max(slowest, took)
    assert "s of motion" in text_of(observer, "north/planner")  # it still plans
    assert observer.call(Trigger, "/north/focal_plane/stop")[0].success
    ended = f"plan {stamp}: planning ended by the service stop"
    observer.until(lambda: text_of(observer, "north/planner") == ended)
    results = observer.set("/north/planner", planner="direct", dnf__dt_s=0.0, dnf__horizon_s=0.0)
    assert all(result.successful for result in results)
    assert observer.call(Trigger, "/north/focal_plane/clear")[0].success
    assert reconfigure(["random:4", "--timeout", str(COMPILE_S), *NORTH]) == 0
    print(f"slowest answer {slowest:.3f} s")


def test_a_change_of_a_parameter_is_in_effect_in_the_next_plan(observer, in_place):
    for value, word in (("bogus", "no planner is called 'bogus'"), ("", "no planner")):
        (result,) = observer.set("/north/planner", planner=value)
        assert not result.successful and word in result.reason
    (result,) = observer.set("/north/bridge", clock="9k")
    assert not result.successful and "read-only" in result.reason
    # no neighbours can keep a metre: all robots are held
    (result,) = observer.set("/north/discretizer", safety__margin_mm=1000)
    assert result.successful
    with PlaneClient(args=NORTH) as client:
        client.wait_for_graph(WAIT_S)
        drawn = random_field(client.plane, np.random.default_rng(5), start=client.angles).problem
        stamp = client.send_targets(client.plane.ids, drawn.targets)
        client.wait_until_ready(stamp, COMPILE_S)
        client.wait_for(lambda: client.held.get(stamp), WAIT_S)
        shown = {"plan": str(stamp), "moving": "1"}  # one robot has no neighbour with a target

        def plan_is_shown():
            values = client.statuses["discretizer"].values
            return {name: values.get(name) for name in shown} == shown

        client.wait_for(plan_is_shown, WAIT_S)
    assert observer.set("/north/discretizer", safety__margin_mm=0.05)[0].successful


def test_the_end_of_a_client_by_sigterm_stops_its_robots(observer, in_place):
    command = [sys.executable, "-c", SCRIPT, "random:8", *NORTH]
    # the observer may still have messages of earlier plans to take
    begin = PlanStamp(time.time_ns())
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        observer.until(
            lambda: (
                all(observer.heard("north", topic, begin) for topic in ("segments", "joint_states"))
                and observer.moving("north")
            ),
            COMPILE_S,
        )
        plan = observer.stamp("north", "segments")
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=WAIT_S)
    assert process.returncode == 1 and "told to stop" in err
    observer.until(lambda: not observer.moving("north"), 5.0)
    observer.until(lambda: observer.stamp("north", "outcome") == plan)
    _, outcomes, _, _ = outcome_table.decode(observer.latest["/north/focal_plane/outcome"])
    assert len(outcomes) == 19 and (outcomes != Outcome.REACHED).any()
    assert observer.call(Trigger, "/north/focal_plane/clear")[0].success


def test_a_client_without_the_clock_that_it_follows_says_so(planes, in_place):
    args = [*NORTH, "-p", "use_sim_time:=true"]
    with PlaneClient(args=args) as client, pytest.raises(WaitError, match="time on /clock"):
        client.wait_for_graph(0.5)

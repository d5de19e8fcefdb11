# SPDX-License-Identifier: Apache-2.0
"""Operators disable and enable robots through the parameters of the bridge."""

import threading

import numpy as np
import pytest
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rest_of_graph import COUNTS, PLANE, Rest, problem_file, turning

import fiber_bus_bridge.node.bridge
from fiber_bus_bridge import BridgeError
from fiber_bus_bridge.disabled_list import read_disabled, write_disabled
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import diagnostics, layout, topics
from fiber_node import RosClient

pytestmark = pytest.mark.timeout(600)


class Operator(Rest):
    """The other nodes of the graph, and an operator."""

    def set(self, **values):
        client = self.peer.node.create_client(
            SetParametersAtomically, "bridge/set_parameters_atomically"
        )
        self.until(client.service_is_ready)
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        request = SetParametersAtomically.Request(
            parameters=[parameter.to_parameter_msg() for parameter in parameters]
        )
        future = client.call_async(request)
        self.until(future.done)
        return future.result().result

    def shown(self):
        return list(self.bridge.get_parameter("disabled").value)

    def enabled(self):
        return layout.decode(self.received[topics.LAYOUT.name][-1])[0].enabled.tolist()

    def left_out(self):
        statuses = diagnostics.decode(self.received[topics.DIAGNOSTICS.name][-1])
        return next(s for s in statuses if s.name == "bridge: left out").values


@pytest.fixture
def path(tmp_path):
    return problem_file(tmp_path)


@pytest.fixture
def peer():
    with RosClient("rest") as peer:
        yield peer


def test_a_disabled_robot_is_an_obstacle_where_it_is_until_it_is_enabled(peer, path, tmp_path):
    file = tmp_path / "disabled.yaml"
    rest = Operator(peer, path, disabled_file=str(file))
    assert rest.shown() == []
    assert rest.set(disabled=[5, 2], disabled_why="arm bent").successful
    rest.until(lambda: rest.enabled() == [True, True, False, True, True, False, True])
    assert read_disabled(file) == {2: "arm bent", 5: "arm bent"}
    rest.until(lambda: rest.left_out() == {"robot 2": "arm bent", "robot 5": "arm bent"})

    rest.ask(9, [2, 5], PLANE.centers[[2, 5]] + 3.0)
    rest.ready(9)  # with orders for the disabled robots too
    assert rest.call(topics.START).success
    result, reason, _ = rest.end(9)
    assert np.all(result[[2, 5]] == Outcome.HELD) and np.all(reason[[2, 5]] == Reason.DISABLED)
    moves = ~np.isin(PLANE.ids, [2, 5])
    rest.until(lambda: np.array_equal(rest.counts()[moves], turning().end[moves]))
    assert np.array_equal(rest.counts()[~moves], COUNTS[~moves])

    assert rest.set(disabled=[2]).successful
    rest.until(lambda: rest.enabled()[5])
    assert rest.set(disabled=[]).successful
    rest.until(lambda: all(rest.enabled()))
    assert read_disabled(file) == {}


def test_the_list_survives_a_restart_and_overrides_the_parameter(peer, path, tmp_path):
    file = tmp_path / "disabled.yaml"
    write_disabled(file, {4: "dark"})
    rest = Operator(peer, path, disabled_file=str(file), disabled=[1])
    rest.until(lambda: rest.enabled() == [True] * 4 + [False] + [True] * 2)
    assert rest.shown() == [4] and read_disabled(file) == {4: "dark"}


def test_without_a_file_the_parameter_is_the_list(peer, path):
    rest = Operator(peer, path, disabled=[1])
    rest.until(lambda: rest.enabled() == [True, False] + [True] * 5)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([3, 99], "robot 99 cannot be disabled: the plane has no such robot"),
        ("3", "disabled is '3', expected robot ids"),
        ([0.5], "disabled holds 0.5"),
    ],
)
def test_a_value_that_names_no_robot_is_refused_and_nothing_changes(
    peer, path, tmp_path, value, message
):
    file = tmp_path / "disabled.yaml"
    rest = Operator(peer, path, disabled_file=str(file))
    answer = rest.set(disabled=value)
    assert not answer.successful and message in answer.reason
    rest.until(lambda: message in rest.status().text)
    assert rest.shown() == [] and all(rest.enabled()) and not file.exists()


def test_the_list_cannot_change_while_robots_move(peer, path):
    rest = Operator(peer, path, time_scale=0.2, disabled=[1])
    rest.ready(9, turning(ticks=200))
    assert rest.call(topics.START).success
    changes = ([1, 3], "robot 3 cannot be disabled"), ([], "robot 1 cannot be enabled")
    for value, message in changes:
        answer = rest.set(disabled=value)
        assert not answer.successful and f"{message} while a plan is under way" in answer.reason
    assert rest.shown() == [1] and not rest.received[topics.OUTCOME.name]
    assert rest.call(topics.STOP).success
    assert rest.set(disabled=[1, 3]).successful


def test_the_list_cannot_change_in_silence_while_the_bridge_is_configured(peer, path, monkeypatch):
    rest, answers = Operator(peer, path, disabled=[1]), []
    claim = fiber_bus_bridge.node.bridge.claim_plane

    def claim_during_a_change(*given):
        change = [Parameter("disabled", value=[3])]
        operator = threading.Thread(
            target=lambda: answers.extend(rest.bridge.set_parameters(change))
        )
        operator.start()
        operator.join()
        return claim(*given)

    rest.bridge.trigger_deactivate()
    rest.bridge.trigger_cleanup()
    assert rest.bridge.set_parameters([Parameter("disabled", value=[2])])[0].successful
    monkeypatch.setattr(fiber_bus_bridge.node.bridge, "claim_plane", claim_during_a_change)
    rest.bridge.trigger_configure()
    (answer,) = answers
    assert not answer.successful and "while the bridge is configured" in answer.reason
    rest.until(lambda: rest.enabled() == [True, True, False] + [True] * 4)
    assert rest.shown() == [2]


def test_a_list_that_cannot_be_read_ends_the_bridge(peer, path, tmp_path):
    file = tmp_path / "disabled.yaml"
    file.write_text("3: [")
    with pytest.raises(BridgeError, match=r"disabled\.yaml: while parsing"):
        Operator(peer, path, disabled_file=str(file))

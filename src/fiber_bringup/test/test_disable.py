# SPDX-License-Identifier: Apache-2.0
"""The commands by which operators take robots out of use and put them back."""

import pytest

from fiber_bringup.graph import Graph
from fiber_client.client import PlaneClient
from fiber_client.disable import disable, enable

WAIT_S = 60.0


@pytest.fixture(scope="module")
def graph(new_domain, tmp_path_factory):
    """A graph with a list on disk, its domain, and the file."""
    file, domain = tmp_path_factory.mktemp("night") / "disabled.yaml", new_domain()
    bridge = {"robots": 19, "time_scale": 0.0, "disabled_file": str(file)}
    with Graph(bridge=bridge, domain=domain), PlaneClient(domain) as client:
        client.wait_for_graph(WAIT_S)
        yield client, domain, file


@pytest.fixture
def run(graph, monkeypatch, capsys):
    """Function that runs a command in the domain of the graph: exit code, output, errors."""
    client, domain, file = graph
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))

    def call(command, *argv):
        code = command(list(argv))
        return code, *capsys.readouterr()

    yield call
    assert call(enable, "--all")[0] == 0
    assert "{}" in file.read_text()
    client.wait_for(lambda: client.plane.enabled.all(), WAIT_S, "a layout with all enabled")


def test_robots_go_out_of_use_and_come_back(run, graph):
    client, _, file = graph
    assert run(disable, "3", "17", "--why", "arm bent")[:2] == (0, "disabled: 3, 17\n")
    assert run(disable, "5")[0] == 0
    client.wait_for(lambda: client.plane.ids[~client.plane.enabled].tolist() == [3, 5, 17], WAIT_S)
    assert "3: arm bent" in file.read_text()
    code, out, _ = run(enable, "17", "5")
    assert (code, out) == (0, "disabled: 3\n")
    client.wait_for(lambda: client.plane.ids[~client.plane.enabled].tolist() == [3], WAIT_S)
    code, out, _ = run(disable, "3", "--list")
    assert code == 0 and [line.split() for line in out.splitlines()] == [
        ["robot", "left", "out", "why"],
        ["3", "disabled", "arm", "bent"],
    ]


def test_an_impossible_change_is_an_error_with_the_id(run, graph):
    code, out, err = run(disable, "3", "99")
    assert code == 1 and not out
    assert "robot 99 cannot be disabled: the plane has no such robot" in err
    code, out, err = run(enable, "4")
    assert code == 1 and not out and "robot 4 is not on the list" in err
    assert run(disable, "--list")[:2] == (0, "no robot is left out\n")


@pytest.mark.parametrize("command", [disable, enable])
def test_help_describes_the_command(command, capsys):
    with pytest.raises(SystemExit) as left:
        command(["--help"])
    text = capsys.readouterr().out
    assert left.value.code == 0 and "disabled_file" in text and "--list" in text
    with pytest.raises(SystemExit) as left:
        command([])
    assert left.value.code == 2 and "name robots by their ids" in capsys.readouterr().err


def test_without_a_bridge_the_command_fails_with_the_reason(new_domain, monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(new_domain()))
    assert disable(["3", "--timeout", "0.3"]) == 1
    assert "parameters of bridge did not come within 0.3 s" in capsys.readouterr().err

# SPDX-License-Identifier: Apache-2.0
"""What a program with default qualities of service sees of the graph, and the command show."""

import contextlib
import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import JointState, PointCloud2
from stranger import Stranger
from trajectory_msgs.msg import JointTrajectory

from fiber_bringup.graph import Graph
from fiber_client.client import PlaneClient
from fiber_client.show import main
from fiber_core.outcomes import Outcome, Reason, Verdict
from fiber_msgs_py import PlanStamp, Stage, measured, topics
from fiber_msgs_py.layout import RowKind

pytestmark = pytest.mark.timeout(300)

COMPILE_S, WAIT_S = 240.0, 30.0
CODES = Path(__file__).parents[1] / "docs" / "codes.md"


@pytest.fixture(scope="module")
def graph(problem_file, new_domain):
    """A graph that has carried out one plan, and the outcome of that plan."""
    domain = new_domain()
    bridge = {"problem": problem_file, "time_scale": 0.0}
    with Graph(bridge=bridge, domain=domain) as graph, PlaneClient(domain) as client:
        client.wait_for_graph(COMPILE_S)
        ids = client.plane.ids[client.plane.enabled][:20]
        rows = np.searchsorted(client.plane.ids, ids)
        xy_mm = client.plane.centers[rows] + [4.0, 0.0]
        ended = client.reconfigure(ids, xy_mm, COMPILE_S)
        yield domain, ended, client
        assert graph.running, "a node has died"


@pytest.fixture
def stranger(graph):
    with Stranger(graph[0], WAIT_S) as stranger:
        yield stranger


def test_layout_and_joint_states_come_every_second_at_rest(graph, stranger):
    layouts = stranger.collect(PointCloud2, "focal_plane/layout")
    states = stranger.collect(JointState, "focal_plane/joint_states")
    stranger.wait_for(lambda: len(layouts) >= 3 and len(states) >= 4)
    assert len(layouts) <= 5 and layouts[0].width == 61
    assert layouts[0].header == layouts[2].header  # the same layout, again
    stamps = [s.header.stamp.sec + 1e-9 * s.header.stamp.nanosec for s in states]
    # the first can be the reading at the end of the plan before
    np.testing.assert_allclose(np.diff(stamps)[1:], 1.0, atol=0.3)


def test_a_repeated_layout_is_no_new_layout(graph):
    client = graph[2]
    plane, layouts = client.plane, client.collect(topics.LAYOUT)
    client.wait_for(lambda: len(layouts) >= 3, WAIT_S)
    assert client.plane is plane


def test_a_trajectory_with_default_quality_of_service_is_heard(graph, stranger):
    publisher = stranger.node.create_publisher(JointTrajectory, "focal_plane/trajectory", 10)
    stranger.wait_for(lambda: publisher.get_subscription_count() == 1)
    client = graph[2]
    before = client.statuses["discretizer"].count("refused")
    publisher.publish(JointTrajectory(joint_names=["p0001/theta"]))  # it belongs to no session

    def refused():
        status = client.statuses["discretizer"]
        return status.count("refused") == before + 1 and "no session" in status.text

    client.wait_for(refused, WAIT_S)


def shown(domain, monkeypatch, *arguments):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert main(["show", *arguments]) == 0
    return out.getvalue()


def test_the_outcome_is_shown_in_words(graph, monkeypatch):
    domain, ended, _ = graph
    table = shown(domain, monkeypatch, "outcome").splitlines()
    assert table[0].endswith(f"{len(ended.ids)} rows")
    assert table[1].split() == ["id", "outcome", "reason", "error"]
    rows = {int(line.split()[0]): line.split()[1:3] for line in table[2:]}
    for robot, outcome, reason in zip(ended.ids, ended.outcome, ended.reason):
        words = [Outcome(outcome).name.lower(), Reason(reason).name.lower()]
        assert rows[int(robot)] == words


def test_every_topic_is_shown_as_csv_and_json(graph, monkeypatch):
    domain, ended, client = graph
    found = list(csv.DictReader(io.StringIO(shown(domain, monkeypatch, "layout", "--format=csv"))))
    assert [int(row["id"]) for row in found] == client.plane.ids.tolist()
    assert {"bus", "address", "enabled"} <= set(found[0]) and found[0]["kind"] == "robot"
    held = json.loads(shown(domain, monkeypatch, "held", "--format=json"))
    assert all(row["stage"] in ("planner", "discretizer") for row in held["rows"])
    head = shown(domain, monkeypatch, "segments").splitlines()[0]
    assert "ticks and wire units" in head and "m, rad and s" in shown(domain, monkeypatch, "held")
    segments = json.loads(shown(domain, monkeypatch, "segments", "--format=json"))
    assert segments["stamp"] == held["stamp"] and {r["joint"] for r in segments["rows"]} == {0, 1}
    outcome = json.loads(shown(domain, monkeypatch, "outcome", "--format=json"))
    assert all(row["error"] is None for row in outcome["rows"] if row["reason"] == "no_target")


def test_what_a_camera_measured_is_shown_in_words(new_domain, monkeypatch):
    domain, two = new_domain(), np.zeros((2, 2))
    table = measured.Measured(
        np.array([3, 17]), np.array([Verdict.MEASURED, Verdict.DARK]), two + [[1.5], [np.nan]],
        two, two + 0.1, np.array([0.01, np.nan]), np.zeros(2), two,
    )  # fmt: skip
    with Stranger(domain, WAIT_S) as stranger:
        publisher = topics.MEASURED.publisher(stranger.node)
        publisher.publish(measured.encode(table, PlanStamp(10**18)))
        rows = json.loads(shown(domain, monkeypatch, "measured", "--format=json"))["rows"]
    assert [row["id"] for row in rows] == [3, 17]
    assert [row["verdict"] for row in rows] == ["measured", "dark"]
    assert rows[0]["x"] == 0.0015 and rows[1]["x"] is None


def test_a_topic_without_a_message_is_an_error(new_domain, monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(new_domain()))
    assert main(["show", "targets", "--timeout", "0.5"]) == 1
    err = capsys.readouterr().err
    assert "/focal_plane/targets, of which none is kept, did not come within 0.5 s" in err
    north = ["--ros-args", "-r", "__ns:=/north"]
    assert main(["show", "outcome", "--timeout", "0.5", *north]) == 1
    assert "a message of /north/focal_plane/outcome did not come" in capsys.readouterr().err


def test_the_page_of_codes_has_every_code():
    parts = re.split(r"^## (\w+)$", CODES.read_text(), flags=re.MULTILINE)[1:]
    pages = dict(zip(parts[::2], parts[1::2]))
    for name, codes in (
        ("outcome", Outcome), ("reason", Reason), ("verdict", Verdict), ("stage", Stage),
        ("kind", RowKind),
    ):  # fmt: skip
        rows = re.findall(r"^\| (\d+) \| (\w+) \|", pages[name], re.MULTILINE)
        assert rows == [(str(int(code)), code.name.lower()) for code in codes]

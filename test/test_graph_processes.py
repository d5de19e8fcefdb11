# SPDX-License-Identifier: Apache-2.0
"""The installed executables as processes: they take a plane to targets and leave nothing behind."""

import json
import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from fiber_bringup.errors import ProcessError
from fiber_bringup.processes import Processes, installed
from fiber_client.client import PlaneClient
from fiber_core.clearance import Safety, certify
from fiber_core.kinematics import forward
from fiber_core.outcomes import Outcome
from fiber_core.problem import load_plan, load_problem
from fiber_core.wire_units import WireUnits
from fiber_formats import read_results

pytestmark = pytest.mark.timeout(900)  # the first plan of all compiles every core

COMPILE_S = 600


@pytest.fixture(autouse=True)
def in_a_domain_of_its_own(new_domain, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(new_domain()))


@pytest.fixture(scope="module")
def executable():
    """Path of an installed executable; skips where the workspace is not built."""

    def find(package, name):
        try:
            return str(installed(package, name))
        except ProcessError as error:
            pytest.skip(f"NOT TESTED, {error}")

    return find


def shared_memory(pid) -> set[str]:
    """Files of Fast DDS in /dev/shm that a process has mapped."""
    return set(re.findall(r"/dev/shm/\S*fastrtps_\S*", Path(f"/proc/{pid}/maps").read_text()))


def test_three_processes_take_a_plane_to_new_targets(executable, problem_file, tmp_path):
    command = [executable("fiber_client", "reconfigure"), "--timeout", str(COMPILE_S), "--json"]
    with Processes(tmp_path) as nodes:
        pids = [
            nodes.start("fiber_bus_bridge", "bridge", {"problem": problem_file, "time_scale": 0.0}),
            nodes.start("fiber_planner", "planner", {"planner": "dnf"}),
            nodes.start("fiber_discretizer", "discretizer", {}),
        ]
        run = subprocess.run(
            [*command, "--home-first", "random:3"], capture_output=True, text=True, check=False
        )
        assert run.returncode == 0, run.stderr
        result = json.loads(run.stdout)
        robots = load_problem(problem_file).plane
        assert result["asked"] == robots.enabled.sum()
        assert result["reached"] + result["held"] == result["asked"] and result["failed"] == 0
        assert result["reached"] > result["asked"] / 2
        assert len(result["not_reached"]) == result["held"]
        assert result["done_s"]["planner"] <= result["done_s"]["ended"]
        assert result["buses"]["retries"] == 0 and result["alerts"] == []
        assert "planner" in run.stderr and "100 %" in run.stderr

        # a file with a robot that does not exist is refused by the bridge, by name
        table = tmp_path / "targets.csv"
        table.write_text("id,x_mm,y_mm\n1,0.5,0.5\n999,1.0,2.0\n")
        run = subprocess.run([*command, str(table)], capture_output=True, text=True, check=False)
        assert run.returncode == 1 and "robot 999: no such robot, target [1.0, 2.0]" in run.stderr
        nodes.check()
        assert not set().union(*map(shared_memory, pids)), "a killed node would leave it there"
        assert nodes.end() == {"bridge": 0, "planner": 0, "discretizer": 0}
    assert "robot 999" in (tmp_path / "bridge.log").read_text()


def test_a_wait_of_the_client_ends_when_a_node_dies(executable, problem_file, tmp_path):
    executable("fiber_bus_bridge", "bridge")
    nodes = Processes(tmp_path)
    try:
        nodes.start("fiber_bus_bridge", "bridge", {"problem": problem_file, "clock": "2M"})
        with PlaneClient(guard=nodes.check) as client, pytest.raises(ProcessError, match="2M"):
            client.wait_for_graph(60.0)
    finally:
        assert nodes.end()["bridge"] not in (0, None)


def test_the_whole_graph_runs_as_one_executable_too(executable, problem_file, tmp_path):
    executable("fiber_bringup", "graph")
    parameters = {"bridge:problem": problem_file, "planner:planner": "direct"}
    with Processes(tmp_path) as nodes:
        nodes.start("fiber_bringup", "graph", parameters)
        with PlaneClient(guard=nodes.check) as client:
            client.wait_for_graph(COMPILE_S)
            assert np.array_equal(client.plane.ids, load_problem(problem_file).plane.ids)
        assert nodes.end() == {"graph": 0}


class Demo:
    """The demo run once: its folder, and the output of it and its nodes, a line for each loop."""

    def __init__(self, folder, command, domain):
        options = ["--robots", "37", "--time-scale", "0", "--seed", "5", "--out", str(folder)]
        environment = {"COLUMNS": "200", "NUMBA_DEBUG_CACHE": "1", "ROS_DOMAIN_ID": str(domain)}
        run = subprocess.run(
            [command, *options],
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | environment,
        )
        assert run.returncode == 0, run.stdout + run.stderr
        self.folder, self.said = folder, run.stdout
        logs = [path.read_text(errors="replace") for path in folder.glob("*.log")]
        self.said_by_all = "\n".join([run.stdout, run.stderr, *logs])


@pytest.fixture(scope="module")
def demo(executable, tmp_path_factory, new_domain):
    return Demo(tmp_path_factory.mktemp("demo"), executable("fiber_bringup", "demo"), new_domain())


def test_the_demo_writes_files_that_agree(demo):
    report = json.loads((demo.folder / "report.json").read_text())
    problem = load_problem(demo.folder / "problem.npz")
    motion, outcome = load_plan(demo.folder / "plan.npz", problem.start)
    assert report["robots"] == report["asked"] == 37 == len(outcome)
    reached = outcome == Outcome.REACHED
    assert report["reached"] == reached.sum() > 37 / 2
    assert report["makespan_s"] == pytest.approx(motion.makespan_s)
    assert report["makespan_s"] >= report["lower_bound_s"] > 0
    assert report["certified"] and certify(problem.plane, motion, Safety()).ok
    off = np.hypot(*(forward(problem.plane, motion.end)[1] - problem.targets).T)
    assert off[reached].max() < 0.1 < off[~reached].min(initial=np.inf)
    assert report["bytes_mean"] >= report["bytes_bound"] > 4 and report["bus_time_s"] > 0
    assert (demo.folder / "plane.png").read_bytes().startswith(b"\x89PNG")
    table = read_results(demo.folder / "results.ecsv")
    assert np.array_equal(table.ids, problem.plane.ids)
    assert np.array_equal(table.outcome, outcome)
    # the robots begin at the nearest angle that an encoder can read, problem.npz at any angle
    off_rad = np.abs(np.deg2rad(table.angles_deg) - motion.end)
    assert off_rad.max() <= 0.51 * WireUnits.for_plane(problem.plane).quantum_rad
    for name in ("makespan", "report.json", "plan.npz", "plane.png", "results.ecsv"):
        assert name in demo.said


def test_the_build_has_compiled_every_loop_of_the_demo(demo):
    built = Path(__file__).parents[1] / "build/.built"  # made when compile_loops was through
    if not built.exists():
        pytest.skip("NOT TESTED, this workspace was not built by make")
    used = re.findall(r"data (?:saved to|loaded from) '(.*)'", demo.said_by_all)
    assert len(used) > 50, "the nodes log nothing about their loops"
    late = {path for path in used if Path(path).stat().st_mtime > built.stat().st_mtime}
    assert not late, "tools/compile_loops.py does not run these"

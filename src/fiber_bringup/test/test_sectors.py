# SPDX-License-Identifier: Apache-2.0
"""A plane of two sectors, each node a process: a reconfiguration, and the death of a sector."""

import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from fiber_client.client import PlaneClient
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_core.problem import Problem, save_problem
from fiber_msgs_py import PlanStamp, topics
from fiber_recording import load_recording
from fiber_sectors import Beat, Order, Report, Stage, encode_beat, encode_report
from fiber_sectors.calls import Kind, encode_call
from fiber_sectors.node.links import as_message

pytestmark = pytest.mark.timeout(900)  # the first plan of all compiles every core
COMPILE_S, WAIT_S, ROBOTS = 600.0, 120.0, 40


class Nodes:
    """Processes of nodes, ended at the end of `with`."""

    def __init__(self, folder, domain, clock_scale=0.0, commands=((), ())):
        self._clock, self._commands = {"sectors.clock_scale": clock_scale}, commands
        plane, rows = preset("desi", ROBOTS), np.arange(ROBOTS)
        plane = replace(plane, bus=rows // 10, address=rows % 10 + 8)
        start = np.stack([np.linspace(-1.0, 1.0, ROBOTS), np.full(ROBOTS, 3.1)], axis=1)
        self._folder = folder
        self._problem = str(folder / "problem.npz")
        save_problem(self._problem, Problem(plane, start, np.full((ROBOTS, 2), np.nan)))
        self._environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
        self.processes = {}

    def start(self, name, module, namespace="", command=(), **parameters):
        given = (
            {"problem": self._problem, "sectors.shares": "0-1; 2-3"}
            if "fiber_sectors" in module
            else {}
        )
        given = given | parameters
        arguments = ["--ros-args", "-r", f"__ns:=/{namespace}"]
        for each, value in given.items():
            arguments += ["-p", f"{each}:={value}"]
        code = f"import sys; from {module} import main; sys.exit(main())"
        self.processes[name] = subprocess.Popen(
            [*command, sys.executable, "-c", code, *arguments], env=self._environment
        )

    def __enter__(self):
        for k in range(2):
            where = "fiber_sectors.node.sector_node"
            own = {"sectors.number": k, "sectors.patience_s": 3.0} | self._clock
            self.start(f"sector_{k}", where, f"sector_{k}", self._commands[k], **own)
        of_coordinator = self._clock | {
            "time_scale": 0.0,
            "sectors.patience_s": 3.0,
            "sectors.call_s": 600.0,
        }
        self.start("coordinator", "fiber_sectors.node.coordinator", **of_coordinator)
        self.start("planner", "fiber_planner.node")
        self.start("discretizer", "fiber_discretizer.node")
        self.start("recorder", "fiber_recording.node", folder=str(self._folder))
        return self

    def __exit__(self, *_):
        for process in self.processes.values():
            process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def new_targets(client, seed):
    drawn = random_field(client.plane, np.random.default_rng(seed), start=client.angles).problem
    return client.plane.ids[drawn.asked], drawn.targets[drawn.asked]


AHEAD_S = 5000
ELSEWHERE = ("unshare", "--time", f"--monotonic={AHEAD_S}")  # a host with another clock


def test_sectors_follow_the_clocks_of_their_hosts(tmp_path, new_domain):
    if subprocess.run([*ELSEWHERE, "true"], capture_output=True).returncode:
        pytest.skip("this user cannot make a time namespace: one machine has one steady clock")
    domain, scale = new_domain(), 0.05  # slow motion: the processes share few cores
    nodes = Nodes(tmp_path, domain, scale, ((), ELSEWHERE))
    with nodes, PlaneClient(domain) as client:
        client.wait_for_graph(COMPILE_S)
        for seed in range(1, 6):  # a loop that compiles, or other work, may keep a lease too long
            ended = client.reconfigure(*new_targets(client, seed), COMPILE_S)
            assert ended.count(Outcome.FAILED) == 0
            if ended.count(Outcome.REACHED) >= ROBOTS - 2:
                break
            client.call_service(topics.CLEAR, WAIT_S)
        else:
            pytest.fail("no plan of five was carried out")
        told = client.statuses["bridge: sector 1"].values
        assert abs(float(told["clock_ahead_s"]) - scale * AHEAD_S) < 1e-3
        assert 0.0 < float(told["clock_bound_ms"]) <= 1.0


def malformed(rng):
    """Bytes that are no message of sectors, or one with a content that cannot be."""
    beat = encode_beat(Beat(5, 3, Order.MOVE, 1.5, (7, 0), (0.2, 1.0), (2.0, 3.0)))
    report = encode_report(Report(1, 4, 5, Stage.READY, 0.2, 1.5, 0.1, 2.0))
    table = encode_call(1, Kind.TABLE, 0, {"robot_counts": np.full((20, 2), 2**40)})
    answer = encode_call(0, Kind.CONFIGURE, 7, {"a": np.arange(30)})
    yield from (b"", b"F", b"FSB1", b"FSR1", b"FSC1", table, table[:-30], answer, answer[:40])
    yield encode_report(Report(65535, 4, 5, Stage.READY, 0.2, 1.5, 0.1, 2.0))
    yield encode_report(Report(0, 4, 5, Stage.READY, 1e300, 1.5, 0.1, 2.0))
    yield encode_beat(Beat(5, 3, Order.GO, np.nan, (7, 0), (0.2, 1.0), (2.0, 3.0)))
    yield encode_call(65535, Kind.PREPARE, 1, {"run": np.array("a")})
    for data in (beat, report):
        yield from (data[:-1], data + b"x", rng.permutation(np.frombuffer(data, "u1")).tobytes())
    yield from (rng.bytes(size) for size in (3, 30, 300, 100_000))


def test_malformed_messages_to_sectors_and_coordinator_end_no_node(tmp_path, new_domain):
    domain, rng = new_domain(), np.random.default_rng(0)
    with Nodes(tmp_path, domain) as nodes, PlaneClient(domain) as client:
        client.wait_for_graph(COMPILE_S)
        strangers = [
            replace(topic, name=f"sector_{k}/{topic.name}").publisher(client.node)
            for topic in (topics.TO_SECTOR, topics.FROM_SECTOR)
            for k in range(2)
        ]
        client.wait_for(
            lambda: all(each.get_subscription_count() for each in strangers), WAIT_S, "sectors"
        )

        def disturb():
            for data in malformed(rng):
                for each in strangers:
                    each.publish(as_message(data))

        disturb()
        ended = client.reconfigure(*new_targets(client, 1), COMPILE_S)
        assert ended.count(Outcome.REACHED) >= ROBOTS - 2
        stamp = client.send_targets(*new_targets(client, 2))
        client.wait_until_ready(stamp, WAIT_S)
        disturb()
        client.start(WAIT_S)
        disturb()
        ended = client.wait_for_outcome(stamp, WAIT_S)
        assert len(ended.outcome) == ROBOTS
        assert ended.count(Outcome.REACHED) >= ROBOTS - 2 and ended.count(Outcome.FAILED) == 0
        assert all(process.poll() is None for process in nodes.processes.values())


def check_recording(path, client, ended):
    """The motion made from the bytes of all sectors ends where the robots rest."""
    recording = load_recording(path)
    np.testing.assert_array_equal(recording.problem.plane.ids, client.plane.ids)
    assert recording.started[ended.outcome == Outcome.REACHED].all()
    assert len(recording.load.buses) == 4 and (recording.load.frames.sum(axis=1) > 0).all()


def test_two_sectors_are_one_plane(tmp_path, new_domain):
    domain = new_domain()
    with Nodes(tmp_path, domain) as nodes, PlaneClient(domain) as client:
        client.wait_for_graph(COMPILE_S)
        sector = client.plane.sector
        np.testing.assert_array_equal(sector, np.arange(ROBOTS) // 20)
        ended = client.reconfigure(*new_targets(client, 1), COMPILE_S)
        assert ended.count(Outcome.REACHED) >= ROBOTS - 2  # the border may cost a robot its target
        assert ended.count(Outcome.FAILED) == 0
        stamp = PlanStamp(ended.stamp_ns)
        client.wait_for(lambda: "recorder" in client.times[stamp], WAIT_S, "the recording")
        check_recording(tmp_path / f"plan-{stamp}.npz", client, ended)

        # a sector dies in motion: the plan ends, with an outcome for each robot
        stamp = client.send_targets(*new_targets(client, 2))
        client.wait_until_ready(stamp, WAIT_S)
        client.start(WAIT_S)
        client.wait_for(lambda: client.moving, WAIT_S, "motion")
        nodes.processes["sector_1"].kill()
        ended = client.wait_for_outcome(stamp, WAIT_S)
        assert len(ended.outcome) == ROBOTS
        assert (ended.outcome[sector == 1] != Outcome.REACHED).any()
        # the others go on: the robots of the lost sector are obstacles
        client.wait_for(lambda: not client.moving, WAIT_S, "rest")
        client.call_service(topics.CLEAR, WAIT_S)
        client.wait_for(lambda: not client.plane.enabled[sector == 1].any(), WAIT_S, "the layout")
        ids, xy_mm = new_targets(client, 3)
        chosen = np.isin(ids, client.plane.ids[sector == 0])
        ended = client.reconfigure(ids[chosen], xy_mm[chosen], WAIT_S)
        assert ended.count(Outcome.REACHED) > 5 and ended.count(Outcome.FAILED) == 0

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measure what a viewer and a recorder cost the control graph.

Takes a plane through the same reconfigurations in four settings: the graph alone, with a
recorder, with a viewer without subscribers, with a viewer that has some. Prints, for each, the
median processor time of the bridge for a reconfiguration and the longest pause between
two joint states while robots moved. Needs a built workspace.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fiber_bringup.processes import Processes
from fiber_client.client import PlaneClient
from fiber_client.terminal import table
from fiber_core.fields import random_field
from fiber_msgs_py import topics
from fiber_node.ros_environment import own_domain, use_loopback
from fiber_viewer.node import WATCHED

_WAIT_S = 300.0
_TICKS = os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Measure all settings; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=5000)
    parser.add_argument("--plans", type=int, default=5, help="in each setting")
    args = parser.parse_args()
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    rows = [("setting", "bridge cpu s", "longest pause s", "pictures a s")]
    for name, beside, watched in (
        ("graph alone", (), False),
        ("with a recorder", (("fiber_recording", "recorder"),), False),
        ("with a viewer", (("fiber_viewer", "viewer"),), False),
        ("viewer with subscribers", (("fiber_viewer", "viewer"),), True),
    ):
        with tempfile.TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
            rows.append((name, *_measure(processes, beside, watched, folder, args)))
    print(table(rows))
    return 0


def _measure(processes, beside, watched, folder, args):
    bridge = processes.start("fiber_bus_bridge", "bridge", {"robots": args.robots})
    processes.start("fiber_planner", "planner", {})
    processes.start("fiber_discretizer", "discretizer", {})
    for package, executable in beside:
        parameters = {"folder": folder} if executable == "recorder" else {}
        processes.start(package, executable, parameters)
    used, pauses, pictures = [], [], []
    with PlaneClient(guard=processes.check) as client:
        client.wait_for_graph(_WAIT_S)
        times = []
        topics.JOINT_STATES.subscription(client.node, lambda _: times.append(time.monotonic()))
        seen = [client.collect(topic) for topic in (topics.VIEW_ARMS, WATCHED)] if watched else [[]]
        for seed in range(args.plans + 1):
            rng = np.random.default_rng(seed)
            problem = random_field(client.plane, rng, start=client.angles).problem
            stamp = client.send_targets(
                client.plane.ids[problem.asked], problem.targets[problem.asked]
            )
            client.wait_until_ready(stamp, _WAIT_S)
            before, begin = _cpu_s(bridge), time.monotonic()
            times.clear()
            seen[0].clear()
            client.start(_WAIT_S)
            client.wait_for_outcome(stamp, _WAIT_S)
            used.append(_cpu_s(bridge) - before)
            pauses.append(np.diff(times).max(initial=0.0))
            pictures.append(len(seen[0]) / (time.monotonic() - begin))
    # the first plan finds cold caches
    return (
        f"{np.median(used[1:]):.2f}",
        f"{np.median(pauses[1:]):.3f}",
        f"{np.median(pictures[1:]):.1f}",
    )


def _cpu_s(pid) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return sum(int(value) for value in fields[11:13]) / _TICKS


if __name__ == "__main__":
    sys.exit(main())

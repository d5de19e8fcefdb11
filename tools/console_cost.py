#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measure what a console costs the control graph, how fast it shows motion, and how fast it stops.

Takes a plane through the same reconfigurations without a console, with one that a client of its
WebSocket follows, and with one that is open in Chromium. Prints for each the median processor time
of the bridge for a reconfiguration, the longest pause between two joint states while robots moved,
the joint states of the bridge, the motions that the follower got and the pictures that it drew, a
second; and the times from an order to stop in the middle of a motion to its answer, which is sent
when all robots have been told. Needs a built workspace, and Chromium for its part.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from console_followers import ChromiumFollower, Follower, SocketFollower

from fiber_bringup.processes import Processes
from fiber_client.client import PlaneClient
from fiber_client.terminal import table
from fiber_core.fields import random_field
from fiber_msgs_py import topics
from fiber_node.ros_environment import own_domain, use_loopback

_WAIT_S = 300.0
_TICKS = os.sysconf("SC_CLK_TCK")
_HEADINGS = (
    "setting", "bridge cpu s", "longest pause s", "joint states a s", "motions a s", "pictures a s",
    "stop ms, median", "most",
)  # fmt: skip


def main() -> int:
    """Measure all settings; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=5000)
    parser.add_argument("--plans", type=int, default=5, help="in each setting")
    parser.add_argument("--stops", type=int, default=30, help="in each setting with a console")
    args = parser.parse_args()
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    rows: list[tuple[object, ...]] = [_HEADINGS]
    for setting in ("graph alone", "console and client", "console and Chromium"):
        with tempfile.TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
            rows.append((setting, *_measure(processes, Path(folder), setting, args)))
    print(table(rows))
    return 0


def _measure(
    processes: Processes, folder: Path, setting: str, args: argparse.Namespace
) -> tuple[str, ...]:
    bridge = processes.start("fiber_bus_bridge", "bridge", {"robots": args.robots})
    processes.start("fiber_planner", "planner", {})
    processes.start("fiber_discretizer", "discretizer", {})
    follower = _follower(processes, folder, setting)
    used, pauses, spans, stops = [], [], [], []
    motions, pictures = [], []
    try:
        with PlaneClient(guard=processes.check) as client:
            client.wait_for_graph(_WAIT_S)
            times: list[float] = []
            topics.JOINT_STATES.subscription(client.node, lambda _: times.append(time.time()))
            for seed in range(args.plans + 1):
                _send_targets(client, seed)
                before = _cpu_s(bridge)
                times.clear()
                client.start(_WAIT_S)
                client.wait_for(lambda: client.moving, _WAIT_S)
                client.wait_for(lambda: not client.moving, _WAIT_S)
                used.append(_cpu_s(bridge) - before)
                pauses.append(np.diff(times).max(initial=0.0))
                spans.append((times[0], times[-1], len(times)))
            heard = [(n - 1) / (until - since) for since, until, n in spans]
            if follower is not None:
                motions = _rates(follower.motions_s(), spans)
                pictures = _rates(follower.pictures_s(), spans)
                for seed in range(args.stops):
                    stops.append(1e3 * _stop_in_motion(client, follower, args.plans + 1 + seed))
    finally:
        if follower is not None:
            follower.close()
    # the first plan finds cold caches
    figures = [
        f"{np.median(used[1:]):.2f}",
        f"{max(pauses[1:]):.3f}",
        f"{np.median(heard[1:]):.1f}",
    ]
    if follower is None:
        return (*figures, "-", "-", "-", "-")
    figures += [f"{np.median(each[1:]):.1f}" if any(each) else "-" for each in (motions, pictures)]
    return (*figures, f"{np.median(stops):.0f}", f"{max(stops):.0f}")


def _rates(times_s: list[float], spans: list[tuple[float, float, int]]) -> list[float]:
    """Return how many of some times are in each span, a second."""
    within = [
        (sum(since <= at <= until for at in times_s), until - since) for since, until, _ in spans
    ]
    return [count / lasts_s for count, lasts_s in within]


def _stop_in_motion(client: PlaneClient, follower: Follower, seed: int) -> float:
    """Start a plan and stop it; return the time from the order to its answer [s]."""
    _send_targets(client, seed)
    client.start(_WAIT_S)
    client.wait_for(lambda: client.moving, _WAIT_S)
    took_s = follower.stop_s()
    client.wait_for(lambda: not client.moving, _WAIT_S)
    client.call_service(topics.CLEAR, _WAIT_S)
    return took_s


def _send_targets(client: PlaneClient, seed: int) -> None:
    problem = random_field(client.plane, np.random.default_rng(seed), start=client.angles).problem
    stamp = client.send_targets(client.plane.ids[problem.asked], problem.targets[problem.asked])
    client.wait_until_ready(stamp, _WAIT_S)


def _follower(processes: Processes, folder: Path, setting: str) -> Follower | None:
    if "console" not in setting:
        return None
    token_file = str(folder / "token")
    processes.start("fiber_console", "console", {"port": 0, "token_file": token_file})
    log, mark = folder / "console.log", "the console is at "
    while True:
        processes.check()
        for line in log.read_text().splitlines():
            if mark in line:
                address = line.partition(mark)[2].strip()
                if "Chromium" in setting:
                    return ChromiumFollower(address, folder / "profile")
                return SocketFollower(address)
        time.sleep(0.1)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return sum(int(value) for value in fields[11:13]) / _TICKS


if __name__ == "__main__":
    sys.exit(main())

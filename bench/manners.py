#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How soon nodes answer while they work, and how soon they end, at each stage of a plan.

python bench/manners.py --preset moons --robots 1006 --out table.md

A plain rclpy node asks each node for a parameter again and again while a plan is made, loaded and
carried out; then nodes are told to end by a signal, at rest and at work. Beside each wall time
stands the time of the processors that the process had in it, which other work on the machine does
not alter much.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import rclpy
from processor_time import of_children_s, processor_s
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from fiber_bringup.processes import installed
from fiber_client import PlaneClient
from fiber_core.errors import FiberError
from fiber_core.fields import random_field
from fiber_msgs_py import topics
from fiber_node import WaitError
from fiber_node.ros_environment import own_domain, use_loopback

__all__ = ["main"]

_WAIT_S, _END_S = 900.0, 60.0
_ASK_S = 0.05  # between two rounds of questions
_PACKAGES = {
    "planner": "fiber_planner", "discretizer": "fiber_discretizer", "bridge": "fiber_bus_bridge",
    "recorder": "fiber_recording", "viewer": "fiber_viewer",
}  # fmt: skip
_CASES = (
    ("idle", "planner"), ("idle", "discretizer"), ("idle", "bridge"), ("idle", "recorder"),
    ("idle", "viewer"), ("planning", "planner"), ("planning", "viewer"),
    ("discretizing", "discretizer"), ("loading", "bridge"), ("motion", "bridge"),
    ("motion", "discretizer"), ("motion", "recorder"), ("recording", "recorder"),
)  # fmt: skip


class Nodes:
    """The processes of a graph without a plant; one that was ended can be started again."""

    def __init__(self, preset: str, robots: int, folder: Path):
        self._parameters = {
            "bridge": [f"preset:={preset}", f"robots:={robots}"],
            "recorder": [f"folder:={folder}"],
        }
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str) -> None:
        given = [x for each in self._parameters.get(name, []) for x in ("-p", each)]
        command = [str(installed(_PACKAGES[name], name)), "--ros-args", *given]
        self._running[name] = subprocess.Popen(command, stderr=subprocess.DEVNULL)

    def end(self, name: str, how: signal.Signals) -> tuple[float, float, int]:
        """Tell a node to end; return wall time and time of the processors [s], and its code."""
        process = self._running.pop(name)
        before, earlier, begin = processor_s(process.pid), of_children_s(), time.monotonic()
        process.send_signal(how)
        try:
            code = process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        wall = time.monotonic() - begin
        return wall, of_children_s() - earlier - before, code

    def end_all(self) -> None:
        for name in list(self._running):
            self.end(name, signal.SIGINT)


class Questions:
    """Asks nodes for a parameter, in a thread, and keeps how long each answer took."""

    def __init__(self, names: Sequence[str]):
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self._node = Node("stranger", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._clients = {
            name: self._node.create_client(GetParameters, f"/{name}/get_parameters")
            for name in names
        }
        self.stage, self._ended = "idle", False
        self.took: dict[tuple[str, str], list[float]] = {}
        self._thread = threading.Thread(target=self._ask)
        self._thread.start()

    def ready(self) -> bool:
        """Return whether all nodes can be asked."""
        return all(client.service_is_ready() for client in self._clients.values())

    def close(self) -> None:
        self._ended = True
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _ask(self) -> None:
        while not self._ended:
            for name, client in self._clients.items():
                if client.service_is_ready():
                    stage, begin = self.stage, time.monotonic()
                    future = client.call_async(GetParameters.Request(names=["use_sim_time"]))
                    while not future.done() and not self._ended:
                        self._executor.spin_once(timeout_sec=0.01)
                    self.took.setdefault((stage, name), []).append(time.monotonic() - begin)
            self._executor.spin_once(timeout_sec=_ASK_S)


def _go_on(client: PlaneClient, seconds: float) -> None:
    with suppress(WaitError):
        client.wait_for(lambda: False, seconds)


def reach(client: PlaneClient, stage: str, seed: int) -> None:
    """Send targets and go on until a stage is under way.

    Args:
        client: the client of the plane.
        stage: planning, discretizing, loading, motion or recording; idle for no plan.
        seed: seed of the targets.
    """
    if stage == "idle":
        return
    rng = np.random.default_rng(seed)
    drawn = random_field(client.plane, rng, start=client.angles).problem
    stamp = client.send_targets(client.plane.ids[drawn.asked], drawn.targets[drawn.asked])
    if stage == "planning":
        _go_on(client, 0.5)
        return
    client.wait_for(lambda: "planner" in client.times[stamp], _WAIT_S, "a trajectory")
    if stage == "discretizing":
        _go_on(client, 0.3)
        return
    client.wait_until_ready(stamp, _WAIT_S)
    # the answer comes when robots move; a bridge that is ended before gives none
    client.node.create_client(Trigger, topics.START.name).call_async(Trigger.Request())
    if stage == "motion":
        client.wait_for(lambda: client.moving, _WAIT_S, "motion")
    elif stage == "recording":
        client.wait_for_outcome(stamp, _WAIT_S)
    _go_on(client, 0.1)


def answers(client: PlaneClient, asked: Questions, seed: int) -> None:
    """Carry out a plan, and let it be recorded, while the nodes are asked."""
    rng = np.random.default_rng(seed)
    drawn = random_field(client.plane, rng, start=client.angles).problem
    asked.stage = "planning"
    stamp = client.send_targets(client.plane.ids[drawn.asked], drawn.targets[drawn.asked])
    client.wait_for(lambda: "planner" in client.times[stamp], _WAIT_S, "a trajectory")
    asked.stage = "discretizing"
    client.wait_until_ready(stamp, _WAIT_S)
    asked.stage = "motion"
    client.start(_WAIT_S)
    client.wait_for_outcome(stamp, _WAIT_S)
    asked.stage = "recording"
    client.wait_for(lambda: "recorder" in client.times[stamp], _WAIT_S, "a recording")
    asked.stage = "idle"


def measure(preset: str, robots: int, plans: int, folder: Path) -> tuple[list[str], list[str]]:
    """Return the rows of both tables."""
    nodes = Nodes(preset, robots, folder)
    for name in _PACKAGES:
        nodes.start(name)
    ends, asked = [], None
    try:
        with PlaneClient(args=[]) as client:
            client.wait_for_graph(_WAIT_S, also=("recorder", "viewer"))
            asked = Questions(list(_PACKAGES))
            client.wait_for(asked.ready, _WAIT_S, "the parameters of all nodes")
            _go_on(client, 1.0)
            for seed in range(plans):
                answers(client, asked, seed)
            asked.close()
        for k, (stage, name) in enumerate(_CASES):
            with PlaneClient(args=[]) as client:
                client.wait_for_graph(_WAIT_S, also=("recorder", "viewer"))
                reach(client, stage, k)
                how = (signal.SIGINT, signal.SIGTERM)[k % 2]
                wall, processors, code = nodes.end(name, how)
                ends.append(
                    f"| {stage} | {name} | {how.name} | {wall:.2f} | {processors:.2f} | {code} |"
                )
                print(ends[-1], flush=True)
                if stage != "idle":
                    with suppress(FiberError):
                        client.call_service(topics.STOP, _WAIT_S)
            nodes.start(name)
            with PlaneClient(args=[]) as client:
                client.wait_for_graph(_WAIT_S, also=("recorder", "viewer"))
                _go_on(client, 1.0)
                client.call_service(topics.CLEAR, _WAIT_S)
    finally:
        nodes.end_all()
    took = [
        f"| {stage} | {name} | {len(times)} | {1e3 * np.median(times):.0f} | "
        f"{1e3 * np.quantile(times, 0.95):.0f} | {1e3 * max(times):.0f} |"
        for (stage, name), times in sorted(asked.took.items())
    ]
    return took, ends


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the tables; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--preset", default="moons", help="instrument")
    parser.add_argument("--robots", type=int, default=0, help="number of robots; 0: all")
    parser.add_argument("--plans", type=int, default=1, help="plans in which nodes are asked")
    parser.add_argument("--out", type=Path, help="file that the tables are appended to")
    options = parser.parse_args(argv)
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    with tempfile.TemporaryDirectory() as folder:
        load = os.getloadavg()[0]
        took, ends = measure(options.preset, options.robots, options.plans, Path(folder))
    lines = [
        f"## {options.preset}, {options.robots or 'all'} robots, load {load:.1f} before and "
        f"{os.getloadavg()[0]:.1f} after", "",
        "Time until a node answers `ros2 param get` [ms]:", "",
        "| stage | node | answers | median | 95 % | most |", "|---|---|---|---|---|---|", *took, "",
        "Time until a node has ended [s]:", "",
        "| stage | node | signal | wall | processors | code |", "|---|---|---|---|---|---|", *ends,
        "",
    ]  # fmt: skip
    print("\n".join(lines))
    if options.out:
        with options.out.open("a") as file:
            file.write("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())

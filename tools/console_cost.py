#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measure what a console with a browser costs the control graph, and how fast it is.

Takes a plane through the same reconfigurations without a console, and with one that a client
follows as a browser does. Prints the median processor time of the bridge for a reconfiguration, the
longest pause between two joint states while robots moved, the motions that the client got each
second meanwhile, and the times from an order to stop to its answer. Needs a built workspace.
"""

import argparse
import asyncio
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from fiber_bringup.processes import Processes
from fiber_client.client import PlaneClient
from fiber_client.terminal import table
from fiber_core.fields import random_field
from fiber_msgs_py import topics
from fiber_node.ros_environment import own_domain, use_loopback

_WAIT_S = 300.0
_TICKS = os.sysconf("SC_CLK_TCK")
_STOPS = 20
_MOST_BYTES = 10_000_000  # of one message


class Browser:
    """Follows a console in a thread: the times of motions, and answers of orders.

    Args:
        address: the address that the console printed.
    """

    def __init__(self, address: str):
        self.motions_s: list[float] = []
        self._answers: dict[int, threading.Event] = {}
        self._loop = asyncio.new_event_loop()
        self._socket: WebSocketClientConnection | None = None
        base, _, query = address.partition("/?")
        self._request = HTTPRequest(
            f"{base.replace('http', 'ws')}/live?{query}", headers={"Origin": base}
        )
        threading.Thread(target=self._loop.run_until_complete, args=(self._follow(),)).start()

    def stop_s(self) -> float:
        """Order a stop; return the time to its answer [s]."""
        number = len(self._answers)
        answered = self._answers[number] = threading.Event()
        begin = time.perf_counter()
        self._loop.call_soon_threadsafe(self._send, {"number": number, "order": "stop"})
        if not answered.wait(_WAIT_S):
            raise TimeoutError("no answer to stop")
        return time.perf_counter() - begin

    def close(self) -> None:
        """Leave the console."""
        if self._socket is not None:
            self._loop.call_soon_threadsafe(self._socket.close)

    def _send(self, message: dict[str, object]) -> None:
        if self._socket is not None:
            self._socket.write_message(json.dumps(message))

    async def _follow(self) -> None:
        self._socket = await websocket_connect(self._request, max_message_size=_MOST_BYTES)
        while (message := await self._socket.read_message()) is not None:
            if isinstance(message, bytes):
                self.motions_s.append(time.monotonic())
            elif (answer := json.loads(message))["kind"] == "answer":
                self._answers[answer["number"]].set()


def main() -> int:
    """Measure both settings; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=5000)
    parser.add_argument("--plans", type=int, default=5, help="in each setting")
    args = parser.parse_args()
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    rows: list[tuple[object, ...]] = [
        ("setting", "bridge cpu s", "longest pause s", "motions a s", "stop ms, median", "most")
    ]
    for name, with_console in (("graph alone", False), ("console and browser", True)):
        with tempfile.TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
            rows.append((name, *_measure(processes, Path(folder), with_console, args)))
    print(table(rows))
    return 0


def _measure(
    processes: Processes, folder: Path, with_console: bool, args: argparse.Namespace
) -> tuple[str, ...]:
    bridge = processes.start("fiber_bus_bridge", "bridge", {"robots": args.robots})
    processes.start("fiber_planner", "planner", {})
    processes.start("fiber_discretizer", "discretizer", {})
    browser = _browser(processes, folder) if with_console else None
    used, pauses, motions, stops = [], [], [], []
    with PlaneClient(guard=processes.check) as client:
        client.wait_for_graph(_WAIT_S)
        times: list[float] = []
        topics.JOINT_STATES.subscription(client.node, lambda _: times.append(time.monotonic()))
        for seed in range(args.plans + 1):
            _send_targets(client, seed)
            before = _cpu_s(bridge)
            times.clear()
            client.start(_WAIT_S)
            began = time.monotonic()
            client.wait_for(lambda: client.moving, _WAIT_S)
            client.wait_for(lambda: not client.moving, _WAIT_S)
            used.append(_cpu_s(bridge) - before)
            pauses.append(np.diff(times).max(initial=0.0))
            if browser is not None:
                seen = [at for at in browser.motions_s if began <= at <= times[-1]]
                motions.append((len(seen) - 1) / (seen[-1] - seen[0]))
        if browser is not None:
            _send_targets(client, args.plans + 1)
            client.start(_WAIT_S)
            client.wait_for(lambda: client.moving, _WAIT_S)
            stops = [1e3 * browser.stop_s() for _ in range(_STOPS)]
            browser.close()
    # the first plan finds cold caches
    return (
        f"{np.median(used[1:]):.2f}",
        f"{np.median(pauses[1:]):.3f}",
        f"{np.median(motions[1:]):.1f}" if motions else "-",
        f"{np.median(stops):.0f}" if stops else "-",
        f"{max(stops):.0f}" if stops else "-",
    )


def _send_targets(client: PlaneClient, seed: int) -> None:
    problem = random_field(client.plane, np.random.default_rng(seed), start=client.angles).problem
    stamp = client.send_targets(client.plane.ids[problem.asked], problem.targets[problem.asked])
    client.wait_until_ready(stamp, _WAIT_S)


def _browser(processes: Processes, folder: Path) -> Browser:
    token_file = str(folder / "token")
    processes.start("fiber_console", "console", {"port": 0, "token_file": token_file})
    log, mark = folder / "console.log", "the console is at "
    while True:
        processes.check()
        for line in log.read_text().splitlines():
            if mark in line:
                return Browser(line.partition(mark)[2].strip())
        time.sleep(0.1)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return sum(int(value) for value in fields[11:13]) / _TICKS


if __name__ == "__main__":
    sys.exit(main())

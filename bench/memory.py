#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Carry out many plans on a small plane and tell how the memory of each node grows.

The first plans load code, fill buffers and histories of bounded length; the growth is that of the
second half of the plans.
"""

import argparse
import os
import signal
import sys
import tempfile
from pathlib import Path

import numpy as np
from forked_processes import ForkedProcesses

from fiber_client.client import PlaneClient
from fiber_core.fields import random_field
from fiber_node.ros_environment import own_domain, use_loopback

__all__ = ["main", "measure", "table"]

_WAIT_S = 600.0
_NODES = (
    ("fiber_planner", "planner"), ("fiber_discretizer", "discretizer"), ("fiber_viewer", "viewer")
)  # fmt: skip


def measure(folder: Path, plans: int, robots: int, every: int) -> dict[str, list[float]]:
    """Return the resident memory of each node after every few plans [MB].

    Args:
        folder: folder for logs and recordings.
        plans: number of plans.
        robots: number of robots.
        every: number of plans between two readings.
    """
    processes, rng = ForkedProcesses(folder), np.random.default_rng(0)
    found: dict[str, list[float]] = {}
    try:
        bridge = {"preset": "desi", "robots": robots, "time_scale": 0.0}
        processes.start("fiber_bus_bridge", "bridge", bridge)
        for package, name in _NODES:
            processes.start(package, name, {})
        processes.start("fiber_recording", "recorder", {"folder": str(folder)})
        with PlaneClient(args=[], guard=processes.check) as client:
            client.wait_for_graph(_WAIT_S, also=("recorder",))
            for plan in range(1, plans + 1):
                drawn = random_field(client.plane, rng, start=client.angles).problem
                ids, xy_mm = client.plane.ids[drawn.asked], drawn.targets[drawn.asked]
                client.reconfigure(ids, xy_mm, _WAIT_S)
                if plan % every == 0:
                    for name, (_, mb) in processes.memory_mb().items():
                        found.setdefault(name, []).append(mb)
    finally:
        processes.end()
    return found


def table(found: dict[str, list[float]], every: int) -> str:
    """Return a table: memory at the beginning, half way and at the end, and its growth."""
    text = [
        "| node | MB, first | MB, half way | MB, last | kB a plan, second half |",
        "|---" * 5 + "|",
    ]
    for name, mb in sorted(found.items()):
        half = len(mb) // 2
        plans = every * (len(mb) - 1 - half)
        growth = 1e3 * (mb[-1] - mb[half]) / max(plans, 1)
        text.append(f"| {name} | {mb[0]} | {mb[half]} | {mb[-1]} | {growth:.1f} |")
    return "\n".join(text)


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--plans", type=int, default=400)
    parser.add_argument("--robots", type=int, default=37)
    parser.add_argument("--every", type=int, default=20, help="plans between two readings")
    args = parser.parse_args(argv)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), args.plans, args.robots, args.every)
    print(f"{args.plans} plans of {args.robots} robots\n\n{table(found, args.every)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

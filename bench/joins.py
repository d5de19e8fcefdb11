#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Clients that join a graph of their own process, two at a time: which of them hear nothing.

Two small planes run in this process, as in a test or a demonstration. A client of each joins, waits
for a sign of its bridge and leaves, again and again, until one hears nothing: then so do those that
come later. Prints one JSON line; decision 60 has the figures with and without the middleware's
delivery inside a process.
"""

import argparse
import json
import sys
import time

import numpy as np

from fiber_bringup.graph import Graph
from fiber_client import PlaneClient
from fiber_node import WaitError
from fiber_node.ros_environment import own_domain, use_loopback

__all__ = ["main", "measure"]

_NAMESPACES = ("north", "south")
_WAIT_S = 6.0


def measure(joins: int, domain: int) -> dict[str, float]:
    """Return the line of a number of joins of two clients each."""
    deaf, took_s = 0, []
    north, south = (
        Graph(bridge={"robots": 7}, domain=domain, args=["--ros-args", "-r", f"__ns:=/{name}"])
        for name in _NAMESPACES
    )
    with north, south:
        while not deaf and len(took_s) < joins:
            begin = time.monotonic()
            deaf = _deaf(domain)
            took_s.append(time.monotonic() - begin)
    heard_s = took_s[: len(took_s) - bool(deaf)] or [np.nan]
    return {
        "joins": len(took_s),
        "deaf": deaf,
        "median_s": round(float(np.median(heard_s)), 3),
        "most_s": round(max(heard_s), 3),
    }


def _deaf(domain: int) -> int:
    # how many of two clients hear nothing
    clients = [PlaneClient(domain, args=[], namespace=name) for name in _NAMESPACES]
    try:
        return sum(not _hears(client) for client in clients)
    finally:
        for client in clients:
            client.close()


def _hears(client: PlaneClient) -> bool:
    try:
        client.bridge_parameters(_WAIT_S)
    except WaitError:
        return False
    return True


def main(argv: list[str] | None = None) -> int:
    """Measure; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--joins", type=int, default=1000)
    options = parser.parse_args(argv)
    use_loopback()
    print(json.dumps(measure(options.joins, own_domain())))
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Explore the protocol: every fate of every message and every mishap, within a number of faults.

The steps of the real controller run with the firmware of the simulated robots; a rule that is
broken is printed with the faults that led to it. The result is a row of a table in markdown.
"""

import argparse
import sys
import time

from fiber_bus_bridge.simulation.model_check import Scenario, explore

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Run the command; return 1 when a rule is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--faults", type=int, default=1, help="largest number of faults")
    parser.add_argument("--buses", type=int, default=2)
    parser.add_argument("--robots", type=int, default=1, help="robots on each bus")
    parser.add_argument("--resumes", type=int, default=1, help="resumes allowed")
    parser.add_argument("--unprotected", action="store_true", help="robots need no heartbeat")
    parser.add_argument("--steps", type=int, help="end after so many steps")
    args = parser.parse_args(argv)
    scenario = Scenario(
        args.buses, args.robots, not args.unprotected, args.resumes, 0 if args.unprotected else 5
    )
    begin = time.process_time()
    search = explore(scenario, args.faults, args.steps)
    cpu_s = time.process_time() - begin
    print(
        "| buses x robots | faults | states | steps | ends | protocol states | stops apart ms "
        "| complete | cpu s |\n|---|---|---|---|---|---|---|---|---|"
    )
    ends = ", ".join(f"{number} {name}" for name, number in sorted(search.ends.items()))
    print(
        f"| {args.buses} x {args.robots}{', unprotected' if args.unprotected else ''} "
        f"| {args.faults} | {search.states} | {search.steps} | {ends} | {len(search.visited)} "
        f"| {1e3 * search.apart_s:.2f} | {'yes' if search.complete else 'no'} | {cpu_s:.0f} |"
    )
    print("\n".join(search.wrong))
    return 1 if search.wrong else 0


if __name__ == "__main__":
    sys.exit(main())

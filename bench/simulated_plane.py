#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Whether the simulated plane keeps up: processor time against the time that the motion lasts.

A DESI-like plane is loaded, verified, started and followed to its end by the session of the
bridge, on simulated buses and positioners, all on one thread, while what its counters do is noted;
then the recording is made. Prints one JSON line for each size; a factor of 1 is real time.
"""

import argparse
import json
import sys
import time

from fiber_core.presets import preset
from fiber_core.threads import threads
from fiber_positioners import Reconfiguration, make_orders, random_problem, run_on_simulated_buses

__all__ = ["main", "measure"]


def measure(robots: int) -> dict[str, float]:
    """Return the line of one size."""
    orders = make_orders(random_problem(preset("desi", robots), seed=0))
    with threads(1):
        begin = time.process_time()
        run = run_on_simulated_buses(orders, observe=True)
        moved_s = time.process_time() - begin
        _ = Reconfiguration(orders, run, seed=0).recording
        recorded_s = time.process_time() - begin - moved_s
    lasts_s = run.motion.makespan_s
    return {
        "robots": robots,
        "motion_s": round(lasts_s, 3),
        "moved_cpu_s": round(moved_s, 3),
        "recorded_cpu_s": round(recorded_s, 3),
        "factor": round((moved_s + recorded_s) / lasts_s, 2),
    }


def main(argv: list[str] | None = None) -> int:
    """Measure some sizes; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--robots", type=int, nargs="+", default=[5000, 30_000])
    options = parser.parse_args(argv)
    measure(60)  # compile
    for robots in options.robots:
        print(json.dumps(measure(robots)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

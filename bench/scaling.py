#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measure computing time and memory against the number of robots, and plot them.

Each size is planned, discretized and certified several times in a process of its own. Times are
medians of processor time; memory is the growth of the process with its first field, after a
plane of 100 robots that includes the compiled code. Writes scaling.md, scaling.jsonl and
scaling.png.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np

from fiber_core.clearance import certify
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_planner import DEFAULT_PLANNER
from fiber_positioners import make_orders, random_problem

_SIZES = (100, 300, 1000, 3000, 5000, 10_000, 30_000, 100_000)
_RESULTS = Path(__file__).parent / "results"
_STAGES = ("plan", "discretize", "certify")


def problem_of(robots: int, seed: int) -> Problem:
    """Return a random DESI-like problem."""
    return random_problem(preset("desi", robots), seed)


def measure(robots: int, planner_name: str, repeats: int) -> dict:
    """Plan, discretize and certify fields of one size; return medians of the stages."""

    def once(problem):
        orders = make_orders(problem, planner=planner_name)
        motion = orders.wire.decoded()
        begin = time.process_time()
        ok = certify(orders.plane, motion, orders.safety).ok
        seconds = {
            "plan": orders.cpu_seconds["plan_s"],
            "discretize": orders.cpu_seconds["discretize_s"],
            "certify": time.process_time() - begin,
        }
        reached = int((orders.discretization.reason == Reason.OK).sum()) if ok else 0
        return seconds, reached, motion.makespan_s / lower_bound_s(orders.start_problem)

    once(problem_of(100, 0))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    runs = [once(problem_of(robots, 0))]
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    runs += [once(problem_of(robots, seed)) for seed in range(1, repeats)]
    return {
        "robots": robots,
        "planner": planner_name,
        "fields": repeats,
        **{f"{stage}_s": round(median(run[0][stage] for run in runs), 4) for stage in _STAGES},
        "reached": sum(run[1] for run in runs),
        "asked": robots * repeats,
        "ratio_worst": round(max(run[2] for run in runs), 4),
        "memory_mb": round(grown / 1024, 1),
    }


def table(lines: list[dict]) -> str:
    """Return the results as a table in markdown."""
    heads = ["robots", "planner", "fields", "reached", "worst makespan / bound"]
    heads += [f"{stage} [s], [us a robot]" for stage in _STAGES] + ["memory [MB], [kB a robot]"]
    rows = [heads, ["---"] * len(heads)]
    for line in lines:
        n = line["robots"]
        row = [n, line["planner"], line["fields"], f"{line['reached']} of {line['asked']}"]
        row.append(line["ratio_worst"])
        for stage in _STAGES:
            seconds = line[f"{stage}_s"]
            row.append(f"{seconds:.3f}, {1e6 * seconds / n:.0f}")
        row.append(f"{line['memory_mb']:.0f}, {1024 * line['memory_mb'] / n:.0f}")
        rows.append(row)
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows) + "\n"


def draw(lines: list[dict], path: Path) -> None:
    """Plot time and memory against the number of robots, with a line of constant cost."""
    import matplotlib.pyplot as plt  # only here: planning needs no pictures

    robots = np.array([line["robots"] for line in lines])
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), constrained_layout=True)
    for stage, marker in zip(_STAGES, "osd"):
        left.loglog(robots, [line[f"{stage}_s"] for line in lines], marker + "-", label=stage)
    at = int(np.flatnonzero(robots >= 5000)[0]) if robots.max() >= 5000 else -1
    slope = lines[at]["plan_s"] / robots[at]
    left.loglog(robots, slope * robots, "k:", label="in proportion")
    left.set(xlabel="robots", ylabel="processor time [s]", title="DESI-like plane, one core")
    left.legend()
    right.loglog(robots[1:], [max(line["memory_mb"], 0.1) for line in lines[1:]], "o-")
    right.set(xlabel="robots", ylabel="memory [MB]", title="grown beyond 100 robots")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main(argv: list[str] | None = None) -> int:
    """Run the measurement from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", type=int, default=_SIZES)
    parser.add_argument("--planner", default=DEFAULT_PLANNER)
    parser.add_argument("--repeats", type=int, default=3, help="fields of each size")
    parser.add_argument("--out", type=Path, default=_RESULTS, help="folder of the results")
    parser.add_argument("--one", type=int, help="measure this size here, print its line")
    options = parser.parse_args(argv)
    if options.one:
        print(json.dumps(measure(options.one, options.planner, options.repeats)))
        return 0
    lines = []
    for size in options.sizes:
        command = [sys.executable, __file__, "--one", str(size), "--planner", options.planner]
        command += ["--repeats", str(options.repeats)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        lines.append(json.loads(done.stdout))
        print(done.stdout, end="", flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "scaling.jsonl").write_text("".join(json.dumps(x) + "\n" for x in lines))
    (options.out / "scaling.md").write_text(table(lines) + "\n![time and memory](scaling.png)\n")
    draw(lines, options.out / "scaling.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())

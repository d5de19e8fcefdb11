#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Plan fields of DESI-like robots with DESI's motors, and have their files judged.

python3 bench/listed.py --fields 20 --out bench/results/listed.md
python3 bench/listed.py --layout calibration.csv --motors-on 0.55
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from listed_checker import check_listed

from fiber_core import preset, random_problem
from fiber_core.drive.named import with_drive
from fiber_formats import read_layout
from fiber_positioners import reconfigure

COLUMNS = (
    "plane", "motors on at most", "field", "reached", "reachable at once", "makespan [s]",
    "lower bound [s]", "power bound [s]", "makespan / power bound", "most motors on",
    "broken rules", "contacts", "pairs nearer than the margin", "least gap [mm]", "certified",
    "bytes an order", "end error, most [um]", "plan + discretize, processor time [s]",
)  # fmt: skip
HEADER = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|"


def line_of(plane, seed: int) -> str:
    """Plan one field; return its line of the table."""
    problem = random_problem(plane, np.random.default_rng(seed))
    result = reconfigure(problem, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder, recording=False)
        files = Path(folder) / "problem.npz", Path(folder) / "plan.npz"
        verdict = check_listed(*files)
    report = result.report
    cells = (
        plane.name,
        f"{plane.drive.motors_on:.0%}",
        seed,
        f"{report['reached']} of {report['asked']}",
        report["reachable_at_once"],
        f"{verdict.makespan_s:.3f}",
        f"{report['lower_bound_s']:.3f}",
        f"{report['power_bound_s']:.3f}",
        f"{verdict.makespan_s / float(str(report['power_bound_s'])):.3f}",
        f"{verdict.peak:.1%}",
        verdict.violations,
        verdict.gaps.contacts,
        verdict.gaps.near,
        f"{verdict.gaps.least_mm:.4f}",
        report["certified"],
        f"{report['bytes_mean']:.1f}",
        f"{verdict.end_error_um:.2f}",
        f"{sum(result.orders.cpu_seconds.values()):.1f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> int:
    """Run the fields and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--layout", help="the robots, in place of the preset desi_petals")
    parser.add_argument("--robots", type=int, help="number of robots of the preset")
    parser.add_argument("--motors-on", type=float, nargs="+", default=[0.55, 1.0])
    parser.add_argument("--fields", type=int, default=20, help="fields of each row")
    parser.add_argument("--out", type=Path, help="write the table here")
    args = parser.parse_args()
    plane = read_layout(args.layout).plane if args.layout else preset("desi_petals", args.robots)
    small = with_drive(preset("desi_petals", 30), "desi", 0.55)
    reconfigure(random_problem(small, np.random.default_rng(0)))  # compiles the loops
    lines = [HEADER]
    print(HEADER)
    for share in args.motors_on:
        for seed in range(args.fields):
            lines.append(line_of(with_drive(plane, "desi", share), seed))
            print(lines[-1], flush=True)
            if args.out is not None:  # a long run that is ended leaves what it found
                args.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

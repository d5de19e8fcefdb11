#!/usr/bin/env python3
"""Run planners on planes and seeds and write one table: who arrives, how fast, how safe.

Every motion is judged as it is: its straight pieces, with nothing rounded, go through the
certificate. A small plan is made first, so that compilation is not counted; cpu_s is the
processor time of the planner, plan_s the time on the clock. Results are JSON lines and a
table in markdown.
"""

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from fiber_core.clearance import Safety, certify, neighbour_pairs
from fiber_core.fields import random_problem
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.report import lower_bound_s
from fiber_core.tables import read_layout
from fiber_planner import make_planner
from fiber_planner.direct import reachable, straight_pieces

__all__ = ["main", "run"]

_DATA = Path(os.environ.get("FIBER_DATA", Path(__file__).parents[2] / "shared" / "data"))

# name -> (preset or layout and obstacle files, robots, share disabled, phi radius [mm] or
# None for the preset's)
PLANES = {
    "desi": ("desi", None, 0.0, None),
    "pfs": ("pfs", None, 0.0, None),
    "desi_outlines": ("desi_outlines", None, 0.0, None),
    "desi_15": ("desi", None, 0.15, None),
    "desi_wide_15": ("desi", None, 0.15, 1.6),
    "desi_2021": (("desi_2021-06-25.csv", None), None, 0.0, None),
    "sdss_v": ("sdss_v", None, 0.0, None),
    "sdss_v_15": ("sdss_v", None, 0.15, None),
    "sdss_v_real": (("sdss_v_positioners.csv", "sdss_v_fiducials.csv"), None, 0.0, None),
    "sdss_v_4921": ("sdss_v", 4921, 0.0, None),
    "moons": ("moons", None, 0.0, 2.25),
    "moons_15": ("moons", None, 0.15, 2.25),
    "desi_100k": ("desi", 100_000, 0.0, None),
}


def problem_of(name: str, seed: int):
    """Return the random problem of a plane in PLANES for a seed."""
    source, robots, disabled, radius = PLANES[name]
    if isinstance(source, str):
        plane = preset(source, robots)
    else:
        plane = read_layout(_DATA / source[0], obstacles=source[1] and _DATA / source[1])
    if radius is not None:
        plane = replace(plane, phi_radius=np.full(plane.n, radius))
    rng = np.random.default_rng(seed)
    if disabled:
        plane = plane.with_enabled(plane.enabled & (rng.random(plane.n) >= disabled))
    return random_problem(plane, rng)


def run(name: str, planner, seed: int) -> dict:
    """Plan one problem and return its row of the table.

    Args:
        name: one of PLANES.
        planner: a planner.
        seed: of the problem.
    """
    problem = problem_of(name, seed)
    begin, begin_cpu = time.perf_counter(), time.process_time()
    planned = planner.plan(problem)
    plan_s, cpu_s = time.perf_counter() - begin, time.process_time() - begin_cpu
    motion = straight_pieces(planned.motion)
    begin = time.perf_counter()
    certificate = certify(problem.plane, motion, Safety())
    certify_s = time.perf_counter() - begin
    can = reachable(problem, neighbour_pairs(problem.plane), Safety().margin_mm)
    bound = lower_bound_s(problem)
    segments = motion.counts[motion.counts > 0]
    return {
        "plane": name,
        "planner": planner.name,
        "seed": seed,
        "robots": problem.plane.n,
        "enabled": int(problem.plane.enabled.sum()),
        "reachable": int(can.sum()),
        "reached": int((planned.reason == Reason.OK).sum()),
        "makespan_s": round(motion.makespan_s, 4),
        "lower_bound_s": round(bound, 4),
        "ratio": round(motion.makespan_s / bound, 4) if bound else None,
        "plan_s": round(plan_s, 3),
        "cpu_s": round(cpu_s, 3),
        "certify_s": round(certify_s, 3),
        "certified": bool(certificate.ok),
        "min_gap_mm": round(certificate.min_gap_mm, 4),
        "segments_mean": round(float(segments.mean()), 3) if len(segments) else 0.0,
        "segments_max": int(segments.max(initial=0)),
    }


def markdown(rows: list[dict]) -> str:
    """Return the rows as a table in markdown."""
    columns = list(rows[0])
    lines = [columns, ["---"] * len(columns)] + [[str(row[c]) for c in columns] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def main(argv=None) -> int:
    """Run the table from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--planes", nargs="+", default=["desi", "pfs"], choices=list(PLANES))
    parser.add_argument("--planners", nargs="+", default=["direct"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None, help="folder for the two tables")
    options = parser.parse_args(argv)
    rows = []
    for planner_name in options.planners:
        planner = make_planner(planner_name)
        for small in (preset("pfs", 60), preset("sdss_v", 37)):  # compile
            planner.plan(random_problem(small, np.random.default_rng(0)))
        for name in options.planes:
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                rows.append(run(name, planner, seed))
                print(json.dumps(rows[-1]), flush=True)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        text = "".join(json.dumps(row) + "\n" for row in rows)
        (options.out / "planners.jsonl").write_text(text)
        (options.out / "planners.md").write_text(markdown(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())

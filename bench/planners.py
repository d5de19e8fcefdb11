#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Run planners on many planes and seeds, down to the bytes: arrivals, makespan, clearance.

Every plan is discretized and rounded as it would be sent, and the motion decoded from that is
certified. A small plan is made first, so that compilation is not counted; cpu_s is
processor time, wall_s the elapsed time. One JSON line for each run is appended to the
results, and a table in markdown is made of all lines there.
"""

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from statistics import median

import numpy as np

from fiber_core.clearance import certify
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_formats import read_layout, read_targets
from fiber_planner import Planner, make_planner, pair_bound
from fiber_positioners import make_orders, random_problem

__all__ = ["main", "problem_of", "run", "run_problem"]

_DATA = Path(os.environ.get("FIBER_DATA", Path(__file__).parents[2] / "shared" / "data"))
_RESULTS = Path(__file__).parent / "results"

# name -> (preset, or files of layout and obstacles and the preset of their outlines; robots, share
# disabled, phi radius [mm] or None for the preset's)
PLANES = {
    "desi": ("desi", None, 0.0, None),
    "desi_outlines": ("desi_outlines", None, 0.0, None),
    "pfs": ("pfs", None, 0.0, None),
    "desi_2021": (("desi_2021-06-25.csv", None, None), None, 0.0, None),
    "desi_15": ("desi", None, 0.15, None),
    "desi_wide_15": ("desi", None, 0.15, 1.6),
    "sdss_v": ("sdss_v", None, 0.0, None),
    "sdss_v_real": (("sdss_v_positioners.csv", "sdss_v_fiducials.csv", None), None, 0.0, None),
    "sdss_v_4921": ("sdss_v", 4921, 0.0, None),
    "moons": ("moons", None, 0.0, 2.25),
    "sdss_v_15": ("sdss_v", None, 0.15, None),
    "moons_15": ("moons", None, 0.15, 2.25),
    "desi_100k": ("desi", 100_000, 0.0, None),
    "desi_2026": (("desi/desi2026_layout_ours.csv", None, "desi_outlines"), None, 0.0, None),
}
_MOONS_START = np.deg2rad([0.0, -180.0])
_MOONS_RADIUS_MM = 2.0


def problem_of(name: str, seed: int) -> Problem:
    """Return the random problem of a plane in PLANES for a seed.

    "moons_real" is a real assignment of MOONS with the number `seed`, from folded arms.
    """
    if name == "moons_real":
        return _moons_assignment(seed)
    source, robots, disabled, radius = PLANES[name]
    if isinstance(source, str):
        plane = preset(source, robots)
    else:
        layout, obstacles, outlines = source
        obstacles = obstacles and _DATA / obstacles
        plane = read_layout(_DATA / layout, outlines, obstacles=obstacles).plane
    if radius is not None:
        plane = replace(plane, phi_radius=np.full(plane.n, radius))
    rng = np.random.default_rng(seed)
    if disabled:
        plane = plane.with_enabled(plane.enabled & (rng.random(plane.n) >= disabled))
    return random_problem(plane, rng)


def _moons_assignment(number: int) -> Problem:
    path = _DATA / "moons" / f"assignment_{number}.txt"
    plane, found = read_layout(path).plane, read_targets(path)
    plane = replace(plane, phi_radius=np.full(plane.n, _MOONS_RADIUS_MM))
    targets = np.full((plane.n, 2), np.nan)
    targets[found.ids] = found.xy_mm
    return Problem(plane, np.tile(_MOONS_START, (plane.n, 1)), targets)


def run(name: str, planner: Planner, seed: int) -> dict:
    """Plan and discretize one problem and return its line of the results.

    Args:
        name: one of PLANES.
        planner: a planner.
        seed: of the problem.
    """
    return run_problem(name, problem_of(name, seed), planner, seed)


def run_problem(name: str, given: Problem, planner: Planner, seed: int) -> dict:
    """Plan and discretize a problem and return its line of the results, see `run`."""
    orders = make_orders(given, planner=planner)
    problem, plane, safety = orders.start_problem, orders.plane, orders.safety
    planned, sent, motion = orders.planned, orders.discretization, orders.wire.decoded()
    begin_cpu = time.process_time()
    certificate = certify(plane, motion, safety)
    certify_s = time.process_time() - begin_cpu
    bound, pairs = lower_bound_s(problem), pair_bound(problem, safety.margin_mm)
    segments = motion.counts[motion.counts > 0]
    return {
        "plane": name,
        "planner": planner.name,
        "seed": seed,
        "robots": plane.n,
        "enabled": int(plane.enabled.sum()),
        "reachable": pairs.robots,
        "planned": int((planned.reason == Reason.OK).sum()),
        "reached": int(((planned.reason == Reason.OK) & (sent.reason == Reason.OK)).sum()),
        "makespan_s": round(motion.makespan_s, 4),
        "lower_bound_s": round(bound, 4),
        "ratio": round(motion.makespan_s / bound, 4),
        "pair_bound_s": round(pairs.time_s, 4),
        "pair_bound_proven": pairs.proven,
        "pair_ratio": round(motion.makespan_s / pairs.time_s, 4),
        "wall_s": round(orders.seconds["plan_s"], 3),
        "cpu_s": round(orders.cpu_seconds["plan_s"], 3),
        "discretize_s": round(orders.cpu_seconds["discretize_s"], 3),
        "certify_s": round(certify_s, 3),
        "certified": bool(certificate.ok),
        "min_gap_mm": round(certificate.min_gap_mm, 4),
        "segments_mean": round(float(segments.mean()), 3) if len(segments) else 0.0,
        "segments_max": int(segments.max(initial=0)),
    }


def markdown(lines: list[dict]) -> str:
    """Return the table of all results: one row for each plane and planner."""
    columns = (
        "plane | planner | robots | seeds | reached of reachable, worst seed | all seeds | "
        "certified | makespan / lower bound, median and worst | / pair bound | "
        "planning cpu [s], median and worst | discretizing cpu [s] | least clearance [mm] | "
        "segments a moving motor, mean and most"
    )
    rows = [columns, " | ".join("---" for _ in columns.split(" | "))]
    order = list(PLANES)
    lines = [line for line in lines if "pair_ratio" in line]  # others are of an older version
    lines = sorted(lines, key=lambda line: (order.index(line["plane"]), line["planner"]))
    for (plane, planner), group in groupby(lines, lambda line: (line["plane"], line["planner"])):
        group = list(group)
        of = {key: [line[key] for line in group] for key in group[0]}
        share = [reached / can for reached, can in zip(of["reached"], of["reachable"])]
        robots, enabled = of["robots"][0], sorted({min(of["enabled"]), max(of["enabled"])})
        working = "" if enabled == [robots] else f", {'-'.join(map(str, enabled))} working"
        rows.append(
            f"{plane} | {planner} | "
            f"{robots}{working} | "
            f"{len(group)} | {100 * min(share):.2f} % | "
            f"{100 * sum(of['reached']) / sum(of['reachable']):.3f} % | "
            f"{sum(of['certified'])} of {len(group)} | "
            f"{median(of['ratio']):.3f}, {max(of['ratio']):.3f} | "
            f"{median(of['pair_ratio']):.3f}, {max(of['pair_ratio']):.3f} | "
            f"{median(of['cpu_s']):.2f}, {max(of['cpu_s']):.2f} | "
            f"{median(of['discretize_s']):.2f} | {min(of['min_gap_mm']):.3f} | "
            f"{np.mean(of['segments_mean']):.2f}, {max(of['segments_max'])}"
        )
    return "\n".join(f"| {row} |" for row in rows) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Run the campaign from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--planes", nargs="+", default=list(PLANES), choices=list(PLANES))
    parser.add_argument("--planners", nargs="+", default=["direct"])
    parser.add_argument("--seeds", type=int, default=20, help="fields of each plane")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--out", type=Path, default=_RESULTS, help="folder of the results")
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "planners.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for planner_name in options.planners:
        planner = make_planner(planner_name)
        for small in (preset("pfs", 60), preset("sdss_v", 37)):  # compile
            make_orders(random_problem(small, seed=0), planner=planner)
        for name in options.planes:
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                line = run(name, planner, seed)
                print(json.dumps(line), flush=True)
                key = [line[each] for each in ("plane", "planner", "seed")]
                lines = [x for x in lines if [x["plane"], x["planner"], x["seed"]] != key] + [line]
                path.write_text("".join(json.dumps(each) + "\n" for each in lines))
    (options.out / "planners.md").write_text(markdown(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())

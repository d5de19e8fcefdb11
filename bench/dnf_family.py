#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compare the navigation function as printed, corrected and with priorities, and `direct`.

One row for each variant and plane, over some random fields: robots that arrive and when,
makespan, least distances of tips and arms. The claims of the papers come first, marked.
Motions are evaluated as planned, sampled at every time step and between; the arrival of a
robot is the instant from which it stays within 0.1 mm of its target. Results are JSON
lines, one for each field, and a table in markdown.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

from fiber_core.clearance import neighbour_pairs, sampled_gaps
from fiber_core.fields import random_problem
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_planner import PlannedMotion, make_planner

__all__ = ["PLANES", "VARIANTS", "judged", "main", "run"]

_RESULTS = Path(__file__).parent / "results"
_ARRIVED_MM = 0.1
_SAMPLES = 5  # at least, in each step of 10 ms
_SAMPLE_S = 0.002
_CHUNK = 100  # instants at a time

# name -> (planner, parameters)
VARIANTS = {
    "as printed": ("dnf", dict(sign="printed", attraction="tip", adaptive=False)),
    "sign corrected": ("dnf", dict(attraction="tip", adaptive=False)),
    "dnf": ("dnf", {}),
    "dnf_arms": ("dnf_arms", {}),
    "dnf_priority, not rehearsed": ("dnf_priority", dict(rehearsals=0)),
    "dnf_arms_priority, not rehearsed": ("dnf_arms_priority", dict(rehearsals=0)),
    "dnf_priority": ("dnf_priority", {}),
    "dnf_arms_priority": ("dnf_arms_priority", {}),
    "direct": ("direct", {}),
}

# name -> (preset, robots or None for all, share disabled, fields)
PLANES = {
    "paper 547": ("paper", 547, 0.0, 10),
    "paper 5167": ("paper", None, 0.0, 3),
    "desi 5000": ("desi", None, 0.0, 3),
    "pfs 2394": ("pfs", None, 0.0, 5),
    "desi 5000, 15 % disabled": ("desi", None, 0.15, 3),
}

# variant, plane, fields, reached, 50 / 90 / 99 %, last, ratio, tip distance, pairs, compute
_CLAIMS = [
    ("**claimed**: DNF (A&A 566 A84)", "7 to 5167 robots", "4100 runs", "100 %", "-",
     "2.65-2.7 from 1000 robots on; 2.5 in the abstract", "-", "no collision",
     "not in the model", "140 (5000 robots)"),
    ("**claimed**: DNF on MOONS (Tao et al. 2018)", "1006 robots", "9", "72.0 %",
     "-", "horizon 52.5", "-", "-", "-", "119"),
    ("**claimed**: the same and priorities (Tao et al. 2018)", "1006 robots", "9",
     "88.6 %", "-", "horizon 52.5", "-", "-", "-", "386"),
]  # fmt: skip
_HEAD = [
    "variant", "plane", "fields", "reached", "50 / 90 / 99 % there [s]", "last there [s]",
    "makespan / bound", "least tip distance [mm]", "arm pairs that overlap", "compute [s]",
]  # fmt: skip

_NOTES = """# The navigation function, with priorities, and the direct planner

Random valid fields of fiber_core.fields; medians over the fields, ranges if they differ.
Reached: within 0.1 mm at the end; "-": fewer arrive. The lower bound is the time of the slowest
robot alone, at full speed; the horizon of the navigation function is three times that.

A tip distance below 2 mm is a collision of tips. *Arm pairs* are neighbours with outlines that
overlap at some sampled instant, one every 5 ms or more: a violation by planners that keep whole
arms apart; after a planner that keeps only tips apart, the discretizer must hold those robots. The
law as printed has no joint stops: the paper's plane has four turns in each direction instead, the
other planes have stops. Claims are the papers' own, on their own fields. *Not rehearsed* is
`rehearsals=0`: no robot knows more than its neighbours' state. Compute is processor time,
measured on: {machine}.

"""


def problem_of(name: str, seed: int) -> Problem:
    """Return the random problem of a plane in PLANES for a seed."""
    source, robots, disabled, _ = PLANES[name]
    rng, plane = np.random.default_rng(seed), preset(source, robots)
    if disabled:
        plane = plane.with_enabled(rng.random(plane.n) >= disabled)
    return random_problem(plane, rng)


def judged(problem: Problem, planned: PlannedMotion) -> dict:
    """Return the figures of a planned motion: arrivals, distances, overlaps.

    Args:
        problem: the problem that was planned.
        planned: the plan.
    """
    plane, motion = problem.plane, planned.motion
    time_s, angles = motion.time_s, motion.angles
    # samples in each interval of the motion
    sub = max(1, int(np.ceil(motion.makespan_s / max(1, len(time_s) - 1) / _SAMPLE_S)))
    sub = max(sub, _SAMPLES)
    pairs = neighbour_pairs(plane)
    near = pairs[pairs[:, 1] < plane.n]
    overlap = np.zeros(len(pairs), dtype=bool)
    least, last_away = np.inf, np.full(plane.n, -1.0)
    for k in range(0, len(time_s) - 1, max(1, _CHUNK // sub)):
        stop = min(k + max(1, _CHUNK // sub), len(time_s) - 1)
        at = np.interp(np.arange((stop - k) * sub + 1) / sub + k, range(len(time_s)), time_s)
        path = _between(time_s, angles, at)
        tips = _tips(plane, path)
        apart = np.linalg.norm(tips[:, near[:, 0]] - tips[:, near[:, 1]], axis=0)
        least = min(least, apart.min(initial=np.inf))
        overlap |= (sampled_gaps(plane, pairs, path[..., :: max(1, sub // 2)]) < 0.0).any(axis=1)
        away = np.linalg.norm(tips - problem.targets.T[..., None], axis=0) > _ARRIVED_MM
        last_away = np.maximum(last_away, np.where(away, at, -1.0).max(axis=1))
    asked = problem.asked
    reached = (planned.reason == Reason.OK) & asked
    there = np.sort(np.where(reached, np.maximum(last_away, 0.0), np.inf)[asked])
    bound = lower_bound_s(problem)

    def by(part):
        moment = there[int(np.ceil(part * len(there))) - 1]
        return round(float(moment), 3) if np.isfinite(moment) else None

    return {
        "robots": int(asked.sum()),
        "reached": int(reached.sum()),
        "t50_s": by(0.5),
        "t90_s": by(0.9),
        "t99_s": by(0.99),
        "last_s": round(float(there[np.isfinite(there)].max(initial=0.0)), 3),
        "makespan_s": round(motion.makespan_s, 3),
        "lower_bound_s": round(bound, 3),
        "ratio": round(motion.makespan_s / bound, 3),
        "least_tip_mm": round(float(least), 3),
        "pairs": len(pairs),
        "overlapping_pairs": int(overlap.sum()),
    }


def _between(time_s, angles, at):
    # angles (n, 2, len(at)) on the straight lines between the samples
    after = np.clip(np.searchsorted(time_s, at), 1, len(time_s) - 1)
    part = (at - time_s[after - 1]) / (time_s[after] - time_s[after - 1])
    return angles[..., after - 1] + part * (angles[..., after] - angles[..., after - 1])


def _tips(plane, angles):
    # places of the tips (2, n, t) at angles (n, 2, t)
    theta, both = angles[:, 0], angles[:, 0] + angles[:, 1]
    arm1, arm2 = plane.arms.T[..., None]
    along = np.stack([np.cos(theta), np.sin(theta)]), np.stack([np.cos(both), np.sin(both)])
    return plane.centers.T[..., None] + arm1 * along[0] + arm2 * along[1]


def run(variant: str, plane: str, seed: int) -> dict:
    """Plan one field with one variant and return its row.

    Args:
        variant: one of VARIANTS.
        plane: one of PLANES.
        seed: of the field.
    """
    name, parameters = VARIANTS[variant]
    problem = problem_of(plane, seed)
    planner = make_planner(name, **parameters)
    begin, begin_cpu = time.perf_counter(), time.process_time()
    planned = planner.plan(problem)
    plan_s, cpu_s = time.perf_counter() - begin, time.process_time() - begin_cpu
    return {
        "variant": variant,
        "plane": plane,
        "seed": seed,
        **judged(problem, planned),
        "cpu_s": round(cpu_s, 3),
        "plan_s": round(plan_s, 3),
    }


def markdown(rows: list[dict], machine: str) -> str:
    """Return the table: claims first, then one line for each variant and plane."""
    groups = {}
    for row in rows:
        groups.setdefault((row["plane"], row["variant"]), []).append(row)
    lines = [_HEAD, ["---"] * len(_HEAD), *_CLAIMS]
    for (plane, variant), group in groups.items():
        lines.append([variant, plane, str(len(group)), *_summary(group)])
    table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return _NOTES.format(machine=machine) + table + "\n"


def _summary(group):
    def column(key):
        return np.array([np.nan if row[key] is None else row[key] for row in group], dtype=float)

    part = 100.0 * column("reached") / column("robots")
    missing = int((column("robots") - column("reached")).sum())
    reached = "100 %" if missing == 0 else _range(part, "{:.2f}") + f" % ({missing} late in all)"
    times = (np.median(column(key)) for key in ("t50_s", "t90_s", "t99_s"))
    return [
        reached,
        " / ".join("-" if np.isnan(t) else f"{t:.2f}" for t in times),
        _range(column("last_s"), "{:.2f}"),
        _range(column("ratio"), "{:.2f}"),
        f"{column('least_tip_mm').min():.3f}",
        _range(column("overlapping_pairs"), "{:.0f}") + f" of {group[0]['pairs']}",
        f"{np.median(column('cpu_s')):.2f}",
    ]


def _range(values, form):
    low, high = form.format(values.min()), form.format(values.max())
    return low if low == high else f"{low}-{high}"


def main(argv: list[str] | None = None) -> int:
    """Run the comparison from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--planes", nargs="+", default=list(PLANES), choices=list(PLANES))
    parser.add_argument("--seeds", type=int, help="fields of each plane, by default 3 to 10")
    parser.add_argument("--machine", default="2 cores, shared", help="machine, for the table")
    parser.add_argument("--out", type=Path, default=_RESULTS, help="folder for the two tables")
    options = parser.parse_args(argv)
    small = random_problem(preset("pfs", 60), np.random.default_rng(0))
    rows = []
    for plane in options.planes:
        for variant in options.variants:
            name, parameters = VARIANTS[variant]
            make_planner(name, **parameters).plan(small)  # compile
            for seed in range(options.seeds or PLANES[plane][3]):
                rows.append(run(variant, plane, seed))
                print(json.dumps(rows[-1]), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    text = "".join(json.dumps(row) + "\n" for row in rows)
    (options.out / "dnf_family.jsonl").write_text(text)
    (options.out / "dnf_family.md").write_text(markdown(rows, options.machine))
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Planes beside their goals: arrivals, makespan, processor time and segments of many fields.

Fields are planned to the bytes and certified as in `planners.py`, two at a time. One JSON line for
each field is appended to the results as soon as it is there; a run that was cut off goes on from
there. A table in markdown is made of all lines, with the goal of each figure, marked where missed.
A goal for a makespan is one over the pair bound where that is above the time of the slowest
robot alone: no certified motion is shorter.
"""

import argparse
import json
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from planners import problem_of, run_problem

from fiber_core.presets import preset
from fiber_planner import make_planner
from fiber_positioners import make_orders, random_problem

__all__ = ["ROWS", "main", "markdown"]

_RESULTS = Path(__file__).parent / "results"
_DOCS = Path(__file__).parents[1] / "docs" / "direct.md"
_BEGIN, _END = "<!-- begin: bench/goals.py -->\n", "<!-- end: bench/goals.py -->"
_FIRST_SEED = 1800  # no test and no other bench has these seeds


@dataclass(frozen=True)
class Row:
    """A plane with its goals, and how many of its fields are run.

    Args:
        fields: fields that are run by default.
        cost_s: processor time of a field, about [s]: the longest are run first.
        reached: goal of the share of the robots that can arrive, in every field.
        ratio: goals of makespan over bound, median and worst.
        cpu_s: goal of the processor time of planning and discretizing, worst [s].
        segments: goal of the segments of a moving motor, mean of all fields; None without.
    """

    fields: int
    cost_s: float
    reached: float
    ratio: tuple[float, float]
    cpu_s: float
    segments: float | None


ROWS = {
    "desi": Row(20, 1, 1.0, (1.005, 1.01), 0.8, 1.05),
    "pfs": Row(20, 1, 1.0, (1.005, 1.01), 0.8, 1.05),
    "desi_outlines": Row(20, 5, 1.0, (1.005, 1.05), 4.0, 1.10),
    "desi_2026": Row(20, 6, 0.998, (1.05, 1.12), 5.0, 1.10),
    "sdss_v": Row(20, 15, 1.0, (1.03, 1.10), 20.0, 1.5),
    "sdss_v_4921": Row(20, 120, 1.0, (1.08, 1.15), 90.0, 1.5),
    "moons": Row(20, 40, 1.0, (1.15, 1.25), 40.0, 1.6),
    "moons_real": Row(3, 50, 1.0, (1.3, 1.3), 60.0, 1.6),
    "sdss_v_15": Row(20, 25, 0.99, (1.2, 1.35), 60.0, None),
    "moons_15": Row(20, 40, 0.99, (1.2, 1.35), 60.0, None),
    "desi_100k": Row(20, 20, 1.0, (1.006, 1.012), 6.0, 1.05),
}


def _warm_up() -> None:
    # so that compilation is not counted
    planner = make_planner("direct")
    for small in (preset("pfs", 60), preset("sdss_v", 37)):
        make_orders(random_problem(small, seed=0), planner=planner)


def _field(plane: str, seed: int) -> dict:
    number = seed - _FIRST_SEED + 1 if plane == "moons_real" else seed
    return run_problem(plane, problem_of(plane, number), make_planner("direct"), seed)


def judged(plane: str, lines: list[dict]) -> dict[str, tuple[str, str, bool]]:
    """Return figure, goal and whether it is met, of each column of a plane's row."""
    row, of = ROWS[plane], {key: [line[key] for line in lines] for key in lines[0]}
    share = [reached / can for reached, can in zip(of["reached"], of["reachable"])]
    ratios = of["ratio"] if plane != "moons_real" else of["pair_ratio"]
    seconds = [plan + rest for plan, rest in zip(of["cpu_s"], of["discretize_s"])]
    middle, worst = median(ratios), max(ratios)
    segments = sum(of["segments_mean"]) / len(lines)
    least = 100 * min(share)
    figures = {
        "reached of reachable, worst field": (
            f"{least:.2f} %", f"{100 * row.reached:g} %", min(share) >= row.reached,
        ),
        "makespan / bound, median": (f"{middle:.3f}", f"{row.ratio[0]}", middle <= row.ratio[0]),
        "worst": (f"{worst:.3f}", f"{row.ratio[1]}", worst <= row.ratio[1]),
        "plan + discretize, processor time, worst [s]": (
            f"{max(seconds):.2f}", f"{row.cpu_s:g}", max(seconds) <= row.cpu_s,
        ),
    }  # fmt: skip
    goal = row.segments
    figures["segments a moving motor, mean"] = (
        f"{segments:.3f}", "-" if goal is None else f"{goal}", goal is None or segments <= goal,
    )  # fmt: skip
    return figures


def markdown(lines: list[dict]) -> str:
    """Return the table of all lines: one row for each plane, the goal of each figure behind it."""
    rows, heads = [], []
    for plane in ROWS:
        fields = [line for line in lines if line["plane"] == plane]
        if not fields:
            continue
        figures = judged(plane, fields)
        heads = list(figures)
        cells = [
            f"{figure} ({goal}){'' if met else ' **missed**'}"
            for figure, goal, met in figures.values()
        ]
        pair_bounds = [line["pair_bound_s"] / line["lower_bound_s"] for line in fields]
        proven = all(line["pair_bound_proven"] for line in fields)
        rows.append(
            [plane, str(fields[0]["robots"]), str(len(fields))]
            + cells
            + [f"{max(pair_bounds):.3f}{'' if proven else ', not all proven'}"]
            + [f"{sum(line['certified'] for line in fields)} of {len(fields)}"]
        )
    table = [["plane", "robots", "fields", *heads, "pair bound / bound, most", "certified"]]
    table += [["---"] * len(table[0]), *rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in table) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Run the fields that are not there yet; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--planes", nargs="+", default=list(ROWS), choices=list(ROWS))
    parser.add_argument("--fields", type=int, help="of each plane, at most as many as in ROWS")
    parser.add_argument("--jobs", type=int, default=2, help="fields at the same time")
    parser.add_argument("--anew", action="store_true", help="run also fields that are there")
    parser.add_argument("--out", type=Path, default=_RESULTS, help="folder of the results")
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "goals.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if options.anew:
        lines = [line for line in lines if line["plane"] not in options.planes]
    for plane in options.planes:
        if (options.fields or 0) > ROWS[plane].fields:
            print(f"{plane}: {ROWS[plane].fields} fields and no more", file=sys.stderr)
    there = {(line["plane"], line["seed"]) for line in lines}
    tasks = [
        (plane, _FIRST_SEED + number)
        for plane in sorted(options.planes, key=lambda plane: -ROWS[plane].cost_s)
        for number in range(min(options.fields or ROWS[plane].fields, ROWS[plane].fields))
    ]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.jobs, context, _warm_up) as pool:
        futures = [pool.submit(_field, *task) for task in tasks if task not in there]
        for future in as_completed(futures):
            lines.append(future.result())
            print(json.dumps(lines[-1]), flush=True)
            order = list(ROWS)
            lines.sort(key=lambda line: (order.index(line["plane"]), line["seed"]))
            path.write_text("".join(json.dumps(each) + "\n" for each in lines))
    (options.out / "goals.md").write_text(markdown(lines))
    if options.out == _RESULTS:
        _write_between_marks(_DOCS, markdown(lines))
    return 0


def _write_between_marks(path: Path, table: str) -> None:
    # the part of a document that comes from here
    before, _, rest = path.read_text().partition(_BEGIN)
    path.write_text(f"{before}{_BEGIN}{table}{_END}{rest.partition(_END)[2]}")


if __name__ == "__main__":
    sys.exit(main())

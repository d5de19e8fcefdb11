#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Plans on planes with walls, fibres and gears, checked apart from the certificate.

Each field is planned, discretized, sent over simulated buses and carried out, then judged twice: by
the certificate, and by judges that read the files alone (gap_judge, motor_judge). Pairs that start
too close are counted apart: no order can part bodies that may not be moved, and of others one may
leave if it comes no nearer. A field is planned again without walls, for the cost. Each field is one
line of JSON, written when it is done, and a table in markdown is made of all lines. Fields that
have a line are left out, so a run that was ended goes on where it was; --again runs them again.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from gap_judge import judge_gaps
from motor_judge import judge_ends

from fiber_core.clearance import neighbour_pairs
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import PRESETS, preset
from fiber_core.problem import Problem
from fiber_formats import problem_from, read_layout
from fiber_planner import pair_bound
from fiber_planner.direct.reachability import reachable
from fiber_positioners import Orders, make_orders, random_problem, reconfigure

__all__ = ["main", "run"]

_DATA = Path(os.environ.get("FIBER_DATA", Path(__file__).parents[2] / "shared" / "data"))
_RESULTS = Path(__file__).parent / "results"
_SMALL = 40  # robots of the plan that is made first, so that compilation is not counted


def _of_files(*names: str) -> Callable[[int], Problem]:
    return lambda seed: random_problem(read_layout([_DATA / name for name in names]).plane, seed)


def _of_preset(name: str) -> Callable[[int], Problem]:
    return lambda seed: random_problem(preset(name), seed)


def _desi_tile(seed: int) -> Problem:
    found = problem_from(
        layout=_DATA / "desi/fp-20260219.ecsv",
        starts=_DATA / "desi/fp-20260219.ecsv",
        targets=_DATA / "cases/desi_tile0.csv",
        seed=seed,
    )
    return found.problem


# what each row should reach, beside no contact and no joint or motor over a limit
GOALS = {
    "desi_2026": "99.5 % of reachable, 6 s, 1.2 by that without walls",
    "desi_tile": "all that a static check allows",
    "sdss_v_apo": "100 % of reachable, 1 um, 1.2 by that without walls",
    "desi_petals": "99.5 % of reachable, 6 s, 1.2 by that without walls",
    "spec_s5": "99.9 %, makespan 1.1, 5 s, 1.2 by that without walls",
    "must": "100 %",
    "wst_mixed": "100 %, makespan 1.2",
}
PLANES: dict[str, Callable[[int], Problem]] = {
    "desi_2026": _of_files("desi/calib-20260303.csv"),
    "desi_tile": _desi_tile,
    "sdss_v_apo": _of_files(
        *(
            f"sdss_v/apo_{k}.csv"
            for k in ("positionerTable", "wokCoords", "fiducialCoords", "gfaCoords")
        )
    ),
    **{
        name: _of_preset(name)
        for name in ("desi_petals", "spec_s5", "must", "wst_mixed")
        if name in PRESETS
    },
}


def run(name: str, seed: int, bare: bool) -> dict[str, object]:
    """Plan a field of one of PLANES, carry it out, have its files judged; return its line.

    Args:
        name: one of PLANES.
        seed: of the field.
        bare: whether it is planned without walls, too.
    """
    problem = PLANES[name](seed)
    result = reconfigure(problem, seed=seed)
    orders, report, plane = result.orders, result.report, result.plane
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder, recording=False)
        saved, plan = (dict(np.load(Path(folder) / f"{of}.npz")) for of in ("problem", "plan"))
    gaps, ends = judge_gaps(saved, plan, orders.safety.margin_mm), judge_ends(saved, plan)
    bound = pair_bound(orders.start_problem, orders.safety.margin_mm)
    can = reachable(orders.start_problem, neighbour_pairs(plane), orders.safety.margin_mm)
    line: dict[str, object] = {
        "plane": name,
        "seed": seed,
        "robots": plane.n,
        "enabled": int(plane.enabled.sum()),
        "walls": len(plane.walls),
        "fibres": len(plane.fibre_names),
        "asked": int(problem.asked.sum()),
        "reachable": int(can.sum()),
        "clear_ends": bound.robots,
        "clear_ends_proven": bound.proven,
        "reached": int(((result.reason == Reason.OK) & problem.asked).sum()),
        "certified": bool(report["certified"]),
        "left": _left(plane.ids, result.reason, can),
        "judged_contacts": gaps.contacts - gaps.leaving_contacts,
        "judged_near": gaps.near - gaps.resting - gaps.leaving,
        "close_at_rest": gaps.resting,
        "leaving": gaps.leaving,
        "leaving_nearer_mm": round(gaps.nearer_mm, 5),
        "wall_contacts": gaps.wall_contacts,
        "least_to_walls_mm": _rounded(gaps.wall_mm),
        "least_between_arms_mm": _rounded(gaps.arm_mm),
        "joints_broken": ends.joints,
        "motors_broken": ends.motors,
        "fastest_motor": round(ends.fastest_motor, 5) if plane.coupling.shape[1] else None,
        "error_um": round(ends.error_um, 3),
        "makespan_s": round(result.motion.makespan_s, 4),
        "lower_bound_s": round(lower_bound_s(orders.start_problem), 4),
        "ratio": round(result.motion.makespan_s / lower_bound_s(orders.start_problem), 4),
        "plan_s": round(orders.cpu_seconds["plan_s"], 3),
        "discretize_s": round(orders.cpu_seconds["discretize_s"], 3),
        "cpu_s": _cpu_s(orders),
    }
    if bare and len(plane.walls):
        without = replace(problem, plane=replace(problem.plane, walls=None))
        line["cpu_without_walls_s"] = _cpu_s(make_orders(without))
    return line


def _cpu_s(orders: Orders) -> float:
    return round(sum(orders.cpu_seconds.values()), 3)


def _left(ids: np.ndarray, reason: np.ndarray, can: np.ndarray) -> dict[str, list[int]]:
    # the robots that could reach their targets alone and do not, by the reason
    left = can & (reason != Reason.OK)
    return {
        Reason(code).name: ids[left & (reason == code)].tolist() for code in np.unique(reason[left])
    }


def _rounded(gap_mm: float) -> float | None:
    return round(gap_mm, 4) if np.isfinite(gap_mm) else None


# --- the table


_COLUMNS = (
    "plane", "robots in use", "walls", "fields", "reached of reachable, worst field", "all fields",
    "of those with ends clear of each other", "certified",
    "judged: contacts, nearer than the margin", "pairs that start too close: at rest, one leaves",
    "wall contacts", "least gap to a wall, between arms [mm]",
    "joints, motors over a limit", "fastest motor by its limit", "end error, most [um]",
    "makespan / lower bound, median and worst",
    "plan + discretize, processor time [s], median, worst",
    "by that without walls, median, worst", "goal",
)  # fmt: skip


def markdown(lines: list[dict]) -> str:
    """Return the table of all results, one row for each plane."""
    rows = [_COLUMNS, ("---",) * len(_COLUMNS)]
    order = list(PLANES)
    lines = sorted(lines, key=lambda line: (order.index(line["plane"]), line["seed"]))
    for _, several in groupby(lines, lambda line: line["plane"]):
        rows.append(_row(list(several)))
    return "".join(f"| {' | '.join(map(str, row))} |\n" for row in rows)


def _row(fields: list[dict]) -> tuple[object, ...]:
    of: dict[str, list[Any]] = {key: [line.get(key) for line in fields] for key in fields[0]}
    share = [reached / can for reached, can in zip(of["reached"], of["reachable"])]
    cost = [
        line["cpu_s"] / line["cpu_without_walls_s"]
        for line in fields
        if "cpu_without_walls_s" in line
    ]
    parts = f"{median(of['plan_s']):.1f} + {median(of['discretize_s']):.1f}"
    return (
        of["plane"][0],
        f"{of['enabled'][0]} of {of['robots'][0]}",
        of["walls"][0],
        len(fields),
        f"{100 * min(share):.2f} %",
        f"{100 * sum(of['reached']) / sum(of['reachable']):.3f} %",
        f"{100 * sum(of['reached']) / max(sum(of['clear_ends']), 1):.3f} %",
        f"{sum(of['certified'])} of {len(fields)}",
        f"{sum(of['judged_contacts'])}, {sum(of['judged_near'])}",
        f"{sum(of['close_at_rest'])}, {sum(of['leaving'])}",
        sum(of["wall_contacts"]),
        f"{_least(of['least_to_walls_mm'])}, {_least(of['least_between_arms_mm'])}",
        f"{sum(of['joints_broken'])}, {sum(of['motors_broken'])}",
        _most(of["fastest_motor"]),
        f"{max(of['error_um']):.2f}",
        f"{median(of['ratio']):.3f}, {max(of['ratio']):.3f}",
        f"{parts} = {median(of['cpu_s']):.1f}, {max(of['cpu_s']):.1f}",
        f"{median(cost):.2f}, {max(cost):.2f}" if cost else "-",
        GOALS[of["plane"][0]],
    )


def _least(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{min(known):.3f}" if known else "-"


def _most(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{max(known):.4f}" if known else "-"


def main(argv: list[str] | None = None) -> int:
    """Run the fields from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--planes", nargs="+", default=list(PLANES), choices=list(PLANES))
    parser.add_argument("--fields", type=int, default=2, help="fields of each plane")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--again", action="store_true", help="run fields again that have a line")
    parser.add_argument("--no-bare", action="store_true", help="do not plan without walls, too")
    parser.add_argument("--out", type=Path, default=_RESULTS, help="folder of the results")
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "geometry.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for name in options.planes:
        fields = 1 if name == "desi_tile" else options.fields
        seeds = list(range(options.first_seed, options.first_seed + fields))
        if not options.again:
            done = {line["seed"] for line in lines if line["plane"] == name}
            seeds = [seed for seed in seeds if seed not in done]
        if seeds:
            _compile(PLANES[name](seeds[0]))
        for seed in seeds:
            line = run(name, seed, not options.no_bare)
            print(json.dumps(line), flush=True)
            lines = [x for x in lines if (x["plane"], x["seed"]) != (name, seed)] + [line]
            _replace(path, "".join(json.dumps(each) + "\n" for each in lines))
            _replace(options.out / "geometry.md", markdown(lines))
    _replace(options.out / "geometry.md", markdown(lines))  # also of lines that are all there
    return 0


def _compile(problem: Problem) -> None:
    rows = np.arange(min(_SMALL, problem.plane.n))
    make_orders(Problem(problem.plane.permuted(rows), problem.start[rows], problem.targets[rows]))


def _replace(path: Path, text: str) -> None:
    # as a whole: a run that is ended meanwhile leaves the lines of before
    fresh = path.with_suffix(path.suffix + ".new")
    fresh.write_text(text)
    fresh.replace(path)


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Plans for real motors, a line of JSON for each field and a table of all lines, judged by others.

Every field is planned, sent over simulated buses and saved. `drive_checker` or `listed_checker`,
which share no code with this project, then read the files. A field that the lines already hold is
not planned again: after a cut the same command goes on.

    python3 bench/motors.py --layout calib-20260303.csv --fields 20
    python3 bench/motors.py --rows blind corrections --fields 1
    python3 bench/motors.py --table
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from correction_field import correction_field
from drive_checker import check
from linear_robots import linear_robots
from listed_checker import check_listed
from motors_table import table_of

from fiber_core.drive import Drive
from fiber_core.drive.named import with_drive
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_formats import read_layout
from fiber_planner import DirectParameters, DirectPlanner, Planner, StraightPlanner
from fiber_positioners import Reconfiguration, random_problem, reconfigure

Figures = dict[str, Any]

_SHARE = 0.55  # of the motors of a supply that may be on at once
_OFF_MM = 1.05  # the error stack of SDSS-V's interface document at the end of an arm
_CORRECTED_MM = 2e-3  # a tick of creep in both joints, the least that an order can turn them
_ERRORS = 50  # random errors of all joints of each field of SDSS-V; 20 fields make 1000 moves
_NOTE = """`python3 bench/motors.py --layout FILE --fields N --out bench/results/motors.md`, FILE
the table of DESI's calibration of March 2026, which is no part of this project; without it the
preset `desi_petals`. What ends allow: robots that can reach their targets at once, with their
approach, past bodies that rest. Bounds: one robot alone with its motors, approach included; the
motor time of a supply over the number of motors that it may feed; goals are of the larger one, for
motors of any speed of the first. Near: pairs nearer than 0.05 mm that do not touch. Rules,
supplies, contacts and gaps are judged from the files. A robot is on its
target within 0.1 mm, and after a correction within 2 um: a tick of creep in both joints of DESI,
the least that an order can turn them, makes 1.7 um.
Blind errors of linear robots are of simulated arms, drawn for 54 um rms with arms of 3 mm; each
plan moves the arms of 20 draws, as the rms of one draw of 460 robots differs from the next, and
contacts are those of the first.
"""


def blind(plane: FocalPlane, seed: int, share: float = _SHARE) -> Figures:
    """A blind move of DESI."""
    return _listed(random_problem(with_drive(plane, "desi", share), seed=seed), seed)


def without_cap(plane: FocalPlane, seed: int) -> Figures:
    """The same where all motors may be on."""
    return blind(plane, seed, 1.0)


def corrections(plane: FocalPlane, seed: int) -> Figures:
    """Corrections of 50 to 500 um."""
    problem = correction_field(with_drive(plane, "desi", _SHARE), np.random.default_rng(seed))
    return _listed(problem, seed, StraightPlanner(), tolerance_mm=_CORRECTED_MM)


def accelerated(_: FocalPlane, seed: int) -> Figures:
    """Motors of any speed with a ramp."""
    plane = with_drive(preset("desi", 5000), "accelerated")
    result = reconfigure(random_problem(plane, seed=seed), seed=seed)
    return _checked(result, seed)


def uncertain(_: FocalPlane, seed: int) -> Figures:
    """Arms of SDSS-V whose ends are within 1.05 mm of where they report."""
    plane = preset("sdss_v", 547)
    # if both joints are off by as much, the end is off by that times this lever
    lever_mm = plane.arms.sum(axis=1) + plane.arms[:, 1]
    off_rad = np.repeat((_OFF_MM / lever_mm)[:, None], 2, axis=1)
    drive = Drive(plane.n, uncertainty_rad=off_rad, name="sdss_v")
    plane = replace(plane, phi_radius=np.full(plane.n, 1.5), drive=drive)
    planner = DirectPlanner(DirectParameters(shortening=0.0))
    result = reconfigure(random_problem(plane, seed=seed), planner=planner, seed=seed)
    # an arm moves 0.3 mm between two instants at most
    return _checked(result, seed, step_s=40e-3, errors=_ERRORS)


def linear(plane: FocalPlane, seed: int) -> Figures:
    """The robots with a joint that turns less than ordered, beside the others, with true arms."""
    return linear_robots(with_drive(plane, "desi", _SHARE), seed)


ROWS: dict[str, Callable[[FocalPlane, int], Figures]] = {
    "blind": blind,
    "without_cap": without_cap,
    "corrections": corrections,
    "accelerated": accelerated,
    "uncertain": uncertain,
    "linear": linear,
}


def _listed(problem: Problem, seed: int, planner: Planner | None = None, **options: Any) -> Figures:
    result = reconfigure(problem, planner=planner, seed=seed, **options)
    verdict = _judged(result, check_listed)
    return _figures(result) | {
        "plane": problem.plane.name,
        "makespan_s": verdict.makespan_s,
        "peak": verdict.peak,
        "violations": verdict.violations,
        "contacts": verdict.gaps.contacts,
        "near": verdict.gaps.near,
        "least_gap_mm": verdict.gaps.least_mm,
        "end_error_um": verdict.end_error_um,
    }


def _checked(result: Reconfiguration, seed: int, step_s: float = 2e-3, errors: int = 0) -> Figures:
    verdict = _judged(result, check, step_s=step_s, errors=errors, seed=seed)
    return _figures(result) | {
        "makespan_s": verdict.makespan_s,
        "violations": verdict.violations,
        "contacts": verdict.contacts,
        "near": verdict.near,
        "true_contacts": verdict.true_contacts,
        "least_gap_mm": verdict.least_gap_mm,
        "least_true_gap_mm": verdict.least_true_gap_mm,
        "end_error_um": verdict.end_error_um,
        "simulated_moves": errors,
    }


def _judged(result: Reconfiguration, judge: Callable[..., Any], **options: object) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder, recording=False)
        return judge(Path(folder) / "problem.npz", Path(folder) / "plan.npz", **options)


def _figures(result: Reconfiguration) -> Figures:
    report = result.report
    names = (
        "asked", "reached", "reachable_at_once", "lower_bound_s", "supply_bound_s",
        "power_bound_s", "certified", "drive_violations", "segments_mean", "bytes_mean",
    )  # fmt: skip
    seconds = {"cpu_s": round(sum(result.orders.cpu_seconds.values()), 3)}
    return {name: report[name] for name in names} | seconds


def main() -> int:
    """Run the fields that are missing and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--layout", help="the robots of DESI, in place of the preset desi_petals")
    parser.add_argument("--robots", type=int, help="number of robots of that preset")
    parser.add_argument("--fields", type=int, default=20, help="fields of each row")
    parser.add_argument(
        "--lines", type=Path, default=Path("bench/results/motors.jsonl"), help="lines of JSON"
    )
    parser.add_argument("--out", type=Path, help="write the table here")
    parser.add_argument("--table", action="store_true", help="plan nothing, print the table")
    args = parser.parse_args()
    lines = (
        [json.loads(line) for line in args.lines.read_text(encoding="utf-8").splitlines()]
        if (args.lines.exists())
        else []
    )
    if not args.table:
        _run(args, lines)
    table = table_of(lines)
    print(table, end="")
    if args.out is not None:
        args.out.write_text(f"{table}\n{_NOTE}", encoding="utf-8")
    return 0


def _run(args: argparse.Namespace, lines: list[Figures]) -> None:
    # plan the fields that are missing, and append each to the lines
    plane = read_layout(args.layout).plane if args.layout else preset("desi_petals", args.robots)
    done = {(line["row"], line["seed"]) for line in lines}
    todo = [(seed, row) for seed in range(args.fields) for row in args.rows]
    todo = [(seed, row) for seed, row in todo if (row, seed) not in done]
    if todo:  # compiles the loops
        for row in dict.fromkeys(row for _, row in todo):
            if row in ("blind", "without_cap", "corrections", "linear"):
                ROWS[row](preset("desi_petals", 30), 0)
        reconfigure(random_problem(with_drive(preset("desi", 30), "accelerated"), seed=0))
    for seed, row in todo:
        begin = time.perf_counter()
        line = {"row": row, "seed": seed, **ROWS[row](plane, seed)}
        line["wall_s"] = round(time.perf_counter() - begin, 1)
        lines.append(line)
        with args.lines.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        print(json.dumps(line), file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""The subcommand `study`: a grid of instruments, a table, a CSV file and a picture."""

import argparse
from pathlib import Path

from fiber_core.presets import PRESETS
from fiber_formats import DEFAULT_PRESET
from fiber_planner import DEFAULT_PLANNER, planners
from fiber_positioners.command.arguments import arm_pairs, names, numbers, positive, whole_numbers
from fiber_positioners.command.exit_codes import DONE, INTERRUPTED
from fiber_positioners.command.progress import ProgressLine
from fiber_positioners.study import (
    Case,
    Row,
    RowFile,
    grid,
    save_figure,
    save_study,
    study_rows,
    study_table,
    summarize,
)

_GRIDS = sorted(name for name, figures in PRESETS.items() if figures.build is None)

__all__ = ["DESCRIPTION", "SUMMARY", "add_arguments", "run"]

SUMMARY = "carry out fields over a grid of parameters and print a table"
DESCRIPTION = """Carry out random fields over a grid of instrument parameters and print a table.

A parameter is a list "5.0,5.5", a range BEGIN:END:STEP with its end "5:7:0.5", or both. Every
combination is drawn several times. A figure that is not given is that of --preset. --out gets
study.csv (a row for each field, written as it is finished), study.json and study.png. An
interrupt (Ctrl-C) ends the study and keeps what is finished.

examples:
  fiber-positioners study --pitch 9:12:0.5 --seeds 3 --out out/study
  fiber-positioners study --arms 3,3.5,3x4 --radius 0.8,1.0 --robots 200
  fiber-positioners study --preset pfs --disabled 0,0.05,0.15 --planner direct,dnf
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("--preset", choices=_GRIDS, default=DEFAULT_PRESET, help="lends other figures")
    add("--robots", type=whole_numbers, default=[300], help="numbers of robots (default 300)")
    add("--pitch", type=numbers, default=[None], metavar="MM", help="distance of neighbours [mm]")
    add("--arms", type=arm_pairs, default=[None], metavar="MM",
        help="arm lengths [mm]: 3 for both arms, 3x2.5 for theta and phi arm")  # fmt: skip
    add("--radius", type=numbers, default=[None], metavar="MM", help="half width of phi arms [mm]")
    add("--disabled", type=numbers, default=[0.0], metavar="SHARE",
        help="shares of disabled robots, 0..1 (default 0)")  # fmt: skip
    add("--planner", type=names(planners()), default=[DEFAULT_PLANNER],
        help=f"planners: {', '.join(planners())} (default {DEFAULT_PLANNER})")  # fmt: skip
    add("--seeds", type=positive, default=3, help="number of draws of each combination")
    add("--first-seed", type=int, default=1, help="seed of the first draw")
    add("--out", type=Path, help="folder for study.csv, study.json and study.png")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand; returns the exit code."""
    cases = grid(
        preset=[args.preset],
        robots=args.robots,
        pitch_mm=args.pitch,
        arms_mm=args.arms,
        radius_mm=args.radius,
        disabled=args.disabled,
        planner=args.planner,
    )
    for case in cases:  # an impossible figure is refused before the work begins
        case.check()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    if args.out is None:
        return _finish(args, *_carry_out(cases, seeds, None))
    args.out.mkdir(parents=True, exist_ok=True)
    with RowFile(args.out / "study.csv") as rows:
        return _finish(args, *_carry_out(cases, seeds, rows))


def _carry_out(
    cases: tuple[Case, ...], seeds: range, rows: RowFile | None
) -> tuple[list[tuple[Case, Row]], bool]:
    """Carry out all fields; return the finished ones, and whether the study was interrupted."""
    total, done = len(cases) * len(seeds), []
    with ProgressLine(every=0.0) as progress:
        progress(0.0, f"{len(cases)} cases, {len(seeds)} draws each")
        try:
            for case, row in study_rows(cases, seeds):
                done.append((case, row))
                if rows is not None:
                    rows.add(row)
                progress(len(done) / total, f"{case}, seed {row['seed']}: {_result(row)}")
        except KeyboardInterrupt:
            progress.line(f"interrupted: {len(done)} of {total} fields are finished")
            return done, True
    return done, False


def _result(row: Row) -> str:
    if row["error"]:
        return str(row["error"])
    return f"{row['reached']} of {row['asked']} reached in {row['makespan_s']:.2f} s"


def _finish(args: argparse.Namespace, done: list[tuple[Case, Row]], interrupted: bool) -> int:
    summaries = summarize(done)
    if done:
        print(study_table(summaries))
    if done and args.out is not None:
        save_study(args.out / "study.json", done)
        save_figure(args.out / "study.png", summaries)
        print("in", args.out)
    return INTERRUPTED if interrupted else DONE

# SPDX-License-Identifier: Apache-2.0
"""The subcommand `plan`: one reconfiguration, one JSON line."""

import argparse
from pathlib import Path

import numpy as np

from fiber_core.drive.named import DRIVES
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import PRESETS
from fiber_core.problem import Problem
from fiber_formats import FORMS, FormatError, check_results, problem_from
from fiber_planner import planners
from fiber_positioners.command.arguments import length, positive, share
from fiber_positioners.command.exit_codes import DONE
from fiber_positioners.command.progress import ProgressLine
from fiber_positioners.reconfiguration import reconfigure
from fiber_positioners.report import report_line
from fiber_viewer import write_player

__all__ = ["DESCRIPTION", "SUMMARY", "add_arguments", "run"]

SUMMARY = "plan one field and carry it out in simulated time"
DESCRIPTION = """Take a focal plane through one reconfiguration and print one JSON line of results.

The orders are planned, discretized, loaded as bytes onto simulated buses, verified and carried
out. --out keeps problem.npz and plan.npz for any other planner or checker, report.json,
outcomes.ecsv, recording.npz, and player.html, which shows the motion in a browser; --player writes
that page alone. --layout, --starts and
--targets take the files of DESI, SDSS-V, PFS, MOONS and JUST, or tables of our own columns; what
of them is not used is named on stderr.

examples:
  fiber-positioners plan --preset desi --robots 500 --seed 1
  fiber-positioners plan --layout plane.csv --targets targets.csv --out out/field
  fiber-positioners plan --layout fp-20260219.ecsv --starts fp-20260219.ecsv
      --targets fiberassign-000001.fits.gz --results results.fits --form desi
  fiber-positioners plan --preset desi --drive accelerated
  fiber-positioners plan --preset desi_petals --drive desi --motors-on 0.55
  fiber-positioners plan --preset moons --planner dnf --player out/moons.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("--preset", choices=sorted(PRESETS), help="instrument; desi without a layout")
    add("--layout", metavar="FILES", help="the robots: one file, or several joined by commas")
    add("--starts", metavar="FILES", help="present angles; by default random")
    add("--problem", type=Path, help="problem.npz, solved as it is")
    add("--targets", metavar="FILES", help="targets; by default random")
    add("--spacing", type=length, metavar="MM", help="least distance between two targets")
    add("--robots", type=positive, help="number of robots of the preset; by default all")
    add("--drive", choices=sorted(DRIVES), help="motors of the robots; by default ideal ones")
    add(
        "--motors-on",
        type=share,
        metavar="SHARE",
        help="most motors of a supply on at once, above 0 to 1",
    )
    add("--seed", type=int, default=0, help="seed of the random field and of the robots' clocks")
    add("--planner", choices=planners(), help="by default direct, for listed speeds scheduled")
    add("--capture", type=Path, help="folder for waveforms (VCD) and packets (pcap) of the buses")
    add("--out", type=Path, help="folder for problem, plan, report, outcomes, recording and player")
    add(
        "--results", type=Path, metavar="TABLE", help="write all robots: .csv, .ecsv, .fits or .par"
    )
    add("--form", choices=sorted(FORMS), help="columns of an instrument in addition, in --results")
    add("--player", type=Path, metavar="PAGE", help="write the player, an HTML page, here")
    add("--cold", action="store_true", help="count the compilation of loops as computing time")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand; returns the exit code."""
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)  # refused before the work, not after it
    _refuse_results(args)
    found = problem_from(
        args.problem,
        args.layout,
        args.preset,
        args.robots,
        args.seed,
        args.starts,
        args.targets,
        spacing_mm=args.spacing,
        drive=args.drive,
        motors_on=args.motors_on,
    )
    problem = found.problem
    _refuse_results(args, problem.plane)
    with ProgressLine() as progress:
        for line in found.lines:
            progress.line(line)
        if not args.cold:
            progress(0.0, "compiling the loops")
            reconfigure(_small(problem), planner=args.planner)
        result = reconfigure(
            problem,
            planner=args.planner,
            seed=args.seed,
            capture=args.capture,
            progress=progress,
        )
        if args.out is not None:
            progress(1.0, f"writing {args.out}")
            folder = result.save(args.out)
            result.write_results(folder / "outcomes.ecsv")
            write_player(folder / "player.html", folder / "recording.npz")
        if args.results is not None:
            result.write_results(args.results, args.form)
        if args.player is not None:
            progress(1.0, f"writing {args.player}")
            result.player(args.player)
    print(report_line(result.report))
    return DONE


def _refuse_results(args: argparse.Namespace, plane: FocalPlane | None = None) -> None:
    # before the work, not after it
    if args.results is not None:
        check_results(args.results, args.form, plane)
    elif args.form is not None:
        raise FormatError("--form tells columns of --results, which is not given")


def _small(problem: Problem) -> Problem:
    """The first few robots of a problem: enough to have every loop compiled."""
    rows = np.arange(min(20, problem.plane.n))
    return Problem(problem.plane.permuted(rows), problem.start[rows], problem.targets[rows])

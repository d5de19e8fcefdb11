# SPDX-License-Identifier: Apache-2.0
"""The subcommand `calibrate`: a history of ordered and measured places into a calibrated plane."""

import argparse
from pathlib import Path

import numpy as np

from fiber_core.array_types import Ids, Rows
from fiber_core.errors import FiberError
from fiber_core.presets import PRESETS
from fiber_formats import kind_of, read_layout, write_layout
from fiber_metrology import GearVerdict, calibrate, calibration_points, trend_of
from fiber_positioners.calibration_tables import (
    counts_of,
    draw_trend,
    fits_of,
    layout_changes,
    read_history,
    write_fit,
    write_points,
    write_trend,
)
from fiber_positioners.command.arguments import positive, whole_numbers
from fiber_positioners.command.exit_codes import DONE

__all__ = ["DESCRIPTION", "SUMMARY", "add_arguments", "run"]

SUMMARY = "fit arms, zeros, scales and backlash of robots to measured places; trends over nights"
DESCRIPTION = """Calibrate the robots of a plane from a history of ordered and measured places.

--points N writes the table of points to go to, point 0 first. Robots whose ranges are the same
stand parallel at each. HISTORY is that table with the measured places: point, id, theta_deg,
phi_deg, x_mm, y_mm; a place that was not measured is empty. Between two points every joint turns
one way. TABLE becomes the layout with measured centres, arms, zeros, scales and backlash, which
every command reads as a plane; its zeros are in the ranges of the joints. A second table, its name
ending in _fit, has all twelve numbers of each robot with errors and a verdict on its gears.
--nights takes tables of _fit, the oldest first, and tells what drifts; --figure draws the robots
that drift, or --robots, over these nights.

examples:
  fiber-positioners calibrate --layout plane.csv --points 20 points.csv
  fiber-positioners calibrate --layout plane.csv --history history.csv calibrated.csv
  fiber-positioners calibrate --nights a_fit.csv,b_fit.csv,c_fit.csv,d_fit.csv,e_fit.csv trend.csv
  fiber-positioners calibrate --nights a_fit.csv,... --figure trend.pdf --robots 107,12 trend.csv
"""
_SHOWN = 20
_DRAWN = 6  # more lines in one figure are not told apart


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("target", metavar="TABLE", help="the table to write: .csv, .ecsv or .fits, also with .gz")
    what = parser.add_mutually_exclusive_group()  # run asks for one
    what.add_argument("--history", metavar="TABLE", help="table of ordered and measured places")
    what.add_argument("--points", type=positive, metavar="N", help="choose N points to go to")
    what.add_argument("--nights", metavar="TABLES", help="tables of _fit joined by commas")
    add("--layout", metavar="FILES", help="the plane: a file, or several joined by commas")
    add("--preset", choices=sorted(PRESETS), help="supplies what the layout lacks")
    add("--error-um", type=float, default=4.0, help="error of a coordinate of a place [um]")
    add("--seed", type=int, help="of the choice of points, by default 0")
    add("--figure", metavar="FILE", help="with --nights: a figure to draw, .pdf or .png")
    add(
        "--robots",
        type=whole_numbers,
        metavar="ID,ID",
        help="robots to draw; by default what drifts",
    )


def run(args: argparse.Namespace) -> int:
    """Run the subcommand; returns the exit code."""
    kind_of(args.target)
    _check(args)
    if args.nights is not None:
        return _trend(args)
    layout = read_layout(args.layout, args.preset)
    plane = layout.plane
    if args.points is not None:
        rng = np.random.default_rng(args.seed or 0)
        write_points(args.target, plane, calibration_points(plane, args.points, rng, args.error_um))
        print(f"{args.points} points after the start for {plane.n} robots are in {args.target}")
        return DONE
    counters, places, there = read_history(args.history, plane)
    places[:, ~there] = np.nan
    found = calibrate(plane, counters, places, args.error_um)
    lines = write_layout(args.target, layout, layout_changes(plane, found))
    target = Path(args.target)
    stem = target.name.split(".")[0]
    beside = target.with_name(stem + "_fit" + target.name[len(stem) :])
    write_fit(beside, plane, found)
    print(f"{len(places)} points, {plane.n} robots: {counts_of(found.verdict)}")
    bad = np.flatnonzero(found.verdict >= GearVerdict.STUCK)
    for row in bad[:_SHOWN]:
        verdict = GearVerdict(found.verdict[row]).name.lower()
        print(f"robot {plane.ids[row]}: {verdict}, rms {found.rms_um[row]:.1f} um: as it was")
    if len(bad) > _SHOWN:
        print(f"and {len(bad) - _SHOWN} robots more")
    print("\n".join([f"numbers, errors and verdicts are in {beside}", *lines]))
    return DONE


def _check(args: argparse.Namespace) -> None:
    """Refuse options that are missing, or that would have no effect.

    Raises:
        FiberError: names them.
    """
    if args.history is None and args.points is None and args.nights is None:
        raise FiberError("one of --history, --points and --nights is missing")
    if args.nights is None and (args.figure or args.robots):
        raise FiberError("--figure and --robots draw nights: --nights is missing")
    if args.nights is None and args.layout is None:
        raise FiberError("--layout names the plane, and is missing")
    if args.nights is not None and (args.layout or args.preset):
        raise FiberError("--layout and --preset have no effect with --nights")
    if args.points is None and args.seed is not None:
        raise FiberError("--seed has no effect without --points")


def _trend(args: argparse.Namespace) -> int:
    paths = args.nights.split(",")
    ids, numbers, errors = fits_of(paths)
    found = trend_of(np.arange(len(paths)), numbers, errors)
    write_trend(args.target, ids, found)
    rows = np.flatnonzero(found.drifts.any(axis=1))
    print(f"{len(paths)} nights, {len(ids)} robots: {len(rows)} drift")
    for row in rows[:_SHOWN]:
        print(f"robot {ids[row]} drifts: see {args.target}")
    if args.figure is not None:
        drawn = rows[:_DRAWN] if args.robots is None else _rows_of(args.robots, ids)
        draw_trend(args.figure, ids, numbers, errors, found, drawn)
        print(f"{len(drawn)} robots are drawn in {args.figure}")
    return DONE


def _rows_of(robots: list[int], ids: Ids) -> Rows:
    at = np.minimum(np.searchsorted(ids, robots), len(ids) - 1)
    wrong = ids[at] != robots
    if wrong.any():
        raise FiberError(f"robot {robots[int(np.argmax(wrong))]} is in no table of these nights")
    return at

# SPDX-License-Identifier: Apache-2.0
"""The subcommand `convert`: the files of an instrument into a table of our own columns."""

import argparse

from fiber_core.presets import PRESETS
from fiber_formats import KINDS, convert
from fiber_positioners.command.exit_codes import DONE

__all__ = ["DESCRIPTION", "SUMMARY", "add_arguments", "run"]

SUMMARY = "write a layout, targets or starts of any format as a table of own columns"
DESCRIPTION = """Read the files of an instrument and write a table of our own columns.

The format is found by the content of the files: DESI state, calibration and fiberassign tile,
SDSS-V positionerTable with wokCoords and confSummary, PFS cobras and pfsConfig, MOONS assignment,
JUST sites, or our own columns in CSV, ECSV and FITS. What is not used is named.

examples:
  fiber-positioners convert fp-20260219.ecsv layout.csv
  fiber-positioners convert fp-20260219.ecsv starts.csv --what starts
  fiber-positioners convert positionerTable.csv,wokCoords.csv,fiducialCoords.csv layout.fits
  fiber-positioners convert confSummary-1.par starts.csv --what starts --layout layout.fits
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("source", metavar="FILES", help="a file, or several joined by commas")
    add("target", metavar="TABLE", help="the table to write: .csv, .ecsv or .fits, also with .gz")
    add("--preset", choices=sorted(PRESETS), help="supplies what a layout lacks")
    add("--what", choices=KINDS, help="what to write; by default the first that the files hold")
    add("--layout", metavar="FILES", help="the robots, for starts that count from their stops")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand; returns the exit code."""
    lines = convert(args.source, args.target, args.preset, args.what, args.layout)
    print("\n".join(lines))
    return DONE

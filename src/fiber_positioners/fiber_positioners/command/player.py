# SPDX-License-Identifier: Apache-2.0
"""The subcommand `player`: from a recording to a page."""

import argparse
from pathlib import Path

from fiber_positioners.command.exit_codes import DONE
from fiber_viewer import write_player

__all__ = ["DESCRIPTION", "SUMMARY", "add_arguments", "run"]

SUMMARY = "write the page that plays a recording"
DESCRIPTION = """Write one self-contained HTML page that plays a recording in a browser.

examples:
  fiber-positioners player out/field/recording.npz
  fiber-positioners player recording.npz --out shown.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("recording", type=Path, help="recording.npz")
    parser.add_argument("--out", type=Path, help="page to write; by default player.html beside it")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand; returns the exit code."""
    page = args.out or args.recording.with_name("player.html")
    page.parent.mkdir(parents=True, exist_ok=True)
    write_player(page, args.recording)
    print(page)
    return DONE

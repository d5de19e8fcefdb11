# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of a recording, as PDF and PNG.

The figures are: plane, outcomes, conflict (a closest approach at six moments), velocities and
positions (of some robots), clearances, makespan, segments, buses; and images (vectors and histogram
after the move and each correction) if a camera has seen the plan.
"""

import argparse
import sys
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fiber_core.array_types import Rows
from fiber_core.errors import FiberError
from fiber_recording.errors import RecordingError
from fiber_recording.recording import Recording
from fiber_recording.recording_file import load_recording
from fiber_viewer import figures

__all__ = ["FIGURES", "main"]

# name -> function of a recording and the rows of some of its robots
FIGURES: dict[str, Callable[[Recording, Rows], Figure]] = {
    "plane": lambda recording, rows: figures.plane(recording),
    "outcomes": lambda recording, rows: figures.outcomes(recording),
    "conflict": figures.conflict,
    "velocities": figures.velocities,
    "positions": figures.positions,
    "clearances": lambda recording, rows: figures.clearances(recording),
    "makespan": lambda recording, rows: figures.makespan(recording),
    "segments": lambda recording, rows: figures.segments(recording),
    "buses": lambda recording, rows: figures.bus_load(recording),
    "images": lambda recording, rows: figures.images(recording),
}
_ROBOT_FIGURES = ("conflict", "velocities", "positions")
_DPI = 150


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code.

    Args:
        argv: arguments; by default those of the process.
    """
    args = _parser().parse_args(argv)
    try:
        recording = load_recording(args.recording)
        rows = recording.rows_of(args.robots) if args.robots else figures.conflict_rows(recording)
        unseen = () if recording.images is not None else ("images",)
        names = args.only or [name for name in FIGURES if name not in unseen]
        if not len(rows) and set(names) & set(_ROBOT_FIGURES):
            rows = np.flatnonzero(recording.started)[:1]
        args.out.mkdir(parents=True, exist_ok=True)
        for name in names:
            if name in _ROBOT_FIGURES and not len(rows):
                raise RecordingError(f"{name}: no robot moves; name robots with --robots")
            figure = FIGURES[name](recording, rows)
            for kind in args.formats:
                path = args.out / f"{name}.{kind}"
                figure.savefig(path, dpi=_DPI)
                print(path)
    except (FiberError, OSError) as error:
        print(f"figures: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    def listed(choices: Collection[str]) -> Callable[[str], list[str]]:
        def parse(text: str) -> list[str]:
            names = text.split(",")
            unknown = [name for name in names if name not in choices]
            if unknown:
                raise argparse.ArgumentTypeError(
                    f"{', '.join(unknown)} is unknown: choose from {', '.join(choices)}"
                )
            return names

        return parse

    parser = argparse.ArgumentParser(
        prog="figures", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="recording to draw (.npz)")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("figures"), help="folder to write to"
    )
    parser.add_argument(
        "--robots",
        type=lambda text: [int(part) for part in text.split(",")],
        default=[],
        metavar="ID,ID",
        help="ids of robots to draw; by default those that came nearest to each other",
    )
    parser.add_argument(
        "--only",
        type=listed(FIGURES),
        default=[],
        metavar="NAME,NAME",
        help="figures to draw; by default all that the recording has",
    )
    parser.add_argument(
        "--formats", type=listed(("pdf", "png")), default=["pdf", "png"], metavar="pdf,png"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""Command: draw the figures of a recording, as PDF and PNG.

plane, outcomes, conflict (six moments of a closest approach), velocities and positions (of
some robots), clearances, makespan, segments, buses.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from fiber_core.errors import FiberError
from fiber_recording.errors import RecordingError
from fiber_recording.recording_file import load_recording
from fiber_viewer import figures

__all__ = ["FIGURES", "main"]

# name -> figure of a recording and of some of its robots
FIGURES = {
    "plane": lambda recording, rows: figures.plane(recording),
    "outcomes": lambda recording, rows: figures.outcomes(recording),
    "conflict": figures.conflict,
    "velocities": figures.velocities,
    "positions": figures.positions,
    "clearances": lambda recording, rows: figures.clearances(recording),
    "makespan": lambda recording, rows: figures.makespan(recording),
    "segments": lambda recording, rows: figures.segments(recording),
    "buses": lambda recording, rows: figures.bus_load(recording),
}
_OF_ROBOTS = ("conflict", "velocities", "positions")
_DPI = 150


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    args = _parser().parse_args(argv)
    try:
        recording = load_recording(args.recording)
        rows = recording.rows_of(args.robots) if args.robots else figures.conflict_rows(recording)
        if not len(rows) and set(args.only) & set(_OF_ROBOTS):
            rows = np.flatnonzero(recording.started)[:1]
        args.out.mkdir(parents=True, exist_ok=True)
        for name in args.only:
            if name in _OF_ROBOTS and not len(rows):
                raise RecordingError(f"{name}: nobody moves; name robots with --robots")
            figure = FIGURES[name](recording, rows)
            for kind in args.formats:
                path = args.out / f"{name}.{kind}"
                figure.savefig(path, dpi=_DPI)
                print(path)
    except (FiberError, OSError) as error:
        print(f"figures: {error}", file=sys.stderr)
        return 1
    return 0


def _parser():
    def listed(choices):
        def parse(text):
            names = text.split(",")
            unknown = [name for name in names if name not in choices]
            if unknown:
                raise argparse.ArgumentTypeError(
                    f"{', '.join(unknown)}: expected some of {', '.join(choices)}"
                )
            return names

        return parse

    parser = argparse.ArgumentParser(
        prog="figures", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="recording.npz")
    parser.add_argument("-o", "--out", type=Path, default=Path("figures"), help="folder to write")
    parser.add_argument(
        "--robots",
        type=lambda text: [int(part) for part in text.split(",")],
        default=[],
        metavar="ID,ID",
        help="robots to show closely; by default those that came nearest to each other",
    )
    parser.add_argument(
        "--only", type=listed(FIGURES), default=list(FIGURES), metavar="NAME,NAME", help="figures"
    )
    parser.add_argument(
        "--formats", type=listed(("pdf", "png")), default=["pdf", "png"], metavar="pdf,png"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())

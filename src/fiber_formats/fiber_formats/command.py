"""The command `convert`: any format into a table of our own columns."""

import argparse
import sys
from collections.abc import Sequence

from fiber_core.errors import FiberError
from fiber_core.presets import PRESETS
from fiber_formats.convert import KINDS, convert

__all__ = ["add_arguments", "main", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command, so that other commands can take them too."""
    parser.add_argument("source", help="a file, or several joined by commas")
    parser.add_argument("target", help="table to write: .csv, .ecsv or .fits, also with .gz")
    parser.add_argument("--preset", choices=[*PRESETS], help="supplies what the files lack")
    parser.add_argument("--what", choices=KINDS, help="what to write; default: the first there is")


def run(arguments: argparse.Namespace) -> int:
    """Convert as the parsed arguments say and print what was done; return the exit status."""
    try:
        lines = convert(
            arguments.source, arguments.target, preset=arguments.preset, what=arguments.what
        )
    except FiberError as error:
        print(error, file=sys.stderr)
        return 1
    print("\n".join(lines))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, or 1 where a file is refused."""
    parser = argparse.ArgumentParser(prog="convert", description=__doc__)
    add_arguments(parser)
    return run(parser.parse_args(argv))

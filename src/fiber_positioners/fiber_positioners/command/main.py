# SPDX-License-Identifier: Apache-2.0
"""The entry point of the command: reads the subcommand and reports errors in one line."""

import argparse
import sys

from fiber_core.errors import FiberError
from fiber_positioners.command import calibrate, convert, plan, player, study, wiring
from fiber_positioners.command.arguments import HelpFormatter, Parser
from fiber_positioners.command.exit_codes import DONE, INTERRUPTED, REFUSED

__all__ = ["main"]

_DESCRIPTION = """Plan reconfigurations of a focal plane of fibre positioners, without ROS.

examples:
  fiber-positioners plan --preset desi --robots 500 --out out/field
  fiber-positioners study --pitch 9:12:0.5 --arms 3 --robots 300 --seeds 3 --out out/study
  fiber-positioners player out/field/recording.npz
  fiber-positioners convert fp-20260219.ecsv layout.csv
"""


def parsers() -> tuple[Parser, dict[str, Parser]]:
    """Return the parser of the command and those of its subcommands."""
    parser = Parser(
        prog="fiber-positioners", description=_DESCRIPTION, formatter_class=HelpFormatter
    )
    choices = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    found = {}
    for name, module in (
        ("plan", plan),
        ("study", study),
        ("player", player),
        ("convert", convert),
        ("calibrate", calibrate),
        ("wiring", wiring),
    ):
        found[name] = choices.add_parser(
            name,
            help=module.SUMMARY,
            description=module.DESCRIPTION,
            formatter_class=HelpFormatter,
            allow_abbrev=False,
        )
        module.add_arguments(found[name])
        found[name].set_defaults(run=module.run)
    return parser, found


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code.

    Args:
        argv: the arguments; by default those of the process.

    Returns:
        0, or 2 where an argument, a file or a problem is refused, with one line on stderr, or
        130 after an interrupt.
    """
    parser, subcommands = parsers()
    try:
        args, rest = parser.parse_known_args(argv)
        subcommands[args.command].refuse_unknown(rest)
        return _run(args)
    except SystemExit as leave:  # of the parsers, for an error or for --help
        return leave.code if isinstance(leave.code, int) else DONE


def _run(args: argparse.Namespace) -> int:
    try:
        return args.run(args)
    except (FiberError, OSError) as error:
        print(f"fiber-positioners {args.command}: {error}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print(f"fiber-positioners {args.command}: interrupted", file=sys.stderr)
        return INTERRUPTED

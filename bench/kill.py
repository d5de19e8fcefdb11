#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Kill, pause and disturb the processes of a small plane at random moments; judge by the truth.

Each run makes a plan with the nodes as processes, and at a random moment of one of its stages one
process (in some runs two) is killed and started again, or paused and woken. Other runs send
messages of strangers on every topic while robots move, or call services from four clients. Then the
next reconfiguration must come about without touching the other processes. The plant tells what the
robots really did. Each run leaves a line of JSON. Its moments depend on the machine.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from kill_campaign import GIVE_UP_S, PROCESSES, Campaign
from kill_jobs import first_left, run_jobs
from kill_table import commit_of_sources

from fiber_core.errors import FiberError
from fiber_node.ros_environment import own_domain, use_loopback

__all__ = ["main"]


def _names(only: str) -> tuple[str, ...]:
    names = tuple(filter(None, only.split(",")))
    known = (*PROCESSES, "strangers", "services")
    for name in names:
        if name not in known:
            raise argparse.ArgumentTypeError(f"{name!r} is none of {', '.join(known)}")
    return names


def parse(argv: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=90)
    parser.add_argument(
        "--first", type=int, help="number of the first run, by default the next of the seed"
    )
    parser.add_argument("--step", type=int, default=1, help="from one number to the next")
    parser.add_argument("--jobs", type=int, default=1, help="planes at the same time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", type=int, default=37)
    parser.add_argument(
        "--only",
        type=_names,
        default=(),
        help="processes of the runs, as planner,discretizer; or strangers, services",
    )
    parser.add_argument("--lines", type=Path, default="bench/results/kill.jsonl", help="a run each")
    parser.add_argument(
        "--logs", type=Path, help="folder for the logs of the processes, kept of runs that hang"
    )
    return parser.parse_args(argv)


def _lines(
    logs: Path, args: argparse.Namespace, numbers: Sequence[int]
) -> Iterator[dict[str, Any]]:
    """Do the runs; after one that the graph or the judge does not survive, in a new graph."""
    left = iter(numbers)
    for first in left:
        with Campaign(logs, args.robots, args.seed, args.only) as campaign:
            number: int | None = first
            while number is not None:
                try:
                    line = campaign.run(number)
                except (FiberError, AssertionError, OSError) as error:
                    traceback.print_exc()
                    line = {"number": number, "error": f"{type(error).__name__}: {error}"[:300]}
                yield line
                if line.get("next_s", GIVE_UP_S) >= GIVE_UP_S:
                    break  # a fault that stays would be counted again and again
                number = next(left, None)


def main(argv: list[str] | None = None) -> int:
    """Run the command; return 1 when something happened that must not."""
    args = parse(argv)
    first = first_left(args.lines, args.seed) if args.first is None else args.first
    if args.jobs > 1:
        given = {
            "seed": args.seed,
            "robots": args.robots,
            "lines": args.lines,
            "only": ",".join(args.only),
        }
        return run_jobs(Path(__file__), args.jobs, first, args.runs, given, args.logs)
    for ends in (signal.SIGINT, signal.SIGTERM):  # the processes end with this one
        signal.signal(ends, signal.default_int_handler)
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    failed, of_all = 0, {"commit": commit_of_sources(), "seed": args.seed}
    if args.only:
        of_all["only"] = ",".join(args.only)
    numbers = range(first, first + args.runs * args.step, args.step)
    with tempfile.TemporaryDirectory() as folder:
        logs = args.logs or Path(folder)
        logs.mkdir(parents=True, exist_ok=True)
        args.lines.parent.mkdir(parents=True, exist_ok=True)
        for done, line in enumerate(_lines(logs, args, numbers), 1):
            with open(args.lines, "a", encoding="utf-8") as file:
                file.write(json.dumps(line | of_all, separators=(",", ":")) + "\n")
            counted = line.get("counted", {"error": 1})
            found = {name: count for name, count in counted.items() if count}
            failed += bool(found)
            what = " ".join([line.get("how", ""), *line.get("names", []), line.get("stage", "")])
            print(f"{done} of {args.runs}: run {line['number']}, {what}", found or "", flush=True)
    print(json.dumps({"runs": args.runs, "failed": failed, "robots": args.robots}))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

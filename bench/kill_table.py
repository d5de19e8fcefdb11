#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Make the table of a kill campaign from the lines that `bench/kill.py` leaves."""

import argparse
import json
import statistics
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

__all__ = ["commit_of_sources", "main", "table"]

_Line: TypeAlias = dict[str, Any]
_ABOUT = """# Killed, paused and disturbed processes

`make kill` (`bench/kill.py`): plant, bridge, planner, discretizer, recorder, viewer and client of a
small plane are killed and started again, or paused and woken, at random moments of a plan. In other
runs strangers send messages on every topic, or four clients call services. The judge is what the
robots of the plant really did. The processes are forked from one that has imported everything, so
that a restart costs no seconds of imports. Several planes can run at the same time (JOBS=): the
times are those of a machine that is busy, with the load below. Columns:

- unverified: movements whose order was not read back by the bridge that started it
- unordered: movements that a new bridge started by itself
- contacts: pairs of robots that touched, by whole outlines in continuous time
- false reached: robots said to have reached their targets that stand elsewhere
- no end: plans without outcome or refusal 46 s after all processes are back
- slow end: plans that ended later than 6 s after all processes were back
- late: the next reconfiguration took more than 5 s, with its motion and a restarted process's start
- died: processes that ended by themselves

4971 runs of earlier code, whose lines are not kept, are counted apart in
[kill_earlier.md](kill_earlier.md). Each line of [kill.jsonl](kill.jsonl) names its commit, and the
third table counts by commit.

"""


def table(lines: Sequence[_Line]) -> str:
    """Return the tables of a campaign, in markdown: by process, stage and commit, and memory."""
    ended = sum("error" in line for line in lines)
    lines = [line for line in lines if "error" not in line]
    late = sum("missed" in line for line in lines)
    load = statistics.median(line["load"] for line in lines)
    of = Counter(line.get("commit", "unknown") for line in lines)
    commits = ", ".join(f"{count} of {commit}" for commit, count in of.items())
    text = [
        f"{len(lines)} runs ({commits}), at a load of {load:.1f} (median); in {late} of them "
        f"the plan ended before the stage of the strike. Of {sum(map(_unjudged, lines))} plans the "
        "robots are not compared with their targets, because other clients moved them on, or the "
        f"targets did not come to the judge. {ended} further runs ended with an error and are not "
        "in the tables.",
        "",
    ]
    groups: dict[str, Callable[[_Line], str]] = {
        "process": lambda line: " ".join([line["how"], *line["names"][:1]]),
        "stage": lambda line: line["stage"],
        "commit": lambda line: line.get("commit", "unknown"),
    }
    for name, group in groups.items():
        rows: dict[str, list[_Line]] = {}
        for line in lines:
            rows.setdefault(group(line), []).append(line)
        text += [*_rows(name, [*sorted(rows.items()), ("all", list(lines))]), ""]
    return "\n".join([*text, *_memory(lines), ""])


def _unjudged(line: _Line) -> int:
    return line.get("unjudged", 0)


def commit_of_sources() -> str:
    """Return the commit of the sources, with a mark if they differ from it."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return described.stdout.strip()


def _rows(name: str, rows: Sequence[tuple[str, list[_Line]]]) -> list[str]:
    counted = list(rows[0][1][0]["counted"])
    heads = [name, "runs", *(each.replace("_", " ") for each in counted)]
    heads += ["next s, median", "next s, worst"]
    text = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for key, lines in rows:
        next_s = [line["next_s"] for line in lines]
        cells: list[object] = [key, len(lines)]
        cells += [sum(line["counted"][each] for line in lines) for each in counted]
        cells += [f"{statistics.median(next_s):.1f}", f"{max(next_s):.1f}"]
        text.append(f"| {' | '.join(map(str, cells))} |")
    return text


def _memory(lines: Sequence[_Line]) -> list[str]:
    """How the memory of the processes grew from their first run to their last [MB]."""
    seen: dict[tuple[str, int], list[float]] = {}
    for line in lines:
        for name, (pid, mb) in line["memory"].items():
            seen.setdefault((name, pid), []).append(mb)
    longest: dict[str, tuple[int, float, float]] = {}
    for (name, _), mb in seen.items():
        longest[name] = max(longest.get(name, (0, 0.0, 0.0)), (len(mb), mb[0], mb[-1]))
    text = ["| process that lived longest | runs | MB, first | MB, last |", "|---|---|---|---|"]
    return text + [f"| {n} | {k} | {a} | {b} |" for n, (k, a, b) in sorted(longest.items())]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("lines", type=Path, help="file of lines, as bench/results/kill.jsonl")
    parser.add_argument("--out", type=Path, help="file for the table, in markdown")
    args = parser.parse_args(argv)
    text = table([json.loads(line) for line in args.lines.read_text("utf-8").splitlines()])
    print(text)
    if args.out:
        args.out.write_text(_ABOUT + text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Kill, pause and cut off the hosts of a plane of sectors at random moments; judge by the truth.

Each host is a process in a network namespace of its own, with a clock of its own; its robots are in
a plant that outlives it. In each run one thing happens in one stage of a short reconfiguration: a
sector or the coordinator is killed or paused, a sector is cut off, a clock jumps or drifts, a robot
jams, messages are lost, doubled and late. Then the next reconfiguration must come about. The plants
tell what the robots really did. Needs the rights to make network namespaces.

The clocks run in slow motion, --scale seconds in one of this machine. With --lines the lines of all
runs are added to a file, and a campaign goes on where it ended. A line has the commit of the
sources, and what the processes of the run have said about errors.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from kill_jobs import first_left, run_jobs
from kill_table import commit_of_sources
from sector_hosts import Namespaces, Trouble
from sector_judge import Moved, Start, broken, judge
from sector_plane import (
    CONTEXT,
    COORDINATOR,
    Setting,
    coordinate,
    logged,
    near_problem,
    run_plant,
    run_sector,
)
from sectors import problem_of

from fiber_bus_bridge.plant import PlantTruth
from fiber_bus_bridge.plant.rehearsal import rehearse
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome
from fiber_core.wire_units import WireUnits
from fiber_positioners import make_orders

__all__ = ["KINDS", "STAGES", "Campaign", "broken_in", "main", "summary"]

KINDS = (
    "sector killed", "sector paused", "coordinator killed", "coordinator paused", "cut off",
    "clock jumps", "clock drifts", "robot jams", "bad network", "nothing",
)  # fmt: skip
STAGES = ("configuring", "loading", "counting", "moving")
_LASTS_S = {"configuring": 0.02, "loading": 0.015, "counting": 0.02, "moving": 0.2}  # of the clocks
_HEAR_S, _BOUND_S = 150.0, 0.3
_LINES = 40  # of errors that are kept of a run
_FEWEST = 0.9  # share of the robots that arrive in the next reconfiguration
_COUNTED = "others_asked", "others_reached", "next_asked", "next_reached"
_LARGEST = "start_skew_ms_max", "stop_ms_max"
_PROMISED = "contacts", "unverified", "without_outcome"
_Line: TypeAlias = dict[str, Any]


class Campaign:
    """The hosts of a plane, and the judge of its runs.

    Args:
        robots, sectors: size of the plane.
        scale: seconds of the clocks in one of this machine.
        seed: of what is drawn.
        folder: for the sockets of the plants.
        net: see Namespaces.
    """

    def __init__(
        self, robots: int, sectors: int, scale: float, seed: int, folder: Path, net: int = 193
    ):
        first = problem_of(robots, sectors, seed)
        self._problem = near_problem(first.plane, first.start, np.random.default_rng(seed))
        self._sectors, self._scale, self._seed, self._folder = sectors, scale, seed, folder
        self._orders = make_orders(self._problem)
        rehearse()
        self._spaces = Namespaces(sectors, net)
        self._commit = commit_of_sources()

    def close(self) -> None:
        """Remove the hosts."""
        self._spaces.close()

    def _draw(self, number: int, kind: str, stage: str) -> _Line:
        rng = np.random.default_rng([self._seed, number])
        hosts = self._sectors + 1  # the coordinator is the last one
        of_coordinator = "clock" in kind and rng.random() < 0.25
        victim = COORDINATOR if of_coordinator else int(rng.integers(self._sectors))
        return {
            "number": number, "seed": self._seed, "scale": self._scale, "commit": self._commit,
            "kind": kind,
            "stage": stage, "victim": victim,
            "moment": float(rng.random()), "pause_s": float(10 ** rng.uniform(-2.0, 0.0)),
            "ahead_s": rng.uniform(-1000.0, 1000.0, hosts).tolist(),
            "rate_ppm": (rng.choice([-1, 1], hosts) * 10.0).tolist(),
            "jump_s": float(rng.choice([-1, 1]) * 10 ** rng.uniform(-3.0, 0.0)),
            "drift_ppm": float(rng.choice([-1, 1]) * 10 ** rng.uniform(1.0, 3.0)),
            "faults": (float(rng.uniform(0, 0.05)), 0.05, float(rng.choice([0.0, 3e-4, 2e-3]))),
        }  # fmt: skip

    def run(self, number: int) -> _Line:
        """Do one run; return what happened."""
        cells = [(kind, stage) for kind in KINDS for stage in STAGES]
        order = np.random.default_rng([self._seed, number // len(cells)]).permutation(len(cells))
        line = self._draw(number, *cells[order[number % len(cells)]])
        begin_s = time.monotonic()
        self._trouble, self._line = Trouble(), line
        self._setting = Setting(self._problem, self._spaces, line, self._scale, self._trouble)
        self._told: list[Start] = []
        self._stage = "before"
        self._paths = [self._folder / f"p{number}_{k}" for k in range(self._sectors)]
        self._log = self._folder / f"log{number}"
        plants = [self._begin(run_plant, p, k) for k, p in enumerate(self._paths)]
        self._hosts = {k: self._new_sector(k) for k in range(self._sectors)}
        try:
            self._conduct(line)
            found = [self._moved(k) for k in range(self._sectors)]
        except Exception as error:  # of the campaign itself: the next run begins anew
            found = None
            line["error"] = repr(error)
        finally:
            for process in [*self._hosts.values(), *plants]:
                process.kill()
                process.join()
        line["errors"] = self._errors()
        line |= {
            "wall_s": round(time.monotonic() - begin_s, 2),
            "load": round(os.getloadavg()[0], 1),
        }
        if found is not None:
            self._judge(line, found)
        line["broken"] = broken_in(line)
        return line

    def _errors(self) -> list[str]:
        """What the processes of the run have written as they failed; the last lines."""
        texts = self._log.read_text("utf-8", "replace").splitlines() if self._log.exists() else []
        return texts[-_LINES:]

    def _judge(self, line: _Line, found: list[Moved]) -> None:
        units = WireUnits.for_plane(self._problem.plane)
        verdict = judge(self._problem.plane, units, found, sorted(self._told))
        line |= {
            "contacts": verdict.contacts, "unverified": verdict.unverified,
            "start_skew_ms_max": round(verdict.start_skew_ms, 4),
            "start_skew_bound_ms": 1e3 * Safety().border_start_skew_s,
            "stop_ms_max": round(verdict.stop_ms, 3),
            "stop_bound_ms": 1e3 * Safety().border_stop_skew_s,
            "starts": len(self._told),
        }  # fmt: skip

    def _moved(self, k: int) -> Moved:
        rows = np.flatnonzero(self._problem.plane.sector == k)
        with PlantTruth(self._paths[k]) as plant:
            truth = plant.since(0)
        return Moved(rows, truth.start, truth.moves, truth.verified, truth.now_s)

    def _begin(self, target: Any, *given: Any) -> Any:
        given = (target, self._log, *given, self._setting)
        process = CONTEXT.Process(target=logged, args=given, daemon=True)
        process.start()
        return process

    def _new_sector(self, k: int) -> Any:
        return self._begin(run_sector, self._paths[k], k)

    def _new_coordinator(self, orders: Any) -> Any:
        pipe, theirs = CONTEXT.Pipe()
        self._hosts[COORDINATOR] = self._begin(coordinate, theirs, orders)
        theirs.close()
        return pipe

    def _conduct(self, line: _Line) -> None:
        time.sleep(_BOUND_S)  # sockets are bound
        pipe, n = self._new_coordinator(self._orders), self._problem.plane.n
        strike = threading.Thread(target=self._strike_later, args=[line])
        first = self._hear_until(pipe, "ended", strike)
        if strike.ident is None:
            self._strike(line)  # its stage never came
        else:
            strike.join()
        self._trouble.heal(self._scale * time.monotonic())
        killed = not self._hosts[COORDINATOR].is_alive()
        if killed:
            pipe = self._new_coordinator(None)
            time.sleep(_BOUND_S)
        pipe.send("go on")
        then = self._hear_until(pipe, "next", None)
        going, after, line["next_why"] = ([], [], "no end") if then is None else then
        line["refused"] = first if isinstance(first, str) else ""
        outcome = [] if first is None or isinstance(first, str) else first
        line |= self._counts(outcome, line["victim"])
        line["next_asked"], line["next_reached"] = sum(going), _reached(after)
        line["next_refused"] = after if isinstance(after, str) else ""
        ended = line["kind"] == "coordinator killed" or bool(line["refused"]) or len(outcome) == n
        line["without_outcome"] = (not ended) * n + n - (len(after) if going else 0)

    def _counts(self, outcome: list[int], victim: int) -> _Line:
        """Count the robots that have targets and have reached them, those of other sectors, too."""
        asked = self._problem.asked & (self._orders.reason == 0)
        others = self._problem.plane.sector != victim
        found = np.array(outcome or [-1] * len(asked)) == int(Outcome.REACHED)
        return {
            "asked": int(asked.sum()), "reached": int(found.sum()),
            "others_asked": int((asked & others).sum()),
            "others_reached": int((found & others).sum()),
        }  # fmt: skip

    def _hear_until(self, pipe: Connection, what: str, strike: threading.Thread | None) -> Any:
        until_s = time.monotonic() + _HEAR_S
        while time.monotonic() < until_s:
            try:
                if not pipe.poll(0.5):
                    if not self._hosts[COORDINATOR].is_alive():
                        break
                    continue
                stage, content = pipe.recv()
            except (EOFError, OSError):
                break
            self._stage = stage
            if stage == "counting":
                self._told.append(content)
            if strike is not None and stage == self._line["stage"] and strike.ident is None:
                strike.start()
            if stage == what:
                return content
        return None

    def _strike_later(self, line: _Line) -> None:
        time.sleep(line["moment"] * _LASTS_S[line["stage"]] / self._scale)
        self._strike(line)

    def _strike(self, line: _Line) -> None:
        kind, pause_s, k = line["kind"], line["pause_s"] / self._scale, line["victim"]
        line["struck"], now_s = self._stage, self._scale * time.monotonic()
        victim = self._hosts[COORDINATOR if kind.startswith("coordinator") else k]
        if kind.endswith("killed"):
            victim.kill()
            victim.join()
            if kind == "sector killed":
                time.sleep(pause_s)
                self._hosts[k] = self._new_sector(k)
        elif kind.endswith("paused"):
            os.kill(victim.pid, signal.SIGSTOP)
            time.sleep(pause_s)
            os.kill(victim.pid, signal.SIGCONT)
        elif kind == "cut off":
            self._spaces.cut(k)
            time.sleep(pause_s)
            self._spaces.cut(k, up=True)
        elif kind == "clock jumps":
            self._trouble.jump(now_s, line["jump_s"])
        elif kind == "clock drifts":
            self._trouble.drift(now_s, line["drift_ppm"])
        elif kind == "robot jams":
            self._trouble.jam()
        elif kind == "bad network":
            self._trouble.disturb()


def _reached(outcome: list[int] | str) -> int:
    return 0 if isinstance(outcome, str) else outcome.count(int(Outcome.REACHED))


def broken_in(line: _Line) -> list[str]:
    """Return the promises that a run breaks: those of `broken`, and the next reconfiguration.

    A run that was not judged breaks one, too, and one in which a process has failed by itself.
    """
    if "error" in line:
        return ["error"]
    failed = any("Traceback" in each for each in line.get("errors", []))  # not a mere notice
    found = broken(line) + (["errors"] if failed else [])
    if not line["next_asked"] or line["next_reached"] < _FEWEST * line["next_asked"]:
        found.append("next")
    return found


def summary(lines: list[_Line]) -> str:
    """Return a table of a campaign by what happened, in markdown, with the totals below."""
    rows = [
        "| what | runs | in its stage | reached of asked, other sectors | the next one | "
        "start skew [ms] | stop [ms] | contacts | unverified | without outcome | broken |",
        "|" + "---|" * 11,
    ]
    failed = sum("error" in line for line in lines)
    lines = [line for line in lines if "error" not in line]
    commits = Counter(line.get("commit", "unknown") for line in lines)
    for kind in (*KINDS, "all"):
        of = [line for line in lines if kind in (line["kind"], "all")]
        if of:
            total = {name: sum(line[name] for line in of) for name in _COUNTED}
            most = {name: max(line[name] for line in of) for name in _LARGEST}
            there = sum(line["struck"] == line["stage"] for line in of)
            broken_ones = sum(bool(line["broken"]) for line in of)
            rows.append(
                f"| {kind} | {len(of)} | {there} | {total['others_reached']} of "
                f"{total['others_asked']} | {total['next_reached']} of {total['next_asked']} | "
                f"{most['start_skew_ms_max']:.3f} | {most['stop_ms_max']:.1f} | "
                + " | ".join(str(sum(line[name] for line in of)) for name in _PROMISED)
                + f" | {broken_ones} |"
            )
    of_commits = ", ".join(f"{n} of {commit}" for commit, n in commits.items())
    return "\n".join([*rows, "", f"Runs: {of_commits}. {failed} more were not judged."])


def main(argv: list[str] | None = None) -> int:
    """Run the campaign; return 1 when a promise is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--sectors", type=int, default=3)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--first", type=int, help="number of the first run, by default the next")
    parser.add_argument("--step", type=int, default=1, help="between the numbers of two runs")
    parser.add_argument("--jobs", type=int, default=1, help="planes side by side")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--lines", type=Path, help="file to which the lines are added")
    args = parser.parse_args(argv)
    first, given = args.first, {"robots": args.robots, "sectors": args.sectors}
    if first is None:
        first = first_left(args.lines, args.seed) if args.lines else 0
    if args.jobs > 1:
        given |= {"seed": args.seed, "scale": args.scale}
        given |= {"lines": args.lines.resolve()} if args.lines else {}
        failed = bool(run_jobs(Path(__file__), args.jobs, first, args.runs, given, None))
        if args.lines:
            print(summary([json.loads(each) for each in args.lines.read_text().splitlines()]))
        return int(failed)
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        net = 10 + os.getpid() % 240
        campaign = Campaign(args.robots, args.sectors, args.scale, args.seed, Path(folder), net)
        try:
            for number in range(first, first + args.step * args.runs, args.step):
                line = campaign.run(number)
                failed |= bool(line["broken"])
                text = json.dumps(line)
                print(text, flush=True)
                if args.lines:
                    with args.lines.open("a", encoding="utf-8") as file:
                        file.write(text + "\n")
        finally:
            campaign.close()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Run campaigns of seeded faults on a small plane; judge each by the true motion of the robots.

A campaign configures a plane, carries out one planned reconfiguration and one HOME during faults,
and ends. The judge believes no report of a robot: it checks the true motion in continuous time, and
compares the executed orders with the verified ones. Kind and seed define a campaign;
`--replay KIND:SEED` runs it again and prints its log. With `--lines FILE` each campaign leaves a
line of JSON in the file and is not run a second time; the table covers all lines of the file.
"""

import argparse
import json
import multiprocessing
import subprocess
import sys
import time
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from soak_judge import SAFETY, Campaign, Setup, judge_motion, judge_outcomes

from fiber_bus_bridge import Session, SessionState, addresses_of
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import (
    FaultKind,
    ObservedBuses,
    Positioners,
    SimulatedBuses,
    TrueMotion,
    draw_faults,
)
from fiber_core.drive.named import DRIVES, with_drive
from fiber_core.presets import preset
from fiber_positioners import Orders, make_orders, random_problem

__all__ = ["KINDS", "Campaign", "run_campaign"]

KINDS = ("none", *(kind.name.lower() for kind in FaultKind), "mixed")
_FIELDS = 200  # random problems that the campaigns share
_FAULTS_BEGIN_S = 2.5  # faults begin before this time
_LONGEST_S = 60.0  # simulated time after which a campaign counts as endless
_Task: TypeAlias = tuple[str, int, int, str]  # kind, seed, number of robots, drive
_Line: TypeAlias = dict[str, Any]


@cache
def _field(robots: int, number: int, drive: str) -> Orders:
    """Orders of a random problem; every second one has ten-bit addresses."""
    plane = with_drive(preset("desi", robots), drive)
    rows = np.arange(plane.n)
    plane = replace(plane, bus=rows // 16, address=(8 if number % 2 else 200) + rows % 16)
    return make_orders(random_problem(plane, np.random.default_rng([number, 77])))


def run_campaign(
    kind: str, seed: int, robots: int = 127, drive: str = "ideal", capture: Path | None = None
) -> Campaign:
    """Run one campaign; everything wrong is in the returned value.

    Args:
        kind: one of KINDS.
        seed: seed of all random numbers.
        robots: number of robots.
        drive: name of their drive.
        capture: folder for the captured traffic.
    """
    campaign = Campaign(kind, seed)
    try:
        _run(campaign, _set_up(campaign, robots, drive, capture is not None))
    except Exception as error:  # any exception is a finding
        campaign.wrong.append(f"crashed: {type(error).__name__}: {error}")
    if campaign.tap is not None and capture is not None:
        campaign.tap.write(capture)
    return campaign


def _run(campaign: Campaign, setup: Setup) -> None:
    session = setup.session
    t = session.configure(0.0)
    campaign.log.append(f"{t:.4f} s: configured {session.known.sum()} of {session.plane.n}")
    for name in ("plan", "home"):
        if session.state is SessionState.STOPPED:
            t = session.clear(t)
        started_s = _start(campaign, setup, name, t)
        if started_s is None:
            break
        t = _follow(setup, started_s)
        if t > _LONGEST_S:
            campaign.wrong.append("does not end")
            return
        setup.phases += session.loaded_plans
        if len(session.loaded_plans) > 1:
            campaign.log.append(f"{t:.4f} s: resumed {len(session.loaded_plans) - 1} times")
        judge_outcomes(campaign, name, t, session, session.take_result())
    judge_motion(campaign, setup, max(t, session.transactions.now_s) + 1.0)


def _set_up(campaign: Campaign, robots: int, drive: str, with_tap: bool) -> Setup:
    """Draw the faults of a campaign and make its session."""
    rng = np.random.default_rng([KINDS.index(campaign.kind), campaign.seed])
    orders = _field(robots, campaign.seed % _FIELDS, drive)
    plane, units = orders.plane, orders.units
    to = addresses_of(plane)
    faults = draw_faults(_kinds(campaign.kind, rng), to.bus, to.address, _FAULTS_BEGIN_S, rng)
    campaign.log += [f"fault: {f}" for f in (*faults.lines, *faults.noise, *faults.stretches)]
    campaign.log += [f"event: {event}" for event in faults.events]
    positioners = Positioners(
        to, plane.ids, units.quantum_prad, orders.counts,
        clock_ppm=rng.uniform(-20, 20, plane.n), start_skew_s=rng.uniform(0, 20e-6, plane.n),
    )  # fmt: skip
    truth = TrueMotion(positioners, units.quantum_rad)
    buses = SimulatedBuses(positioners, faults=faults, rng=rng)
    if with_tap:
        campaign.tap = Tap(buses, buses.timing)
    angles = units.to_angles(orders.counts)
    observed = ObservedBuses(campaign.tap or buses, truth)
    session = Session(plane, units, SAFETY, observed, angles)
    stop_s = rng.uniform(0, _FAULTS_BEGIN_S) if rng.random() < 0.1 else np.inf
    return Setup(orders, session, truth, stop_s)


def _start(campaign: Campaign, setup: Setup, name: str, t: float) -> float | None:
    """Start the plan or HOME; return the time [s], None if the state does not allow it."""
    session = setup.session
    if name == "home" and session.state is SessionState.IDLE:
        t = max(t, session.configure(t))
        if session.state is SessionState.STOPPED:  # a robot is in FAULT
            t = max(t, session.clear(t))
    if session.state is not SessionState.IDLE:
        campaign.log.append(f"{t:.4f} s: no {name} while {session.state.name}")
        return None
    if name == "home":
        return max(t, session.home(t))
    session.submit(setup.orders.wire, setup.orders.targets)
    return max(t, session.start(t))


def _follow(setup: Setup, t: float) -> float:
    """Advance until no robot moves, with the operator's stop; return the time [s]."""
    session = setup.session
    while session.state is SessionState.MOVING and t <= _LONGEST_S:
        t += 0.1
        if t > setup.stop_s:
            setup.stop_s = np.inf
            t = max(t, session.stop(t))
        else:
            t = max(t, session.advance(t))
    return t


def _kinds(kind: str, rng: np.random.Generator) -> list[FaultKind]:
    if kind == "none":
        return []
    if kind == "mixed":
        return [FaultKind(k) for k in rng.integers(1, len(FaultKind) + 1, rng.integers(2, 6))]
    return [FaultKind[kind.upper()]]


def _work(task: _Task) -> _Line:
    begin = time.process_time()
    campaign = run_campaign(*task)
    return {
        "kind": campaign.kind,
        "seed": campaign.seed,
        "robots": task[2],
        "drive": task[3],
        "wrong": campaign.wrong,
        "outcomes": dict(campaign.outcomes),
        "gap_mm": round(float(campaign.gap_mm), 5),
        "apart_ms": round(campaign.apart_ms, 4),
        "ended_s": round(campaign.ended_s, 3),
        "cpu_s": round(time.process_time() - begin, 3),
    }


def _commit() -> str:
    """The present commit, with a mark when files differ from it."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return described.stdout.strip() or "unknown"


def _read(file: Path | None) -> list[_Line]:
    """The lines of earlier runs."""
    if file is None or not file.exists():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def parse(argv: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--campaigns", type=int, default=20, help="campaigns of each kind")
    parser.add_argument("--mixed", type=int, help="campaigns of the mixed kind, if another number")
    parser.add_argument("--kind", choices=KINDS, nargs="+", default=list(KINDS))
    parser.add_argument("--seed", type=int, default=0, help="first seed of each kind")
    parser.add_argument("--robots", type=int, default=127)
    parser.add_argument("--drive", choices=list(DRIVES), default="ideal", help="of the motors")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--lines", type=Path, help="file of campaigns to continue")
    parser.add_argument("--out", type=Path, help="file for the table, in markdown")
    parser.add_argument("--replay", metavar="KIND:SEED", help="run one campaign and print its log")
    parser.add_argument("--capture", type=Path, help="folder for the captured traffic of a replay")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the command; return 1 when a campaign failed."""
    args = parse(argv)
    if args.replay:
        return _replay(args)
    lines = _read(args.lines)
    done = {
        (line["kind"], line["seed"], line["robots"], line.get("drive", "ideal")) for line in lines
    }
    tasks = [task for task in _tasks(args) if task not in done]
    commit, failed = _commit(), sum(bool(line["wrong"]) for line in lines)
    with multiprocessing.Pool(args.jobs) if args.jobs > 1 else nullcontext() as pool:
        for number, line in enumerate((pool.imap if pool else map)(_work, tasks), 1):
            line["commit"] = commit
            lines.append(line)
            if args.lines:
                with open(args.lines, "a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")
            for finding in line["wrong"]:
                print(f"{line['kind']}:{line['seed']} {finding}", flush=True)
            failed += bool(line["wrong"])
            if sys.stderr.isatty() or number % 100 == 0:
                end = "\r" if sys.stderr.isatty() else "\n"
                progress = f"{number} of {len(tasks)} campaigns, {failed} failed"
                print(progress, end=end, file=sys.stderr, flush=True)
    text = table(lines)
    print(text)
    print(json.dumps({"campaigns": len(lines), "failed": failed, "robots": args.robots}))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(text, encoding="utf-8")
    return 1 if failed else 0


def _tasks(args: argparse.Namespace) -> list[_Task]:
    """Tasks in the order of seeds, so that an interrupted run covers all kinds."""
    counts = {kind: args.campaigns for kind in args.kind}
    if args.mixed is not None and "mixed" in counts:
        counts["mixed"] = args.mixed
    tasks: list[tuple[float, str, int, int, str]] = []
    for kind, count in counts.items():
        # spread evenly, for every number of campaigns
        places = (np.arange(count) + 0.5) / max(count, 1)
        of_all = args.robots, args.drive
        tasks += [(p, kind, args.seed + k, *of_all) for k, p in enumerate(places.tolist())]
    return [task[1:] for task in sorted(tasks, key=lambda task: task[0])]


def _replay(args: argparse.Namespace) -> int:
    kind, seed = args.replay.split(":")
    campaign = run_campaign(kind, int(seed), args.robots, args.drive, args.capture)
    print("\n".join(campaign.log))
    print(f"smallest true gap {campaign.gap_mm:.4f} mm, stops {campaign.apart_ms:.3f} ms apart")
    print("\n".join(campaign.wrong) or "nothing wrong")
    return 1 if campaign.wrong else 0


def table(lines: list[_Line]) -> str:
    """Return a table in markdown with a row for each kind, from the lines of campaigns."""
    text = [
        "| fault | campaigns | failed | reached | held | failed robots | smallest gap mm "
        "| stops apart ms | cpu s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in (*KINDS, "all"):
        of_kind = [line for line in lines if kind in (line["kind"], "all")]
        if not of_kind:
            continue
        ends: Counter[str] = Counter()
        for line in of_kind:
            ends.update(line["outcomes"])
        text.append(
            f"| {kind} | {len(of_kind)} | {sum(bool(line['wrong']) for line in of_kind)} "
            f"| {ends['reached']} | {ends['held']} | {ends['failed']} "
            f"| {min(line['gap_mm'] for line in of_kind):.4f} "
            f"| {max(line['apart_ms'] for line in of_kind):.2f} "
            f"| {np.mean([line['cpu_s'] for line in of_kind]):.2f} |"
        )
    return "\n".join(text) + "\n"


if __name__ == "__main__":
    sys.exit(main())

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
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from fiber_bus_bridge import LoadedPlan, PlanResult, Session, SessionState, addresses_of
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import (
    FaultKind,
    Movements,
    ObservedBuses,
    Positioners,
    SimulatedBuses,
    TrueMotion,
    draw_faults,
)
from fiber_core.clearance import Safety, certify_arms, neighbour_pairs
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_positioners import Orders, make_orders, random_problem

__all__ = ["KINDS", "Campaign", "run_campaign"]

KINDS = ("none", *(kind.name.lower() for kind in FaultKind), "mixed")
_FIELDS = 200  # random problems that the campaigns share
_FAULTS_BEGIN_S = 2.5  # faults begin before this time
_LONGEST_S = 60.0  # simulated time after which a campaign counts as endless
SAFETY = Safety()
_Task: TypeAlias = tuple[str, int, int]  # kind, seed, number of robots
_Line: TypeAlias = dict[str, Any]


@dataclass
class Campaign:
    """Result of a campaign; an empty `wrong` means that it passed.

    Args:
        kind: one of KINDS.
        seed: seed of all random numbers.
        wrong: events that must never happen and did.
        log: the course of the campaign, in words.
        outcomes: number of robots by outcome.
        gap_mm: smallest true gap between outlines [mm].
        apart_ms: longest time between the first and the last stop of one motion [ms].
        ended_s: simulated end time [s].
        tap: the captured traffic, if requested.
    """

    kind: str
    seed: int
    wrong: list[str] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    outcomes: Counter[str] = field(default_factory=Counter)
    gap_mm: float = np.inf
    apart_ms: float = 0.0
    ended_s: float = 0.0
    tap: Tap | None = None


@cache
def _field(robots: int, number: int) -> Orders:
    """Orders of a random problem; every second one has ten-bit addresses."""
    plane = preset("desi", robots)
    rows = np.arange(plane.n)
    plane = replace(plane, bus=rows // 16, address=(8 if number % 2 else 200) + rows % 16)
    return make_orders(random_problem(plane, np.random.default_rng([number, 77])))


@dataclass
class _Setup:
    """A session with simulated robots, and the phases of its plans so far."""

    orders: Orders
    session: Session
    truth: TrueMotion
    stop_s: float  # simulated time of an operator's stop, inf for none
    phases: list[LoadedPlan] = field(default_factory=list)


def run_campaign(kind: str, seed: int, robots: int = 127, capture: Path | None = None) -> Campaign:
    """Run one campaign; everything wrong is in the returned value.

    Args:
        kind: one of KINDS.
        seed: seed of all random numbers.
        robots: number of robots.
        capture: folder for the captured traffic.
    """
    campaign = Campaign(kind, seed)
    try:
        _run(campaign, robots, capture)
    except Exception as error:  # any exception is a finding
        campaign.wrong.append(f"crashed: {type(error).__name__}: {error}")
    if campaign.tap is not None and capture is not None:
        campaign.tap.write(capture)
    return campaign


def _run(campaign: Campaign, robots: int, capture: Path | None) -> None:
    setup = _set_up(campaign, robots, capture is not None)
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
        _judge_outcomes(campaign, name, t, session, session.take_result())
    _judge_motion(campaign, setup, max(t, session.transactions.now_s) + 1.0)


def _set_up(campaign: Campaign, robots: int, with_tap: bool) -> _Setup:
    """Draw the faults of a campaign and make its session."""
    rng = np.random.default_rng([KINDS.index(campaign.kind), campaign.seed])
    orders = _field(robots, campaign.seed % _FIELDS)
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
    return _Setup(orders, session, truth, stop_s)


def _start(campaign: Campaign, setup: _Setup, name: str, t: float) -> float | None:
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


def _follow(setup: _Setup, t: float) -> float:
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


def _judge_motion(campaign: Campaign, setup: _Setup, t: float) -> None:
    """Judge the true motion until time t [s]: orders, stops and gaps."""
    plane = setup.orders.plane
    campaign.ended_s = t
    moves = setup.truth.movements(t)
    _judge_movements(campaign, moves, setup.phases)
    campaign.apart_ms = 1e3 * _apart_s(moves, setup.phases, setup.orders.units.tick_s)
    motion = setup.truth.motion(t)
    exact = Safety(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    truth = certify_arms(plane, motion, exact, neighbour_pairs(plane))
    campaign.gap_mm = truth.min_gap_mm
    if truth.unsafe.any():
        at = int(np.argmin(truth.gap_mm))
        campaign.wrong.append(
            f"arms touch: robots {truth.pairs[at].tolist()} at {truth.time_s[at]:.4f} s, "
            f"gap {truth.gap_mm[at]:.4f} mm"
        )


def _kinds(kind: str, rng: np.random.Generator) -> list[FaultKind]:
    if kind == "none":
        return []
    if kind == "mixed":
        return [FaultKind(k) for k in rng.integers(1, len(FaultKind) + 1, rng.integers(2, 6))]
    return [FaultKind[kind.upper()]]


def _judge_outcomes(
    campaign: Campaign, name: str, t: float, session: Session, result: PlanResult | None
) -> None:
    """Check that every robot has exactly one outcome and one reason."""
    if result is None or not len(result.outcome) == len(result.reason) == session.plane.n:
        campaign.wrong.append(f"{name}: not every robot has one outcome")
        return
    counts = Counter(Outcome(o).name.lower() for o in result.outcome)
    campaign.outcomes += counts
    campaign.log.append(f"{t:.4f} s: {name} ended {session.state.name}: {dict(counts)}")


def _judge_movements(campaign: Campaign, moves: Movements, phases: list[LoadedPlan]) -> None:
    """Check that each movement is, from first to last segment, a verified order."""
    for k, row in enumerate(moves.row):
        if not moves.ended_s[k] > moves.started_s[k]:
            if np.isnan(moves.ended_s[k]):
                campaign.wrong.append(f"robot {row} never came to rest")
            continue  # cancelled in its countdown
        late = [abs(moves.started_s[k] - phase.start_s) for phase in phases]
        phase = phases[int(np.argmin(late))] if late else None
        if phase is None or min(late) > SAFETY.start_skew_s or not phase.started[row]:
            campaign.wrong.append(f"robot {row} moved at {moves.started_s[k]:.4f} s unverified")
            continue
        wire = phase.motion
        for joint in range(2):
            part = slice(*wire.offsets[2 * row + joint : 2 * row + joint + 2])
            count = moves.counts[k, joint]
            same = (
                count == part.stop - part.start
                and np.array_equal(moves.ticks[k, joint, :count], wire.ticks[part])
                and np.array_equal(moves.velocity[k, joint, :count], wire.velocity[part])
            )
            if not same:
                campaign.wrong.append(f"robot {row} executed another order than was verified")


def _apart_s(moves: Movements, phases: list[LoadedPlan], tick_s: float) -> float:
    """Longest time between the first and the last stop of a phase that was broken off [s]."""
    used = np.arange(moves.ticks.shape[2]) < moves.counts[..., None]
    lasts = (moves.ticks * used).sum(axis=2)
    broken = moves.ended_s > moves.started_s
    broken &= moves.ended_s < moves.started_s + (1 - 1e-3) * lasts.max(axis=1) * tick_s
    apart = [0.0]
    for phase in phases:
        of_phase = broken & (np.abs(moves.started_s - phase.start_s) <= SAFETY.start_skew_s)
        apart.append(float(np.ptp(moves.ended_s[of_phase])) if of_phase.any() else 0.0)
    return max(apart)


def _work(task: _Task) -> _Line:
    begin = time.process_time()
    campaign = run_campaign(*task)
    return {
        "kind": campaign.kind,
        "seed": campaign.seed,
        "robots": task[2],
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
    done = {(line["kind"], line["seed"], line["robots"]) for line in lines}
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
    tasks: list[tuple[float, str, int, int]] = []
    for kind, count in counts.items():
        # spread evenly, for every number of campaigns
        places = (np.arange(count) + 0.5) / max(count, 1)
        tasks += [(p, kind, args.seed + k, args.robots) for k, p in enumerate(places.tolist())]
    return [task[1:] for task in sorted(tasks, key=lambda task: task[0])]


def _replay(args: argparse.Namespace) -> int:
    kind, seed = args.replay.split(":")
    campaign = run_campaign(kind, int(seed), args.robots, args.capture)
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

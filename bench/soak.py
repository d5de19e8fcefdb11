#!/usr/bin/env python3
"""Run campaigns of seeded faults on a small plane and judge each by how robots really moved.

A campaign configures a plane, carries out one planned reconfiguration and one HOME while
things go wrong, and ends. The judge believes nothing that robots report: it watches their true
motion in continuous time, and compares what they ran with what was verified. A campaign is its
kind and its seed; `--replay KIND:SEED` runs it again and tells what happened. With `--lines FILE`
each campaign leaves a line of JSON there and is not run a second time, and the table is of all
lines.
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

import numpy as np

from fiber_bus_bridge import Session, SessionConfig, SessionState, addresses_of
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import (
    FaultKind,
    Positioners,
    SimulatedBuses,
    TrueMotion,
    draw_faults,
)
from fiber_core.clearance import Safety, certify, neighbour_pairs
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_positioners import Orders, make_orders, random_problem

__all__ = ["KINDS", "Campaign", "run_campaign"]

KINDS = ("none", *(kind.name.lower() for kind in FaultKind), "mixed")
_FIELDS = 200  # random fields that campaigns share
_FAULTS_BEGIN_S = 2.5  # before this time
_LONGEST_S = 60.0  # simulated; a campaign that takes longer does not end
SAFETY = Safety()


@dataclass
class Campaign:
    """What came of a campaign; no `wrong` means that it passed.

    Args:
        kind: one of KINDS.
        seed: of everything drawn.
        wrong: what must never happen and did.
        told: what happened, in words.
        outcomes: how often robots ended as they did.
        gap_mm: smallest true gap between outlines [mm].
        apart_ms: longest time between the first and the last stop of a motion broken off [ms].
        ended_s: when it was over, simulated [s].
        tap: what went over the buses, if it was asked for.
    """

    kind: str
    seed: int
    wrong: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    outcomes: Counter = field(default_factory=Counter)
    gap_mm: float = np.inf
    apart_ms: float = 0.0
    ended_s: float = 0.0
    tap: Tap | None = None


@cache
def _field(robots: int, number: int) -> Orders:
    """A random field, planned and discretized; every other one has ten-bit addresses."""
    plane = preset("desi", robots)
    rows = np.arange(plane.n)
    plane = replace(plane, bus=rows // 16, address=(8 if number % 2 else 200) + rows % 16)
    return make_orders(random_problem(plane, np.random.default_rng([number, 77])))


class _Seen:
    """Buses under the eyes of a record of motion."""

    def __init__(self, buses, record):
        self._buses, self._record = buses, record
        self.recover, self.alert_lines = buses.recover, buses.alert_lines

    def transfer(self, *batch):
        replies = self._buses.transfer(*batch)
        self._record.observe()
        return replies


def run_campaign(kind: str, seed: int, robots: int = 127, capture: Path | None = None) -> Campaign:
    """Run one campaign; whatever is wrong is in what it returns.

    With `capture`, a folder, what went over the buses is written there.
    """
    campaign = Campaign(kind, seed)
    try:
        _run(campaign, robots, capture)
    except Exception as error:  # whatever escapes is a finding
        campaign.wrong.append(f"crashed: {type(error).__name__}: {error}")
    if campaign.tap is not None:
        campaign.tap.write(capture)
    return campaign


def _run(campaign, robots, capture):
    rng = np.random.default_rng([KINDS.index(campaign.kind), campaign.seed])
    base = _field(robots, campaign.seed % _FIELDS)
    plane, units = base.plane, base.units
    to = addresses_of(plane)
    faults = draw_faults(_kinds(campaign.kind, rng), to.bus, to.address, _FAULTS_BEGIN_S, rng)
    campaign.told += [f"fault: {f}" for f in (*faults.lines, *faults.noise, *faults.stretches)]
    campaign.told += [f"event: {e}" for e in faults.events]
    robots = Positioners(
        to, plane.ids, units.quantum_prad, base.counts,
        clock_ppm=rng.uniform(-20, 20, plane.n), start_skew_s=rng.uniform(0, 20e-6, plane.n),
    )  # fmt: skip
    record = TrueMotion(robots, units.quantum_rad)
    buses = SimulatedBuses(robots, faults=faults, rng=rng)
    if capture is not None:
        buses = campaign.tap = Tap(buses, buses.timing)
    backend = _Seen(buses, record)
    session = Session(plane, units, SAFETY, backend, units.to_angles(base.counts), SessionConfig())
    uploads = []
    stop_s = rng.uniform(0, _FAULTS_BEGIN_S) if rng.random() < 0.1 else np.inf
    t = session.configure(0.0)
    campaign.told.append(f"{t:.4f} s: configured {session.known.sum()} of {plane.n}")
    for name in ("plan", "home"):
        if session.state is SessionState.STOPPED:
            t = session.clear(t)
        if session.state is not SessionState.IDLE:
            campaign.told.append(f"{t:.4f} s: no {name} while {session.state.name}")
            break
        if name == "plan":
            session.submit(base.wire, base.targets)
            t = max(t, session.start(t))
        else:
            t = max(t, session.configure(t))
            if session.state is SessionState.STOPPED:  # somebody is in FAULT
                t = max(t, session.clear(t))
            if session.state is not SessionState.IDLE:
                campaign.told.append(f"{t:.4f} s: no home while {session.state.name}")
                break
            t = max(t, session.home(t))
        while session.state is SessionState.MOVING:
            t = t + 0.1
            if t > stop_s:
                stop_s = np.inf
                t = max(t, session.stop(t))
            else:
                t = max(t, session.advance(t))
            if t > _LONGEST_S:
                campaign.wrong.append("does not end")
                return
        uploads += session.loaded_plans
        if len(session.loaded_plans) > 1:
            campaign.told.append(f"{t:.4f} s: went on {len(session.loaded_plans) - 1} times")
        result = session.take_result()
        _judge_outcomes(campaign, name, t, session, result)
    t = max(t, session.transactions.now_s) + 1.0
    campaign.ended_s = t
    runs = record.movements(t)
    _judge_runs(campaign, runs, uploads)
    campaign.apart_ms = 1e3 * _apart_s(runs, uploads, units.tick_s)
    truth = certify(plane, record.motion(t), Safety(0.0, 0.0, 0.0, 0.0), neighbour_pairs(plane))
    campaign.gap_mm = truth.min_gap_mm
    if truth.unsafe.any():
        at = int(np.argmin(truth.gap_mm))
        campaign.wrong.append(
            f"arms touch: robots {truth.pairs[at].tolist()} at {truth.time_s[at]:.4f} s, "
            f"gap {truth.gap_mm[at]:.4f} mm"
        )


def _kinds(kind, rng):
    if kind == "none":
        return []
    if kind == "mixed":
        return [FaultKind(k) for k in rng.integers(1, len(FaultKind) + 1, rng.integers(2, 6))]
    return [FaultKind[kind.upper()]]


def _judge_outcomes(campaign, name, t, session, result):
    if result is None or not len(result.outcome) == len(result.reason) == session.plane.n:
        campaign.wrong.append(f"{name}: not every robot has one outcome")
        return
    counts = Counter(Outcome(o).name.lower() for o in result.outcome)
    campaign.outcomes += counts
    campaign.told.append(f"{t:.4f} s: {name} ended {session.state.name}: {dict(counts)}")


def _judge_runs(campaign, runs, uploads):
    """Whoever moved ran, from first to last, what was verified for it."""
    for k, row in enumerate(runs.row):
        if not runs.ended_s[k] > runs.started_s[k]:
            if np.isnan(runs.ended_s[k]):
                campaign.wrong.append(f"robot {row} never came to rest")
            continue  # called off in its countdown
        late = [abs(runs.started_s[k] - u.start_s) for u in uploads]
        upload = uploads[int(np.argmin(late))] if late else None
        if upload is None or min(late) > SAFETY.start_skew_s or not upload.started[row]:
            campaign.wrong.append(f"robot {row} moved at {runs.started_s[k]:.4f} s unverified")
            continue
        wire = upload.motion
        for joint in range(2):
            part = slice(*wire.offsets[2 * row + joint : 2 * row + joint + 2])
            count = runs.counts[k, joint]
            same = (
                count == part.stop - part.start
                and np.array_equal(runs.ticks[k, joint, :count], wire.ticks[part])
                and np.array_equal(runs.velocity[k, joint, :count], wire.velocity[part])
            )
            if not same:
                campaign.wrong.append(f"robot {row} ran another order than was verified")


def _apart_s(runs, uploads, tick_s):
    """How far apart in time robots of one motion stopped that did not come to its end [s]."""
    lasts = (runs.ticks * (np.arange(runs.ticks.shape[2]) < runs.counts[..., None])).sum(axis=2)
    broken = runs.ended_s > runs.started_s
    broken &= runs.ended_s < runs.started_s + (1 - 1e-3) * lasts.max(axis=1) * tick_s
    apart = [0.0]
    for upload in uploads:
        of_it = broken & (np.abs(runs.started_s - upload.start_s) <= SAFETY.start_skew_s)
        apart.append(float(np.ptp(runs.ended_s[of_it])) if of_it.any() else 0.0)
    return max(apart)


def _work(task):
    begin = time.process_time()
    campaign = run_campaign(*task)
    line = {
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
    return line


def _commit():
    """The commit that is run, with a mark when files differ from it."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return told.stdout.strip() or "unknown"


def _read(file):
    """The lines of earlier runs."""
    if file is None or not file.exists():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def parse(argv):
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--campaigns", type=int, default=20, help="of each kind")
    parser.add_argument("--mixed", type=int, help="of the mixed kind, if not as many")
    parser.add_argument("--kind", choices=KINDS, nargs="+", default=list(KINDS))
    parser.add_argument("--seed", type=int, default=0, help="of the first campaign of each kind")
    parser.add_argument("--robots", type=int, default=127)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--lines", type=Path, help="file to go on with, a line for each campaign")
    parser.add_argument("--out", type=Path, help="file for the table, in markdown")
    parser.add_argument("--replay", metavar="KIND:SEED", help="run one campaign and tell of it")
    parser.add_argument("--capture", type=Path, help="folder for the bytes of a replay")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns 1 when a campaign failed."""
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
            for words in line["wrong"]:
                print(f"{line['kind']}:{line['seed']} {words}", flush=True)
            failed += bool(line["wrong"])
            if sys.stderr.isatty() or number % 100 == 0:
                end = "\r" if sys.stderr.isatty() else "\n"
                told = f"{number} of {len(tasks)} campaigns, {failed} failed"
                print(told, end=end, file=sys.stderr, flush=True)
    text = table(lines)
    print(text)
    print(json.dumps({"campaigns": len(lines), "failed": failed, "robots": args.robots}))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(text, encoding="utf-8")
    return 1 if failed else 0


def _tasks(args):
    """Seed by seed through all kinds, so that a run that is cut off has had all of them."""
    counts = {kind: args.campaigns for kind in args.kind}
    if args.mixed is not None and "mixed" in counts:
        counts["mixed"] = args.mixed
    tasks = []
    for kind, count in counts.items():
        # spread evenly, whatever their number
        places = (np.arange(count) + 0.5) / max(count, 1)
        tasks += [(p, kind, args.seed + k, args.robots) for k, p in enumerate(places.tolist())]
    return [task[1:] for task in sorted(tasks, key=lambda task: task[0])]


def _replay(args):
    kind, seed = args.replay.split(":")
    campaign = run_campaign(kind, int(seed), args.robots, args.capture)
    print("\n".join(campaign.told))
    print(f"smallest true gap {campaign.gap_mm:.4f} mm, stops {campaign.apart_ms:.3f} ms apart")
    print("\n".join(campaign.wrong) or "nothing wrong")
    return 1 if campaign.wrong else 0


def table(lines) -> str:
    """Return a table of campaigns in markdown, a row for each kind, from their lines."""
    text = [
        "| fault | campaigns | failed | reached | held | failed robots | smallest gap mm "
        "| stops apart ms | cpu s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in (*KINDS, "all"):
        of_it = [line for line in lines if kind in (line["kind"], "all")]
        if not of_it:
            continue
        ends = sum((Counter(line["outcomes"]) for line in of_it), Counter())
        text.append(
            f"| {kind} | {len(of_it)} | {sum(bool(line['wrong']) for line in of_it)} "
            f"| {ends['reached']} | {ends['held']} | {ends['failed']} "
            f"| {min(line['gap_mm'] for line in of_it):.4f} "
            f"| {max(line['apart_ms'] for line in of_it):.2f} "
            f"| {np.mean([line['cpu_s'] for line in of_it]):.2f} |"
        )
    return "\n".join(text) + "\n"


if __name__ == "__main__":
    sys.exit(main())

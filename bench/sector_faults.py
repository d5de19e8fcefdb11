#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Kill, pause and cut off the hosts of a plane of sectors at random moments; judge by the truth.

Each host is a process in a network namespace of its own, with a clock of its own; its robots are in
a plant that outlives it. In each run one thing happens in one stage of a reconfiguration: a sector
or the coordinator is killed or paused, a sector is cut off, its clock jumps or drifts, a robot
jams, messages are lost, doubled and late. Then the next reconfiguration must come about. The plants
tell what the robots really did. Needs the rights to make network namespaces.

The clocks run in slow motion, --scale seconds in one of this machine.
"""

import argparse
import json
import multiprocessing
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
from sector_hosts import Faults, Namespaces, Socket, enter
from sectors import judge, problem_of

from fiber_bus_bridge import Session, SessionConfig, SessionState, addresses_of
from fiber_bus_bridge.plant import PlantBuses, PlantTruth
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.plant.rehearsal import rehearse
from fiber_bus_bridge.plant.server import PlantServer, listen
from fiber_bus_bridge.simulation import EVENT, Event, SimulationConfig, simulated_buses
from fiber_bus_bridge.simulation import Faults as RobotFaults
from fiber_core.clearance import Safety
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_positioners import make_orders
from fiber_sectors import Terms
from fiber_sectors.exchange import Pace
from fiber_sectors.inbox import Inbox
from fiber_sectors.paced import PacedBuses
from fiber_sectors.sector import Sector, certified_elsewhere
from fiber_sectors.sectored_session import SectoredSession
from fiber_sectors.shares import part_of

__all__ = ["KINDS", "Campaign", "main"]

KINDS = (
    "sector killed", "sector paused", "coordinator killed", "coordinator paused", "cut off",
    "clock jumps", "clock drifts", "robot jams", "bad network", "nothing",
)  # fmt: skip
STAGES = ("configuring", "loading", "counting", "moving")
_LASTS_S = {"configuring": 0.1, "loading": 0.3, "counting": 0.06, "moving": 1.2}  # of the clocks
_CALL_S, _END_S = 3.0, 90.0
_Line: TypeAlias = dict[str, Any]
_CONTEXT = multiprocessing.get_context("fork")


def _plant(path: Path, problem: Problem, number: int, scale: float, jam_s: float) -> None:
    part, units = part_of(problem.plane, number), WireUnits.for_plane(problem.plane)
    begin = problem.start[problem.plane.sector == number]
    buses = simulated_buses(part, units, begin, SimulationConfig(seed=number))
    if np.isfinite(jam_s):
        events = np.array([(0, jam_s, int(Event.JAM_THETA), 0)], dtype=EVENT)
        buses = type(buses)(buses.positioners, buses.timing, RobotFaults(events=events))
    plant = Plant(buses, units.quantum_rad, scale)
    listener, _ = listen(path)
    PlantServer(plant, part.ids, listener, time.monotonic).serve()


class _HostClock:
    """The clock of a host: ahead of the true one, at another rate, and it may jump."""

    def __init__(self, scale: float, ahead_s: float, rate_ppm: float, jump: tuple[float, float]):
        self._scale, self._ahead_s, self._rate, self._jump = scale, ahead_s, 1e-6 * rate_ppm, jump

    def true_s(self) -> float:
        return self._scale * time.monotonic()

    def __call__(self) -> float:
        at_s, by_s = self._jump
        t = self.true_s()
        return self._ahead_s + t * (1.0 + self._rate) + (by_s if t >= at_s else 0.0)


class _TrueBuses(PacedBuses):
    """Buses that live by true time, used by a host that lives by its clock."""

    def __init__(self, buses: PlantBuses, clock: _HostClock, scale: float):
        super().__init__(buses, clock, lambda clock_s: time.sleep(clock_s / scale))
        self._host_clock = clock

    def transfer(self, frames, read_bytes, not_before_s):
        self._origin_s = self._host_clock() - self._host_clock.true_s()
        return super().transfer(frames, read_bytes, not_before_s)


def _sector(
    number: int, problem: Problem, plant: Path, spaces: Namespaces, line: _Line, scale: float
) -> None:
    enter(spaces.name(number))
    part, units = part_of(problem.plane, number), WireUnits.for_plane(problem.plane)
    mine = line["victim"] == number
    jump = (line["jump_at_s"], line["jump_s"]) if mine else (np.inf, 0.0)
    clock = _HostClock(scale, line["ahead_s"][number], line["rate_ppm"][number], jump)
    timing = simulated_buses(part, units, problem.start[: part.n], SimulationConfig()).timing
    buses = PlantBuses(plant, part.ids, addresses_of(part), timing)
    begin = problem.start[problem.plane.sector == number]
    session = Session(
        part, units, Safety(), _TrueBuses(buses, clock, scale), begin, SessionConfig(resumes=0),
        certified_elsewhere,
    )  # fmt: skip
    own, other = spaces.address(number), spaces.address(number, ours=True)
    rng = np.random.default_rng([line["number"], number, os.getpid()])
    link = Socket(own, other, Faults(*line["faults"]), rng, scale)
    sector = Sector(number, session, Terms(), time.time_ns(), link.send, clock)
    link.listen(sector.inbox.put)
    sector.serve(lambda: False)


class _Links:
    """The connections of the coordinator with its sectors, by datagrams."""

    def __init__(self, spaces: Namespaces, line: _Line, scale: float):
        rng = np.random.default_rng([line["number"], 99, os.getpid()])
        self._came = Inbox()
        self._links = [
            Socket(spaces.address(k, ours=True), spaces.address(k), Faults(*line["faults"]), rng,
                   scale)
            for k in range(spaces.number)
        ]  # fmt: skip
        for link in self._links:
            link.listen(self._came.put)

    def send(self, sector: int, data: bytes) -> None:
        self._links[sector].send(data)

    def receive(self, wait_s: float) -> list[bytes]:
        return self._came.take(wait_s)

    def left(self, sector: int) -> bool:
        return False


def _coordinator(
    pipe: Connection, problem: Problem, orders, spaces: Namespaces, line: _Line, scale: float
) -> None:
    clock = _HostClock(scale, 0.0, 0.0, (np.inf, 0.0))
    session = SectoredSession(
        problem.plane, WireUnits.for_plane(problem.plane), Safety(), problem.start,
        SessionConfig(), Terms(), _Links(spaces, line, scale),
        Pace(clock, 5.0, _CALL_S / scale * 0.5),
    )  # fmt: skip
    conductor, go = session.sectors.conductor, session.sectors.conductor.go

    def counting(*given: float) -> None:
        go(*given)
        pipe.send(("counting", None))

    conductor.go = counting  # type: ignore[method-assign]
    if orders is not None:
        pipe.send(("configuring", None))
        session.configure(clock())
        pipe.send(("loading", None))
        try:
            session.submit(orders.wire, problem.targets)
        except Exception as error:  # robots of a lost sector, a stop: the next one begins anew
            pipe.send(("ended", [str(error)[:80]]))
        else:
            pipe.send(("ended", _carry_out(session, clock, pipe)))
    pipe.recv()  # all hosts are back
    time.sleep(0.5 / scale)  # robots without a host come to rest
    for _ in range(3):
        if session.state is not SessionState.UNCONFIGURED:
            session.clear(clock())
        session.configure(clock())
    if session.state is SessionState.STOPPED:
        session.clear(clock())
    enabled = session.known & ~session.robots["lost"]
    session.enable(enabled)
    drawn = random_field(session.plane, np.random.default_rng(1), start=session.angles).problem
    session.submit(make_orders(drawn).wire, drawn.targets)
    outcome = _carry_out(session, clock, pipe)
    pipe.send(("next", (int(enabled.sum()), outcome, session.sectors.why)))


def _carry_out(session: SectoredSession, clock: _HostClock, pipe: Connection) -> list[int]:
    session.start(clock())
    if session.state is SessionState.MOVING:
        pipe.send(("moving", None))
    until_s = time.monotonic() + _END_S
    while session.state is SessionState.MOVING and time.monotonic() < until_s:
        session.advance(clock() + 0.1)
    return [] if session.result is None else session.result.outcome.tolist()


class Campaign:
    """The hosts of a plane, and the judge of its runs."""

    def __init__(self, robots: int, sectors: int, scale: float, seed: int, folder: Path):
        self._problem, self._sectors = problem_of(robots, sectors, seed), sectors
        self._scale, self._seed, self._folder = scale, seed, folder
        self._orders = make_orders(self._problem)
        rehearse()
        self._spaces = Namespaces(sectors)

    def close(self) -> None:
        """Remove the hosts."""
        self._spaces.close()

    def _draw(self, number: int, kind: str, stage: str) -> _Line:
        rng = np.random.default_rng([self._seed, number])
        now_s = self._scale * time.monotonic()
        bad = kind == "bad network"
        drifts_ppm = 80.0 if kind == "clock drifts" else 20.0
        return {
            "number": number, "kind": kind, "stage": stage,
            "victim": int(rng.integers(self._sectors)),
            "moment": float(rng.random()), "pause_s": float(10 ** rng.uniform(-2.0, 0.0)),
            "ahead_s": rng.uniform(-1000.0, 1000.0, self._sectors).tolist(),
            "rate_ppm": (rng.choice([-1, 1], self._sectors) * drifts_ppm / 2).tolist(),
            "jump_at_s": now_s + rng.uniform(0.5, 2.5) if kind == "clock jumps" else np.inf,
            "jump_s": float(rng.choice([-1, 1]) * 10 ** rng.uniform(-3.0, 0.0)),
            "jam_s": now_s + rng.uniform(1.0, 3.0) if kind == "robot jams" else np.inf,
            "faults": (float(rng.uniform(0, 0.05)), 0.05, float(rng.choice([0.0, 3e-4, 2e-3])))
            if bad else (0.0, 0.0, 0.0),
        }  # fmt: skip

    def run(self, number: int) -> _Line:
        """Do one run; return what happened."""
        cells = [(kind, stage) for kind in KINDS for stage in STAGES]
        order = np.random.default_rng([self._seed, number // len(cells)]).permutation(len(cells))
        line = self._draw(number, *cells[order[number % len(cells)]])
        paths = [self._folder / f"p{number}_{k}" for k in range(self._sectors)]
        plants = [
            self._begin(_plant, path, self._problem, k, self._scale,
                        line["jam_s"] if k == line["victim"] else np.inf)
            for k, path in enumerate(paths)
        ]  # fmt: skip
        self._paths, self._line = paths, line
        self._hosts = {k: self._new_sector(k) for k in range(self._sectors)}
        self._struck = threading.Event()
        try:
            self._conduct(line)
            truths = []
            for path in paths:
                with PlantTruth(path) as truth:
                    truths.append(truth.since(0))
        finally:
            for process in [*self._hosts.values(), *plants]:
                process.kill()
                process.join()
        rows = [np.flatnonzero(self._problem.plane.sector == k) for k in range(self._sectors)]
        units = WireUnits.for_plane(self._problem.plane)
        found = [(each.start, each.moves, each.verified, each.now_s, 0.0) for each in truths]
        judged = judge(self._problem.plane, units, rows, found)
        line |= {
            "contacts": judged.contacts, "unverified": judged.unverified,
            "start_skew_ms": round(judged.start_skew_ms, 4), "stop_ms": round(judged.stop_ms, 3),
        }  # fmt: skip
        return line

    def _begin(self, target, *given):
        process = _CONTEXT.Process(target=target, args=given, daemon=True)
        process.start()
        return process

    def _new_sector(self, k: int):
        return self._begin(
            _sector, k, self._problem, self._paths[k], self._spaces, self._line, self._scale
        )

    def _new_coordinator(self, orders):
        pipe, theirs = _CONTEXT.Pipe()
        given = theirs, self._problem, orders, self._spaces, self._line, self._scale
        self._hosts[-1] = self._begin(_coordinator, *given)
        theirs.close()
        return pipe

    def _conduct(self, line: _Line) -> None:
        time.sleep(0.3)  # sockets are bound
        pipe, n = self._new_coordinator(self._orders), self._problem.plane.n
        first, begun = self._hear_until(pipe, "ended", line)
        if not begun.is_alive() and begun.ident is None:
            self._strike(line)  # its stage never came
        else:
            begun.join()
        killed = line["kind"] == "coordinator killed"
        if killed:
            pipe = self._new_coordinator(None)
            time.sleep(0.3)
        pipe.send("go on")
        then, _ = self._hear_until(pipe, "next", line)
        enabled, after, line["next_why"] = then if then is not None else (0, [], "no end")
        line["reached"] = 0 if first is None else first.count(int(Outcome.REACHED))
        line["next_enabled"], line["next_reached"] = enabled, after.count(int(Outcome.REACHED))
        text = "" if first is None or len(first) != 1 else str(first[0])
        line["refused"] = text
        ended = killed or bool(text) or (first is not None and len(first) == n)
        line["without_outcome"] = int(not ended) * n + n - len(after)

    def _hear_until(self, pipe: Any, what: str, line: _Line):
        strike = threading.Thread(target=self._strike_later, args=[line])
        until_s = time.monotonic() + 2 * _END_S
        while time.monotonic() < until_s:
            try:
                if not pipe.poll(0.5):
                    if not self._hosts[-1].is_alive():
                        break
                    continue
                stage, content = pipe.recv()
            except (EOFError, OSError):
                break
            if stage == line["stage"] and what == "ended" and strike.ident is None:
                strike.start()
            if stage == what:
                return content, strike
        return None, strike

    def _strike_later(self, line: _Line) -> None:
        time.sleep(line["moment"] * _LASTS_S[line["stage"]] / self._scale)
        self._strike(line)

    def _strike(self, line: _Line) -> None:
        kind, pause_s, k = line["kind"], line["pause_s"] / self._scale, line["victim"]
        victim = self._hosts[-1 if kind.startswith("coordinator") else k]
        pid = victim.pid or 0
        if kind.endswith("killed"):
            victim.kill()
            victim.join()
            if kind == "sector killed":
                time.sleep(pause_s)
                self._hosts[k] = self._new_sector(k)
        elif kind.endswith("paused"):
            os.kill(pid, signal.SIGSTOP)
            time.sleep(pause_s)
            os.kill(pid, signal.SIGCONT)
        elif kind == "cut off":
            self._spaces.cut(k)
            time.sleep(pause_s)
            self._spaces.cut(k, up=True)


def main(argv: list[str] | None = None) -> int:
    """Run the campaign; return 1 when a promise is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--sectors", type=int, default=3)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scale", type=float, default=0.1)
    args = parser.parse_args(argv)
    total: Counter[str] = Counter()
    skew_ms = stop_ms = 0.0
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(args.robots, args.sectors, args.scale, args.seed, Path(folder))
        try:
            for number in range(args.first, args.first + args.runs):
                line = campaign.run(number)
                print(json.dumps(line), flush=True)
                for name in ("contacts", "unverified", "without_outcome", "reached",
                             "next_enabled", "next_reached"):  # fmt: skip
                    total[name] += line[name]
                skew_ms, stop_ms = (
                    max(skew_ms, line["start_skew_ms"]),
                    max(stop_ms, line["stop_ms"]),
                )
        finally:
            campaign.close()
    bound_ms = 1e3 * Safety().border_start_skew_s
    summary = {
        "runs": args.runs, "robots": args.robots, "sectors": args.sectors, "scale": args.scale,
        **total, "start_skew_ms_max": skew_ms, "start_skew_bound_ms": bound_ms,
        "stop_ms_max": stop_ms,
    }  # fmt: skip
    print(json.dumps(summary))
    broken = total["contacts"] or total["unverified"] or total["without_outcome"]
    return 1 if broken or skew_ms > bound_ms else 0


if __name__ == "__main__":
    sys.exit(main())

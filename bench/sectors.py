#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Reconfigure a plane of sectors, each in a process of its own; print one JSON line.

Buses and robots are simulated; their time goes on when all sectors have come to the same instant,
so that start and stop are measured in the time of the robots, however busy this machine is. With
--campaigns the plane meets random faults: a robot jams, a process of a sector dies, or messages are
lost. What is judged is the true motion. The traffic is that of the messages between the coordinator
and the sector that has most of it, without headers of the network.
"""

import argparse
import json
import multiprocessing
import pickle
import resource
import sys
import threading
import time
from dataclasses import replace
from multiprocessing.connection import Connection, wait

import numpy as np
from sector_judge import Moved, Start, Verdict, broken, judge
from sector_plane import start_of

from fiber_bus_bridge import PlanResult, Session, SessionConfig, SessionState
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.simulation import (
    EVENT,
    Event,
    Faults,
    SimulationConfig,
    simulated_buses,
)
from fiber_core.clearance import Safety
from fiber_core.fields import random_problem
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_positioners import make_orders
from fiber_sectors import Terms
from fiber_sectors.exchange import Pace
from fiber_sectors.sector import Sector, certified_elsewhere
from fiber_sectors.sectored_session import SectoredSession
from fiber_sectors.shares import part_of, with_sectors

__all__ = ["main", "problem_of"]

_KILL, _TRUTH = b"KILL", b"TRTH"
_PATIENCE_S = 20.0
_ON_BUS = 500  # robots, at most


class _Buses:
    """The buses of a plant in this process."""

    def __init__(self, plant: Plant):
        self._plant = plant

    def transfer(self, frames, read_bytes, not_before_s):
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (len(frames),))
        return self._plant.transfer(frames, read, not_before_s, 0.0)

    def recover(self, bus, recovery, t):
        return self._plant.recover(bus, recovery, t, 0.0)

    def alert_lines(self, t):
        return self._plant.alert_lines(t, 0.0)


class _Killed(Exception):
    """The process of this sector shall behave as one that was killed."""


def _host(connection: Connection, plane, start, number: int, seed: int, fault) -> None:
    """Run one sector until its connection ends."""
    part, units = part_of(plane, number), WireUnits.for_plane(plane)
    begin = start[plane.sector == number]
    buses = simulated_buses(part, units, begin, SimulationConfig(seed=seed + number))
    if fault is not None:
        row, at_s, event = fault
        events = np.array([(row, at_s, int(event), 0)], dtype=EVENT)
        positioners = buses.positioners
        buses = type(buses)(positioners, buses.timing, Faults(events=events))
    plant = Plant(buses, units.quantum_rad, 0.0, kept=200_000)
    plant.open(0.0)
    config, killed, lock = SessionConfig(resumes=0), threading.Event(), threading.Lock()
    session = Session(part, units, Safety(), _Buses(plant), begin, config, certified_elsewhere)

    def send(data: bytes) -> None:
        if killed.is_set():
            raise _Killed
        with lock:
            connection.send_bytes(data)

    sector = Sector(number, session, Terms(), number + 1, send, patience_s=_PATIENCE_S)

    def serve() -> None:
        try:
            sector.serve(killed.is_set)
        except _Killed:
            pass

    worker = threading.Thread(target=serve, daemon=True)
    worker.start()
    while True:
        try:
            data = connection.recv_bytes()
        except EOFError:
            return
        if data == _KILL:
            killed.set()
        elif data == _TRUTH:
            if killed.is_set():
                worker.join()
                plant.close()
                plant.run_on(0.0)  # nothing sends heartbeats: the robots stop by themselves
            _, first, moves, _, verified = plant.true_movements(0)
            memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            with lock:
                connection.send((first, moves, verified, plant.now_s, memory_mb))
        else:
            sector.inbox.put(data)


class _Plane:
    """The processes of the sectors, and the session of their coordinator."""

    def __init__(self, problem, sectors: int, seed: int, loss: float = 0.0, fault=None):
        self._problem, self._units = problem, WireUnits.for_plane(problem.plane)
        self._rng, self._loss, self.dead = np.random.default_rng(seed), loss, set()
        self.traffic = np.zeros((sectors, 2), dtype=np.int64)  # bytes to and from each sector
        self._connections, self._processes = [], []
        self._told: list[Start] = []
        context = multiprocessing.get_context("fork")
        for k in range(sectors):
            ours, theirs = context.Pipe()
            own = fault[1:] if fault is not None and fault[0] == k else None
            process = context.Process(
                target=_host, args=(theirs, problem.plane, problem.start, k, seed, own), daemon=True
            )
            process.start()
            theirs.close()
            self._connections.append(ours)
            self._processes.append(process)
        self.session = SectoredSession(
            problem.plane, self._units, Safety(), problem.start, SessionConfig(), Terms(), self,
            Pace(patience_s=_PATIENCE_S),
        )  # fmt: skip
        conductor = self.session.sectors.conductor
        conductor.go = self._telling(conductor.go)  # type: ignore[method-assign]

    def _telling(self, go):
        def call(start_s: float, *more: float) -> None:
            go(start_s, *more)
            self._told.append(start_of(self.session, start_s))

        return call

    def send(self, sector: int, data: bytes) -> None:
        if sector not in self.dead and self._rng.random() >= self._loss:
            self.traffic[sector, 0] += len(data)
            self._connections[sector].send_bytes(data)

    def receive(self, wait_s: float) -> list[bytes]:
        alive = {c: k for k, c in enumerate(self._connections) if k not in self.dead}
        taken = []
        for each in wait(alive, wait_s):
            if isinstance(each, Connection):
                data = each.recv_bytes()
                self.traffic[alive[each], 1] += len(data)
                taken.append(data)
        return [data for data in taken if self._rng.random() >= self._loss]

    def left(self, sector: int) -> bool:
        return sector in self.dead

    def kill(self, sector: int) -> None:
        self._connections[sector].send_bytes(_KILL)
        self.dead.add(sector)

    def truth(self) -> tuple[Verdict, list[float]]:
        """Judge the true motion of all robots since the begin; return the memory, too [MB]."""
        found = []
        for k, each in enumerate(self._connections):
            while each.poll(0.05 if k in self.dead else 0.0):
                each.recv_bytes()
            each.send_bytes(_TRUTH)
            found.append(self._answer(each))
        moved = [Moved(own, *each[:4]) for own, each in zip(self.session.sectors.rows, found)]
        verdict = judge(self._problem.plane, self._units, moved, self._told)
        return verdict, [each[4] for each in found]

    @staticmethod
    def _answer(connection: Connection):
        while True:  # a report may be under way
            data = connection.recv_bytes()
            if data[:1] == b"\x80":  # pickled
                return pickle.loads(data)

    def close(self) -> None:
        for each in self._connections:
            each.close()
        for process in self._processes:  # the forked ones hold each other's connections open
            process.terminate()
            process.join(10.0)


def problem_of(robots: int, sectors: int, seed: int):
    plane = preset("desi", robots)
    # neighbours share a sector: sectors are slices around the axis
    turn = np.argsort(np.arctan2(*plane.centers.T[::-1]), kind="stable")
    on_bus = max(1, min(_ON_BUS, -(-robots // max(10, sectors))))
    bus = np.empty(robots, dtype=np.int64)
    bus[turn] = np.arange(robots) // on_bus
    order = np.argsort(bus, kind="stable")
    address = np.empty(robots, dtype=np.int64)
    first = np.searchsorted(bus[order], bus[order])
    address[order] = 8 + np.arange(robots) - first
    plane = with_sectors(replace(plane, bus=bus, address=address), str(sectors))
    return random_problem(plane, np.random.default_rng(seed))


def _start_bound_ms(session: SectoredSession) -> float:
    """Largest difference between two starts: between sectors as measured, and inside of one."""
    between_s = session.sectors.conductor.start_skew_bound_s
    return 1e3 * (between_s + session.protocol.safety.start_skew_s)


def _stop_bound_ms(session: SectoredSession) -> float:
    """Largest time from the stop of one robot until all rest [ms]."""
    safety = session.protocol.safety
    several = session.sectors.number > 1
    return 1e3 * (safety.border_stop_skew_s if several else safety.stop_skew_s)


def _run(session: SectoredSession) -> PlanResult:
    begin_s = time.monotonic()
    while session.state is SessionState.MOVING:
        if time.monotonic() > begin_s + 600.0:
            raise TimeoutError("the plan does not end")
        session.advance(session.transactions.now_s + 0.1)
    if session.result is None:
        raise RuntimeError("a plan ended without a result")
    return session.result


def _measure(args: argparse.Namespace) -> dict:
    """One reconfiguration without faults, with the wall time of each stage."""
    times, traffic, last_s = {}, {}, time.perf_counter()
    carried = np.zeros((args.sectors, 2), dtype=np.int64)

    def lap(name: str) -> None:
        nonlocal last_s
        now_s = time.perf_counter()
        times[name], last_s = round(now_s - last_s, 3), now_s

    def carry(name: str) -> None:
        nonlocal carried
        most = (plane.traffic - carried).max(axis=0)
        traffic[name], carried = most.tolist(), plane.traffic.copy()

    problem = problem_of(args.robots, args.sectors, args.seed)
    lap("field")
    orders = make_orders(problem)
    lap("plan_and_discretize")
    plane = _Plane(problem, args.sectors, args.seed)
    session = plane.session
    session.configure(0.0)
    lap("begin_and_configure")
    carry("begin_and_configure")
    session.submit(orders.wire, problem.targets)
    session.start(0.0)
    lap("load_verify_certify_go")
    carry("load_verify_certify_go")
    go_s = session.loaded_plan.start_s if session.loaded_plan else 0.0
    bound_ms = _start_bound_ms(session)
    result = _run(session)
    lap("move")
    carry("move")
    truth, memory_mb = plane.truth()
    lap("judge")
    plane.close()
    own_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "robots": args.robots, "sectors": args.sectors,
        "reached": int((result.outcome == Outcome.REACHED).sum()),
        "start_skew_ms_max": round(truth.start_skew_ms, 4),
        "start_skew_bound_ms": round(bound_ms, 4),
        "stop_ms_max": round(truth.stop_ms, 3), "stop_bound_ms": _stop_bound_ms(session),
        "contacts": truth.contacts,
        "unverified": truth.unverified,
        "without_outcome": args.robots - len(result.outcome),
        "start_s": round(go_s, 4), "ended_s": round(session.transactions.now_s, 4),
        "wall_s": times,
        "bytes_to_and_from_a_sector": traffic,
        "memory_mb": {"coordinator": round(own_mb), "sectors": [round(m) for m in memory_mb]},
    }  # fmt: skip


def _campaign(problem, orders, sectors: int, seed: int) -> tuple[Verdict, int, float]:
    rng = np.random.default_rng(seed)
    kind, victim = ("jam", "kill", "loss", "jam and loss")[seed % 4], int(rng.integers(sectors))
    at_s = rng.uniform(0.05, 0.05 + 0.8 * orders.wire.decoded().makespan_s)
    robots = int((problem.plane.sector == victim).sum())
    jam = (victim, int(rng.integers(robots)), at_s, Event.JAM_THETA) if "jam" in kind else None
    plane = _Plane(problem, sectors, seed, 0.01 if "loss" in kind else 0.0, jam)
    session = plane.session
    session.configure(0.0)
    session.submit(orders.wire, problem.targets)
    session.start(0.0)
    bound_ms = _start_bound_ms(session)
    if kind == "kill" and session.state is SessionState.MOVING:
        session.advance(at_s)
        plane.kill(victim)
    result, (truth, _) = _run(session), plane.truth()
    plane.close()
    return truth, problem.plane.n - len(result.outcome), bound_ms


def main(argv: list[str] | None = None) -> int:
    """Run the command; return 1 when a promise is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=500)
    parser.add_argument("--sectors", type=int, default=2)
    parser.add_argument("--campaigns", type=int, default=0, help="reconfigurations with faults")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    line = _measure(args)
    if args.campaigns:
        problem = problem_of(args.robots, args.sectors, args.seed)
        orders = make_orders(problem)
        for seed in range(args.seed, args.seed + args.campaigns):
            truth, without, bound_ms = _campaign(problem, orders, args.sectors, seed)
            line["contacts"] += truth.contacts
            line["unverified"] += truth.unverified
            line["without_outcome"] += without
            # the line has the run that is closest to its bound, or furthest beyond
            if truth.start_skew_ms - bound_ms > (
                line["start_skew_ms_max"] - line["start_skew_bound_ms"]
            ):
                line["start_skew_ms_max"], line["start_skew_bound_ms"] = (
                    truth.start_skew_ms,
                    bound_ms,
                )
            line["stop_ms_max"] = max(line["stop_ms_max"], truth.stop_ms)
        line["campaigns"] = args.campaigns
    line["broken"] = broken(line)
    print(json.dumps(line))
    return 1 if line["broken"] else 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How late the beats of sectors are on one machine, and whether sectors stop because of it.

Each sector is a process with simulated buses in the time of the clock; the coordinator is this
process. All turn their robots once, together. The clocks run --scale seconds in one of this
machine. Prints a line of JSON for each number of sectors and each scale; times are of the clocks.
`cores_of_sectors` is the processor time of all sectors in a second of the clocks: what they would
need at full speed, also where other work makes beats late.
"""

import argparse
import json
import multiprocessing
import os
import sys
import threading
import time
from dataclasses import replace
from multiprocessing.connection import Connection, wait

import numpy as np

from fiber_bus_bridge import Session, SessionConfig, SessionState
from fiber_bus_bridge.plant.rehearsal import rehearse
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_sectors import Order, SectorError, Terms, decode_beat
from fiber_sectors.exchange import Pace
from fiber_sectors.paced import PacedBuses
from fiber_sectors.sector import Sector, certified_elsewhere
from fiber_sectors.sectored_session import SectoredSession
from fiber_sectors.shares import part_of, with_sectors

__all__ = ["main"]

_ON_BUS, _TICKS, _VELOCITY = 10, 400, 150
_END, _TOLD = b"END", b"TOLD"


def _sector(connection: Connection, plane, start, k: int, scale: float) -> None:
    part, units = part_of(plane, k), WireUnits.for_plane(plane)
    begin = start[plane.sector == k]

    def clock() -> float:
        return scale * time.monotonic()

    buses = PacedBuses(
        simulated_buses(part, units, begin, SimulationConfig(seed=k)), clock,
        lambda clock_s: time.sleep(clock_s / scale),
    )  # fmt: skip
    session = Session(
        part, units, Safety(), buses, begin, SessionConfig(resumes=0), certified_elsewhere
    )
    heard: list[tuple[float, float, float]] = []
    ended, lock = threading.Event(), threading.Lock()

    def send(data: bytes) -> None:
        with lock:
            connection.send_bytes(data)

    sector = Sector(k, session, Terms(), k + 1, send, clock, scale=scale)
    threading.Thread(target=sector.serve, args=(ended.is_set,), daemon=True).start()
    while (data := connection.recv_bytes()) != _END:
        try:
            beat = decode_beat(data)
            if beat.order in (Order.GO, Order.MOVE):
                heard.append((beat.sent_s, clock(), time.process_time()))
        except SectorError:
            pass  # a call
        sector.inbox.put(data)
    ended.set()
    sent_s, heard_s, busy_s = np.array(heard).reshape(-1, 3).T
    told = np.diff(heard_s), (heard_s - sent_s)[1:], np.diff(busy_s)
    send(_TOLD + np.stack(told).tobytes())


class _Links:
    def __init__(self, connections: list[Connection]):
        self._connections = connections

    def send(self, sector: int, data: bytes) -> None:
        self._connections[sector].send_bytes(data)

    def receive(self, wait_s: float) -> list[bytes]:
        found = wait(self._connections, wait_s)
        return [each.recv_bytes() for each in found if isinstance(each, Connection)]

    def left(self, sector: int) -> bool:
        return False


def measure(sectors: int, scale: float) -> dict[str, object]:
    """Turn all robots once; return how late beats were, and how it ended.

    Args:
        sectors: number of sectors, each a process.
        scale: seconds of the clocks in one of this machine.
    """
    n = _ON_BUS * sectors
    plane = replace(
        preset("desi", n), bus=np.arange(n) // _ON_BUS, address=np.arange(n) % _ON_BUS + 8
    )
    plane, units = with_sectors(plane, str(sectors)), WireUnits.for_plane(plane)
    start = np.stack([np.zeros(n), np.full(n, 3.1)], axis=1)  # folded: clear at every theta
    context, connections, processes = multiprocessing.get_context("fork"), [], []
    for k in range(sectors):
        ours, theirs = context.Pipe()
        given = (theirs, plane, start, k, scale)
        processes.append(context.Process(target=_sector, args=given, daemon=True))
        processes[-1].start()
        connections.append(ours)

    def clock() -> float:
        return scale * time.monotonic()

    session = SectoredSession(
        plane, units, Safety(), start, SessionConfig(tolerance_mm=1e-3, resumes=0), Terms(),
        _Links(connections), Pace(clock, scale=scale),
    )  # fmt: skip
    session.configure(clock())
    segments = np.tile([True, False], n)
    offsets = np.append(0, np.cumsum(segments))
    session.submit(
        WireMotion(units, session.counts, offsets, np.full(n, _TICKS), np.full(n, _VELOCITY))
    )
    session.start(clock())
    moved_s, own_s = clock(), time.process_time()
    while session.state is SessionState.MOVING:
        session.advance(clock() + 0.1)
    moved_s, own_s = max(clock() - moved_s, 1e-9), time.process_time() - own_s
    result, told = session.result, []
    for each in connections:
        each.send_bytes(_END)
    for each in connections:
        while (data := each.recv_bytes())[: len(_TOLD)] != _TOLD:
            pass
        told.append(np.frombuffer(data[len(_TOLD) :]).reshape(3, -1))
    for process in processes:
        process.join()
    between_ms, late_ms, busy_ms = 1e3 * np.concatenate(told, axis=1)
    return {
        "sectors": sectors, "scale": scale, "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
        "reached": 0 if result is None else int((result.outcome == Outcome.REACHED).sum()),
        "robots": n, "why": session.sectors.why,
        "cores_of_sectors": round(sectors * busy_ms.sum() / max(between_ms.sum(), 1e-9), 3),
        "cores_of_coordinator": round(own_s / moved_s, 3),
        "between_ms": _of(between_ms), "under_way_ms": _of(late_ms),
    }  # fmt: skip


def _of(values: np.ndarray) -> dict[str, float]:
    """Return median, 99 % and largest of some values; nothing where robots did not count down."""
    if len(values) == 0:
        return {}
    low, high = np.quantile(values, [0.5, 0.99]).round(3).tolist()
    return {"median": low, "p99": high, "most": round(float(values.max()), 3)}


def main(argv: list[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sectors", type=int, nargs="+", default=[3, 10, 30])
    parser.add_argument("--scale", type=float, nargs="+", default=[1.0, 0.2, 0.05])
    args = parser.parse_args(argv)
    rehearse()
    for sectors in args.sectors:
        for scale in args.scale:
            print(json.dumps(measure(sectors, scale)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

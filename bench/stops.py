#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measure the time between the first and the last stop when one of many moving robots fails.

All robots on two full buses turn; one robot fails at a random instant, and all robots with
remaining orders stop. The table holds the longest time between the first stop and the last, by the
memory of the robots. The certificate allows for `Safety.stop_skew_s`.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from fiber_bus_bridge import (
    TOPOLOGIES,
    Session,
    SessionConfig,
    SessionState,
    addresses_of,
    bus_timing,
)
from fiber_bus_bridge.bus import Recovery, Topology
from fiber_bus_bridge.simulation import Event, Faults, LineFault, Positioners, SimulatedBuses
from fiber_bus_bridge.simulation.faults import LineTrouble, Stretch
from fiber_core.clearance import Safety
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["FAILURES", "apart_ms", "main"]

FAILURES = ("stalls", "loses power", "goes deaf", "holds the clock", "bus stuck")
TABLE = {**TOPOLOGIES, "16 a bus": Topology(16, 200)}
_EVENTS = {"stalls": Event.JAM_THETA, "loses power": Event.POWER, "goes deaf": Event.DEAF}


def apart_ms(topology: str, clock: str, failure: str, rng: np.random.Generator) -> float:
    """Let one robot on two buses fail; return the time between the first and the last stop [ms].

    Args:
        topology: one of TABLE.
        clock: bus clock, as in bus_timing.
        failure: one of FAILURES.
        rng: source of the robot and the instant.
    """
    n = 2 * TABLE[topology].robots_per_bus
    bus, address = TABLE[topology].assign(n)
    plane = replace(preset("desi", n), bus=bus, address=address)
    units = WireUnits.for_plane(plane)
    counts = units.encoder_counts(plane, np.tile([0.0, 2.9], (n, 1)))
    robots = Positioners(addresses_of(plane), plane.ids, units.quantum_prad, counts)
    row, at = int(rng.integers(n)), 1.0 + rng.uniform(0.0, 0.1)
    lines: tuple[LineTrouble, ...] = ()
    stretches: tuple[Stretch, ...] = ()
    if failure == "bus stuck":
        lines = ((LineFault.SCL_LOW, int(bus[row]), at, np.inf, Recovery.NOTHING),)
    elif failure == "holds the clock":
        stretches = ((row, at, np.inf, 10 ** rng.uniform(-3, -1.7)),)
    faults = Faults(lines=lines, stretches=stretches)
    buses = SimulatedBuses(robots, bus_timing(clock), faults)
    config = SessionConfig(resumes=0)
    session = Session(plane, units, Safety(), buses, units.to_angles(counts), config)
    t = session.configure(0.0)
    orders = np.arange(n + 1).repeat(2)[1:]  # theta only
    motion = WireMotion(units, counts, orders, np.full(n, 1000), np.full(n, 300))
    session.submit(motion)
    t = session.start(t)
    if failure in _EVENTS:
        robots.schedule([(row, at, _EVENTS[failure], int(failure != "loses power"))])
    while session.state is SessionState.MOVING:
        t = session.advance(t + 0.1)
    robots.advance(t + 0.1)
    assert session.loaded_plan is not None  # start() sets it
    stops = robots.memory["halted_s"][session.loaded_plan.started]
    return 1e3 * float(np.ptp(stops[stops >= 1.0]))


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--clock", nargs="+", default=["1M", "3.4M"])
    parser.add_argument("--topology", choices=TABLE, nargs="+", default=list(TABLE))
    parser.add_argument("--out", type=Path, help="file for the table, in markdown")
    args = parser.parse_args(argv)
    lines = [
        "| topology | clock | " + " | ".join(FAILURES) + " |",
        "|---" * (len(FAILURES) + 2) + "|",
    ]
    for topology in args.topology:
        for clock in args.clock:
            worst = []
            for failure in FAILURES:
                rng = np.random.default_rng(args.seed)
                trials = range(args.trials)
                worst.append(max(apart_ms(topology, clock, failure, rng) for _ in trials))
            cells = " | ".join(f"{value:.2f}" for value in worst)
            lines.append(f"| {topology} | {clock} | {cells} |")
            print(lines[-1], flush=True)
    text = "\n".join(lines) + "\n"
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

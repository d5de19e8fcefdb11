#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measure the buses: one plan of a whole plane is loaded, verified and started, with faults too.

Bus time is simulated by the formulas of the standard, from the first LOAD to the end of GO. Its
lower bound is the time of the bytes of LOAD, VERIFY and GO. The plan comes from the default
planner and discretizer. The result is a table in markdown.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fiber_bus_bridge import (
    TOPOLOGIES,
    LoadedPlan,
    Session,
    SessionState,
    addresses_of,
    bus_timing,
)
from fiber_bus_bridge.bus import Recovery
from fiber_bus_bridge.simulation import Faults, LineFault, Positioners, SimulatedBuses
from fiber_bus_bridge.wire import VERIFY_BYTES, decode_load, encode_load
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_positioners import Orders, make_orders, random_problem

__all__ = ["main"]

_UNANSWERED = (Reason.NOT_ACKNOWLEDGED, Reason.NO_REPLY, Reason.BUS_FAILED)
_STUCK = ((LineFault.SDA_LOW, 3, 0.5, np.inf, Recovery.NOTHING),)
CASES = {
    "fault-free": Faults(),
    "one bit in 1e5": Faults(noise=tuple((bus, 0.0, np.inf, 1e-5) for bus in range(200))),
    "one bit in 1e4": Faults(noise=tuple((bus, 0.0, np.inf, 1e-4) for bus in range(200))),
    "bus 3 stuck": Faults(lines=_STUCK),
}


def plan_of(robots: int, seed: int, topology: str) -> Orders:
    """Return orders of the default planner and discretizer for a random problem."""
    bus, address = TOPOLOGIES[topology].assign(robots)
    plane = replace(preset("desi", robots), bus=bus, address=address)
    return make_orders(random_problem(plane, seed))


def carry_out(plan: Orders, faults: Faults, clock: str, seed: int) -> dict[str, float | str]:
    """Configure, then load, verify and start one second later; return the figures by name.

    Args:
        plan: the orders.
        faults: faults of the buses.
        clock: bus clock, as in bus_timing.
        seed: seed of bit errors.
    """
    plane, to = plan.plane, addresses_of(plan.plane)
    robots = Positioners(to, plane.ids, plan.units.quantum_prad, plan.counts)
    buses = SimulatedBuses(robots, bus_timing(clock), faults, np.random.default_rng(seed))
    session = Session(plane, plan.units, Safety(), buses, plan.units.to_angles(plan.counts))
    begin_s = max(1.0, session.configure(0.0))
    session.submit(plan.wire, plan.targets)
    cpu = time.process_time()
    t = session.start(begin_s)
    cpu = time.process_time() - cpu
    loaded_plan = session.loaded_plan
    assert loaded_plan is not None  # start() sets it
    wrong = _wrong(robots, loaded_plan, plan)
    monitor_cpu = time.process_time()
    while session.state is SessionState.MOVING:
        t = session.advance(t + 0.1)
    monitor_cpu = time.process_time() - monitor_cpu
    result, ids = session.take_result(), np.unique(to.bus)
    assert result is not None  # a plan that has ended has one
    busy = np.bincount(
        np.searchsorted(ids, to.bus[loaded_plan.started]),
        buses.timing.message_s(loaded_plan.frames.lengths, 0, to.ten_bit[loaded_plan.started])
        + buses.timing.message_s(0, VERIFY_BYTES, to.ten_bit[loaded_plan.started]),
    )
    bound = busy.max() + buses.timing.message_s(6, 0, False)
    return {
        "started": int(loaded_plan.started.sum()),
        "reached": int((result.outcome == Outcome.REACHED).sum()),
        "not answered": int(np.isin(result.reason, _UNANSWERED).sum()),
        "unsafe then": int((result.reason == Reason.UNSAFE_AS_LOADED).sum()),
        "wrong orders": wrong,
        "buses given up": int(session.transactions.given_up.sum()),
        "bytes": float(loaded_plan.frames.lengths.mean()),
        "bound ms": 1e3 * float(bound),
        "to GO ms": 1e3 * (loaded_plan.go_s - begin_s),
        "to motion ms": 1e3 * (loaded_plan.start_s - begin_s),
        "bridge cpu s": cpu,
        "monitor cpu s": monitor_cpu,
        "ended": session.state.name,
    }


def _wrong(robots: Positioners, loaded_plan: LoadedPlan, plan: Orders) -> int:
    """Number of orders on robots that are not, byte for byte, the orders of the plan."""
    memory, rows = robots.memory, np.flatnonzero(loaded_plan.started)
    moves = (memory["started_s"] > 0) & memory["counts"].any(axis=1)
    wrong = int((moves & ~loaded_plan.started).sum())
    for k, row in enumerate(rows):
        payload = loaded_plan.frames.payload(k)
        wrong += memory["order"][row, : len(payload)].tobytes() != payload
    sent = decode_load(plan.units, loaded_plan.frames).motion
    intended = plan.wire.of_robots(rows)
    for k in range(len(rows)):
        part = slice(intended.offsets[2 * k], intended.offsets[2 * k + 2])
        own = slice(sent.offsets[2 * k], sent.offsets[2 * k + 2])
        wrong += not np.array_equal(sent.ticks[own], intended.ticks[part])
        wrong += not np.array_equal(sent.velocity[own], intended.velocity[part])
    return int(wrong)


def codec_ms(plan: Orders) -> dict[str, float]:
    """Return the median processor time to encode and to decode all orders [ms]."""
    to, wire, units = addresses_of(plan.plane), plan.wire, plan.units
    frames = encode_load(to, 1, wire)

    def median(work: Callable[[], object]) -> float:
        work()
        times = []
        for _ in range(51):
            begin = time.process_time()
            work()
            times.append(time.process_time() - begin)
        return 1e3 * float(np.median(times))

    return {
        "encode ms": median(lambda: encode_load(to, 1, wire)),
        "decode ms": median(lambda: decode_load(units, frames)),
    }


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--topology", choices=sorted(TOPOLOGIES), default="10x500")
    parser.add_argument("--clock", default="1M")
    parser.add_argument("--case", choices=CASES, nargs="+", default=list(CASES))
    parser.add_argument("--out", type=Path, help="file for the table, in markdown")
    args = parser.parse_args(argv)
    carry_out(plan_of(40, 0, args.topology), Faults(), args.clock, 0)  # compile
    plan = plan_of(args.robots, args.seed, args.topology)
    codec = codec_ms(plan)
    lines = [
        f"{args.robots} robots, {args.topology}, {args.clock}, seed {args.seed}; "
        + ", ".join(f"{name} {value:.2f}" for name, value in codec.items()),
        "",
    ]
    for case in args.case:
        figures = carry_out(plan, CASES[case], args.clock, args.seed)
        if len(lines) == 2:
            lines += ["| case | " + " | ".join(figures) + " |", "|---" * (len(figures) + 1) + "|"]
        cells = (f"{v:.2f}" if isinstance(v, float) else str(v) for v in figures.values())
        lines.append(f"| {case} | " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    text = "\n".join(lines) + "\n"
    print(text)
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

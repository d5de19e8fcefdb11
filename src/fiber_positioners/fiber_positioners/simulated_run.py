# SPDX-License-Identifier: Apache-2.0
"""Orders carried out by simulated positioners on simulated buses, in simulated time."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from fiber_bus_bridge import (
    Exchange,
    LoadedPlan,
    PlanResult,
    Session,
    SessionConfig,
    SessionState,
)
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import (
    CounterMotion,
    ObservedBuses,
    SimulationConfig,
    TrueMotion,
    simulated_buses,
)
from fiber_bus_bridge.wire import Speeds, encode_load
from fiber_core.array_types import Counts
from fiber_core.clearance import Certificate, certify, neighbour_pairs
from fiber_core.motion import SegmentMotion
from fiber_positioners.orders import Orders, ProgressCallback

__all__ = ["SimulatedRun", "run_on_simulated_buses"]

_STEP_S = 0.1  # simulated time between two calls while robots move

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """The course of one plan on simulated buses.

    Args:
        motion: the motion decoded from the bytes that the robots verified.
        certificate: certificate of that motion.
        result: outcome and reason of every robot.
        exchanges: the frames of the plan and their replies, in batches, oldest first.
        counts: encoder readings after the plan [quanta], shape (n, 2).
        costs: bytes of an order (mean), time on the buses [s], length of the countdown [s],
            wall time of each stage [s].
        counters: the motion that the counters made, if it was observed.
    """

    motion: SegmentMotion
    certificate: Certificate
    result: PlanResult
    exchanges: list[Exchange]
    counts: Counts
    costs: dict[str, float]
    counters: CounterMotion | None = None


def run_on_simulated_buses(
    orders: Orders,
    *,
    seed: int = 0,
    capture: str | Path | None = None,
    progress: ProgressCallback | None = None,
    observe: bool = False,
    tolerance_mm: float = SessionConfig.tolerance_mm,
) -> SimulatedRun:
    """Load, verify and certify orders, start the robots, and follow them to the end.

    Args:
        orders: the orders of all robots.
        seed: seed of the errors of the robots' clocks.
        capture: folder for waveforms (VCD) and packets (pcap) of the buses.
        progress: called with the fraction of the motion that is done, 0..1, and a short text.
        observe: whether to note what the counters do, which no robot reports.
        tolerance_mm: distance from its target within which a fibre has reached it [mm].

    Raises:
        FiberError: the bus addresses of the plane are impossible, or the tolerance is no length.
        OSError: the capture cannot be written.
    """
    plane, units, seconds = orders.plane, orders.units, {}
    start = units.to_angles(orders.counts)
    buses = simulated_buses(plane, units, start, SimulationConfig(seed=seed))
    true_motion = TrueMotion(buses.positioners, units.quantum_rad) if observe else None
    backend = buses if true_motion is None else ObservedBuses(buses, true_motion)
    tap = None if capture is None else Tap(backend, buses.timing)
    config = SessionConfig(tolerance_mm=tolerance_mm)
    session = Session(plane, units, orders.safety, tap or backend, start, config)
    ready_s = session.configure(0.0)
    session.transactions.take_traffic()  # the frames of the configuration belong to no plan
    session.submit(orders.wire, orders.targets)
    now_s = _timed(seconds, "upload_s", lambda: session.start(ready_s))
    loaded_plan, exchanges = session.loaded_plan, session.transactions.take_traffic()
    assert loaded_plan is not None  # start() sets it
    motion = loaded_plan.motion.decoded()
    while session.state is SessionState.MOVING:
        now_s = session.advance(now_s + _STEP_S)
        exchanges += session.transactions.take_traffic()
        if progress is not None:
            gone = (now_s - loaded_plan.start_s) / max(motion.makespan_s, _STEP_S)
            progress(float(np.clip(gone, 0.0, 1.0)), "robots are moving")
    if tap is not None and capture is not None:
        tap.write(Path(capture))
    pairs = neighbour_pairs(plane)
    certificate = _timed(seconds, "certify_s", lambda: certify(plane, motion, orders.safety, pairs))
    _timed(seconds, "encode_s", lambda: _encoded(orders, session, loaded_plan))
    result = session.take_result()
    assert result is not None  # a plan that is over has one
    lengths = loaded_plan.frames.lengths
    costs = {
        "bytes_mean": float(lengths.mean()) if len(lengths) else 0.0,
        "bus_time_s": loaded_plan.go_s - ready_s,
        "countdown_s": loaded_plan.start_s - loaded_plan.go_s,
        **seconds,
    }
    counters = None
    if true_motion is not None:
        moves, begin_s = true_motion.movements(now_s), loaded_plan.go_s
        counters = moves.counters(orders.counts, units.quantum_rad, now_s, begin_s)
    return SimulatedRun(
        motion, certificate, result.explained_by(orders.reason), exchanges, session.counts, costs,
        counters,
    )  # fmt: skip


def _timed(seconds: dict[str, float], name: str, work: Callable[[], T]) -> T:
    begin = time.perf_counter()
    value = work()
    seconds[name] = round(time.perf_counter() - begin, 4)
    return value


def _encoded(orders: Orders, session: Session, loaded_plan: LoadedPlan):
    """The LOAD frames of the robots that were started, encoded once more."""
    rows = np.flatnonzero(loaded_plan.started)
    addresses, sequence = session.transactions.addresses[rows], loaded_plan.sequence[rows]
    lists = Speeds.of(orders.plane, orders.units)
    listed = None if lists is None else lists[rows]
    return encode_load(addresses, sequence, loaded_plan.motion.of_robots(rows), listed)

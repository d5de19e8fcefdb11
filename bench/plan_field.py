#!/usr/bin/env python3
"""Take a focal plane through one reconfiguration without ROS, and print one JSON line.

The same cores as in the nodes: plan, discretize, load the bytes onto simulated buses, run.
Writes problem.npz and plan.npz; any other planner or checker can work on the same files.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fiber_bus_bridge import PlanResult, Session, SessionState
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import encode_load
from fiber_core.assignment import assign
from fiber_core.clearance import Certificate, Safety, certify, neighbour_pairs
from fiber_core.errors import FiberError
from fiber_core.metrics import ORDER_BYTES_BOUND, plan_metrics
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import PRESETS
from fiber_core.problem import Problem, save_plan, save_problem
from fiber_core.problem_sources import problem_from
from fiber_core.wire_units import WireUnits
from fiber_discretizer import discretize
from fiber_planner import DEFAULT_PLANNER, make_planner, planners

_TICK_S = 0.1  # simulated time between two looks at moving robots


@dataclass(frozen=True)
class Run:
    """A reconfiguration carried out.

    Args:
        motion: as decoded from the verified bytes.
        certificate: of that motion.
        result: what became of each robot.
        figures: what it cost: seconds of computing, bytes and bus time.
    """

    motion: SegmentMotion
    certificate: Certificate
    result: PlanResult
    figures: dict


class _Watch:
    def __init__(self):
        self.seconds = {}

    def __call__(self, name, work):
        begin = time.perf_counter()
        value = work()
        self.seconds[name] = round(time.perf_counter() - begin, 4)
        return value


def carry_out(problem: Problem, planner: str, seed: int = 0, capture: Path | None = None) -> Run:
    """Plan, discretize, load, verify, go, and wait for the end, in simulated time.

    Args:
        problem: what is asked.
        planner: name of the planner.
        seed: of the errors of the robots' clocks.
        capture: folder for what went over the buses.

    Raises:
        FiberError: the problem or the planner's name is malformed.
    """
    plane, safety, watch = problem.plane, Safety(), _Watch()
    units = WireUnits.for_plane(plane)
    counts = units.encoder_counts(plane, problem.start)
    start, asked = units.to_angles(counts), problem.asked
    given = assign(plane, start, plane.ids[asked], problem.targets[asked])
    accepted = Problem(plane, start, given.targets)
    planned = watch("plan_s", lambda: make_planner(planner).plan(accepted))
    done = watch(
        "discretize_s",
        lambda: discretize(plane, planned.motion, units, safety, counts),
    )
    held = np.where(given.refused, given.reason, planned.reason)
    held = np.where(np.isin(held, (Reason.OK, Reason.NO_TARGET)), done.reason, held)

    buses = simulated_buses(plane, units, start, SimulationConfig(seed=seed))
    if capture is not None:
        buses = Tap(buses, buses.timing)
    session = Session(plane, units, safety, buses, start)
    ready_s = session.configure(0.0)
    session.submit(done.wire, problem.targets)
    now_s = watch("upload_s", lambda: session.start(ready_s))
    upload = session.upload
    while session.state is SessionState.MOVING:
        now_s = session.advance(now_s + _TICK_S)
    if capture is not None:
        buses.write(capture)
    motion = upload.motion.decoded()
    pairs = neighbour_pairs(plane)
    certificate = watch("certify_s", lambda: certify(plane, motion, safety, pairs))
    rows, wire = np.flatnonzero(upload.started), upload.motion
    profiles = np.sort(np.concatenate([2 * rows, 2 * rows + 1]))
    offsets = np.concatenate([[0], np.cumsum(np.diff(wire.offsets)[profiles])])
    watch(
        "encode_s",
        lambda: encode_load(
            units,
            session.link.addresses[rows],
            upload.sequence[rows],
            offsets,
            wire.ticks,
            wire.velocity,
        ),
    )
    figures = {
        "bytes_mean": float(upload.loaded.lengths.mean()) if len(rows) else 0.0,
        "bytes_bound": ORDER_BYTES_BOUND,
        "bus_time_s": upload.go_s - ready_s,
        "countdown_s": upload.start_s - upload.go_s,
        **watch.seconds,
    }
    return Run(motion, certificate, session.take_result().explained_by(held), figures)


def parse(argv: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--preset", choices=sorted(PRESETS), help="instrument (desi if no layout)")
    parser.add_argument("--layout", type=Path, help="table of robots: CSV, ECSV or FITS")
    parser.add_argument("--problem", type=Path, help="problem.npz to solve as it is")
    parser.add_argument("--robots", type=int, help="how many robots of the preset")
    parser.add_argument("--seed", type=int, default=0, help="of the random field")
    parser.add_argument("--planner", choices=planners(), default=DEFAULT_PLANNER)
    parser.add_argument("--capture", type=Path, help="folder for waveforms (VCD) and packets")
    parser.add_argument("--out", type=Path, help="folder for problem.npz and plan.npz")
    parser.add_argument(
        "--cold", action="store_true", help="let the first compilation count as computing"
    )
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    args = parse(argv)
    try:
        problem = problem_from(args.problem, args.layout, args.preset, args.robots, args.seed)
        if not args.cold:
            carry_out(_small(problem), args.planner)
        run = carry_out(problem, args.planner, args.seed, args.capture)
    except (FiberError, OSError) as error:
        print(f"plan_field: {error}", file=sys.stderr)
        return 2
    outcome, reason = run.result.outcome, run.result.reason
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        save_problem(args.out / "problem.npz", problem)
        save_plan(args.out / "plan.npz", run.motion, outcome, reason)
    report = plan_metrics(problem, run.motion, run.certificate, outcome, reason)
    print(json.dumps({"planner": args.planner, "seed": args.seed, **report, **run.figures}))
    return 0


def _small(problem: Problem) -> Problem:
    """The first few robots: enough to have every loop compiled."""
    rows = np.arange(min(20, problem.plane.n))
    plane = problem.plane.permuted(rows)
    return Problem(plane, problem.start[rows], problem.targets[rows])


if __name__ == "__main__":
    sys.exit(main())

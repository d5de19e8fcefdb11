"""Take a simulated focal plane through one reconfiguration with the installed nodes.

Makes a problem, starts bridge, planner and discretizer as processes of their own on this
machine, moves the robots, and writes into the output folder: problem.npz, plan.npz (the
motion decoded from the bytes that went over the buses), report.json, recording.npz (all of
it in one file), player.html (open it in a browser), plane.png, and the nodes' logs.

With --faults things go wrong on the way, e.g. `--faults stall:2,reset`: robots stop by
themselves, all are stopped with them, and who can goes on.

Exit code 0 says that the motion was certified and, unless faults were asked for, that each robot
asked reached its target or is held with a reason.
"""

import argparse
import json
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fiber_bringup.processes import Processes
from fiber_bus_bridge.simulation import FaultKind, SimulationConfig
from fiber_client.client import PlaneClient
from fiber_client.reconfigure import summary, went_well
from fiber_client.terminal import ProgressDisplay, table
from fiber_core.assignment import assign
from fiber_core.errors import FiberError
from fiber_core.metrics import ORDER_BYTES_BOUND
from fiber_core.outcomes import PlanOutcome
from fiber_core.presets import PRESETS
from fiber_core.problem import Problem, save_plan, save_problem
from fiber_core.problem_sources import problem_from
from fiber_core.tables import read_targets
from fiber_node.ros_environment import own_domain, use_loopback
from fiber_planner import DEFAULT_PLANNER, planners
from fiber_recording import Recording, load_recording
from fiber_recording.node import recording_name
from fiber_viewer import before_and_after, write_player

__all__ = ["main"]

_FILES = ("report.json", "problem.npz", "plan.npz", "plane.png", "recording.npz", "player.html")


@dataclass(frozen=True, eq=False)
class _Run:
    """What one reconfiguration left behind."""

    ended: PlanOutcome
    recording: Recording
    wall_s: dict[str, float]


def main(argv=None) -> int:
    """Run the demonstration from the command line."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the nodes with it
    options = _parser().parse_args(argv)
    begin = time.monotonic()
    options.out.mkdir(parents=True, exist_ok=True)
    with ProgressDisplay() as display:
        try:
            SimulationConfig(faults=options.faults)  # refuses what it does not know
            problem = _problem(options)
            save_problem(options.out / "problem.npz", problem)
            display.say(
                f"{problem.plane.name}: {problem.plane.n} robots, "
                f"{problem.plane.enabled.sum()} enabled, {problem.asked.sum()} asked to move"
            )
            run = _reconfigure(problem, options, display)
            report = _report(run)
            for note in run.recording.about["notes"]:
                display.say(note)
            if options.faults and not run.recording.events.unexpected.any():
                display.say("the faults met nobody on the way: another --seed may")
        except (FiberError, OSError) as error:
            display.say(f"demo: {error}")
            return 1
        except KeyboardInterrupt:
            display.say("demo: interrupted, all nodes were ended")
            return 1
    report["wall_s"]["all"] = time.monotonic() - begin
    _write(options.out, run, report)
    print(_figures(report))
    print()
    print(summary(run.ended.of(problem.plane.ids[problem.asked])))
    print("\nin", options.out)
    for name in _FILES:
        print("  ", name)
    well = bool(options.faults) or went_well(run.ended.of(problem.plane.ids[problem.asked]))
    return 0 if well and report["certified"] else 1


def _parser():
    parser = argparse.ArgumentParser(
        prog="demo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", choices=list(PRESETS), help="instrument, default desi")
    parser.add_argument("--robots", type=int, help="how many; by default as the instrument has")
    parser.add_argument("--layout", type=Path, help="table of robots instead (CSV, ECSV, FITS)")
    parser.add_argument("--targets", type=Path, help="table id, x_mm, y_mm; by default random")
    parser.add_argument("--seed", type=int, default=0, help="of random starts and targets")
    parser.add_argument("--planner", choices=planners(), default=DEFAULT_PLANNER)
    parser.add_argument(
        "--faults",
        default="",
        metavar="KIND[:COUNT],...",
        help="what goes wrong, at random times while robots move: "
        + ", ".join(kind.name.lower() for kind in FaultKind),
    )
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="output folder")
    parser.add_argument(
        "--time-scale",
        type=float,
        default=1.0,
        help="simulated seconds a second, 1 for real time, 0 for as fast as possible",
    )
    parser.add_argument("--timeout", type=float, default=600.0, help="of each wait [s]")
    return parser


def _problem(options) -> Problem:
    problem = problem_from(
        layout=options.layout, preset=options.preset, robots=options.robots, seed=options.seed
    )
    if options.targets is None:
        return problem
    plane = problem.plane
    ids, xy_mm = read_targets(options.targets)
    return Problem(plane, problem.start, assign(plane, problem.start, ids, xy_mm).asked_mm)


def _reconfigure(problem, options, display) -> _Run:
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    bridge = {
        "problem": str((options.out / "problem.npz").resolve()),
        "seed": options.seed,
        "time_scale": options.time_scale,
        "faults": options.faults,
    }
    times = [time.monotonic()]
    with Processes(options.out) as processes:
        processes.start("fiber_bus_bridge", "bridge", bridge)
        processes.start("fiber_planner", "planner", {"planner": options.planner})
        processes.start("fiber_discretizer", "discretizer", {})
        processes.start("fiber_recording", "recorder", _recorder(problem, options))
        with PlaneClient(
            on_progress=display, on_status=display.status, guard=processes.check
        ) as client:
            client.wait_for_graph(options.timeout, also=("recorder",))
            times.append(time.monotonic())
            asked = problem.asked
            stamp = client.send_targets(problem.plane.ids[asked], problem.targets[asked])
            client.wait_until_ready(stamp, options.timeout)
            times.append(time.monotonic())
            client.start(options.timeout)
            times.append(time.monotonic())
            ended = client.wait_for_outcome(stamp, options.timeout)
            times.append(time.monotonic())
            heard = client.times[stamp]
            client.wait_for_recording(stamp, options.timeout)
    (options.out / recording_name(stamp)).replace(options.out / "recording.npz")
    graph, ready, start, move = np.diff(times)
    plan = heard["planner"] - heard["sent"]
    wall_s = {
        "graph": graph, "plan": plan, "discretize": ready - plan, "start": start, "move": move
    }  # fmt: skip
    return _Run(ended, load_recording(options.out / "recording.npz"), wall_s)


def _recorder(problem, options) -> dict:
    return {
        "folder": str(options.out.resolve()),
        "preset": problem.plane.name,
        "seed": options.seed,
        "planner": options.planner,
    }


def _report(run) -> dict:
    about = run.recording.about
    return about["report"] | {
        "margin_mm": about["certificate"]["margin_mm"],
        "bytes_bound": ORDER_BYTES_BOUND,
        "notes": about["notes"],
        "wall_s": run.wall_s,
    }


def _write(out, run, report):
    recording, ended = run.recording, run.ended
    motion = recording.executed
    save_plan(out / "plan.npz", motion, ended.outcome, ended.reason)
    before_and_after(recording.problem, motion, ended.outcome).savefig(out / "plane.png", dpi=110)
    write_player(out / "player.html", out / "recording.npz")
    (out / "report.json").write_text(json.dumps(_plain(report), indent=2) + "\n")


def _plain(value):
    # JSON has no number for what is not finite
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _figures(report) -> str:
    rows = [("", "value", "bound")]
    rows += [("reached", report["reached"], report["asked"])]
    rows += [(name, report[name], "") for name in ("held", "failed")]
    rows += [
        ("makespan s", f"{report['makespan_s']:.3f}", f"{report['lower_bound_s']:.3f}"),
        ("least clearance mm", _clearance(report), f"{report['margin_mm']:.4f}"),
        ("segments a moving motor", f"{report['segments_mean']:.2f}", "1.00"),
        ("segments at most", report["segments_max"], 1),
        ("bytes an order", f"{report['bytes_mean']:.1f}", f"{report['bytes_bound']:.1f}"),
        ("load, verify, go on the buses s", f"{report['bus_time_s']:.3f}", ""),
        ("end error um, rms", f"{report['end_error_um_rms']:.2f}", ""),
        ("end error um, at most", f"{report['end_error_um_max']:.2f}", ""),
        ("certified", "yes" if report["certified"] else "NO", ""),
    ]
    rows += [
        (f"wall time s, {name}", f"{value:.1f}", "") for name, value in report["wall_s"].items()
    ]
    return table(rows)


def _clearance(report) -> str:
    least = report["min_clearance_mm"]
    return "nobody near" if least is None else f"{least:.4f}"


if __name__ == "__main__":
    sys.exit(main())

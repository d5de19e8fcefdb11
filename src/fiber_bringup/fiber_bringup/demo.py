# SPDX-License-Identifier: Apache-2.0
"""Take a simulated focal plane through one reconfiguration with the installed nodes.

Makes a problem, starts plant, bridge, planner, discretizer and recorder as processes on this
machine, moves the robots, and writes into the output folder: problem.npz, plan.npz (the motion
decoded from the bytes that went over the buses), report.json, recording.npz (all of the plan in one
file), player.html (open it in a browser), plane.png, results.ecsv (a row for each robot), and
the logs of the nodes.

With --tolerance-um a simulated camera sees arms that do not quite follow their counters, and
corrections bring the fibres to their targets; outcome and error of each robot come from the last
image, the recording is that of the blind move with all images after it, which the player shows, and
residuals.png has the vectors and histograms.

With --faults robots and buses fail during the motion, e.g. `--faults stall:2,reset`: robots stop
by themselves, all others are stopped with them, and the robots that can go on are started again.

Exit code 0: the motion was certified and, unless faults were requested, each robot with a target
reached it or is held with a reason. With --tolerance-um a hundredth of the simulated robots have a
joint that does not turn: an image names them as not_moved, and that is no error of the run. Another
robot that is named so is one, and so is a run in which no robot had a target.
"""

import argparse
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fiber_bringup.processes import Processes
from fiber_bus_bridge.plant import plant_socket
from fiber_bus_bridge.simulation import (
    FaultKind,
    MechanicalErrors,
    SimulationConfig,
    draw_mechanics,
)
from fiber_client.client import PlaneClient
from fiber_client.closed_loop import CameraLoop, show_images
from fiber_client.reconfigure import summary, went_well
from fiber_client.terminal import ProgressDisplay, table
from fiber_core.array_types import Ids
from fiber_core.drive.named import DRIVES
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.metrics import ORDER_BYTES_BOUND
from fiber_core.outcomes import PlanOutcome, Reason
from fiber_core.presets import PRESETS
from fiber_core.problem import Problem, save_plan, save_problem
from fiber_formats import FORMS, FoundProblem, problem_from, write_results
from fiber_node.ros_environment import own_domain, use_loopback
from fiber_planner import DEFAULT_PLANNER, planners
from fiber_positioners.report import save_report
from fiber_recording import Recording, load_recording
from fiber_recording.node import recording_name
from fiber_viewer import before_and_after, figures, write_player

__all__ = ["ARMS", "main"]

# 54 um rms after a blind move of robots with arms of 3 mm
ARMS = {"arms.scale": 0.0041, "arms.backlash_deg": 0.08, "arms.wave_deg": 0.12,
         "arms.speed_noise": 0.002, "arms.non_movers": 0.01}  # fmt: skip
_FILES = (
    *("report.json", "problem.npz", "plan.npz", "plane.png"),
    *("recording.npz", "player.html", "results.ecsv"),
)


@dataclass(frozen=True, eq=False)
class _Run:
    """The result of one reconfiguration.

    Args:
        outcome: the outcome of every robot.
        recording: the recording of the plan.
        wall_s: wall time of each step, by name [s].
        images: what the images of a camera showed, empty without one.
    """

    outcome: PlanOutcome
    recording: Recording
    wall_s: dict[str, float]
    images: dict[str, object]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demonstration from the command line; return the exit code."""
    for each in (signal.SIGINT, signal.SIGTERM):  # a shell lets its background jobs ignore SIGINT
        signal.signal(each, signal.default_int_handler)
    options = _parser().parse_args(argv)
    begin = time.monotonic()
    with ProgressDisplay() as display:
        try:
            options.out.mkdir(parents=True, exist_ok=True)
            problem, run = _simulate(options, display)
        except (FiberError, OSError) as error:
            display.say(f"demo: {error}")
            return 1
        except KeyboardInterrupt:
            display.say("demo: interrupted, all nodes were ended")
            return 1
    report = _report(run)
    report["wall_s"]["all"] = time.monotonic() - begin
    _write(options.out, run, report, options.form)
    outcome = run.outcome.of(problem.plane.ids[problem.asked])
    print(_figures(report), summary(outcome), sep="\n\n")
    print("\nin", options.out)
    for name in _FILES:
        print("  ", name)
    stuck = _stuck(problem.plane, options.seed) if options.tolerance_um is not None else []
    good = bool(options.faults) or _as_simulated(outcome, stuck)
    return 0 if good and report["certified"] else 1


def _stuck(plane: FocalPlane, seed: int) -> Ids:
    """Robots with a joint that the simulated drives let stick; the camera draws them first."""
    errors = MechanicalErrors(**{name.removeprefix("arms."): size for name, size in ARMS.items()})
    return plane.ids[draw_mechanics(plane.n, errors, np.random.default_rng(seed)).sticking]


def _as_simulated(outcome: PlanOutcome, stuck: ArrayLike) -> bool:
    """Return whether robots had targets, and all went well but for joints that are to stick."""
    named = (outcome.reason == Reason.NOT_MOVED) & np.isin(outcome.ids, stuck)
    return len(outcome.ids) > 0 and went_well(outcome.of(outcome.ids[~named]))


def _simulate(options: argparse.Namespace, display: ProgressDisplay) -> tuple[Problem, _Run]:
    SimulationConfig(faults=options.faults)  # refuses an unknown fault before anything is started
    found = _found_problem(options)
    for line in found.lines:
        display.say(line)
    problem = found.problem
    save_problem(options.out / "problem.npz", problem)
    display.say(
        f"{problem.plane.name}: {problem.plane.n} robots, "
        f"{problem.plane.enabled.sum()} enabled, {problem.asked.sum()} with a target"
    )
    run = _reconfigure(problem, options, display)
    for note in run.recording.about["notes"]:
        display.say(note)
    if options.faults and not run.recording.events.unexpected.any():
        display.say("no fault hit a moving robot; try another --seed")
    return problem, run


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="demo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", choices=list(PRESETS), help="instrument, default desi")
    parser.add_argument(
        "--robots", type=int, help="number of robots; by default all of the instrument"
    )
    parser.add_argument("--layout", help="files of robots instead of a preset, joined by commas")
    parser.add_argument("--starts", help="files with the present angles; by default random")
    parser.add_argument("--targets", help="files with targets; by default random targets")
    parser.add_argument("--spacing", type=float, metavar="MM", help="least distance of two targets")
    parser.add_argument("--drive", choices=sorted(DRIVES), help="motors; by default of the layout")
    parser.add_argument(
        "--motors-on", type=float, metavar="SHARE", help="most motors of a supply on at once, to 1"
    )
    parser.add_argument(
        "--form", choices=sorted(FORMS), help="columns of an instrument in results.ecsv"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of random starts and targets")
    parser.add_argument("--planner", choices=planners(), default=DEFAULT_PLANNER)
    parser.add_argument(
        "--faults",
        default="",
        metavar="KIND[:COUNT],...",
        help="faults at random times while robots move: "
        + ", ".join(kind.name.lower() for kind in FaultKind),
    )
    parser.add_argument(
        "--tolerance-um", type=float, metavar="T",
        help="arms with drive errors, a camera, and corrections until fibres are so close [um]",
    )  # fmt: skip
    parser.add_argument("--iterations", type=int, default=2, help="largest number of corrections")
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="output folder")
    parser.add_argument(
        "--time-scale",
        type=float,
        default=1.0,
        help="simulated seconds per second: 1 for real time, 0 for as fast as possible",
    )
    parser.add_argument("--timeout", type=float, default=600.0, help="time-out of each wait [s]")
    return parser


def _found_problem(options: argparse.Namespace) -> FoundProblem:
    return problem_from(
        layout=options.layout,
        preset=options.preset,
        robots=options.robots,
        seed=options.seed,
        starts=options.starts,
        targets=options.targets,
        spacing_mm=options.spacing,
        drive=options.drive,
        motors_on=options.motors_on,
    )


def _reconfigure(problem: Problem, options: argparse.Namespace, display: ProgressDisplay) -> _Run:
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    problem_file = str((options.out / "problem.npz").resolve())
    plant = plant_socket(f"demo.{os.getpid()}")
    bridge = {"problem": problem_file, "time_scale": options.time_scale, "plant": str(plant)}
    times = [time.monotonic()]
    with Processes(options.out) as processes:
        processes.start_command(
            "fiber_bus_bridge",
            "plant",
            [f"--problem={problem_file}", f"--seed={options.seed}", f"--faults={options.faults}",
             f"--time-scale={options.time_scale}", f"--socket={plant}"],
        )  # fmt: skip
        processes.start("fiber_bus_bridge", "bridge", bridge)
        processes.start("fiber_planner", "planner", {"planner": options.planner})
        processes.start("fiber_discretizer", "discretizer", {})
        processes.start("fiber_recording", "recorder", _recorder(problem, options))
        if options.tolerance_um is not None:
            processes.start("fiber_metrology", "metrology", {})
            camera = {"plant": str(plant), "seed": options.seed} | ARMS
            processes.start("fiber_metrology", "camera", camera)
        with PlaneClient(
            on_progress=display, on_status=display.status, guard=processes.check
        ) as client:
            # the metrology too: it has to hear where the robots are before they move
            also = ("recorder",) if options.tolerance_um is None else ("recorder", "metrology")
            client.wait_for_graph(options.timeout, also)
            loop = None
            if options.tolerance_um is not None:
                loop = CameraLoop(client, options.tolerance_um, options.iterations, options.timeout)
            times.append(time.monotonic())
            asked, plane = problem.asked, problem.plane
            stamp = client.send_targets(
                plane.ids[asked], problem.targets[asked], plane.fibre[asked]
            )
            client.wait_until_ready(stamp, options.timeout)
            times.append(time.monotonic())
            client.start(options.timeout)
            times.append(time.monotonic())
            outcome = client.wait_for_outcome(stamp, options.timeout)
            times.append(time.monotonic())
            stages = client.times[stamp]
            images: dict[str, object] = {}
            client.wait_for_recording(stamp, options.timeout)
            if loop is not None:
                asked_ids = plane.ids[asked]
                closed = loop.run(asked_ids, problem.targets[asked], outcome)
                outcome, images = closed.outcome, show_images(closed, display.say)
                times[-1] = time.monotonic()
                path = options.out / recording_name(stamp)
                _wait_for_images(client, path, len(closed.places), options.timeout)
    (options.out / recording_name(stamp)).replace(options.out / "recording.npz")
    graph, ready, start, move = np.diff(times)
    plan = stages["planner"] - stages["sent"]
    wall_s: dict[str, float] = {
        "graph": graph, "plan": plan, "discretize": ready - plan, "start": start, "move": move
    }  # fmt: skip
    return _Run(outcome, load_recording(options.out / "recording.npz"), wall_s, images)


def _wait_for_images(client: PlaneClient, path: Path, images: int, timeout_s: float) -> None:
    """Wait until the recorder has added all images of a loop to the recording of its plan."""
    seen_ns, found = -1, 0

    def written() -> bool:
        nonlocal seen_ns, found
        now_ns = path.stat().st_mtime_ns
        if now_ns != seen_ns:  # to load it takes longer than a message
            seen_ns, recorded = now_ns, load_recording(path).images
            found = 0 if recorded is None else len(recorded.place_mm)
        return found >= images

    client.wait_for(written, timeout_s, lambda: f"images in the recording, {found} of {images}")


def _recorder(problem: Problem, options: argparse.Namespace) -> dict[str, object]:
    return {
        "folder": str(options.out.resolve()),
        "preset": problem.plane.name,
        "seed": options.seed,
        "planner": options.planner,
    }


def _report(run: _Run) -> dict[str, Any]:
    about = run.recording.about
    return (
        about["report"]
        | {
            "margin_mm": about["certificate"]["margin_mm"],
            "bytes_bound": ORDER_BYTES_BOUND,
            "notes": about["notes"],
            "wall_s": run.wall_s,
        }
        | run.images
    )


def _write(out: Path, run: _Run, report: dict[str, Any], form: str | None) -> None:
    recording, outcome = run.recording, run.outcome
    motion = recording.executed
    save_plan(out / "plan.npz", motion, outcome.outcome, outcome.reason)
    before_and_after(recording.problem, motion, outcome.outcome).savefig(out / "plane.png", dpi=110)
    if recording.images is not None:
        figures.images(recording).savefig(out / "residuals.png", dpi=110)
    write_player(out / "player.html", out / "recording.npz")
    save_report(out / "report.json", report)
    problem = recording.problem
    write_results(out / "results.ecsv", problem.plane, outcome, motion.end, form, problem.targets)


def _figures(report: dict[str, Any]) -> str:
    rows: list[tuple[object, ...]] = [("", "value", "bound")]
    rows += [("reached", report["reached"], report["asked"])]
    rows += [(name, report[name], "") for name in ("held", "failed")]
    rows += [("held because disabled", report["reasons"].get("disabled", 0), "")]
    rows += [
        ("makespan s", f"{report['makespan_s']:.3f}", f"{report['lower_bound_s']:.3f}"),
        ("least clearance mm", _clearance(report), f"{report['margin_mm']:.4f}"),
        ("segments of a moving joint", f"{report['segments_mean']:.2f}", "1.00"),
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


def _clearance(report: dict[str, Any]) -> str:
    least = report["min_clearance_mm"]
    nearer = len(report["nearer_from_start"])
    text = "no robots near each other" if least is None else f"{least:.4f}"
    return f"{text}, {nearer} pairs nearer from the start" if nearer else text


if __name__ == "__main__":
    sys.exit(main())

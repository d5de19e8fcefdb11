# SPDX-License-Identifier: Apache-2.0
"""Run a simulated focal plane with its console until interrupted.

Starts plant, bridge, planner, discretizer, recorder and console as processes on this machine, in
the ROS domain of the environment, and prints the address of the console: open it in a browser. It
shows the plane as it moves, and has buttons for the orders of an operator. Targets come from
another terminal, as from an observatory: `make reconfigure TARGETS=random:1`. With --camera a
simulated camera sees arms that do not quite follow their counters, for `make reconfigure
ARGS=--tolerance-um=10`, `make recover` and `make wiring`.

A console that ends is started again, three times in a minute at most. When it ends more often, or
another process ends, all end, and the exit code is 1.
"""

import argparse
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from fiber_bringup.demo import ARMS
from fiber_bringup.processes import Processes
from fiber_bus_bridge.plant import plant_socket
from fiber_core.drive.named import DRIVES
from fiber_core.errors import FiberError
from fiber_core.presets import PRESETS
from fiber_core.problem import save_problem
from fiber_formats import problem_from
from fiber_node.ros_environment import use_loopback
from fiber_planner import DEFAULT_PLANNER, planners

__all__ = ["main"]

_LOOK_S = 0.2  # time between two looks at the processes
_ADDRESS = "the console is at "
_CONSOLE = "console"
_RESTARTS, _WITHIN_S = 3, 60.0  # most restarts of the console, in the time before


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line; return the exit code."""
    options = _parser().parse_args(argv)
    for each in (signal.SIGINT, signal.SIGTERM):  # a shell lets its background jobs ignore SIGINT
        signal.signal(each, signal.default_int_handler)
    use_loopback()
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        _run(options)
    except (FiberError, OSError) as error:
        print(f"console: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("console: interrupted, all nodes were ended", file=sys.stderr)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="live", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", choices=list(PRESETS), help="instrument, default desi")
    parser.add_argument("--robots", type=int, help="number of robots; by default all")
    parser.add_argument("--layout", help="files of robots instead of a preset, joined by commas")
    parser.add_argument("--starts", help="files with the present angles; by default random")
    parser.add_argument("--drive", choices=sorted(DRIVES), help="motors; by default of the layout")
    parser.add_argument(
        "--motors-on", type=float, metavar="SHARE", help="most motors of a supply on at once, to 1"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of random starts")
    parser.add_argument("--planner", choices=planners(), default=DEFAULT_PLANNER)
    parser.add_argument("--faults", default="", metavar="KIND[:COUNT],...", help="as of the demo")
    parser.add_argument("--camera", action="store_true", help="metrology and a simulated camera")
    parser.add_argument(
        "--swapped", default="", metavar="A-B, C-D", help="robots whose plugs are swapped"
    )
    parser.add_argument("--port", type=int, default=8137, help="port of the console, 8137")
    parser.add_argument("--out", type=Path, default=Path("out/live"), help="logs and recordings")
    return parser


def _run(options: argparse.Namespace) -> None:
    found = problem_from(
        layout=options.layout,
        preset=options.preset,
        robots=options.robots,
        seed=options.seed,
        starts=options.starts,
        drive=options.drive,
        motors_on=options.motors_on,
    )
    for line in found.lines:
        print(line, file=sys.stderr)
    out = options.out.resolve()
    problem_file, name = str(out / "problem.npz"), found.problem.plane.name
    save_problem(problem_file, found.problem)
    plant = str(plant_socket(f"live.{os.getpid()}"))
    with Processes(options.out) as processes:
        processes.start_command(
            "fiber_bus_bridge",
            "plant",
            [f"--problem={problem_file}", f"--seed={options.seed}", f"--faults={options.faults}",
             "--time-scale=1.0", f"--socket={plant}"],
        )  # fmt: skip
        bridge = {"problem": problem_file, "time_scale": 1.0, "plant": plant}
        processes.start("fiber_bus_bridge", "bridge", bridge)
        processes.start("fiber_planner", "planner", {"planner": options.planner})
        processes.start("fiber_discretizer", "discretizer", {})
        recorder = {"folder": str(out), "preset": name, "planner": options.planner}
        processes.start("fiber_recording", "recorder", recorder)
        _start_camera(processes, plant, options)
        console = {"folder": str(out), "port": options.port}
        processes.start("fiber_console", _CONSOLE, console)
        print(f"{found.problem.plane.n} robots of {name}; logs and recordings in {options.out}")
        print(_address(processes, options.out / f"{_CONSOLE}.log"), flush=True)
        _watch(processes)


def _start_camera(processes: Processes, plant: str, options: argparse.Namespace) -> None:
    """Start metrology and camera, if they are asked for.

    Raises:
        FiberError: plugs are swapped that no camera would see.
    """
    if not options.camera:
        if options.swapped:
            raise FiberError("--swapped names arms that a camera shows: --camera is missing")
        return
    processes.start("fiber_metrology", "metrology", {})
    camera = {"plant": plant, "seed": options.seed, "swapped": options.swapped} | ARMS
    processes.start("fiber_metrology", "camera", camera)


def _watch(
    processes: Processes,
    clock: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
) -> None:
    """Start the console again when it ends; raise when it ends often, or another process ends.

    Raises:
        ProcessError: a process has ended for good; shows the end of its log.
    """
    restarts: list[float] = []
    while True:
        pause(_LOOK_S)
        ended, now_s = processes.ended(), clock()
        restarts = [each for each in restarts if each > now_s - _WITHIN_S]
        if ended == [_CONSOLE] and len(restarts) < _RESTARTS:
            print("the console has ended and is started again", file=sys.stderr)
            processes.restart(_CONSOLE)
            restarts.append(now_s)
        elif ended:
            processes.check()


def _address(processes: Processes, log: Path) -> str:
    """Wait until the console says where it is."""
    while True:
        processes.check()
        for line in log.read_text(errors="replace").splitlines():
            if _ADDRESS in line:
                return f"console: {line.partition(_ADDRESS)[2]}"
        time.sleep(_LOOK_S)


if __name__ == "__main__":
    sys.exit(main())

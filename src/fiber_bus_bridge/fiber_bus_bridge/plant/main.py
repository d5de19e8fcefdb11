# SPDX-License-Identifier: Apache-2.0
"""Run the simulated plant of a focal plane: its robots and buses, served on a local socket.

A bridge connects with the parameter `plant`. The plant outlives it: when the bridge is killed the
robots stop by their own watchdogs, and the next bridge finds them where they are. The options of
the plane are those of the bridge, and must describe the same plane.
"""

import argparse
import gc
import logging
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import MISSING, fields
from pathlib import Path

import yaml

from fiber_bus_bridge.plant.memory_file import MemoryFile
from fiber_bus_bridge.plant.messages import PlantError
from fiber_bus_bridge.plant.paths import plant_socket
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.plant.rehearsal import rehearse
from fiber_bus_bridge.plant.server import PlantServer, listen
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses, simulated_problem
from fiber_core.errors import FiberError
from fiber_core.wire_units import WireUnits

__all__ = ["main"]

_CONFIGURED = {field.name for field in fields(SimulationConfig)}
_LOG = logging.getLogger("plant")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the plant until it is interrupted; return the exit code."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where a shell ignores it
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logging.basicConfig(
        level=logging.INFO, format="[%(levelname)s] [%(created).6f] [%(name)s]: %(message)s"
    )
    try:
        _serve(_options(argv))
    except (FiberError, OSError) as error:
        _LOG.critical("%s", error)
        return 2
    except KeyboardInterrupt:
        _LOG.info("interrupted: the plant ends")
    gc.freeze()  # as nodes do when they end: the end of Python takes 0.2 s less
    return 0


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line, over the parameters of the file that it names."""
    parser = _parser()
    given = parser.parse_args(argv)
    if given.params_file:
        parameters = _parameters(given.params_file)
        for name, value in parameters.items():
            wanted = type(parser.get_default(name))
            if name not in _CONFIGURED or not isinstance(value, wanted):
                raise PlantError(
                    f"{given.params_file}: {name} = {value!r} is no parameter of a plant"
                )
        parser.set_defaults(**parameters)
    return parser.parse_args(argv)


def _parameters(path: Path) -> dict[str, object]:
    """The section `plant` of a parameter file, as ROS has them."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
        return dict(content.get("plant", {}).get("ros__parameters", {}))
    except (yaml.YAMLError, AttributeError, ValueError, TypeError) as error:
        raise PlantError(f"{path} is no parameter file: {error}") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="plant", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    plane = parser.add_argument_group("plane, clocks and faults, as the parameters of the bridge")
    for field in fields(SimulationConfig):
        assert field.default is not MISSING
        plane.add_argument(
            f"--{field.name.replace('_', '-')}",
            type=type(field.default),
            default=field.default,
            metavar=type(field.default).__name__.upper(),
            help=f"default {field.default!r}",
        )
    parser.add_argument(
        "--params-file", type=Path, help="YAML file with a section plant: ros__parameters:"
    )
    parser.add_argument(
        "--socket",
        default="auto",
        help="path of the socket; auto: one of this user and ROS_DOMAIN_ID",
    )
    parser.add_argument("--name", default="", help="name of the plane in the path auto")
    parser.add_argument(
        "--time-scale",
        type=float,
        default=1.0,
        help="simulated seconds per second without a bridge, 0 for as fast as possible",
    )
    parser.add_argument(
        "--patience",
        type=float,
        default=1.0,
        help="seconds after which a connected bridge counts as silent while robots move",
    )
    parser.add_argument(
        "--memory", type=Path, help="file that keeps the robots' memory if the plant is killed"
    )
    parser.add_argument(
        "--kept", type=int, default=20_000, help="movements of the true motion that are kept"
    )
    return parser


def _serve(options: argparse.Namespace) -> None:
    config = SimulationConfig(
        **{f.name: getattr(options, f.name) for f in fields(SimulationConfig)}
    )
    path = plant_socket(options.name) if options.socket == "auto" else Path(options.socket)
    found = simulated_problem(config)
    plane, start = found.problem.plane, found.problem.start
    units = WireUnits.for_plane(plane)
    buses = simulated_buses(plane, units, start, config)
    memory = MemoryFile(options.memory, buses) if options.memory else None
    rehearse()
    plant = Plant(buses, units.quantum_rad, options.time_scale, options.patience, options.kept)
    listener, lock = listen(path)
    server = PlantServer(plant, plane.ids, listener, time.monotonic)
    try:
        if memory is not None:
            memory.power_cut()
            if memory.taken_over:
                _LOG.info("%s: the robots had a power cut and have booted", options.memory)
            server.keep_time = memory.keep_time
        for line in found.lines:
            _LOG.info("%s", line)
        _LOG.info("%d robots on %d buses, at %s", plane.n, len(set(buses.positioners.bus)), path)
        server.serve()
    finally:
        path.unlink(missing_ok=True)
        server.close(lock)


if __name__ == "__main__":
    sys.exit(main())

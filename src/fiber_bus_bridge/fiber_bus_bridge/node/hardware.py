# SPDX-License-Identifier: Apache-2.0
"""The hardware of the bridge: simulated buses, here or in a plant, or I2C adapters; its clock."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from fiber_bus_bridge.bus import BusBackend, BusTiming, LinuxBuses, addresses_of, bus_timing
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.plant import PlantBuses, plant_socket
from fiber_bus_bridge.plant.rehearsal import rehearse
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses, simulated_problem
from fiber_core.array_types import Angles
from fiber_core.clearance import Safety
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_node import NodeParameters

__all__ = [
    "SLICE_S",
    "DeclaredHardware",
    "Hardware",
    "declare_hardware",
    "device_hardware",
    "open_hardware",
    "plant_hardware",
    "simulated_hardware",
]

_OF_THE_PLANT = ("clock_ppm", "start_skew_s", "faults", "faults_from_s", "faults_until_s")
_PLANT_S = 60.0  # longest wait for a plant, which may have to compile its loops
SLICE_S = 0.01  # time of the buses after which a waiting stop is served
Part: TypeAlias = Callable[[FocalPlane], FocalPlane]


def _all(plane: FocalPlane) -> FocalPlane:
    return plane


@dataclass(frozen=True, eq=False)
class Hardware:
    """A plane and its buses.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of its wire format.
        start: assumed angles of robots that do not answer [rad], shape (n, 2).
        buses: the buses.
        timing: nominal clock and times of the buses.
        clock: returns the time of the buses [s], or -inf for simulated buses, whose time advances
            only with their traffic.
        slice_s: longest time for which moving robots are supervised in one call [s].
        plant: socket of the plant with the robots, None without a plant.
        lines: what was read from the files of the plane, and what of them is not used.
    """

    plane: FocalPlane
    units: WireUnits
    start: Angles
    buses: BusBackend
    timing: BusTiming
    clock: Callable[[], float] = lambda: -np.inf
    slice_s: float = np.inf
    lines: tuple[str, ...] = ()
    plant: Path | None = None

    @property
    def in_real_time(self) -> bool:
        """Whether the time of the buses is the time of this machine."""
        return bool(np.isfinite(self.slice_s))

    @property
    def robots_outlive(self) -> bool:
        """Whether the robots are still there when the bridge has ended."""
        return self.in_real_time or self.plant is not None

    def session(self, safety: Safety, config: SessionConfig, tap: BusBackend | None) -> Session:
        """Return a session with these robots.

        Args:
            safety: clearance required of every started motion.
            config: settings.
            tap: the buses with what captures their traffic; None for no captures.
        """
        buses = self.buses if tap is None else tap
        return Session(self.plane, self.units, safety, buses, self.start, config)

    def close(self) -> None:
        """Leave the buses; robots that move stop by their own watchdogs."""
        if isinstance(self.buses, (LinuxBuses, PlantBuses)):
            self.buses.close()


@dataclass(frozen=True)
class HardwareConfig:
    """The process of the simulated robots, or the I2C adapters of this machine.

    Args:
        plant: socket of a plant with the simulated robots; "auto" for that of this user, domain and
            namespace; "none" for robots in the process of the bridge.
        devices: paths of the I2C adapters in the order of the bus numbers, as /dev/i2c-1; an
            empty text for the simulated buses.
    """

    plant: str = "none"
    devices: tuple[str, ...] = ("",)


class DeclaredHardware(NamedTuple):
    """The parameters of the hardware.

    Args:
        plane: the plane, and the simulation of its robots.
        chosen: the plant or the I2C adapters in place of simulated buses.
    """

    plane: SimulationConfig
    chosen: HardwareConfig


def declare_hardware(parameters: NodeParameters) -> DeclaredHardware:
    """Declare the parameters of the hardware: those of SimulationConfig and of HardwareConfig.

    HardwareConfig replaces the simulated buses. None of them can change while the bridge runs.

    Raises:
        FiberError: a value is refused.
    """
    plane = parameters.declare(SimulationConfig, read_only=True).value
    return DeclaredHardware(plane, parameters.declare(HardwareConfig, read_only=True).value)


def open_hardware(
    declared: DeclaredHardware,
    namespace: str = "",
    pause: Callable[[float], None] = time.sleep,
    part: Part = _all,
) -> Hardware:
    """Return the hardware that parameters describe.

    Args:
        declared: the parameters.
        namespace: the namespace of the node, which is part of the path of its plant.
        pause: waits for a number of seconds, while there is no plant yet.
        part: returns the robots of the plane that are driven, with their ids; by default all.

    Raises:
        FiberError: the parameters describe no hardware, or there is no plant.
    """
    config, chosen = declared
    if chosen.devices:
        if chosen.plant != "none":
            raise BridgeError(
                f"plant is {chosen.plant!r} and devices are {list(chosen.devices)}: choose one"
            )
        return device_hardware(config, chosen.devices, part)
    if chosen.plant == "none":
        return simulated_hardware(config, part)
    path = plant_socket(namespace) if chosen.plant == "auto" else Path(chosen.plant)
    return plant_hardware(config, path, pause, part)


def _found(config: SimulationConfig, part: Part) -> tuple[FocalPlane, Angles, tuple[str, ...]]:
    found = simulated_problem(config)
    whole, plane = found.problem.plane, part(found.problem.plane)
    start = found.problem.start
    if plane is not whole:
        start = start[whole.index_of(plane.ids)]
    return plane, start, found.lines


def simulated_hardware(config: SimulationConfig, part: Part = _all) -> Hardware:
    """Return a simulated plane with simulated buses.

    Args:
        config: the plane.
        part: returns the robots of the plane that are simulated, with their ids; by default all.

    Raises:
        FiberError: the plane does not exist.
    """
    plane, start, lines = _found(config, part)
    units = WireUnits.for_plane(plane)
    buses = simulated_buses(plane, units, start, config)
    return Hardware(plane, units, start, buses, bus_timing(config.clock), lines=lines)


def plant_hardware(
    config: SimulationConfig,
    path: Path,
    pause: Callable[[float], None] = time.sleep,
    part: Part = _all,
) -> Hardware:
    """Return a plane with robots in the process of a plant.

    Args:
        config: the plane; errors of clocks and faults are those of the plant.
        path: the socket of the plant, which may appear later.
        pause: waits for a number of seconds, while there is no plant yet.
        part: returns the robots of the plane that this plant has; by default all.

    Raises:
        BridgeError: a parameter belongs to the plant; there is no plant, another bridge is
            connected with it, or it has another plane.
        FiberError: the plane does not exist.
    """
    for field in fields(SimulationConfig):
        value = getattr(config, field.name)
        if field.name in _OF_THE_PLANT and value != field.default:
            raise BridgeError(f"{field.name} is {value!r}: give it to the plant at {path} instead")
    plane, start, lines = _found(config, part)
    timing = bus_timing(config.clock)
    rehearse()
    buses = PlantBuses(path, plane.ids, addresses_of(plane), timing, _PLANT_S, pause=pause)
    units = WireUnits.for_plane(plane)
    return Hardware(plane, units, start, buses, timing, lines=lines, plant=path)


def device_hardware(
    config: SimulationConfig, devices: Sequence[str], part: Part = _all
) -> Hardware:
    """Return a plane on I2C adapters of this machine, in the order of its bus numbers.

    Args:
        config: the plane, and by its problem or starts the assumed angles of the robots.
        devices: path of the adapter of each bus, as "/dev/i2c-1".
        part: returns the robots of the plane on these adapters, with their ids; by default all.

    Raises:
        BridgeError: there is neither problem nor starts, the motors have a ramp, or the devices do
            not fit the buses or cannot be opened.
        FiberError: the plane does not exist.
    """
    if not (config.problem or config.starts):
        raise BridgeError(
            "devices need the parameter problem or starts: it holds the robots' assumed angles"
        )
    plane, start, lines = _found(config, part)
    # the stop skew of the certificate has no term for the way that a ramp needs to come to rest
    ramp_s = plane.drive.longest_ramp_s
    if ramp_s > 0.0:
        raise BridgeError(
            f"the drive {plane.drive.name!r} has a ramp of {ramp_s:.6g} s: robots on devices could "
            f"not come to rest within the stop skew of the certificate"
        )
    numbers = np.unique(np.asarray(plane.bus)).tolist()
    if len(devices) != len(numbers):
        raise BridgeError(f"devices are {list(devices)} for the {len(numbers)} buses {numbers}")
    try:
        buses = LinuxBuses(dict(zip(numbers, devices)))
    except (OSError, ModuleNotFoundError) as error:
        raise BridgeError(f"devices {list(devices)}: {error}") from error
    units, timing = WireUnits.for_plane(plane), bus_timing(config.clock)
    return Hardware(plane, units, start, buses, timing, time.monotonic, SLICE_S, lines)

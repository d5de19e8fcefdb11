"""What the bridge's buses are made of, simulation or devices of this machine, and their clock."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.bus import BusBackend
from fiber_bus_bridge.bus.linux import LinuxBuses
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.simulation.config import SimulationConfig, simulated_buses, simulated_plane
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits

__all__ = ["Hardware", "device_hardware", "simulated_hardware"]

_SLICE_S = 0.01  # of real time after which a stop gets its turn


@dataclass(frozen=True, eq=False)
class Hardware:
    """A plane and its buses.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of its wire format.
        start: where robots that do not answer are believed to be [rad], shape (n, 2).
        buses: what carries frames.
        clock: tells the time of the buses [s]; of simulated ones it tells nothing, because
            their time goes on with what is done on them.
        slice_s: longest time robots are watched in one go [s].
    """

    plane: FocalPlane
    units: WireUnits
    start: np.ndarray
    buses: BusBackend
    clock: Callable[[], float] = lambda: -np.inf
    slice_s: float = np.inf


def simulated_hardware(config: SimulationConfig) -> Hardware:
    """Return a simulated plane.

    Raises:
        FiberError: there is no such plane.
    """
    plane, start = simulated_plane(config)
    units = WireUnits.for_plane(plane)
    return Hardware(plane, units, start, simulated_buses(plane, units, start, config))


def device_hardware(config: SimulationConfig, devices: Sequence[str]) -> Hardware:
    """Return a plane on I2C adapters of this machine, in the order of its bus numbers.

    Args:
        config: which plane, and by a problem where its robots are believed to be.
        devices: path of the adapter of each bus, as "/dev/i2c-1".

    Raises:
        BridgeError: no problem is given, devices do not fit its buses, or cannot be opened.
        FiberError: there is no such plane.
    """
    if not config.problem:
        raise BridgeError("devices need problem: it tells where robots stand that do not answer")
    plane, start = simulated_plane(config)
    numbers = np.unique(plane.bus).tolist()
    if len(devices) != len(numbers):
        raise BridgeError(f"devices are {list(devices)} for the {len(numbers)} buses {numbers}")
    try:
        buses = LinuxBuses(dict(zip(numbers, devices)))
    except (OSError, ModuleNotFoundError) as error:
        raise BridgeError(f"devices {list(devices)}: {error}") from error
    return Hardware(plane, WireUnits.for_plane(plane), start, buses, time.monotonic, _SLICE_S)

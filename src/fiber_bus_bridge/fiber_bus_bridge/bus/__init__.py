"""The buses: who hangs where, how long a message takes, and who carries it."""

from fiber_bus_bridge.bus.backend import Ack, BusBackend, Exchange, Replies
from fiber_bus_bridge.bus.counters import BusCounters
from fiber_bus_bridge.bus.faults import Cure, FaultKind, Faults, Line, draw_faults
from fiber_bus_bridge.bus.linux import LinuxBuses
from fiber_bus_bridge.bus.simulated import SimulatedBuses
from fiber_bus_bridge.bus.timing import BUS_TIMINGS, BusTiming, bus_timing
from fiber_bus_bridge.bus.topology import TOPOLOGIES, Topology, addresses_of

__all__ = [
    "BUS_TIMINGS",
    "TOPOLOGIES",
    "Ack",
    "BusBackend",
    "BusCounters",
    "BusTiming",
    "Cure",
    "Exchange",
    "FaultKind",
    "Faults",
    "Line",
    "LinuxBuses",
    "Replies",
    "SimulatedBuses",
    "Topology",
    "addresses_of",
    "bus_timing",
    "draw_faults",
]

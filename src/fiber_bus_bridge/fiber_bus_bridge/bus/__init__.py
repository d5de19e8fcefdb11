# SPDX-License-Identifier: Apache-2.0
"""The buses: topology, timing, and the backend that carries messages on real adapters."""

from fiber_bus_bridge.bus.backend import Ack, BusBackend, Exchange, Replies
from fiber_bus_bridge.bus.counters import BusCounters
from fiber_bus_bridge.bus.linux import LinuxBuses
from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.bus.timing import BUS_TIMINGS, BusTiming, bus_timing
from fiber_bus_bridge.bus.topology import TOPOLOGIES, Topology, addresses_of

__all__ = [
    "BUS_TIMINGS",
    "TOPOLOGIES",
    "Ack",
    "BusBackend",
    "BusCounters",
    "BusTiming",
    "Recovery",
    "Exchange",
    "LinuxBuses",
    "Replies",
    "Topology",
    "addresses_of",
    "bus_timing",
]

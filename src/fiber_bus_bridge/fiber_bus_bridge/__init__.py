"""The bus bridge: orders become bytes, bytes go over I2C, robots move, outcomes come back."""

from fiber_bus_bridge.attempts import Attempts
from fiber_bus_bridge.bus import (
    TOPOLOGIES,
    Ack,
    BusBackend,
    BusTiming,
    Exchange,
    SimulatedBuses,
    addresses_of,
    bus_timing,
)
from fiber_bus_bridge.errors import BridgeError, SessionError, TopologyError, WireError
from fiber_bus_bridge.firmware import Positioners
from fiber_bus_bridge.results import PlanResult
from fiber_bus_bridge.roster import Roster
from fiber_bus_bridge.session import Session, SessionState
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses, simulated_plane
from fiber_bus_bridge.upload import Upload

__all__ = [
    "TOPOLOGIES",
    "Ack",
    "Attempts",
    "BridgeError",
    "BusBackend",
    "BusTiming",
    "Exchange",
    "PlanResult",
    "Positioners",
    "Roster",
    "Session",
    "SessionConfig",
    "SessionError",
    "SessionState",
    "SimulatedBuses",
    "SimulationConfig",
    "TopologyError",
    "Upload",
    "WireError",
    "addresses_of",
    "bus_timing",
    "simulated_buses",
    "simulated_plane",
]

# SPDX-License-Identifier: Apache-2.0
"""The bus bridge: orders become bytes, bytes go over I2C, robots move, outcomes come back."""

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.bus import (
    TOPOLOGIES,
    Ack,
    BusBackend,
    BusTiming,
    Exchange,
    addresses_of,
    bus_timing,
)
from fiber_bus_bridge.errors import BridgeError, SessionError, TopologyError, WireError
from fiber_bus_bridge.measured_places import place_robots, widen_outlines
from fiber_bus_bridge.plan_result import LoadedPlan, PlanResult
from fiber_bus_bridge.replanning import Replanning
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_config import SessionConfig
from fiber_bus_bridge.session_state import SessionState

__all__ = [
    "TOPOLOGIES",
    "Ack",
    "Replanning",
    "BridgeError",
    "BusBackend",
    "BusTiming",
    "Exchange",
    "PlanResult",
    "Availability",
    "Session",
    "SessionConfig",
    "SessionError",
    "SessionState",
    "TopologyError",
    "LoadedPlan",
    "WireError",
    "addresses_of",
    "bus_timing",
    "place_robots",
    "widen_outlines",
]

# SPDX-License-Identifier: Apache-2.0
"""The simulated plant: positioners, their buses, noise and faults.

The plant speaks the wire format and nothing else. Code that drives real buses does not import it.
"""

from fiber_bus_bridge.simulation.buses import SimulatedBuses
from fiber_bus_bridge.simulation.config import (
    SimulationConfig,
    simulated_buses,
    simulated_plane,
    simulated_problem,
)
from fiber_bus_bridge.simulation.events import EVENT, Event
from fiber_bus_bridge.simulation.faults import FaultKind, Faults, LineFault, draw_faults
from fiber_bus_bridge.simulation.mechanics import (
    NEVER,
    MechanicalErrors,
    Mechanics,
    draw_mechanics,
)
from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_bus_bridge.simulation.true_arms import ArmState, arms_at, arms_motion, true_angles
from fiber_bus_bridge.simulation.true_motion import (
    CounterMotion,
    Movements,
    ObservedBuses,
    TrueMotion,
)

__all__ = [
    "NEVER",
    "ArmState",
    "CounterMotion",
    "EVENT",
    "Event",
    "FaultKind",
    "Faults",
    "LineFault",
    "MechanicalErrors",
    "Mechanics",
    "Positioners",
    "Movements",
    "ObservedBuses",
    "SimulatedBuses",
    "SimulationConfig",
    "TrueMotion",
    "arms_at",
    "arms_motion",
    "draw_faults",
    "draw_mechanics",
    "simulated_buses",
    "simulated_plane",
    "simulated_problem",
    "true_angles",
]

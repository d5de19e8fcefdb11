# SPDX-License-Identifier: Apache-2.0
"""A model check of the protocol: its real steps, with every fate of every message, within a bound.

The controller is the real one, and so is the firmware of the simulated robots. Not modelled: the
certificate, which is a predicate here, bit errors, and durations of messages.
"""

from fiber_bus_bridge.simulation.model_check.choices import Choices, ChosenBuses, Fate, Mishap
from fiber_bus_bridge.simulation.model_check.search import Search, explore
from fiber_bus_bridge.simulation.model_check.system import Scenario, System
from fiber_bus_bridge.simulation.model_check.truth import Truth

__all__ = [
    "Choices",
    "ChosenBuses",
    "Fate",
    "Mishap",
    "Scenario",
    "Search",
    "System",
    "Truth",
    "explore",
]

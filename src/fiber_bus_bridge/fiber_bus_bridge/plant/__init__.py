# SPDX-License-Identifier: Apache-2.0
"""The simulated plant as a process of its own, which outlives the bridge.

`PlantProcess` serves buses and robots on a local socket; `PlantBuses` is the bus backend of a
bridge on the other side, and `PlantTruth` asks for the true motion.
"""

from fiber_bus_bridge.plant.buses import PlantBuses
from fiber_bus_bridge.plant.paths import plant_socket
from fiber_bus_bridge.plant.truth import PlantTruth, Truth, touching

__all__ = ["PlantBuses", "PlantTruth", "Truth", "plant_socket", "touching"]

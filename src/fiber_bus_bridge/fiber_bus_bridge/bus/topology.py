# SPDX-License-Identifier: Apache-2.0
"""Distribution of robots over buses and addresses."""

from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.errors import TopologyError
from fiber_bus_bridge.wire import ROLL_CALL_ADDRESS, Addresses
from fiber_core.array_types import Ints
from fiber_core.focal_plane import FocalPlane

__all__ = ["TOPOLOGIES", "Topology", "addresses_of"]

_FIRST_USABLE, _LAST_USABLE = 0x08, 0x77  # seven-bit addresses that are not reserved


@dataclass(frozen=True)
class Topology:
    """A rule that assigns robots to buses in the order of their rows.

    Args:
        robots_per_bus: number of robots on each bus.
        first_address: address of the first robot of a bus; the next robots have the next ones.
    """

    robots_per_bus: int
    first_address: int

    def assign(self, robots: int) -> tuple[Ints, Ints]:
        """Return the bus number and the address of each robot, both shape (robots,)."""
        rows = np.arange(robots)
        return rows // self.robots_per_bus, self.first_address + rows % self.robots_per_bus


TOPOLOGIES = {
    "10x500": Topology(500, 1),  # Kaci et al., SPIE 9912 (2016)
    "45x112": Topology(112, _FIRST_USABLE),  # all usable seven-bit addresses
    "139x36": Topology(36, _FIRST_USABLE),  # the load that an unbuffered bus can drive at 1 MHz
}


def addresses_of(plane: FocalPlane) -> Addresses:
    """Return the I2C address of each robot of a plane, n rows.

    All robots of a bus have the seven-bit form where all addresses of the bus lie in
    0x08..0x77, and the ten-bit form otherwise.

    Raises:
        TopologyError: an address is outside 0..1022, as 1023 is the roll call; names the robot.
    """
    bus, address = np.asarray(plane.bus), np.asarray(plane.address)
    outside = (address < 0) | (address >= ROLL_CALL_ADDRESS)
    if outside.any():
        at = int(np.argmax(outside))
        raise TopologyError(
            f"robot {plane.ids[at]}: address {address[at]} is not 0..{ROLL_CALL_ADDRESS - 1}"
        )
    needs_ten_bit = (address < _FIRST_USABLE) | (address > _LAST_USABLE)
    _, place = np.unique(bus, return_inverse=True)
    ten_bit = np.zeros(place.max(initial=-1) + 1, dtype=bool)
    np.logical_or.at(ten_bit, place, needs_ten_bit)
    return Addresses(bus, address, ten_bit[place])

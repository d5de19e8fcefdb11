"""Which robot hangs on which bus at which address."""

from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.errors import TopologyError
from fiber_bus_bridge.wire import Addresses
from fiber_core.focal_plane import FocalPlane

__all__ = ["TOPOLOGIES", "Topology", "addresses_of"]

_FIRST_USABLE, _LAST_USABLE = 0x08, 0x77  # of the seven-bit addresses; the rest is reserved


@dataclass(frozen=True)
class Topology:
    """A way to hang robots on buses in the order of their rows.

    Args:
        robots_per_bus: robots each bus takes before the next is begun.
        first_address: address of the first robot of a bus; the others follow.
    """

    robots_per_bus: int
    first_address: int

    def hang(self, robots: int) -> tuple[np.ndarray, np.ndarray]:
        """Return bus numbers and addresses of some robots, both shape (robots,)."""
        rows = np.arange(robots)
        return rows // self.robots_per_bus, self.first_address + rows % self.robots_per_bus


TOPOLOGIES = {
    "10x500": Topology(500, 1),  # Kaci et al., SPIE 9912 (2016)
    "45x112": Topology(112, _FIRST_USABLE),  # every seven-bit address there is
    "139x36": Topology(36, _FIRST_USABLE),  # what an unbuffered bus can drive at 1 MHz
}


def addresses_of(plane: FocalPlane) -> Addresses:
    """Return the I2C address of each robot of a plane, n rows.

    A bus whose addresses all lie in 0x08..0x77 uses the seven-bit form, any other the
    ten-bit form for all its robots.

    Raises:
        TopologyError: an address is outside 0..1023; names the robot.
    """
    outside = (plane.address < 0) | (plane.address > 1023)
    if outside.any():
        at = int(np.argmax(outside))
        raise TopologyError(f"robot {plane.ids[at]}: address {plane.address[at]} is not 0..1023")
    unfit = (plane.address < _FIRST_USABLE) | (plane.address > _LAST_USABLE)
    _, bus = np.unique(plane.bus, return_inverse=True)
    ten_bit = np.zeros(bus.max(initial=-1) + 1, dtype=bool)
    np.logical_or.at(ten_bit, bus, unfit)
    return Addresses(plane.bus, plane.address, ten_bit[bus])

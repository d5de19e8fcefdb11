# SPDX-License-Identifier: Apache-2.0
"""A coordinator of simulated sectors never writes or recalls the memory of real robots."""

import time
from pathlib import Path

from fiber_bus_bridge.node.hardware import simulated_hardware
from fiber_bus_bridge.node.remembered import MemoryConfig, memory_path
from fiber_bus_bridge.simulation import SimulationConfig
from fiber_sectors.node.coordinator import _SectoredHardware


def test_simulated_sectors_on_the_clock_of_their_host_have_no_memory_of_their_own():
    found = simulated_hardware(SimulationConfig(preset="desi", robots=7))
    hardware = _SectoredHardware(
        found.plane, found.units, found.start, found.buses, found.timing, clock=time.monotonic,
        slice_s=0.01,
    )  # fmt: skip
    assert hardware.in_real_time
    assert memory_path(MemoryConfig(), hardware) is None
    assert memory_path(MemoryConfig("kept.json"), hardware) == Path("kept.json")

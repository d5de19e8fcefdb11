"""Simulated positioners."""

from fiber_bus_bridge.firmware.positioners import Positioners

__all__ = ["Positioners"]

"""Simulated positioners."""

from fiber_bus_bridge.firmware.events import EVENT, Event
from fiber_bus_bridge.firmware.positioners import Positioners
from fiber_bus_bridge.firmware.record import MotionRecord, Runs

__all__ = ["EVENT", "Event", "MotionRecord", "Positioners", "Runs"]

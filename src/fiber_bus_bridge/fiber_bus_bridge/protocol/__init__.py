# SPDX-License-Identifier: Apache-2.0
"""The protocol of a controller: LOAD, VERIFY, certify, GO, countdown, motion, STOP, resume."""

from fiber_bus_bridge.protocol.context import Certifier, Context, Phase, Transition, Watch
from fiber_bus_bridge.protocol.machine import STEPS, handle, run, run_one
from fiber_bus_bridge.protocol.states import TRANSITIONS, Event, State, allows, next_state
from fiber_bus_bridge.protocol.tables import BUS, ROBOT, Buses, Robots

__all__ = [
    "BUS",
    "ROBOT",
    "STEPS",
    "TRANSITIONS",
    "Buses",
    "Certifier",
    "Context",
    "Event",
    "Phase",
    "Robots",
    "State",
    "Transition",
    "Watch",
    "allows",
    "handle",
    "next_state",
    "run",
    "run_one",
]

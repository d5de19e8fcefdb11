# SPDX-License-Identifier: Apache-2.0
"""A rehearsal: a small plane is moved once, so that all loops are compiled before robots wait."""

import logging
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from fiber_bus_bridge.bus import addresses_of
from fiber_bus_bridge.plant.buses import PlantBuses
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.plant.server import PlantServer, listen
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_core.clearance import Safety
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["rehearse"]

_ROBOTS, _TICKS, _SPEED = 7, 30, 400
_STEP_S = 0.1
_COMPILE_S = 300.0


def rehearse() -> None:
    """Take seven robots of a plant in this process through one plan.

    Compilation takes seconds where the cache of compiled loops is empty; in a motion it would
    keep the heartbeats back, and the robots would stop.
    """
    plane = preset("desi", _ROBOTS)
    units, start = WireUnits.for_plane(plane), np.tile([0.0, 3.1], (_ROBOTS, 1))
    buses = simulated_buses(plane, units, start, SimulationConfig())
    ended = threading.Event()
    with tempfile.TemporaryDirectory() as folder:
        listener, lock = listen(Path(folder) / "plant.sock")
        plant = Plant(buses, units.quantum_rad, patience_s=1e3)
        silent = logging.Logger("rehearsal", logging.CRITICAL)
        server = PlantServer(plant, plane.ids, listener, time.monotonic, silent)
        thread = threading.Thread(target=server.serve, args=[ended.is_set], daemon=True)
        thread.start()
        try:
            path, to = Path(folder) / "plant.sock", addresses_of(plane)
            remote = PlantBuses(path, plane.ids, to, buses.timing, answer_s=_COMPILE_S)
            _move(Session(plane, units, Safety(), remote, start))
            remote.close()
        finally:
            ended.set()
            thread.join()
            server.close(lock)


def _move(session: Session) -> None:
    t = session.configure(0.0)
    n = session.plane.n
    one_segment = np.repeat(np.arange(n + 1), 2)[1:]
    ticks, velocity = np.full(n, _TICKS), np.full(n, _SPEED)
    session.submit(WireMotion(session.units, session.counts, one_segment, ticks, velocity))
    t = session.start(t)
    while session.state is SessionState.MOVING:
        t = session.advance(t + _STEP_S)
    session.stop(t)

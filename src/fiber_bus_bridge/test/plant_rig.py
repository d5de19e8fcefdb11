# SPDX-License-Identifier: Apache-2.0
"""A plant in a thread of the test, and the same robots without one."""

import threading
import time
from contextlib import contextmanager

import numpy as np

from fiber_bus_bridge import Session, SessionState, addresses_of
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.plant import PlantBuses
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.plant.server import PlantServer, listen
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_core.clearance import Safety, certify, hold_until_safe
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits

N = 19
PLANE = preset("desi", N)
UNITS = WireUnits.for_plane(PLANE)
START = np.stack([np.linspace(-1, 1, N), np.full(N, 2.6)], axis=1)
LONG_S = 120.0  # loops may be compiled


class FakeTime:
    """A time that stands still until a test moves it."""

    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s


class Served:
    """A plant served by a thread."""

    def __init__(self, path, config=None, clock=time.monotonic, **settings):
        self.path = path
        self.buses = simulated_buses(PLANE, UNITS, START, config or SimulationConfig())
        self.plant = Plant(self.buses, UNITS.quantum_rad, **settings)
        listener, self._lock = listen(path)
        self.server = PlantServer(self.plant, PLANE.ids, listener, clock)
        self._ended = threading.Event()
        self._thread = threading.Thread(
            target=self.server.serve, args=[self._ended.is_set], daemon=True
        )
        self._thread.start()

    def end(self):
        self._ended.set()
        self._thread.join(LONG_S)
        self.server.close(self._lock)

    def connect(self, **settings):
        settings = {"wait_s": 5.0, "answer_s": LONG_S} | settings
        to = addresses_of(PLANE)
        return PlantBuses(self.path, PLANE.ids, to, self.buses.timing, **settings)


@contextmanager
def served(path, *args, **settings):
    made = Served(path, *args, **settings)
    try:
        yield made
    finally:
        made.end()


def session_on(buses, certify=hold_until_safe):
    tap = Tap(buses, None, limit=10**9)
    tap.buses = buses
    return Session(PLANE, UNITS, Safety(), tap, START, None, certify), tap


def turning(session, ticks=60, speed=400):
    offsets = np.repeat(np.arange(N + 1), 2)[1:]
    return WireMotion(UNITS, session.counts, offsets, np.broadcast_to(ticks, N), np.full(N, speed))


def begin(session, t=0.0, **motion):
    """Configure and start; return the time."""
    t = session.configure(t)
    if session.state is SessionState.STOPPED:
        t = session.clear(t)
    session.submit(turning(session, **motion), None)
    return session.start(t)


def finish(session, t):
    for _ in range(300):
        if session.state is not SessionState.MOVING:
            return t
        t = session.advance(t + 0.1)
    raise AssertionError("the plan does not end")


def wait_for(condition):
    """Let the thread of the plant work until a condition holds."""
    until_s = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < until_s, "the condition did not come to hold"
        time.sleep(1e-3)


def end(*_):
    """A bridge that ends between VERIFY and GO."""
    raise KeyboardInterrupt


def without_care(plane, motion, safety):
    """A certifier that takes every motion for safe, as if the robots rested."""
    rest = SegmentMotion(motion.start, np.zeros(2 * plane.n + 1, dtype=int), [], [])
    return motion, np.zeros(plane.n, dtype=bool), certify(plane, rest, safety)


def moving(plant, **motion):
    """A session whose robots have moved for 0.1 s."""
    session, _ = session_on(plant.connect())
    t = begin(session, **motion)
    session.advance(t + 0.1)
    assert plant.plant.moving == PLANE.n
    return session

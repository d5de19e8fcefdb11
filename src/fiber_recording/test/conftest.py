# SPDX-License-Identifier: Apache-2.0
"""Two example recordings, and simulated plans to compare replays with the true motion."""

from dataclasses import replace as changed

import numpy as np
import pytest

from fiber_bus_bridge import Session, SessionConfig, SessionState, addresses_of
from fiber_bus_bridge.frame_log import frame_log
from fiber_bus_bridge.simulation import EVENT, Faults, Positioners, SimulatedBuses, TrueMotion
from fiber_core.clearance import Safety
from fiber_core.presets import preset
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording import Recording, replay, save_recording
from fiber_recording.examples import random_recording


@pytest.fixture(scope="session")
def recording() -> Recording:
    return random_recording(1)


@pytest.fixture(scope="session")
def resumed() -> Recording:
    """All robots were stopped on the way; all but the failed one were resumed."""
    return random_recording(2, interrupted=True)


@pytest.fixture(scope="session")
def recording_file(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "recording.npz"
    save_recording(path, recording)
    return path


@pytest.fixture(scope="session")
def resumed_file(resumed, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "resumed.npz"
    save_recording(path, resumed)
    return path


class SimulatedPlan:
    """A plan of folded robots that turn forth and back in many segments, with faults.

    Args:
        events: faults of robots: row, time [s], Event, detail.
        lines: faults of the lines of a bus.
        stop_s: when an operator stops all robots [s].
        attempts: how many attempts are started one after the other.
        volatile: whether a loss of power sets the encoders of a robot to 0.
    """

    robots = 37

    def __init__(self, events=(), lines=(), stop_s=np.inf, attempts=1, volatile=False):
        rows = np.arange(self.robots)
        self.plane = changed(preset("desi", self.robots), bus=rows // 13, address=8 + rows % 13)
        self.units = units = WireUnits.for_plane(self.plane)
        rng = np.random.default_rng(1)
        folded = np.stack([rng.uniform(-1, 1, self.robots), np.full(self.robots, 3.0)], axis=1)
        self.start = units.to_counts(folded)
        faults = Faults(tuple(lines), events=np.array(list(events), dtype=EVENT))
        robots = Positioners(
            addresses_of(self.plane), self.plane.ids, units.quantum_prad, self.start,
            clock_ppm=rng.uniform(-20, 20, self.robots),
            start_skew_s=rng.uniform(0, 20e-6, self.robots), volatile=volatile,
        )  # fmt: skip
        true_motion = TrueMotion(robots, units.quantum_rad)
        buses = SimulatedBuses(robots, faults=faults)
        transfer = buses.transfer

        def observed_transfer(*batch):
            replies = transfer(*batch)
            true_motion.observe()
            return replies

        buses.transfer = observed_transfer
        session = Session(
            self.plane, units, Safety(), buses, units.to_angles(self.start),
            SessionConfig(),
        )  # fmt: skip
        t = session.configure(0.0)
        session.transactions.take_traffic()
        for _ in range(attempts):
            session.submit(self._orders(rng, session.counts))
            t = session.start(t)
            while session.state is SessionState.MOVING:
                t += 0.1
                t = max(t, session.stop(t) if t > stop_s else session.advance(t))
            self.result = session.take_result()
        self.logs = [frame_log(session.transactions.take_traffic())]
        self.replay = replay(self.plane, units, self.start, self.logs)
        self.encoders = robots.positions(t + 1.0)
        self.truth = true_motion.motion(t + 1.0)
        self.last_counts = session.counts
        self.phases_started = len(session.loaded_plans)

    def _orders(self, rng, counts):
        # theta forth and back at several speeds, phi a little in and out: no arm leaves the fold
        lengths = np.tile([6, 4], self.robots)
        speed = np.tile([3000, -6000, 5000, -2000, 0, 1500, -500, 400, 0, 100], self.robots)
        ticks = np.tile([60, 70, 90, 50, 20, 120, 90, 70, 40, 80], self.robots)
        ticks = np.maximum(ticks + rng.integers(-20, 20, len(ticks)), 5)
        offsets = Parts.from_counts(lengths).offsets
        return WireMotion(self.units, counts, offsets, ticks, speed)

    def off_rad(self, rows=slice(None)):
        """Largest distance of the replay from the true motion of some robots [rad]."""
        t0, executed = self.replay.start_s, self.replay.executed
        times = np.linspace(-0.1, executed.makespan_s + 0.2, 1500)
        return max(np.abs(executed(t) - self.truth(t + t0))[rows].max() for t in times)


@pytest.fixture
def simulated_plan():
    """The class SimulatedPlan: call it with faults."""
    return SimulatedPlan

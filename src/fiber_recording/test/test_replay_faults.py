"""A night that goes wrong is read back from the bytes as robots truly moved, stop by stop."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import Session, SessionConfig, SessionState, addresses_of
from fiber_bus_bridge.bus import Recovery
from fiber_bus_bridge.frame_log import frame_log
from fiber_bus_bridge.simulation import (
    EVENT,
    Event,
    Faults,
    Line,
    Positioners,
    SimulatedBuses,
    TrueMotion,
)
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.replay import replay
from fiber_recording.stop_time import stop_time_s

N = 37
MOST_RAD_S = 3.2 * 1.3
FRAME_S = 1.5e-4  # a frame is dated from its START; the GO is complete a little later


class Night:
    """Folded robots that turn there and back with many segments, and what befalls them."""

    def __init__(self, events=(), lines=(), stop_s=np.inf, attempts=1):
        rows = np.arange(N)
        self.plane = replace(preset("desi", N), bus=rows // 13, address=8 + rows % 13)
        self.units = units = WireUnits.for_plane(self.plane)
        rng = np.random.default_rng(1)
        folded = np.stack([rng.uniform(-1, 1, N), np.full(N, 3.0)], axis=1)
        self.start = units.to_counts(folded)
        faults = Faults(tuple(lines), events=np.array(list(events), dtype=EVENT))
        robots = Positioners(
            addresses_of(self.plane), self.plane.ids, units.quantum_prad, self.start,
            clock_ppm=rng.uniform(-20, 20, N), start_skew_s=rng.uniform(0, 20e-6, N),
        )  # fmt: skip
        record = TrueMotion(robots, units.quantum_rad)
        buses = SimulatedBuses(robots, faults=faults)
        transfer = buses.transfer

        def seen(*batch):
            replies = transfer(*batch)
            record.look()
            return replies

        buses.transfer = seen
        session = Session(
            self.plane, units, Safety(), buses, units.to_angles(self.start),
            SessionConfig(),
        )  # fmt: skip
        t = session.configure(0.0)
        session.link.take_traffic()
        for _ in range(attempts):
            session.submit(self._orders(rng, session.counts))
            t = session.start(t)
            while session.state is SessionState.MOVING:
                t += 0.1
                t = max(t, session.stop(t) if t > stop_s else session.advance(t))
            self.result = session.take_result()
        self.logs = [frame_log(session.link.take_traffic())]
        self.told = replay(self.plane, units, self.start, self.logs)
        self.encoders = robots.positions(t + 1.0)
        self.truth = record.motion(t + 1.0)
        self.heard = session.counts
        self.uploads = len(session.uploads)

    def _orders(self, rng, counts):
        # theta there and back at several speeds, phi a little in and out, nobody leaves home
        lengths = np.tile([6, 4], N)
        speed = np.tile([3000, -6000, 5000, -2000, 0, 1500, -500, 400, 0, 100], N)
        ticks = np.tile([60, 70, 90, 50, 20, 120, 90, 70, 40, 80], N)
        ticks = np.maximum(ticks + rng.integers(-20, 20, len(ticks)), 5)
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        return WireMotion(self.units, counts, offsets, ticks, speed)

    def off_rad(self, rows=slice(None)):
        """How far from the truth the replay ever is [rad]."""
        t0 = self.told.start_s
        times = np.linspace(-0.1, self.told.executed.makespan_s + 0.2, 1500)
        return max(np.abs(self.told.executed(t) - self.truth(t + t0))[rows].max() for t in times)


def test_without_faults_it_is_the_orders():
    night = Night()
    assert len(night.told.phases) == 1 and not night.told.phases[0].stopped.any()
    assert night.off_rad() < MOST_RAD_S * FRAME_S
    np.testing.assert_array_equal(night.told.end, night.encoders)


@pytest.mark.parametrize(
    "events",
    [
        [(5, 0.9, Event.JAM_THETA, 1)],
        [(5, 0.9, Event.JAM_PHI, 1), (20, 1.3, Event.JAM_THETA, 1)],
        [(11, 0.8, Event.POWER, 0), (11, 0.803, Event.POWER, 1)],
    ],
    ids=["jam", "two jams", "reset"],
)
def test_robots_that_stop_by_themselves_and_the_others_that_go_on(events):
    night = Night(events)
    told, bad = night.told, np.unique([event[0] for event in events])
    assert len(told.phases) == night.uploads == 1 + len(bad)
    assert (night.result.outcome[bad] == Outcome.FAILED).all()
    assert not told.lost.any()
    assert night.off_rad() < MOST_RAD_S * FRAME_S
    np.testing.assert_array_equal(told.end, night.encoders)
    for phase, after in zip(told.phases, told.phases[1:]):
        assert phase.stopped.sum() > 20 and after.begin_us > phase.stop_us.max()
        np.testing.assert_array_equal(after.motion.start, phase.end)
    on = told.phases[1].motion.decoded().counts.any(axis=1)
    assert on.sum() > 20 and not on[bad[0]]


@pytest.mark.parametrize(
    ("jam", "dies_s"),
    [((), 1.0), (((5, 0.9, Event.JAM_THETA, 1),), 0.9385)],
    ids=["first", "second"],
)
def test_robots_on_a_bus_that_dies_stop_when_the_others_are_stopped(jam, dies_s):
    # the second time before any of them was looked at since they went on
    night = Night(jam, lines=[(Line.SCL_LOW, 1, dies_s, np.inf, Recovery.NOTHING)])
    told, dead = night.told, night.plane.bus == 1
    assert len(told.phases) == 2 + len(jam) and (night.result.outcome[dead] == Outcome.FAILED).any()
    alive = np.flatnonzero(~dead)
    assert not told.lost[alive].any() and told.lost[dead].any()
    assert night.off_rad(alive) < MOST_RAD_S * FRAME_S
    np.testing.assert_array_equal(told.end[alive], night.encoders[alive])
    # when they hear nothing any more is known to a step of the watch
    assert night.off_rad(np.flatnonzero(dead)) < MOST_RAD_S * 2 * SessionConfig().watch_s


def test_a_robot_that_falls_silent_is_drawn_where_it_was_last_heard():
    night = Night([(11, 0.9, Event.POWER, 0)])
    told = night.told
    assert np.flatnonzero(told.lost).tolist() == [11] and len(told.phases) == 2
    others = np.delete(np.arange(N), 11)
    assert night.off_rad(others) < MOST_RAD_S * FRAME_S
    # of the looks at moving robots one in a tenth of a second is published
    assert night.off_rad([11]) < MOST_RAD_S * 0.12
    # the bridge tells where it heard it last, which is later
    told = replay(night.plane, night.units, night.start, night.logs, night.heard)
    np.testing.assert_array_equal(told.end, night.heard)
    off = night.units.to_angles(np.abs(told.end - night.encoders))
    assert off.max() < MOST_RAD_S * 4 * SessionConfig().watch_s


def test_another_attempt_goes_on_where_the_first_one_ended():
    night = Night([(5, 0.9, Event.JAM_THETA, 1)], attempts=2)
    phases = night.told.phases
    assert len(phases) == 3 and not phases[1].stopped.any()
    assert phases[2].motion.decoded().counts.any(axis=1).sum() > 20
    assert night.off_rad() < MOST_RAD_S * FRAME_S
    np.testing.assert_array_equal(night.told.end, night.encoders)


def test_a_stop_by_hand_leaves_robots_where_they_are():
    night = Night(stop_s=1.0)
    (phase,) = night.told.phases
    assert phase.stopped.sum() > 20
    assert night.off_rad() < MOST_RAD_S * FRAME_S
    np.testing.assert_array_equal(night.told.end, night.encoders)


def test_the_place_tells_the_instant_unless_both_joints_rest():
    units = WireUnits()
    # theta there and back, then a rest of both, then on; phi turns at first only
    motion = WireMotion(units, [[0, 0]], [0, 4, 5], [10, 10, 50, 10, 5], [100, -100, 0, 100, 7])
    tick_s = units.tick_s
    for place, about, ticks in (
        ([450, 31], 9.0, 4.5),  # phi tells which way theta went
        ([500, 35], 4.0, 5.0),
        ([500, 35], 16.0, 15.0),  # both times fit: that of the STOP counts
        ([0, 35], 40.0, 40.0),  # at rest any instant will do
        ([0, 35], 99.0, 70.0),
        ([800, 35], 99.0, 78.0),
    ):
        assert stop_time_s(motion, 0, place, about * tick_s) == pytest.approx(
            ticks * tick_s, abs=0.03 * tick_s
        )
    nothing = WireMotion(units, [[5, 5]], [0, 0, 0], [], [])
    assert stop_time_s(nothing, 0, [5, 5], 1.0) == 0.0

# SPDX-License-Identifier: Apache-2.0
"""Replays of plans with faults agree with the true motion of the simulated robots."""

import numpy as np
import pytest

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.bus import Recovery
from fiber_bus_bridge.simulation import Event, LineFault
from fiber_core.outcomes import Outcome
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.replay import replay
from fiber_recording.stop_time import stop_on_way

SIMULATED_ROBOTS = 37
MAX_SPEED_RAD_S = 3.2 * 1.3
FRAME_S = 1.5e-4  # a frame is dated from its START; the GO is complete a little later


def test_without_faults_the_executed_motion_is_that_of_the_orders(simulated_plan):
    plan = simulated_plan()
    assert len(plan.replay.phases) == 1 and not plan.replay.phases[0].stopped.any()
    assert plan.off_rad() < MAX_SPEED_RAD_S * FRAME_S
    np.testing.assert_array_equal(plan.replay.end, plan.encoders)


@pytest.mark.parametrize(
    "events",
    [
        [(5, 0.9, Event.JAM_THETA, 1)],
        [(5, 0.9, Event.JAM_PHI, 1), (20, 1.3, Event.JAM_THETA, 1)],
        [(11, 0.8, Event.POWER, 0), (11, 0.803, Event.POWER, 1)],
    ],
    ids=["jam", "two jams", "reset"],
)
def test_robots_that_stop_by_themselves_and_the_others_that_resume(simulated_plan, events):
    plan = simulated_plan(events)
    followed, bad = plan.replay, np.unique([event[0] for event in events])
    assert len(followed.phases) == plan.phases_started == 1 + len(bad)
    assert (plan.result.outcome[bad] == Outcome.FAILED).all()
    assert not followed.lost.any()
    assert plan.off_rad() < MAX_SPEED_RAD_S * FRAME_S
    np.testing.assert_array_equal(followed.end, plan.encoders)
    for phase, following in zip(followed.phases, followed.phases[1:]):
        assert phase.stopped.sum() > 20 and following.begin_us > phase.stop_us.max()
        np.testing.assert_array_equal(following.motion.start, phase.end)
    resumed = followed.phases[1].motion.decoded().counts.any(axis=1)
    assert resumed.sum() > 20 and not resumed[bad[0]]


@pytest.mark.parametrize(
    ("jam", "dies_s"),
    [((), 1.0), (((5, 0.9, Event.JAM_THETA, 1),), 0.9385)],
    ids=["first", "second"],
)
def test_robots_on_a_bus_that_dies_stop_when_the_others_are_stopped(simulated_plan, jam, dies_s):
    # the second time before any of them was polled after it was resumed
    plan = simulated_plan(jam, lines=[(LineFault.SCL_LOW, 1, dies_s, np.inf, Recovery.NOTHING)])
    followed, dead = plan.replay, plan.plane.bus == 1
    assert (
        len(followed.phases) == 2 + len(jam) and (plan.result.outcome[dead] == Outcome.FAILED).any()
    )
    alive = np.flatnonzero(~dead)
    assert not followed.lost[alive].any() and followed.lost[dead].any()
    assert plan.off_rad(alive) < MAX_SPEED_RAD_S * FRAME_S
    np.testing.assert_array_equal(followed.end[alive], plan.encoders[alive])
    # when they miss the heartbeat is known to a period of the polls
    assert (
        plan.off_rad(np.flatnonzero(dead))
        < MAX_SPEED_RAD_S * 2 * SessionConfig().heartbeat_period_s
    )


def test_a_lost_robot_is_placed_where_its_last_reply_said(simulated_plan):
    plan = simulated_plan([(11, 0.9, Event.POWER, 0)])
    followed = plan.replay
    assert np.flatnonzero(followed.lost).tolist() == [11] and len(followed.phases) == 2
    others = np.delete(np.arange(SIMULATED_ROBOTS), 11)
    assert plan.off_rad(others) < MAX_SPEED_RAD_S * FRAME_S
    # of the polls of moving robots one in a tenth of a second is published
    assert plan.off_rad([11]) < MAX_SPEED_RAD_S * 0.12
    # the last reply that the bridge received is later
    followed = replay(plan.plane, plan.units, plan.start, plan.logs, plan.last_counts)
    np.testing.assert_array_equal(followed.end, plan.last_counts)
    off = plan.units.to_angles(np.abs(followed.end - plan.encoders))
    assert off.max() < MAX_SPEED_RAD_S * 4 * SessionConfig().heartbeat_period_s


def test_another_attempt_begins_where_the_first_one_ended(simulated_plan):
    plan = simulated_plan([(5, 0.9, Event.JAM_THETA, 1)], attempts=2)
    phases = plan.replay.phases
    assert len(phases) == 3 and not phases[1].stopped.any()
    assert phases[2].motion.decoded().counts.any(axis=1).sum() > 20
    assert plan.off_rad() < MAX_SPEED_RAD_S * FRAME_S
    np.testing.assert_array_equal(plan.replay.end, plan.encoders)


def test_after_a_stop_by_an_operator_robots_stay_where_they_stopped(simulated_plan):
    plan = simulated_plan(stop_s=1.0)
    (phase,) = plan.replay.phases
    assert phase.stopped.sum() > 20
    assert plan.off_rad() < MAX_SPEED_RAD_S * FRAME_S
    np.testing.assert_array_equal(plan.replay.end, plan.encoders)


def test_the_place_gives_the_instant_of_a_stop_unless_both_joints_rest():
    units = WireUnits()
    # theta turns forth and back, both rest, theta turns again; phi turns only at first
    motion = WireMotion(units, [[0, 0]], [0, 4, 5], [10, 10, 50, 10, 5], [100, -100, 0, 100, 7])
    tick_s = units.tick_s
    for place, near, ticks in (
        ([450, 31], 9.0, 4.5),  # phi shows in which direction theta turned
        ([500, 35], 4.0, 5.0),
        ([500, 35], 16.0, 15.0),  # two times fit: the one near the STOP counts
        ([0, 35], 40.0, 40.0),  # both rest: the time of the STOP counts
        ([0, 35], 99.0, 70.0),
        ([800, 35], 99.0, 78.0),
    ):
        stop = stop_on_way(motion, 0, place, near * tick_s)
        assert stop.time_s == pytest.approx(ticks * tick_s, abs=0.03 * tick_s)
        assert stop.off_rad < units.quantum_rad
    nothing = WireMotion(units, [[5, 5]], [0, 0, 0], [], [])
    assert stop_on_way(nothing, 0, [5, 5], 1.0) == (0.0, 0.0)

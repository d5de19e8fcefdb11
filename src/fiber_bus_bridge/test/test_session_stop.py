# SPDX-License-Identifier: Apache-2.0
"""Stops during a motion: when all robots stop, and which robots resume."""

import numpy as np
import pytest
from session_rig import Rig, ended_once

from fiber_bus_bridge import Session, SessionConfig, SessionError, SessionState
from fiber_bus_bridge.bus import Recovery
from fiber_bus_bridge.remaining_motion import remaining_motion
from fiber_bus_bridge.simulation import Event, Faults, LineFault, SimulatedBuses
from fiber_bus_bridge.wire import Fault, RobotState
from fiber_core.clearance import Safety, neighbour_pairs
from fiber_core.outcomes import Outcome, Reason
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits


@pytest.mark.parametrize("when_s", [-0.2, 0.2])
def test_a_robot_deaf_to_general_calls_fails_and_all_others_arrive(when_s):
    rig = Rig()
    motion = rig.ready()
    if when_s > 0:
        rig.call("start")
        when_s += rig.session.loaded_plan.start_s
    rig.robots.schedule([(3, when_s, Event.CALL_DEAF, 1)])
    if when_s < 0:
        rig.call("start")
    result = rig.run()
    ended_once(result, 19)
    assert result.outcome[3] != Outcome.REACHED
    assert result.reason[3] == Reason.NO_HEARTBEAT
    assert set(np.delete(result.outcome, 3)) == {Outcome.REACHED}
    assert np.array_equal(np.delete(rig.where(), 3, 0), np.delete(motion.end, 3, 0))


@pytest.mark.parametrize("when_s", [0.0, 0.3])
def test_a_robot_that_stops_by_itself_stops_all_robots_at_once(when_s):
    rig = Rig(config=SessionConfig(resumes=0))
    rig.ready()
    rig.call("start")
    at = rig.session.loaded_plan.start_s + when_s
    rig.robots.schedule([(3, at, Event.JAM_THETA, 1)])
    result = rig.run()
    assert rig.session.state is SessionState.STOPPED
    ended_once(result, 19)
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, Reason.STALLED)
    assert set(np.delete(result.reason, 3)) == {Reason.OTHER_FAILED}
    halted = rig.robots.memory["halted_s"]
    assert halted[3] == pytest.approx(at, abs=20e-6)
    assert np.all(halted - at < rig.session.config.heartbeat_period_s + 1e-3)


@pytest.mark.parametrize("when_s", [0.0, 0.3123, 0.9999])
def test_stopped_robots_resume_to_the_exact_end_of_their_orders(when_s):
    rig = Rig()
    motion = rig.ready(theta=np.arange(19) * 40 - 360, phi=-30)
    rig.call("start")
    at = rig.session.loaded_plan.start_s + when_s
    rig.robots.schedule([(3, at, Event.JAM_THETA, 1)])
    result = rig.run()
    assert rig.session.state is SessionState.IDLE and len(rig.session.loaded_plans) == 2
    ended_once(result, 19)
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, Reason.STALLED)
    assert set(np.delete(result.outcome, 3)) == {Outcome.REACHED}
    assert np.array_equal(np.delete(rig.where(), 3, 0), np.delete(motion.end, 3, 0))


def test_the_remaining_motion_keeps_the_instants_of_its_segments():
    units = WireUnits()
    motion = WireMotion(units, [[0, 0]], [0, 3, 4], [10, 20, 5, 40], [7, -3, 100, 11])
    # stopped half a tick after the 17th: theta is in its second segment
    counts = [[70 - 3 * 7 - 1, 11 * 17 + 5]]
    left = remaining_motion(motion, counts, 17.5 * units.tick_s, [[500, 500]], [True])
    assert np.array_equal(left.end, motion.end)
    assert left.ticks[left.offsets[0] : left.offsets[1]].sum() == 13 + 5
    assert left.ticks[left.offsets[1] :].sum() == 23
    assert (left.ticks[left.offsets[1] - 1], left.velocity[left.offsets[1] - 1]) == (5, 100)
    assert np.abs(np.delete(left.velocity, left.offsets[1] - 1)).max() <= 11
    rests = remaining_motion(motion, counts, 17.5 * units.tick_s, [[500, 500]], [False])
    assert len(rests.ticks) == 0


def test_robots_without_heartbeats_stop_by_themselves():
    rig = Rig()
    rig.ready()
    rig.call("start")
    rig.t = rig.session.loaded_plan.start_s + 0.3
    rig.session.advance(rig.t)
    silence_s = 1e-3 * rig.session.config.silence_ms
    assert set(rig.robots.states(rig.t + silence_s + 0.1)) == {RobotState.FAULT}
    assert set(rig.robots.memory["fault"]) == {Fault.SILENCE}
    assert np.ptp(rig.robots.memory["halted_s"]) < 100e-6


def test_a_lost_robot_fails_and_holds_its_neighbours_until_it_is_configured():
    rig = Rig()
    rig.ready()
    rig.call("start")
    rig.robots.schedule([(0, rig.session.loaded_plan.start_s + 0.3, Event.POWER, 0)])
    result = rig.run()
    ended_once(result, 19)
    assert (result.outcome[0], result.reason[0]) == (Outcome.FAILED, Reason.NO_REPLY)
    # its position is unknown: robots that could touch it stay at the stop, the others resume
    assert rig.session.state is SessionState.IDLE
    neighbours = np.isin(
        np.arange(19), neighbour_pairs(rig.plane)[(neighbour_pairs(rig.plane) == 0).any(axis=1)]
    )
    assert set(result.reason[neighbours & (np.arange(19) > 0)]) == {Reason.PLACE_UNKNOWN}
    assert set(result.reason[~neighbours]) == {Reason.OK}

    rig.session.submit(rig.orders(-400, 0))
    rig.call("start")
    pairs = neighbour_pairs(rig.plane)
    held_neighbours = np.setdiff1d(pairs[(pairs == 0).any(axis=1)].ravel(), 0)
    held = np.union1d(held_neighbours, [0])
    assert np.array_equal(np.flatnonzero(~rig.session.loaded_plan.started), held)
    rig.run()

    rig.robots.power([0], True, rig.t)
    rig.call("configure")
    assert np.array_equal(rig.session.counts, rig.where())
    rig.session.submit(rig.orders(np.where(np.isin(np.arange(19), held), -300, 0), 0))
    rig.call("start")
    assert (rig.run().outcome[held] == Outcome.REACHED).all()


def test_a_robot_left_out_of_a_phase_keeps_its_reason_in_the_next():
    rig = Rig()
    pairs = neighbour_pairs(rig.plane)
    held_neighbours = np.setdiff1d(pairs[(pairs == 0).any(axis=1)].ravel(), 0)
    oversized = np.setdiff1d(np.arange(1, 18), held_neighbours)[
        0
    ]  # has more segments than an order can carry
    counts = np.zeros((19, 2), dtype=np.int64)
    counts[:, 0] = np.where(np.arange(19) == oversized, 16, 1)
    offsets = Parts.from_counts(counts).offsets
    m = offsets[-1]
    rig.call("configure")
    start = rig.session.counts.copy()
    rig.session.submit(
        WireMotion(rig.units, start, offsets, np.full(m, 250), np.full(m, 400)),
        np.zeros((19, 2)),
    )
    rig.call("start")
    begin_s = rig.session.loaded_plan.start_s
    rig.robots.schedule(
        [
            (0, begin_s + 0.3, Event.POWER, 0),
            (18, begin_s + 0.9, Event.JAM_THETA, 1),
        ]
    )
    result = rig.run()
    assert len(rig.session.loaded_plans) == 3
    ended_once(result, 19)
    assert result.reason[[0, 18]].tolist() == [Reason.NO_REPLY, Reason.STALLED]
    assert set(result.reason[held_neighbours]) == {Reason.PLACE_UNKNOWN}
    assert result.reason[oversized] == Reason.TOO_MANY_SEGMENTS
    others = np.setdiff1d(np.arange(19), [0, 18, oversized, *held_neighbours])
    assert set(result.reason[others]) == {Reason.OFF_TARGET}  # no target is there
    assert (rig.where()[others, 0] == start[others, 0] + 250 * 400).all()


@pytest.mark.parametrize("moving", [True, False])
def test_orders_are_accepted_after_stop_and_clear(moving):
    rig = Rig()
    motion = rig.ready()
    if moving:
        rig.call("start")
    rig.t += 0.4
    rig.call("advance")
    rig.call("stop")
    at = rig.where()
    result = rig.session.result
    ended_once(result, 19)
    assert set(result.reason) == {Reason.STOPPED} and set(result.outcome) == {Outcome.HELD}
    assert np.array_equal(rig.session.counts, at)
    assert np.all((at[:, 0] > motion.start[:, 0]) == moving)
    assert np.all(at[:, 0] < motion.end[:, 0])
    rig.t += 9
    assert np.array_equal(rig.where(), at)
    assert set(rig.robots.states(rig.t)) == {RobotState.STOPPED}
    with pytest.raises(SessionError, match="cannot submit while STOPPED: clear first"):
        rig.session.submit(rig.orders(100, 0))
    rig.call("clear")
    rig.session.submit(rig.orders(100, 0))
    rig.call("start")
    assert set(rig.run().outcome) == {Outcome.REACHED}


def test_stop_works_in_every_state():
    for before in ((), ("configure",), ("configure", "stop"), ("configure", "stop", "clear")):
        rig = Rig(7)
        for name in before:
            rig.call(name)
        rig.call("stop")
        assert rig.session.state is SessionState.STOPPED
        rig.call("clear")
        known = SessionState.IDLE if before else SessionState.UNCONFIGURED
        assert rig.session.state is known


def test_a_new_session_finds_stopped_robots_stopped():
    rig = Rig(7)
    rig.call("configure")
    rig.call("stop")
    second = Session(rig.plane, rig.units, Safety(), SimulatedBuses(rig.robots), rig.session.angles)
    second.configure(rig.t)
    assert second.state is SessionState.STOPPED


def restarted(rig):
    """A session that begins beside the robots of a rig."""
    made = Session(rig.plane, rig.units, Safety(), SimulatedBuses(rig.robots), rig.session.angles)
    rig.t = made.configure(rig.t)
    return made


def test_a_new_session_clears_robots_that_stopped_by_themselves():
    rig = Rig(7)
    rig.ready()
    rig.call("start")
    rig.robots.schedule([(3, rig.t + 0.2, Event.JAM_THETA, 1)])
    rig.t += 1.0  # the controller is gone: robots without heartbeats stop
    assert set(rig.robots.states(rig.t)) == {RobotState.FAULT}
    rig.session = restarted(rig)
    assert rig.session.state is SessionState.IDLE and rig.session.known.all()
    assert np.array_equal(rig.session.counts, rig.where()) and not rig.session.robots["lost"].any()
    rig.session.submit(rig.orders(np.where(np.arange(7) == 3, 0, -100), 0))
    rig.call("start")
    assert set(np.delete(rig.run().outcome, 3)) == {Outcome.REACHED}


@pytest.mark.parametrize("cleared", [False, True])
def test_a_stop_outlives_the_bridge_also_of_robots_that_do_not_remember_it(cleared):
    rig = Rig(7)
    rig.ready()
    rig.call("start")
    rig.t += 1.0  # the controller pauses: robots without heartbeats stop by themselves
    assert set(rig.robots.states(rig.t)) == {RobotState.FAULT}
    rig.call("stop")
    assert set(rig.robots.states(rig.t)) == {RobotState.FAULT}
    if cleared:
        rig.call("clear")
    memory = rig.session.memory(np.full(7, int(Reason.OK)))
    later = Session(rig.plane, rig.units, Safety(), SimulatedBuses(rig.robots), rig.session.angles)
    later.recall(memory)
    rig.t = later.configure(rig.t)
    assert later.state is (SessionState.IDLE if cleared else SessionState.STOPPED)
    rig.t = later.clear(rig.t)
    assert later.state is SessionState.IDLE
    assert not later.memory(np.full(7, int(Reason.OK))).stopped


def test_a_new_session_does_not_clear_beside_robots_that_an_operator_stopped():
    rig = Rig(7)
    rig.ready()
    rig.call("start")
    rig.t += 0.3
    rig.call("advance")
    rig.call("stop")
    rig.robots.memory["state"][2] = RobotState.FAULT  # one of them stopped by itself
    assert restarted(rig).state is SessionState.STOPPED


def test_a_new_session_does_not_clear_while_a_robot_moves():
    # robots without a watchdog go on without a controller
    rig = Rig(7, config=SessionConfig(silence_ms=0))
    rig.ready(theta=100)
    rig.call("start")
    rig.robots.schedule([(3, rig.t + 0.1, Event.JAM_THETA, 1)])
    rig.t += 0.3
    assert sorted(rig.robots.states(rig.t)) == [RobotState.MOVING] * 6 + [RobotState.FAULT]
    later = restarted(rig)
    assert later.robots["lost"].sum() == 6 and later.state is SessionState.STOPPED


STOPS = {
    "stalls": ([(3, 0.3, Event.JAM_THETA, 1)], ()),
    "loses power": ([(3, 0.3, Event.POWER, 0)], ()),
    "boots": ([(3, 0.3, Event.POWER, 0), (3, 0.301, Event.POWER, 1)], ()),
    "boots after 2 ms": ([(3, 0.3, Event.POWER, 0), (3, 0.302, Event.POWER, 1)], ()),
    "goes deaf": ([(3, 0.3, Event.DEAF, 1)], ()),
    "hears no calls": ([(3, 0.3, Event.CALL_DEAF, 1)], ()),
    "refuses frames": ([(3, 0.3, Event.BUSY, 1)], ()),
    "holds the clock": ([], ((3, 0.3, np.inf, 2e-3),)),
    "holds the clock for long": ([], ((3, 0.3, np.inf, 3.55e-3),)),
}


@pytest.mark.parametrize("what", STOPS)
@pytest.mark.parametrize("later_s", [0.0, 0.7e-3, 1.4e-3, 2.1e-3])
def test_all_robots_stop_within_the_certified_skew(what, later_s):
    events, stretches = STOPS[what]
    faults = Faults(stretches=tuple((row, t + later_s, *rest) for row, t, *rest in stretches))
    rig = Rig(config=SessionConfig(resumes=0), faults=faults)
    rig.ready()
    rig.call("start")
    rig.robots.schedule([(row, t + later_s, *rest) for row, t, *rest in events])
    rig.run()
    rig.robots.advance(rig.t + 0.1)
    stops = rig.robots.memory["halted_s"]
    assert stops.min() >= 0.3
    assert np.ptp(stops) <= Safety().stop_skew_s


CAUSES = {
    "stalls": Reason.STALLED,
    "loses power": Reason.NO_REPLY,
    "boots": Reason.REBOOTED,
    "boots after 2 ms": Reason.REBOOTED,
    "goes deaf": Reason.NO_REPLY,
    "hears no calls": Reason.NO_HEARTBEAT,
    "refuses frames": Reason.NO_HEARTBEAT,
}


@pytest.mark.parametrize("resumes", [0, 3])
@pytest.mark.parametrize("what", CAUSES)
def test_a_robot_that_fails_names_its_own_cause_and_the_others_theirs(what, resumes):
    rig = Rig(config=SessionConfig(resumes=resumes))
    motion = rig.ready()
    rig.call("start")
    rig.robots.schedule([(row, t + 2e-3, *rest) for row, t, *rest in STOPS[what][0]])
    result = rig.run()
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, CAUSES[what])
    others = np.arange(19) != 3
    assert not np.isin(result.outcome[others], Outcome.FAILED).any()
    if resumes == 0:
        assert set(result.reason[others]) == {Reason.OTHER_FAILED}
        return
    assert set(result.reason[others]) <= {Reason.OK, Reason.PLACE_UNKNOWN}
    beside = np.isin(np.arange(19), neighbour_pairs(rig.plane)[
        (neighbour_pairs(rig.plane) == 3).any(axis=1)]) & others  # fmt: skip
    waits = beside & (CAUSES[what] == Reason.NO_REPLY)
    assert np.array_equal(result.reason[others] == Reason.PLACE_UNKNOWN, waits[others])
    arrived = others & ~waits
    assert np.array_equal(rig.where()[arrived], motion.end[arrived])


def test_robots_on_a_bus_that_sticks_have_failed_by_their_bus():
    lines = ((LineFault.SCL_LOW, 1, 0.3, np.inf, Recovery.NOTHING),)
    rig = Rig(config=SessionConfig(resumes=0), faults=Faults(lines=lines))
    rig.ready()
    rig.call("start")
    result = rig.run()
    assert set(result.reason[rig.plane.bus == 1]) == {Reason.BUS_FAILED}
    assert set(result.reason[rig.plane.bus == 0]) == {Reason.OTHER_FAILED}
    assert np.array_equal(result.outcome == Outcome.FAILED, rig.plane.bus == 1)


def test_a_robot_found_stalled_by_the_stop_of_an_operator_says_so():
    rig = Rig()
    rig.ready()
    rig.call("start")
    at = rig.session.loaded_plan.start_s + 0.3
    rig.robots.schedule([(3, at + 1e-5, Event.JAM_THETA, 1)])
    rig.t = at
    rig.session.advance(rig.t)
    rig.t = max(rig.t, rig.session.transactions.now_s)
    rig.call("stop")
    result = rig.session.result
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, Reason.STALLED)
    assert set(np.delete(result.reason, 3)) == {Reason.STOPPED}


def test_a_bus_that_sticks_stops_with_the_others():
    lines = ((LineFault.SCL_LOW, 1, 0.3, np.inf, Recovery.NOTHING),)
    rig = Rig(config=SessionConfig(resumes=0), faults=Faults(lines=lines))
    rig.ready()
    rig.call("start")
    rig.run()
    rig.robots.advance(rig.t + 0.1)
    stops = rig.robots.memory["halted_s"]
    silence_s = 1e-3 * SessionConfig().silence_ms
    assert 0.3 < stops.min() and stops.max() < 0.3 + silence_s + 1e-3
    assert np.ptp(stops) <= Safety().stop_skew_s

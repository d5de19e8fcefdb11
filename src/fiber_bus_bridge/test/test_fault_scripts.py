# SPDX-License-Identifier: Apache-2.0
"""The protocol under scripted faults: which message is lost, when, and what the robots then do."""

from dataclasses import replace

import numpy as np
import pytest
from session_rig import Rig

from fiber_bus_bridge import SessionConfig, SessionState
from fiber_bus_bridge.protocol import Event
from fiber_bus_bridge.protocol.decisions import countdown_s
from fiber_bus_bridge.simulation import Event as RobotEvent
from fiber_bus_bridge.simulation import Faults
from fiber_bus_bridge.wire import COUNTDOWN_S, ROLL_CALL_ADDRESS, Frames, Opcode
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome, Reason

CALL = 0xF1  # first byte of a general call


class Wire:
    """The wire under a session: garbles chosen general calls, and keeps a list of messages.

    Args:
        rig: the rig.
        opcode: general calls that may be garbled.
        garbles: function of the number of such a call on its bus, the bus, and its time.
    """

    def __init__(self, rig, opcode=None, garbles=lambda number, bus, t: False):
        self.opcode, self.garbles = opcode, garbles
        self.numbers: dict[int, int] = {}
        self.messages = []  # opcode or None for a read, bus, address, start [s]
        self.backend = rig.session.transactions.backend
        self.transfer_unharmed = self.backend.transfer
        self.backend.transfer = self.transfer

    def transfer(self, frames, read_bytes, not_before_s):
        data = frames.data.copy()
        before_s = np.broadcast_to(not_before_s, len(frames))
        opcodes = []
        for i, bus in enumerate(frames.to.bus.tolist()):
            payload = frames.payload(i)
            called = payload[:1] == bytes([CALL])
            opcode = Opcode(payload[called] >> 4) if payload else None
            opcodes.append(opcode)
            if called and opcode is self.opcode:
                number = self.numbers[bus] = self.numbers.get(bus, -1) + 1
                if self.garbles(number, bus, before_s[i]):
                    data[frames.offsets[i + 1] - 1] ^= 0x55
        sent = Frames(frames.to, frames.offsets, data)
        replies = self.transfer_unharmed(sent, read_bytes, not_before_s)
        columns = opcodes, frames.to.bus.tolist(), frames.to.address.tolist(), replies.start_s
        self.messages += list(zip(*columns))
        return replies

    def times(self, opcode, address):
        return [t for o, _, a, t in self.messages if o is opcode and a == address]


def stops_after(rig, t):
    rig.robots.advance(rig.t + 0.1)
    stops = rig.robots.memory["halted_s"]
    return stops[stops >= t]


@pytest.mark.parametrize("lost", [1, 2])
def test_lost_stops_do_not_delay_the_stop(lost):
    # asking a hundred robots takes longer than the certified skew
    rig = Rig(200, on_bus=100, config=SessionConfig(resumes=0))
    rig.ready(theta=100)
    rig.call("start")
    at = rig.t + 0.1
    rig.robots.schedule([(3, at, RobotEvent.JAM_THETA, 1)])
    wire = Wire(rig, Opcode.STOP, lambda number, bus, t: number < lost)
    rig.run()
    assert wire.numbers[0] >= 2
    stops = stops_after(rig, at)
    assert len(stops) == 200 and np.ptp(stops) <= Safety().stop_skew_s


def test_two_lost_heartbeats_in_a_row_stop_no_robot():
    # at every place in a step
    rig = Rig(6, on_bus=3)
    wire = Wire(rig, Opcode.HEARTBEAT, lambda number, bus, t: number % 9 < 2)
    motion = rig.ready(theta=100)
    rig.call("start")
    result = rig.run()
    assert len(rig.session.loaded_plans) == 1 and wire.numbers[0] > 500
    assert set(result.outcome) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), motion.end)


def test_a_bus_without_heartbeats_in_the_countdown_is_left_out_and_the_other_starts():
    # all its robots answer, and the poll of a hundred robots outlasts the silence
    rig = Rig(200, on_bus=100)
    motion = rig.ready()
    Wire(rig, Opcode.HEARTBEAT, lambda number, bus, t: bus == 1)
    rig.call("start")
    assert np.array_equal(rig.session.loaded_plan.started, rig.plane.bus == 0)
    result = rig.run()
    assert set(result.reason[rig.plane.bus == 1]) == {Reason.NOT_ACKNOWLEDGED}
    assert set(result.outcome[rig.plane.bus == 0]) == {Outcome.REACHED}
    moved = rig.plane.bus[:, None] == 0
    assert np.array_equal(rig.where(), np.where(moved, motion.end, motion.start))


@pytest.mark.parametrize("lasts_s", [1.2e-3, 1.8e-3])
def test_a_bus_with_a_stretched_clock_is_left_to_stop_by_itself(lasts_s):
    # its heartbeats still arrive in time, and a STOP would be late
    rig = Rig(faults=Faults(stretches=((15, 0.3, np.inf, lasts_s),)))
    rig.ready()
    rig.call("start")
    rig.session.take_transitions()
    while rig.session.state is SessionState.MOVING and len(rig.session.loaded_plans) == 1:
        rig.t += 0.01
        rig.call("advance")
    failures = [x.t for x in rig.session.take_transitions() if x.event is Event.FAILURE]
    assert 0.3 < failures[0] < 0.3 + 20e-3  # three slow heartbeats, and the silence
    rig.run()
    stops = rig.robots.memory["halted_s"]
    assert rig.session.result.outcome[rig.plane.bus == 0].max() == Outcome.REACHED
    assert np.ptp(stops[rig.plane.bus == 1]) < Safety().stop_skew_s


def test_a_short_stretch_of_a_clock_stops_no_robot():
    rig = Rig(faults=Faults(stretches=((15, 0.3, np.inf, 0.5e-3),)))
    rig.ready()
    rig.call("start")
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert len(rig.session.loaded_plans) == 1


def test_robots_at_their_speed_limit_resume_within_it():
    # slow clocks: at the stop the robots are behind their orders, and cannot catch up
    rig = Rig(7, clock_ppm=-20_000.0)
    speed = rig.session.protocol.speed[:, 0]
    motion = rig.ready(theta=np.where(np.arange(7) < 4, speed, -speed))
    rig.call("start")
    rig.robots.schedule([(3, rig.session.loaded_plan.start_s + 0.7, RobotEvent.JAM_THETA, 1)])
    result = rig.run()
    resumed = rig.session.loaded_plans[1].motion
    assert 0.99 * speed.max() < np.abs(resumed.velocity).max() <= speed.max()
    assert set(np.delete(result.outcome, 3)) == {Outcome.REACHED}
    assert np.array_equal(np.delete(rig.where(), 3, 0), np.delete(motion.end, 3, 0))


def test_a_lost_robot_that_answers_again_is_not_loaded_before_it_was_read():
    rig = Rig(7)
    rig.ready()
    rig.call("start")
    at = rig.session.loaded_plan.start_s + 0.3
    rig.robots.schedule([(3, at, RobotEvent.DEAF, 1), (3, at + 5, RobotEvent.DEAF, 0)])
    assert rig.run().outcome[3] == Outcome.FAILED
    rig.t += 10
    rig.session.submit(rig.orders(-100, 0))
    wire = Wire(rig)
    rig.call("start")
    assert rig.session.loaded_plan.reason[3] == Reason.PLACE_UNKNOWN
    address = rig.session.transactions.addresses.address[3]
    assert not wire.times(Opcode.LOAD, address)
    rig.run()
    rig.call("clear")
    assert np.array_equal(rig.session.counts, rig.where())
    rig.session.submit(rig.orders(-100, 0))
    rig.call("start")
    assert set(rig.run().outcome) == {Outcome.REACHED}


def test_no_robot_waits_behind_one_that_blocks_its_bus():
    # the first robot of bus 0 holds the clock until it times out
    rig = Rig(8, on_bus=4, faults=Faults(stretches=((0, 0.0, np.inf, 40e-3),)))
    wire = Wire(rig)
    rig.call("configure")
    assert rig.session.known.tolist() == [False] + [True] * 7
    asked = [a for o, bus, a, _ in wire.messages if o is Opcode.IDENTIFY and bus == 0]
    # the batch that the first robot breaks off, then the others before it
    assert asked[:4] == [8, 9, 10, 11] and asked[4:8] == [9, 10, 11, 8]


def test_the_roll_is_not_called_after_the_end_of_the_motion():
    rig = Rig(500, on_bus=500)  # the end of the last robot is read some ten milliseconds later
    rig.ready(theta=100)
    wire = Wire(rig)
    rig.call("start")
    end_s = rig.session.loaded_plan.start_s + rig.session.loaded_plan.makespan_s
    rig.run()
    calls = wire.times(None, ROLL_CALL_ADDRESS)
    reads = [t for o, _, a, t in wire.messages if o is None and a != ROLL_CALL_ADDRESS]
    assert end_s - 2.6e-3 < max(calls) <= end_s + 1e-3 < max(reads)


def test_robots_with_slow_clocks_are_not_overdue():
    rig = Rig(7, config=SessionConfig(grace_s=0.0), clock_ppm=-15_000.0)
    rig.session.protocol.safety = replace(Safety(), clock_ppm=20_000.0)
    motion = rig.ready(theta=100)
    rig.call("start")
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), motion.end)


def test_robots_that_are_later_than_their_clocks_allow_are_overdue():
    rig = Rig(7, config=SessionConfig(grace_s=0.0), clock_ppm=-15_000.0)
    rig.ready(theta=100)
    rig.call("start")
    result = rig.run()
    assert rig.session.state is SessionState.STOPPED
    assert set(result.outcome) == {Outcome.FAILED}


def test_the_countdown_is_long_enough_to_poll_all_robots_of_a_large_bus():
    rig = Rig(500, on_bus=500)
    rig.ready(theta=100)
    wire = Wire(rig)
    rig.call("start")
    session = rig.session
    go_s, start_s = session.loaded_plan.go_s, session.loaded_plan.start_s
    assert set(session.loaded_plan.sequence) == {1}
    polls = [t for o, _, a, t in wire.messages if o is None and a and t > go_s]
    first = np.array(polls[:500]) - go_s
    until_s = 1e-3 * session.config.silence_ms + session.config.heartbeat_period_s
    spare_s = start_s - until_s - go_s - first.max()
    # for a robot that needs another poll and another GO, and no longer
    assert 5e-3 < spare_s < 20e-3


@pytest.mark.parametrize(("verify_s", "lasts_s"), [(0.0, 0.02), (0.04, 0.068), (5.0, 0.65)])
def test_the_countdown_grows_with_the_bus_and_fits_its_field(verify_s, lasts_s):
    assert countdown_s(verify_s, 5e-3, 2.5e-3) == pytest.approx(lasts_s, abs=1e-12)
    assert round(countdown_s(verify_s, 5e-3, 2.5e-3) / COUNTDOWN_S) < 2**16

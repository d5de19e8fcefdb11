# SPDX-License-Identifier: Apache-2.0
"""Faults of lines, bits and robots, and how the transactions deal with them."""

import numpy as np
import pytest

from fiber_bus_bridge import bus_timing
from fiber_bus_bridge.bus import Ack, Recovery
from fiber_bus_bridge.simulation import (
    EVENT,
    Event,
    FaultKind,
    Faults,
    LineFault,
    Positioners,
    SimulatedBuses,
    TrueMotion,
    draw_faults,
)
from fiber_bus_bridge.simulation.events import BOOT_S
from fiber_bus_bridge.simulation.lines import STRETCH_LIMIT_S
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import (
    STATUS_BYTES,
    VERIFY_BYTES,
    Addresses,
    Alert,
    Configuration,
    Fault,
    Frames,
    Opcode,
    RobotState,
    decode_status,
    encode_address,
    encode_command,
    encode_config,
    encode_load,
    general_call,
)
from fiber_core.wire_units import WireMotion, WireUnits

UNITS = WireUnits()
TO = Addresses([0, 0, 0, 5], [8, 9, 10, 300], [False, False, False, True])
CLEAR = encode_command(Opcode.CLEAR, TO)
FOREVER = np.inf


def buses_with(lines=(), noise=(), stretches=(), events=(), seed=0, mode="1M", to=TO):
    robots = Positioners(to, np.arange(len(to)) + 1, UNITS.quantum_prad, np.zeros((len(to), 2)))
    events = np.array(list(events), dtype=EVENT)
    faults = Faults(tuple(lines), tuple(noise), tuple(stretches), events)
    return SimulatedBuses(robots, bus_timing(mode), faults, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("line", "ack", "needed", "frees"),
    [
        (LineFault.SDA_LOW, Ack.STUCK, Recovery.CLOCKS, [True, True, True]),
        (LineFault.SDA_LOW, Ack.STUCK, Recovery.RESET, [False, True, True]),
        (LineFault.SCL_LOW, Ack.TIMED_OUT, Recovery.POWER, [False, False, True]),
        (LineFault.SCL_LOW, Ack.TIMED_OUT, Recovery.NOTHING, [False, False, False]),
    ],
)
def test_a_stuck_line_times_out_and_blocks_its_bus_until_it_is_freed(line, ack, needed, frees):
    for attempt, frees_it in zip((Recovery.CLOCKS, Recovery.RESET, Recovery.POWER), frees):
        buses = buses_with([(line, 0, 0.0, FOREVER, needed)])
        replies = buses.transfer(CLEAR, 0, 1.0)
        assert replies.ack.tolist() == [ack, Ack.NOT_SENT, Ack.NOT_SENT, Ack.OK]
        assert replies.end_s[0] - replies.start_s[0] == pytest.approx(STRETCH_LIMIT_S)
        assert replies.end_s[3] - 1.0 < 1e-3
        end_s, free = buses.recover(0, attempt, replies.end_s[0])
        assert (free, end_s > replies.end_s[0]) == (frees_it, True)
        booted_s = end_s + BOOT_S * (attempt == Recovery.POWER)
        acks = buses.transfer(CLEAR[np.arange(3)], 0, booted_s).ack
        assert (set(acks) == {Ack.OK}) == frees_it


def test_a_power_cycle_of_a_branch_boots_its_robots_and_no_others():
    buses = buses_with([(LineFault.SCL_LOW, 0, 0.0, FOREVER, Recovery.POWER)])
    buses.recover(0, Recovery.POWER, 1.0)
    assert buses.positioners.memory["boot"].tolist() == [2, 2, 2, 1]
    assert buses.alert_lines(2.0).tolist() == [0]


def test_a_booting_robot_does_not_acknowledge():
    buses = buses_with(events=[(1, 0.5, Event.POWER, 0), (1, 0.502, Event.POWER, 1)])
    asked = Frames.empty(TO[np.array([0, 1])])
    for t, present in ((0.503, False), (0.5069, False), (0.502 + BOOT_S, True)):
        acks = buses.transfer(asked, 0, t).ack.tolist()
        assert acks == [Ack.OK, Ack.OK if present else Ack.NO_ADDRESS]


def test_a_robot_obeys_a_frame_whose_line_sticks_at_the_last_acknowledge():
    one = bus_timing("1M").message_s(2, 0, False)
    for since, state in ((one - 0.5e-6, RobotState.STOPPED), (one / 2, RobotState.IDLE)):
        buses = buses_with([(LineFault.SCL_LOW, 0, 1 + since, FOREVER, Recovery.NOTHING)])
        buses.positioners.memory["state"] = RobotState.IDLE
        stop = encode_command(Opcode.STOP, TO[:1])
        assert buses.transfer(stop, 0, 1.0).ack.tolist() == [Ack.TIMED_OUT]
        assert buses.positioners.states(2.0)[0] == state


def test_a_babbling_talker_wins_every_arbitration():
    buses = buses_with([(LineFault.BABBLE, 0, 0.0, 2.0, Recovery.NOTHING)])
    replies = buses.transfer(CLEAR, 0, 1.0)
    assert replies.ack.tolist() == [Ack.LOST] * 3 + [Ack.OK]
    assert set(buses.transfer(CLEAR, 0, 2.0).ack) == {Ack.OK}


def test_a_slow_clock_takes_time_and_too_slow_a_clock_is_timed_out():
    one = bus_timing("1M").message_s(2, 0, False)
    buses = buses_with(stretches=[(1, 0.0, 1.0, 3e-3), (1, 2.0, 3.0, 30e-3)])
    replies = buses.transfer(CLEAR, 0, 0.5)
    took = replies.end_s - replies.start_s
    assert replies.ack.tolist() == [Ack.OK] * 4
    assert took[:3] == pytest.approx([one, one + 3e-3, one], abs=1e-12)
    replies = buses.transfer(CLEAR, 0, 2.5)
    assert replies.ack.tolist() == [Ack.OK, Ack.TIMED_OUT, Ack.NOT_SENT, Ack.OK]
    # the other robots do not wait: they are served before the retry
    transactions = Transactions(buses_with(stretches=[(0, 0.0, FOREVER, 30e-3)]), TO)
    acks = transactions.command(Opcode.CLEAR, np.arange(4), 0.0)
    assert acks.tolist() == [Ack.NO_ADDRESS] + [Ack.OK] * 3
    assert transactions.failures.tolist() == [3, 0, 0, 0]


@pytest.mark.parametrize("rate", [1e-4, 1e-3, 1e-2])
def test_as_many_messages_fail_as_bits_are_wrong(rate):
    buses = buses_with(noise=[(5, 0.0, FOREVER, rate)], seed=3)
    rows = np.full(20_000, 3)
    frames = CLEAR[rows]
    failed = (buses.transfer(frames, 0, 0.0).ack != Ack.OK).mean()
    bits = 9 * (2 + 2)
    expected = 1 - (1 - rate) ** bits
    assert abs(failed - expected) < 4 * np.sqrt(expected / len(rows))
    empty = Frames(TO[rows], np.zeros(len(rows) + 1, dtype=int), np.zeros(0, dtype=np.uint8))
    replies = buses.transfer(empty, STATUS_BYTES, buses._line(5).free_s)
    ok = decode_status(TO[rows], replies.table(STATUS_BYTES)).ok
    bits = 9 * (3 + STATUS_BYTES)
    expected = 1 - (1 - rate) ** (bits - 1)  # the controller never acknowledges the last byte
    assert abs((~ok).mean() - expected) < 4 * np.sqrt(expected / len(rows)) + 0.01 * expected
    quiet = buses.transfer(CLEAR[np.zeros(5000, dtype=int)], 0, 0.0)
    assert set(quiet.ack) == {Ack.OK}


def test_a_missing_acknowledge_does_not_prove_that_a_frame_was_refused():
    buses = buses_with(noise=[(0, 0.0, FOREVER, 2e-2)], seed=1)
    buses.positioners.memory["state"] = RobotState.IDLE
    obeyed_without_ack = 0
    for _ in range(300):
        buses.positioners.memory["state"][0] = RobotState.IDLE
        ack = buses.transfer(encode_command(Opcode.STOP, TO[:1]), 0, 0.0).ack[0]
        stopped = buses.positioners.memory["state"][0] == RobotState.STOPPED
        obeyed_without_ack += stopped and ack != Ack.OK
        assert stopped or ack != Ack.OK
    assert obeyed_without_ack > 0


def test_the_same_seed_reads_the_same_bits_wrong():
    def run(seed):
        buses = buses_with(noise=[(0, 0.0, FOREVER, 1e-2)], seed=seed)
        empty = Frames(TO, np.zeros(5, dtype=int), np.zeros(0, dtype=np.uint8))
        return buses.transfer(empty, STATUS_BYTES, 0.0).data.tobytes()

    assert run(4) == run(4) != run(5)


@pytest.mark.parametrize("mode", ["1.7M", "3.4M"])
def test_a_batch_in_high_speed_mode_begins_at_fast_mode_speed(mode):
    buses, timing = buses_with(mode=mode), bus_timing(mode)
    took = np.diff(buses.transfer(CLEAR, 0, 0.0).end_s[:3], prepend=0.0)
    one = float(timing.message_s(2, 0, False))
    assert took == pytest.approx([one + 22.5e-6 + 1.9e-6, one, one], abs=1e-12)


def test_events_happen_to_robots_at_their_time():
    events = [
        (0, 1.0, Event.DEAF, 1), (0, 2.0, Event.DEAF, 0), (1, 1.0, Event.BUSY, 1),
        (2, 1.0, Event.POWER, 0), (2, 1.5, Event.POWER, 1), (3, 1.2, Event.MOVE_ADDRESS, 301),
    ]  # fmt: skip
    buses = buses_with(events=events)
    assert buses.transfer(CLEAR, 0, 0.5).ack.tolist() == [Ack.OK] * 4
    expected = [Ack.NO_ADDRESS, Ack.REFUSED, Ack.NO_ADDRESS, Ack.OK]
    assert buses.transfer(CLEAR, 0, 1.1).ack.tolist() == expected
    expected = [Ack.OK, Ack.REFUSED, Ack.OK, Ack.NO_ADDRESS]
    assert buses.transfer(CLEAR, 0, 2.1).ack.tolist() == expected
    assert buses.positioners.memory["boot"].tolist() == [1, 1, 2, 1]


def test_a_robot_deaf_to_general_calls_receives_frames_to_its_address():
    buses = buses_with(events=[(0, 0.0, Event.CALL_DEAF, 1)])
    buses.positioners.memory["state"] = RobotState.IDLE
    stop = encode_command(Opcode.STOP, general_call([0]))
    assert buses.transfer(stop, 0, 1.0).ack.tolist() == [Ack.OK]  # one acknowledge is enough
    states = buses.positioners.states(2.0)
    assert states.tolist() == [RobotState.IDLE, *[RobotState.STOPPED] * 2, RobotState.IDLE]
    buses.transfer(encode_command(Opcode.STOP, TO[:1]), 0, 2.0)
    assert buses.positioners.states(3.0)[0] == RobotState.STOPPED


def test_two_robots_at_one_address_disturb_each_other_until_one_is_moved():
    buses = buses_with(events=[(1, 0.0, Event.MOVE_ADDRESS, 8)])
    transactions = Transactions(buses, TO)
    assert not transactions.identities(np.array([0, 1]), 1.0).ok.any()
    move = encode_address(general_call([0]), [2], TO[1:2])
    assert buses.transfer(move, 0, 2.0).ack.tolist() == [Ack.OK]
    found = transactions.identities(np.arange(4), 3.0)
    assert found.ok.all() and found.serial.tolist() == [1, 2, 3, 4]


def moving(buses, watchdog=0, silence=0, ticks=250):
    """Configure all robots, load 1000 quanta per tick on theta, and GO; return the time of GO."""
    n = len(TO)
    limits = np.tile([[-2_000_000, 2_000_000], [0, 2_000_000]], (n, 1, 1))
    config = Configuration(UNITS, limits, np.full((n, 2), 8000), watchdog, silence)
    buses.transfer(encode_config(config, TO), 0, 0.0)
    offsets = np.repeat(np.arange(n + 1), 2)[1:]
    orders = WireMotion.from_zero(UNITS, offsets, np.full(n, ticks), np.full(n, 1000))
    loads = encode_load(TO, 1, orders)
    assert set(buses.transfer(loads, 0, 0.0).ack) == {Ack.OK}
    go = encode_command(Opcode.GO, general_call([0, 5]), 1, 1000)
    return buses.transfer(go, 0, 1.0).end_s[0]


def test_no_robot_moves_during_the_countdown():
    buses = buses_with()
    go_s = moving(buses)
    robots = buses.positioners
    assert set(robots.states(go_s + 0.009)) == {RobotState.MOVING}
    assert not robots.positions(go_s + 0.0099).any()
    assert robots.positions(go_s + 0.01 + 100 * UNITS.tick_s)[0].tolist() == [100_000, 0]


def test_a_jammed_joint_stops_its_robot_and_pulls_the_alert_line():
    buses = buses_with(events=[(1, 1.5, Event.JAM_THETA, 1), (2, 0.0, Event.JAM_PHI, 1)])
    go_s = moving(buses)
    robots = buses.positioners
    assert buses.alert_lines(1.49).tolist() == []
    assert buses.alert_lines(1.51).tolist() == [0]
    ran = (1.5 - go_s - 0.01) / UNITS.tick_s
    assert robots.positions(9.0)[:, 0].tolist() == [250_000, round(1000 * ran), 250_000, 250_000]
    memory = robots.memory[1]
    assert (memory["state"], memory["fault"]) == (RobotState.FAULT, Fault.STALL)
    assert memory["alerts"] == Alert.STALLED


def test_robots_move_as_long_as_they_receive_heartbeats():
    buses = buses_with()
    go_s = moving(buses, silence=50)
    heartbeat = encode_command(Opcode.HEARTBEAT, general_call([0]))
    for k in range(10):
        buses.transfer(heartbeat, 0, go_s + 0.04 * (k + 1))
    robots = buses.positioners
    robots.advance(go_s + 0.6)
    assert robots.memory["fault"].tolist() == [Fault.SILENCE] * 4
    assert robots.memory["halted_s"][0] == pytest.approx(go_s + 0.45, abs=1e-3)
    assert robots.memory["halted_s"][3] == pytest.approx(go_s + 0.05, abs=1e-3)


def test_true_motion_is_independent_of_the_reports():
    buses = buses_with(events=[(1, 1.5, Event.POWER, 0)])
    robots = buses.positioners
    robots.memory["clock_ppm"] = [0, 0, 10_000, 0]
    truth = TrueMotion(robots, UNITS.quantum_rad)
    go_s = moving(buses)
    truth.observe()
    stop = encode_command(Opcode.STOP, TO[:1])
    stopped = buses.transfer(stop, 0, 1.7).end_s[0]
    truth.observe()
    motion = truth.motion(9.0)
    speed = 1000 * UNITS.velocity_rad_s
    start = go_s + 0.01
    late = start - 0.01 + 0.01 / 1.01  # the fast clock also counts down faster
    for t in (start - 1e-3, start + 0.1, 1.49, 1.6, 1.9, 8.0):
        expected = speed * np.clip(
            [min(t, stopped) - start, min(t, 1.5) - start, 1.01 * (t - late), t - start], 0, 1.0
        )
        assert motion(t)[:, 0] == pytest.approx(expected, abs=1e-9)
    moves = truth.movements(9.0)
    assert moves.row.tolist() == [0, 1, 2, 3] and moves.counts.tolist() == [[1, 0]] * 4
    assert moves.ended_s[:2] == pytest.approx([stopped, 1.5])


def test_an_observation_that_begins_late_has_the_end_of_a_movement_that_is_over():
    buses = buses_with()
    go_s = moving(buses)
    robots = buses.positioners
    stopped = buses.transfer(encode_command(Opcode.STOP, TO[:1]), 0, go_s + 0.3).end_s[0]
    # robots that rest hear the heartbeats for the others
    buses.transfer(encode_command(Opcode.HEARTBEAT, general_call([0])), 0, go_s + 0.4)
    assert robots.memory["heartbeat_s"][0] > robots.memory["halted_s"][0]
    truth = TrueMotion(robots, UNITS.quantum_rad)
    truth.observe()
    _, _, moves = truth.since()
    assert moves.ended_s[moves.row == 0] == pytest.approx([stopped])
    assert np.isnan(moves.ended_s[moves.row == 3]).all()


def test_a_bus_that_stays_stuck_is_given_up_and_no_other_bus_waits_for_it():
    buses = buses_with([(LineFault.SDA_LOW, 0, 0.0, FOREVER, Recovery.POWER)])
    transactions = Transactions(buses, TO)
    acks = transactions.command(Opcode.CLEAR, np.arange(4), 0.0)
    assert acks.tolist() == [Ack.NO_ADDRESS] * 3 + [Ack.OK]
    assert transactions.given_up.tolist() == [True, False]
    assert transactions.now_s < 1e-3
    assert transactions.counters.table()[0]["recoveries"] == 2
    transactions.revive(power=True, t=1.0)
    assert set(transactions.command(Opcode.CLEAR, np.arange(4), 2.0)) == {Ack.OK}


@pytest.mark.parametrize("kind", FaultKind)
def test_every_kind_of_fault_can_be_drawn_and_repeats_for_a_seed(kind):
    drawn = [
        draw_faults([kind], TO.bus, TO.address, 2.0, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    ]
    parts = [(f.lines, f.noise, f.stretches, f.events.tolist()) for f in drawn]
    assert parts[0] == parts[1] != parts[2]
    assert sum(map(bool, parts[0])) == 1


def test_the_alert_line_is_released_when_the_complete_status_has_been_read():
    buses = buses_with(events=[(1, 1.5, Event.JAM_THETA, 1)])
    moving(buses)
    one = TO[np.array([1])]
    first_bytes = buses.transfer(Frames.empty(one), VERIFY_BYTES, 1.6)
    assert first_bytes.ack.tolist() == [Ack.OK]
    assert buses.alert_lines(1.7).tolist() == [0]
    assert buses.alert_lines(1.4).tolist() == []  # before the jam
    status = decode_status(one, buses.transfer(Frames.empty(one), STATUS_BYTES, 1.8).table(17))
    assert status.alerts.tolist() == [Alert.STALLED]
    assert buses.alert_lines(1.9).tolist() == []
    second = decode_status(one, buses.transfer(Frames.empty(one), STATUS_BYTES, 2.0).table(17))
    assert second.alerts.tolist() == [Alert.STALLED]


def test_a_frame_without_data_tests_the_presence_of_a_robot():
    buses = buses_with(events=[(1, 0.5, Event.POWER, 0), (2, 0.5, Event.DEAF, 1)])
    calls = encode_command(Opcode.HEARTBEAT, general_call([0]))
    frames = calls.then(Frames.empty(TO))
    assert [frames.payload(k) for k in range(5)] == [calls.payload(0), b"", b"", b"", b""]
    replies = buses.transfer(frames, 0, 1.0)
    presence = [Ack.OK, Ack.NO_ADDRESS, Ack.NO_ADDRESS, Ack.OK]
    assert replies.ack.tolist() == [Ack.OK, *presence]
    took = (replies.end_s - replies.start_s)[1:]
    assert took == pytest.approx(buses.timing.unanswered_s(TO.ten_bit))

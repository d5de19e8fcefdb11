# SPDX-License-Identifier: Apache-2.0
"""Time on the wire, topologies, and the transfer of messages on simulated buses."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import TopologyError, addresses_of, bus_timing
from fiber_bus_bridge.bus import BUS_TIMINGS, TOPOLOGIES, Ack
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_bus_bridge.wire import Addresses, Frames, Opcode, encode_command, general_call
from fiber_core.presets import preset


@pytest.mark.parametrize(
    ("written", "ten_bit", "expected_us"),
    [
        (10, False, 100.5),
        (10, True, 109.5),
        (16, False, 154.5),
        (16, True, 163.5),
        (22, False, 208.5),
        (22, True, 217.5),
    ],
)
def test_writes_at_1_mhz_take_the_published_time(written, ten_bit, expected_us):
    assert abs(1e6 * bus_timing("1M").message_s(written, 0, ten_bit) - expected_us) <= 0.1


@pytest.mark.parametrize("mode", BUS_TIMINGS)
def test_reads_repeat_start_and_address_where_the_standard_requires_it(mode):
    timing = bus_timing(mode)
    byte = 9 / timing.clock_hz
    restart = byte + timing.restart_setup_s + timing.start_hold_s + timing.low_s
    one = timing.message_s(5, 0, False)
    assert timing.message_s(0, 5, False) == pytest.approx(one, abs=1e-12)
    assert timing.message_s(0, 5, True) == pytest.approx(one + byte + restart, abs=1e-12)
    assert timing.message_s(2, 3, False) == pytest.approx(one + restart, abs=1e-12)
    assert timing.message_s(2, 3, True) == pytest.approx(one + byte + restart, abs=1e-12)


def test_an_unknown_mode_is_refused():
    with pytest.raises(TopologyError, match="5M"):
        bus_timing("5M")


def test_topologies_fill_their_buses():
    for name, topology in TOPOLOGIES.items():
        buses, per_bus = (int(part) for part in name.split("x"))
        bus, address = topology.assign(buses * per_bus)
        assert bus.max() == buses - 1
        assert np.bincount(bus).tolist() == [per_bus] * buses
        assert len(set(zip(bus.tolist(), address.tolist()))) == buses * per_bus


def test_the_form_of_an_address_follows_from_the_addresses_of_its_bus():
    plane = preset("desi", 4)
    plane = replace(plane, bus=[0, 0, 7, 7], address=[0x08, 0x77, 0x08, 0x78])
    assert addresses_of(plane).ten_bit.tolist() == [False, False, True, True]
    for outside in (1023, 1024):  # 1023 is the roll call
        with pytest.raises(TopologyError, match=str(outside)):
            addresses_of(replace(plane, address=[8, 9, outside, 9]))


TO = Addresses([0, 0, 5, 5], [8, 9, 8, 300], [False, False, False, True])


@pytest.fixture
def buses():
    return SimulatedBuses(Positioners(TO, [1, 2, 3, 4], 1000, np.zeros((4, 2))), bus_timing("1M"))


def test_buses_run_in_parallel_and_frames_of_one_bus_in_turn(buses):
    clear = encode_command(Opcode.CLEAR, TO)
    replies = buses.transfer(clear, 0, [0.0, 0.0, 1.0, 0.0])
    one, ten = (buses.timing.message_s(2, 0, t) for t in (False, True))
    assert replies.ack.tolist() == [Ack.OK] * 4
    assert replies.start_s == pytest.approx([0, one, 1, 1 + one], abs=1e-12)
    assert replies.end_s == pytest.approx([one, 2 * one, 1 + one, 1 + one + ten], abs=1e-12)
    later = buses.transfer(clear, 0, 0.5)
    assert later.start_s == pytest.approx([0.5, 0.5 + one, *(1 + one + ten + [0, one])], abs=1e-12)


def test_an_absent_robot_does_not_acknowledge_and_takes_the_time_of_its_address(buses):
    absent = Addresses([0, 5, 9], [10, 8, 8], [False, True, False])
    replies = buses.transfer(encode_command(Opcode.CLEAR, absent), 3, 0.0)
    assert replies.ack.tolist() == [Ack.NO_ADDRESS] * 3
    assert np.array_equal(replies.table(3), np.full((3, 3), 255))
    assert replies.end_s == pytest.approx(buses.timing.unanswered_s([False, True, False]))
    buses.positioners.power([0], False, 1.0)
    acks = buses.transfer(encode_command(Opcode.CLEAR, TO), 0, 1.0).ack
    assert acks.tolist() == [Ack.NO_ADDRESS, Ack.OK, Ack.OK, Ack.OK]


def test_a_general_call_is_acknowledged_if_one_robot_acknowledges(buses):
    call = encode_command(Opcode.STOP, general_call([0, 5, 6]))
    buses.positioners.power([0, 2, 3], False, 0.0)
    acks = buses.transfer(call, 0, 0.0).ack
    assert acks.tolist() == [Ack.OK, Ack.NO_ADDRESS, Ack.NO_ADDRESS]


def test_a_refused_frame_takes_its_time_and_is_not_acknowledged(buses):
    replies = buses.transfer(Frames.from_bytes(TO[:1], [b"\x40\x00"]), 0, 0.0)
    assert replies.ack.tolist() == [Ack.REFUSED]
    assert replies.end_s == pytest.approx([buses.timing.message_s(2, 0, False)])

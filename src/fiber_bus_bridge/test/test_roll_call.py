# SPDX-License-Identifier: Apache-2.0
"""The roll call: a bit for each robot of a bus, pulled low while it carries out its order."""

import numpy as np
import pytest
from session_rig import Rig

from fiber_bus_bridge import SessionState
from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.simulation import Event, Faults
from fiber_bus_bridge.wire import (
    ROLL_CALL_ADDRESS,
    Addresses,
    Opcode,
    encode_command,
    general_call,
    roll_call,
    roll_call_bytes,
    roll_call_slots,
)
from fiber_core.clearance import Safety


def test_slots_are_the_ranks_by_address_on_each_bus():
    to = Addresses([1, 0, 1, 0, 1], [300, 9, 20, 8, 1000], [True, False, True, False, True])
    assert roll_call_slots(to).tolist() == [1, 1, 0, 0, 2]


def test_a_roll_call_reads_a_bit_for_each_robot():
    assert roll_call_bytes([0, 1, 8, 9, 36, 112, 500]).tolist() == [0, 1, 1, 2, 5, 14, 63]
    frames = roll_call([4, 7])
    assert frames.to.bus.tolist() == [4, 7] and frames.to.ten_bit.all()
    assert set(frames.to.address) == {ROLL_CALL_ADDRESS} and frames.lengths.tolist() == [0, 0]


def present(rig, t, read=2):
    """Bits of the roll call of each bus at time t, shape (buses, 8 read), True = present."""
    replies = rig.session.transactions.backend.transfer(roll_call([0, 1]), read, t)
    assert (replies.ack == Ack.OK).all()
    return ~np.unpackbits(replies.table(read), axis=1).astype(bool)


def test_robots_that_carry_out_their_orders_are_present_and_all_others_absent():
    rig = Rig()  # ten robots on bus 0, nine on bus 1
    rig.call("configure")
    assert not present(rig, rig.t).any()  # IDLE
    rig.session.submit(rig.orders(np.where(np.arange(19) == 13, 0, 400), 0))
    rig.call("start")
    t = rig.t + 1e-3  # a later one would find them without a HEARTBEAT
    expected = np.zeros((2, 16), dtype=bool)
    expected[0, :10] = expected[1, :9] = True
    expected[1, 3] = False  # robot 13 has no order
    np.testing.assert_array_equal(present(rig, t), expected)
    rig.robots.power([4], False, t)
    stop = encode_command(Opcode.STOP, rig.session.transactions.addresses[np.array([2, 17])])
    rig.session.transactions.backend.transfer(stop, 0, t)
    expected[0, [4, 2]] = expected[1, 7] = False
    np.testing.assert_array_equal(present(rig, t), expected)
    assert present(rig, t, read=1)[0, 2:5].tolist() == [False, True, False]


def test_a_robot_that_lost_its_configuration_does_not_answer():
    rig = Rig(n=3, on_bus=2)
    rig.ready()
    rig.call("start")
    t = rig.t + 1e-3
    rig.robots.power([0], False, t)
    rig.robots.power([0], True, t)
    heartbeat = encode_command(Opcode.HEARTBEAT, general_call([0, 1]))
    for k in range(4):  # the robot boots for 5 ms
        rig.session.transactions.backend.transfer(heartbeat, 0, t + 2e-3 * k)
    assert present(rig, t + 7e-3, read=1)[0, :2].tolist() == [False, True]


def test_a_noisy_roll_call_stops_no_robot():
    noise = ((0, 0.0, np.inf, 1e-4), (1, 0.0, np.inf, 1e-4))
    rig = Rig(faults=Faults(noise=noise))
    rig.ready()
    rig.call("start")
    result = rig.run()
    assert (result.outcome == 0).all() and len(rig.session.loaded_plans) == 1


@pytest.mark.parametrize("failure", [Event.POWER, Event.DEAF])
def test_a_silent_robot_on_a_bus_of_500_stops_all_within_what_the_certificate_contains(failure):
    rig = Rig(n=500, on_bus=500)
    rig.ready(theta=100)
    rig.call("start")
    failed_s = rig.t + 0.1234
    rig.robots.schedule([(321, failed_s, failure, int(failure == Event.DEAF))])
    while rig.session.state is SessionState.MOVING and len(rig.session.loaded_plans) == 1:
        rig.t += 0.01
        rig.call("advance")
    rig.robots.advance(rig.t)
    stops = rig.robots.memory["halted_s"]
    stops = stops[(stops >= failed_s) & (stops < failed_s + 0.02)]
    assert len(stops) == 500 and np.ptp(stops) <= Safety().stop_skew_s


def test_supervision_takes_no_more_than_half_of_the_time_of_a_bus_of_500():
    rig = Rig(n=500, on_bus=500)
    busy_s, backend = [], rig.session.transactions.backend
    transfer = backend.transfer

    def measured(frames, read_bytes, not_before_s):
        replies = transfer(frames, read_bytes, not_before_s)
        busy_s.append((replies.start_s.min(), (replies.end_s - replies.start_s).sum()))
        return replies

    rig.ready(theta=100)
    rig.call("start")
    backend.transfer = measured
    begin_s = rig.t + 0.1
    while rig.t < begin_s + 0.2:
        rig.t += 0.01
        rig.call("advance")
    used_s = sum(took for at, took in busy_s if begin_s <= at < begin_s + 0.15)
    assert 0.2 < used_s / 0.15 <= 0.5

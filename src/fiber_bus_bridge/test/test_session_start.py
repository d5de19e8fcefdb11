# SPDX-License-Identifier: Apache-2.0
"""Load, verify, go: the robots that are started, and the robots that are held with a reason."""

from dataclasses import replace

import numpy as np
import pytest
from session_rig import Rig, ended_once

from fiber_bus_bridge.bus import Recovery
from fiber_bus_bridge.protocol import loading
from fiber_bus_bridge.simulation import Faults, LineFault
from fiber_bus_bridge.wire import Frames, Opcode, RobotState, decode_command, decode_load
from fiber_core.clearance import hold_until_safe, neighbour_pairs
from fiber_core.outcomes import Outcome, Reason


@pytest.mark.parametrize("present", [True, False])
def test_an_absent_robot_is_held_and_its_neighbours_are_certified_around_it(present):
    # a robot points at its neighbour, which turns there while the robot turns away
    plane = Rig(7).plane
    away, follower = neighbour_pairs(plane)[0]
    toward = plane.centers[follower] - plane.centers[away]
    angle = np.arctan2(toward[1], toward[0])
    bend = 1.2  # tips lie half of this off theta
    facing = np.angle(np.exp(1j * (angle + np.pi))) - bend / 2
    start = np.tile([0.0, 3.1], (7, 1))
    start[away] = [angle - bend / 2, bend]
    start[follower] = [facing - np.sign(facing) * 7000 * 250 * 1e-6, bend]
    theta = np.zeros(7)
    theta[away] = -7000 * np.sign(start[away, 0])
    theta[follower] = np.sign(facing) * 7000e-6 / Rig(7).units.quantum_rad

    rig = Rig(7, start)
    rig.ready(theta)
    rig.robots.power([away], present, rig.t)
    rig.call("start")
    result = rig.run()
    ended_once(result, 7)
    expected = [Reason.OK] * 2 if present else [Reason.NO_REPLY, Reason.UNSAFE_AS_LOADED]
    assert result.reason[[away, follower]].tolist() == expected
    assert np.any(rig.where() != rig.units.to_counts(start)) == present
    assert rig.session.transactions.counters.table()[0]["retries"] == (0 if present else 4)


def test_the_certificate_is_of_the_loaded_bytes(monkeypatch):
    seen = []

    def certified(plane, motion, safety):
        seen.append(motion)
        return hold_until_safe(plane, motion, safety)

    rig = Rig(certify=certified)
    motion = rig.ready(theta=400, phi=-30)

    def tampered(*arguments):
        frames = encode(*arguments)
        if len(frames) <= 4:
            return frames
        data = frames.data.copy()
        rows = frames[np.array([4])]
        orders = decode_load(rig.units, rows)
        other = encode(
            rows.to,
            orders.sequence,
            replace(orders.motion, velocity=-orders.motion.velocity),
        )
        data[frames.offsets[4] : frames.offsets[5]] = other.data
        return Frames(frames.to, frames.offsets, data)

    encode = loading.encode_load
    monkeypatch.setattr(loading, "encode_load", tampered)
    rig.call("start")
    moved = rig.units.to_counts(seen[-1].end - seen[-1].start)
    assert moved[4].tolist() == [-400 * 250, 30 * 250]
    assert moved[5].tolist() == [400 * 250, -30 * 250]
    result = rig.run()
    assert (result.outcome[4], result.reason[4]) == (Outcome.HELD, Reason.OFF_TARGET)
    assert np.array_equal(np.delete(rig.where(), 4, 0), np.delete(motion.end, 4, 0))


def test_a_tampered_order_is_not_verified_and_does_not_move(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    transactions = rig.session.transactions
    statuses = transactions.statuses

    def tamper_then_read(rows, t, complete=True):
        rig.robots.memory["order"][3, 3] ^= 1
        return statuses(rows, t, complete)

    monkeypatch.setattr(transactions, "statuses", tamper_then_read)
    rig.call("start")
    monkeypatch.undo()
    assert not rig.session.loaded_plan.started[3]
    # its bus has a fresh sequence number, so that the GO had no effect on the robot
    assert rig.session.loaded_plan.sequence.tolist() == [2] * 10 + [1] * 9
    result = rig.run()
    assert (result.outcome[3], result.reason[3]) == (Outcome.HELD, Reason.NOT_VERIFIED)
    expected = motion.end.copy()
    expected[3] = motion.start[3]
    assert np.array_equal(rig.where(), expected)


def test_a_robot_that_refuses_its_order_is_held_alone():
    rig = Rig()
    rig.call("configure")
    rig.robots.memory["limits"][5] = 0
    rig.session.submit(rig.orders(-400, 0))  # beyond the limits that the robot has
    rig.call("start")
    result = rig.run()
    assert result.reason[5] == Reason.REFUSED and result.outcome[5] == Outcome.HELD
    assert (result.outcome == Outcome.REACHED).sum() == 18
    assert rig.session.transactions.counters.table()[0]["refused"] == 3


def test_a_reset_after_loading_is_noticed_before_go(monkeypatch):
    rig = Rig()
    rig.ready()
    send = rig.session.transactions.send

    def send_then_lose_power(rows, frames, t):
        acks = send(rows, frames, t)
        rig.robots.power([2], False, rig.session.transactions.now_s)
        rig.robots.power([2], True, rig.session.transactions.now_s)
        return acks

    monkeypatch.setattr(rig.session.transactions, "send", send_then_lose_power)
    rig.call("start")
    monkeypatch.undo()
    assert rig.run().reason[2] == Reason.REBOOTED


def test_a_robot_that_misses_the_go_gets_its_own_and_starts_with_the_others(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    call = rig.session.transactions.call

    def deaf_to_go(frames, t):
        rig.robots.memory["call_deaf"][1] = True
        replies = call(frames, t)
        rig.robots.memory["call_deaf"][1] = False
        return replies

    monkeypatch.setattr(rig.session.transactions, "call", deaf_to_go)
    rig.call("start")
    monkeypatch.undo()
    started = rig.robots.memory["started_s"]
    assert np.ptp(started) < 20e-6 and started.min() > rig.session.transactions.now_s
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), motion.end)


def test_a_robot_that_cannot_be_started_cancels_the_start_and_is_left_out_of_the_next(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    transactions = rig.session.transactions
    transfer = transactions.transfer

    def deaf_to_every_go(frames, *arguments, **options):
        heads = [p[p[:1] == b"\xf1" :][:1] for p in map(frames.payload, range(len(frames)))]
        rig.robots.memory["deaf"][1] = any(h and h[0] >> 4 == Opcode.GO for h in heads)
        return transfer(frames, *arguments, **options)

    monkeypatch.setattr(transactions, "transfer", deaf_to_every_go)
    rig.call("start")
    assert rig.session.loaded_plan.started.tolist() == [row != 1 for row in range(19)]
    assert set(rig.session.loaded_plan.sequence) == {2}
    assert np.array_equal(rig.where(), motion.start)
    result = rig.run()
    ended_once(result, 19)
    assert (result.outcome[1], result.reason[1]) == (Outcome.HELD, Reason.NOT_ACKNOWLEDGED)
    assert (result.outcome == Outcome.REACHED).sum() == 18


def test_a_bus_with_one_late_go_is_loaded_and_started_again():
    quiet = Rig()
    quiet.ready()
    quiet.call("start")
    # the clock of the second bus is held when the GO is on it, and never again
    go_s = quiet.session.loaded_plan.go_s
    rig = Rig(faults=Faults(stretches=((12, go_s - 1.1e-4, go_s, 1e-3),)))
    motion = rig.ready()
    rig.call("start")
    assert rig.session.loaded_plan.started.all() and rig.session.loaded_plan.go_s > go_s + 2e-3
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), motion.end)


def test_a_bus_with_late_gos_does_not_start_and_no_robot_is_left_stopped():
    rig = Rig(faults=Faults(stretches=((12, 0.0, np.inf, 1e-3),)))
    motion = rig.ready(theta=np.where(np.arange(19) == 4, 0, 400))
    rig.call("start")
    moves = (np.arange(19) < 10) & (np.arange(19) != 4)
    assert np.array_equal(rig.session.loaded_plan.started, moves)
    result = rig.run()
    assert set(result.reason[10:]) == {Reason.NOT_ACKNOWLEDGED}
    assert np.array_equal(rig.where()[moves], motion.end[moves])
    assert np.array_equal(rig.where()[~moves], motion.start[~moves])
    assert set(rig.robots.states(rig.t)[~moves]) == {RobotState.IDLE}


def test_a_bus_that_sticks_in_the_countdown_holds_no_robot_of_the_other_bus():
    quiet = Rig(220, on_bus=110)
    quiet.ready()
    quiet.call("start")
    go_s = quiet.session.loaded_plan.go_s
    # before all robots of the other bus have been polled in the countdown
    lines = ((LineFault.SCL_LOW, 0, go_s + 1e-4, np.inf, Recovery.NOTHING),)
    rig = Rig(220, on_bus=110, faults=Faults(lines=lines))
    motion = rig.ready()
    rig.call("start")
    assert np.array_equal(rig.session.loaded_plan.started, rig.plane.bus == 1)
    result = rig.run()
    assert set(result.reason[:110]) == {Reason.BUS_FAILED}
    assert set(result.outcome[110:]) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), np.where(rig.plane.bus[:, None], motion.end, motion.start))


def test_a_refusal_after_the_certificate_drops_all_orders():
    rig = Rig(7)
    motion = rig.ready()
    seen = []

    def refuse():
        seen.append(set(rig.robots.states(rig.session.transactions.now_s)))
        return False

    rig.call("start", refuse)
    assert seen == [{RobotState.LOADED}]
    assert set(rig.session.result.reason) == {Reason.STOPPED}
    assert set(rig.robots.states(rig.t)) == {RobotState.IDLE}
    assert np.array_equal(rig.robots.positions(rig.t + 9), motion.start)


def test_the_same_call_puts_the_same_bytes_on_the_buses():
    def traffic():
        rig = Rig()
        rig.robots.power([7], False, 0.0)
        rig.ready(theta=300, phi=-20)
        rig.call("start")
        rig.run()
        parts = [
            (e.frames.to.bus, e.frames.to.address, e.frames.data, e.replies.data, e.replies.end_s)
            for e in rig.session.transactions.take_traffic()
        ]
        assert rig.session.transactions.take_traffic() == []
        return b"".join(column.tobytes() for part in parts for column in part)

    assert traffic() == traffic()


def test_go_starts_all_buses_at_one_instant_and_is_sent_once():
    rig = Rig()
    rig.ready()
    rig.session.transactions.take_traffic()
    rig.call("start")
    calls = [e for e in rig.session.transactions.take_traffic() if not e.frames.to.address.any()]
    assert len(calls) == 1 and calls[0].frames.to.bus.tolist() == [0, 1]
    assert decode_command(calls[0].frames.payload(0), 0, False) == (Opcode.GO, 1)
    assert len(set(calls[0].replies.start_s)) == 1


def test_sequence_numbers_are_reused_after_fifteen():
    rig = Rig(3)
    rig.call("configure")
    for number in range(35):
        rig.session.submit(rig.orders(200 if number % 2 else -200, 0, ticks=5))
        rig.call("start")
        assert set(rig.run().outcome) == {Outcome.REACHED}


def test_an_unsafe_robot_that_cannot_be_disarmed_ignores_the_go(monkeypatch):
    held = np.arange(19) == 2

    def unsafe_and_cut_off(*arguments):
        rig.robots.powered[2] = False  # on the bus only: the robot keeps its order
        motion, _, certificate = hold_until_safe(*arguments)
        return motion, held, certificate

    rig = Rig(certify=unsafe_and_cut_off)
    motion = rig.ready()
    transactions = rig.session.transactions
    call = transactions.call

    def call_with_power(frames, t):
        rig.robots.powered[2] = True
        return call(frames, t)

    monkeypatch.setattr(transactions, "call", call_with_power)
    rig.call("start")
    assert rig.robots.states(rig.t)[2] == RobotState.LOADED
    assert np.array_equal(rig.session.loaded_plan.started, ~held)
    result = rig.run()
    assert result.reason[2] == Reason.UNSAFE_AS_LOADED
    expected = np.where(held[:, None], motion.start, motion.end)
    assert np.array_equal(rig.where(), expected)


def test_no_robot_moves_when_no_sequence_number_is_safe():
    # in each round another robot is unsafe, and cut off before it can be disarmed
    unsafe = iter(np.eye(7, dtype=bool))

    def one_more_unsafe(*arguments):
        motion, held, certificate = hold_until_safe(*arguments)
        if arguments[1].counts.any():
            held = next(unsafe)
            rig.robots.powered[held] = False
        return motion, held, certificate

    rig = Rig(7, certify=one_more_unsafe)
    motion = rig.ready()
    rig.call("start")
    ended_once(rig.session.result, 7)
    reasons = rig.session.result.reason.tolist()
    assert reasons == [Reason.UNSAFE_AS_LOADED] * 6 + [Reason.STOPPED]
    assert np.array_equal(rig.robots.positions(rig.t + 9), motion.start)


def test_an_absent_robot_holds_only_the_robots_that_could_touch_it():
    # a robot points at its neighbour, which turns there while the robot turns away; others turn too
    rig = Rig(37)
    plane, pairs = rig.plane, neighbour_pairs(rig.plane)
    leaver, follower = pairs[len(pairs) // 2]
    toward = plane.centers[follower] - plane.centers[leaver]
    angle, bend = np.arctan2(toward[1], toward[0]), 1.2
    facing = np.angle(np.exp(1j * (angle + np.pi))) - bend / 2
    start = np.tile([0.0, 3.1], (37, 1))
    start[leaver] = [angle - bend / 2, bend]
    start[follower] = [facing - np.sign(facing) * 7000 * 250 * 1e-6, bend]
    theta = np.full(37, 400)
    theta[leaver] = -7000 * np.sign(start[leaver, 0])
    theta[follower] = np.sign(facing) * 7000e-6 / rig.units.quantum_rad

    ended = []
    for present in (True, False):
        rig = Rig(37, start)
        motion = rig.ready(theta)
        rig.robots.power([leaver], present, rig.t)
        rig.call("start")
        ended.append((rig.run(), rig.where(), motion))
    (with_all, _, _), (result, where, motion) = ended
    assert set(with_all.outcome) == {Outcome.REACHED}
    held = np.flatnonzero(result.outcome != Outcome.REACHED)
    assert sorted(held.tolist()) == sorted([leaver, follower])
    assert result.reason[leaver] == Reason.NO_REPLY
    assert result.reason[follower] == Reason.UNSAFE_AS_LOADED
    others = np.setdiff1d(np.arange(37), held)
    assert len(np.unique(plane.bus[others])) == len(np.unique(plane.bus))
    assert np.array_equal(where[others], motion.end[others])

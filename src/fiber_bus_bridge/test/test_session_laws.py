# SPDX-License-Identifier: Apache-2.0
"""Laws of sessions that no fault may break: what is commanded, when, and how plans end."""

from dataclasses import replace

import numpy as np
import pytest
from session_rig import Rig, ended_once

from fiber_bus_bridge import Session, SessionConfig, SessionError, SessionState, addresses_of
from fiber_bus_bridge.bus import Ack, Recovery
from fiber_bus_bridge.protocol import Event as Happened
from fiber_bus_bridge.simulation import Event, Faults, LineFault, SimulatedBuses
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import Fault, Frames, Opcode, RobotState
from fiber_core.clearance import Safety, certify, hold_until_safe
from fiber_core.outcomes import Outcome, Reason
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion


def commands(rig, opcode):
    """Rows of the robots to which each frame with an opcode went, in order, -1 = to all."""
    to = rig.session.transactions.addresses
    found = []
    for exchange in rig.session.transactions.take_traffic():
        frames = exchange.frames
        for k in range(len(frames)):
            payload = frames.payload(k)
            payload = payload if frames.to.address[k] else payload[1:]  # the mark of a call to all
            if len(payload) == 0 or payload[0] >> 4 != opcode:
                continue
            own = (to.bus == frames.to.bus[k]) & (to.address == frames.to.address[k])
            found.append(int(np.argmax(own)) if own.any() else -1)
    return found


@pytest.mark.parametrize(
    "assumed", [np.zeros((2, 2)), np.zeros((3, 1)), np.full((3, 2), np.nan)], ids=str
)
def test_assumed_angles_must_be_finite_and_fit_the_plane(assumed):
    rig = Rig(3)
    with pytest.raises(SessionError, match=r"expected \(3, 2\) finite values"):
        Session(rig.plane, rig.units, Safety(), SimulatedBuses(rig.robots), assumed)


def test_a_robot_that_is_disabled_is_held_and_one_that_is_enabled_again_moves():
    rig = Rig(5)
    motion = rig.ready()
    rig.session.enable(np.arange(5) != 2)
    rig.call("start")
    result = rig.run()
    assert (result.outcome[2], result.reason[2]) == (Outcome.HELD, Reason.DISABLED)
    assert set(np.delete(result.outcome, 2)) == {Outcome.REACHED}
    assert np.array_equal(rig.where()[2], motion.start[2])
    rig.session.enable(np.ones(5, dtype=bool))
    rig.session.submit(rig.orders(-400, 0))
    rig.call("start")
    assert set(rig.run().outcome) == {Outcome.REACHED}


def test_a_robot_that_keeps_a_fault_is_configured_twice_and_left_out(monkeypatch):
    rig = Rig(3)
    send = rig.session.transactions.send

    def broken(rows, *arguments):
        acks = send(rows, *arguments)
        rig.robots.memory["fault"][1] = Fault.BAD_CRC
        return acks

    monkeypatch.setattr(rig.session.transactions, "send", broken)
    rig.call("configure")
    monkeypatch.undo()
    assert rig.session.known.tolist() == [True, False, True]
    assert commands(rig, Opcode.CONFIG) == [0, 1, 2, 1]


def slow_rig(config=None, stuck=3):
    """A plan in which the clock of one robot is so slow that it does not arrive in time."""
    ppm = np.zeros(7)
    ppm[stuck] = -4e5
    rig = Rig(7, config=config, clock_ppm=ppm)
    rig.ready(theta=100, phi=0)
    return rig


def test_a_robot_that_does_not_arrive_in_time_fails_and_all_are_stopped():
    rig = slow_rig(SessionConfig(grace_s=0.25))
    rig.call("start")
    plan = rig.session.loaded_plan
    result = rig.run()
    ended_once(result, 7)
    assert rig.session.state is SessionState.STOPPED
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, Reason.OVERDUE)
    assert set(np.delete(result.outcome, 3)) == {Outcome.REACHED}
    assert set(rig.robots.states(rig.t)) == {RobotState.STOPPED}
    (overdue,) = (e for e in rig.session.take_transitions() if e.event is Happened.OVERDUE)
    after = overdue.t - plan.start_s - plan.makespan_s
    # the grace, the error of the clock that Safety allows for, and at most one step
    allowed = Safety().clock_ppm * 1e-6 * plan.makespan_s + Safety().start_skew_s
    assert 0.25 + allowed < after < 0.25 + allowed + 2 * SessionConfig().heartbeat_period_s


def test_a_robot_that_arrives_within_the_grace_has_not_failed():
    rig = slow_rig(SessionConfig(grace_s=5.0))
    rig.call("start")
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert rig.session.state is SessionState.IDLE


def test_retries_wait_a_millisecond_and_then_ten():
    rig = Rig(3)
    rig.robots.power([1], False, 0.0)
    transactions = rig.session.transactions
    transactions.statuses(np.arange(3), 1.0)
    tries = [
        (e.replies.start_s[k], e.replies.end_s[k])
        for e in transactions.take_traffic()
        for k in range(len(e.frames))
        if e.frames.to.address[k] == rig.plane.address[1]
    ]
    assert len(tries) == 3
    pauses = [after[0] - before[1] for before, after in zip(tries, tries[1:])]
    assert 1e-3 <= pauses[0] < 2e-3 and 10e-3 <= pauses[1] < 11e-3
    assert transactions.failures.tolist() == [0, 3, 0]


def test_of_the_traffic_the_last_thousand_batches_are_kept():
    rig = Rig(1)
    transactions = Transactions(rig.session.transactions.backend, addresses_of(rig.plane))
    for k in range(1010):
        transactions.statuses(np.array([0]), float(k))
    traffic = transactions.take_traffic()
    assert len(traffic) == 1000 and traffic[0].replies.start_s[0] >= 10.0
    assert transactions.take_traffic() == []


def test_a_plan_without_faults_needs_no_retry_and_no_recovery():
    rig = Rig()
    rig.ready()
    rig.call("start")
    rig.run()
    for totals in rig.session.transactions.counters.table().values():
        for name in ("recoveries", "retries", "refused", "timed_out", "bad_replies"):
            assert totals.get(name, 0) == 0, (name, totals)


def test_a_robot_deaf_to_general_calls_is_stopped_by_a_stop_of_its_own():
    rig = Rig(4)
    rig.call("configure")
    rig.robots.memory["call_deaf"][2] = True
    commands(rig, Opcode.STOP)
    rig.call("stop")
    assert set(rig.robots.states(rig.t)) == {RobotState.STOPPED}
    sent = commands(rig, Opcode.STOP)
    assert sent == [-1, -1, -1, 2]  # the call is repeated at once, then each robot has its own


def test_a_bus_that_works_again_is_stopped_and_read():
    lines = ((LineFault.SCL_LOW, 1, 0.3, 2.0, Recovery.NOTHING),)
    rig = Rig(config=SessionConfig(resumes=0), faults=Faults(lines=lines))
    rig.ready(theta=300)
    rig.call("start")
    rig.run()
    assert rig.session.transactions.given_up.tolist() == [False, True]
    rig.t = 2.5
    rig.call("stop")
    assert not rig.session.transactions.given_up.any()
    assert set(rig.robots.states(rig.t)[10:]) <= {RobotState.STOPPED, RobotState.FAULT}
    assert np.array_equal(rig.session.counts, rig.where())


def test_no_message_is_sent_on_a_bus_that_was_given_up():
    lines = ((LineFault.SCL_LOW, 1, 0.0, np.inf, Recovery.NOTHING),)
    rig = Rig(faults=Faults(lines=lines))
    transactions = rig.session.transactions
    status = transactions.statuses(np.arange(19), 1.0)
    assert status.ok.tolist() == [row < 10 for row in range(19)]
    assert transactions.given_up.tolist() == [False, True]
    asked = []
    transfer = transactions.backend.transfer

    def watched(frames, *arguments):
        asked.append(frames.to.bus.tolist())
        return transfer(frames, *arguments)

    transactions.backend.transfer = watched
    t = transactions.now_s + 1.0
    replies = transactions.transfer(Frames.empty(transactions.addresses), 4, t)
    assert asked == [[0] * 10]
    assert (replies.ack[:10] == Ack.OK).all() and (replies.ack[10:] == Ack.NOT_SENT).all()
    assert (replies.start_s[10:] == t).all() and (replies.end_s[10:] == t).all()
    assert (replies.table(4)[10:] == 0xFF).all() and (replies.table(4)[:10] != 0xFF).any(
        axis=1
    ).all()
    assert t < transactions.now_s < t + 5e-3
    transactions.revive()
    assert not transactions.given_up.any()


@pytest.mark.parametrize("later_s", [0.0, 0.6e-3, 1.2e-3, 1.8e-3])
def test_robots_on_all_buses_stop_together_when_a_bus_sticks(later_s):
    lines = ((LineFault.SCL_LOW, 1, 0.3 + later_s, np.inf, Recovery.NOTHING),)
    rig = Rig(config=SessionConfig(resumes=0), faults=Faults(lines=lines))
    rig.ready()
    rig.call("start")
    rig.run()
    rig.robots.advance(rig.t + 0.1)
    assert np.ptp(rig.robots.memory["halted_s"]) < 0.5e-3


def test_the_polls_of_a_robot_are_in_the_traffic_ten_times_a_second():
    rig = Rig(4)
    rig.ready(theta=100)
    rig.call("start")
    plan = rig.session.loaded_plan
    rig.session.transactions.take_traffic()
    rig.run()
    address = rig.plane.address[2]
    times = [
        e.replies.start_s[k]
        for e in rig.session.transactions.take_traffic()
        for k in range(len(e.frames))
        if e.frames.to.address[k] == address and e.frames.lengths[k] == 0
        if plan.start_s < e.replies.start_s[k] < plan.start_s + plan.makespan_s
    ]
    # a poll of another robot brings all polls of its step into the traffic
    assert 9 * plan.makespan_s <= len(times) <= 45 * plan.makespan_s
    assert np.diff(times).max() < 0.11


def moved_slowly(rig):
    """Orders of two segments, far below the highest speeds."""
    n = rig.plane.n
    ticks = np.tile([200, 300], n)
    velocity = np.tile([60, -20], n)
    offsets = np.repeat(np.arange(0, 2 * n + 1, 2), 2)[1:]
    return WireMotion(rig.units, rig.session.counts, offsets, ticks, velocity)


@pytest.mark.parametrize("when_s", [0.1, 0.73])
def test_a_resumed_motion_takes_the_time_that_was_left(when_s):
    rig = Rig()
    rig.call("configure")
    motion = moved_slowly(rig)
    resting = np.arange(19) == 12
    motion = motion.without(resting)
    rig.session.submit(motion)
    rig.call("start")
    first = rig.session.loaded_plan
    assert first.started.tolist() == (~resting).tolist()
    rig.robots.schedule([(3, first.start_s + when_s, Event.JAM_THETA, 1)])
    rig.run()
    before, after = rig.session.loaded_plans
    resumed = np.isin(np.arange(19), [3, 12], invert=True)
    assert after.started.tolist() == resumed.tolist()
    left = before.makespan_s - when_s
    tick_s = rig.units.tick_s
    assert left - 2 * SessionConfig().heartbeat_period_s - tick_s <= after.makespan_s
    assert after.makespan_s <= left + tick_s
    assert np.array_equal(rig.where()[resumed], motion.end[resumed])
    # the second segment, not yet begun at 0.1 s, is as it was
    part = after.motion.parts.slice(0)
    expected = (300, -20) if when_s == 0.1 else None
    if expected:
        assert (after.motion.ticks[part][-1], after.motion.velocity[part][-1]) == expected
    assert np.array_equal(after.motion.end[resumed], motion.end[resumed])


def test_the_certificate_is_of_the_robots_that_are_started():
    held = np.arange(7) == 4

    def one_is_unsafe(plane, motion, safety):
        safe, also, certificate = hold_until_safe(plane, motion.without(held), safety)
        return safe, held & motion.without(~held).counts.reshape(7, -1).any(axis=1), certificate

    rig = Rig(7, certify=one_is_unsafe)
    rig.call("configure")
    ticks = np.where(held, 900, 250)
    rig.session.submit(rig.orders(100, 0, ticks=ticks))
    rig.call("start")
    plan = rig.session.loaded_plan
    assert plan.started.tolist() == (~held).tolist()
    assert plan.motion.moves.tolist() == (~held).tolist()
    assert plan.makespan_s == pytest.approx(250 * rig.units.tick_s)
    result = rig.run()
    assert result.reason[4] == Reason.UNSAFE_AS_LOADED
    assert set(np.delete(result.outcome, 4)) == {Outcome.REACHED}
    assert np.array_equal(rig.where()[4], plan.motion.start[4])


@pytest.mark.parametrize("which", ["unsafe", "limits_broken", "moved_disabled"])
def test_no_robot_starts_when_a_moving_robot_is_not_certified(which):
    def not_proven(plane, motion, safety):
        certificate = certify(plane, motion, safety)
        wrong = {name: np.array(getattr(certificate, name)) for name in (which,)}
        wrong[which][:1] = bool((motion.velocity_rad_s != 0).any())
        return motion, np.zeros(plane.n, dtype=bool), replace(certificate, **wrong)

    rig = Rig(7, certify=not_proven)
    motion = rig.ready()
    rig.call("start")
    ended_once(rig.session.result, 7)
    assert set(rig.session.result.outcome) == {Outcome.HELD}
    assert set(rig.session.result.reason) == {Reason.UNSAFE_AS_LOADED}
    assert np.array_equal(rig.robots.positions(rig.t + 9), motion.start)


def test_resting_robots_that_are_not_certified_hold_no_other_robot():
    def two_rest_too_close(plane, motion, safety):
        motion, held, certificate = hold_until_safe(plane, motion, safety)
        unsafe = (certificate.pairs == 0).any(axis=1) & (certificate.pairs == 1).any(axis=1)
        assert unsafe.any()
        return motion, held, replace(certificate, unsafe=unsafe)

    rig = Rig(7, certify=two_rest_too_close)
    rig.ready(theta=np.where(np.arange(7) < 2, 0, 300))
    rig.call("start")
    assert np.flatnonzero(rig.session.loaded_plan.started).tolist() == [2, 3, 4, 5, 6]
    assert set(rig.run().outcome[2:]) == {Outcome.REACHED}


def test_orders_of_sixteen_segments_are_held_and_of_fifteen_are_carried_out():
    rig = Rig(3)
    rig.call("configure")
    counts = np.zeros((3, 2), dtype=np.int64)
    counts[:, 0] = [15, 16, 14]
    offsets = Parts.from_counts(counts).offsets
    motion = WireMotion(
        rig.units, rig.session.counts, offsets, np.full(45, 90), np.tile([50, 60, 70], 15)
    )
    rig.session.submit(motion)
    rig.call("start")
    result = rig.run()
    assert result.reason.tolist() == [Reason.OK, Reason.TOO_MANY_SEGMENTS, Reason.OK]
    assert np.array_equal(rig.where()[[0, 2]], motion.end[[0, 2]])


def test_a_start_within_the_tolerance_of_the_encoders_begins_at_the_encoders():
    rig = Rig(3)
    rig.call("configure")
    good = rig.orders(400, 0)
    most = int(SessionConfig().start_tolerance_rad / rig.units.quantum_rad)
    near = WireMotion(rig.units, good.start + most, good.offsets, good.ticks, good.velocity)
    rig.session.submit(near)
    rig.call("start")
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), good.end)
    again = rig.orders(-400, 0)
    far = WireMotion(rig.units, again.start - most - 1, again.offsets, again.ticks, again.velocity)
    with pytest.raises(SessionError, match="robot 0: orders begin at"):
        rig.session.submit(far)
    # a robot that rests, or was never found, need not begin anywhere
    resting = rig.orders(0, 0)
    rig.session.submit(
        WireMotion(rig.units, resting.start + 999, resting.offsets, resting.ticks, [])
    )


def test_a_result_is_taken_once():
    rig = Rig(3)
    rig.ready()
    rig.call("start")
    result = rig.run()
    assert rig.session.take_result() is result
    assert rig.session.take_result() is None and rig.session.result is None


def test_a_call_returns_when_the_buses_are_free_and_waits_for_them():
    rig = Rig(5)
    after = rig.session.configure(2.0)
    assert after == rig.session.transactions.now_s > 2.0
    again = rig.session.configure(1.0)
    assert again - after == pytest.approx(after - 2.0, rel=0.05)
    assert rig.session.advance(50.0) == again  # nothing moves

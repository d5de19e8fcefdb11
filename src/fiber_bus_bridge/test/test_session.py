"""The whole protocol on small planes: who is started, who is held and why, where all end."""

from dataclasses import replace

import numpy as np
import pytest

import fiber_bus_bridge.upload
from fiber_bus_bridge import (
    Positioners,
    Session,
    SessionConfig,
    SessionError,
    SessionState,
    SimulatedBuses,
    addresses_of,
    bus_timing,
)
from fiber_bus_bridge.bus import Faults
from fiber_bus_bridge.firmware import Event
from fiber_bus_bridge.resume import remaining_motion
from fiber_bus_bridge.wire import Fault, Frames, Opcode, RobotState, decode_command, decode_load
from fiber_core import kinematics
from fiber_core.clearance import Safety, certify, neighbour_pairs
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits


class Rig:
    """A plane of nearly folded robots on simulated buses, ten to a bus, and a session with it."""

    def __init__(self, n=19, start=None, enabled=None, config=None, faults=None, **positioners):
        rows = np.arange(n)
        plane = replace(preset("desi", n), bus=rows // 10, address=8 + rows % 10)
        self.plane = plane if enabled is None else plane.with_enabled(enabled)
        self.units = WireUnits.for_plane(self.plane)
        folded = np.stack([np.linspace(-1, 1, n), np.full(n, 2.6)], axis=1)
        start = self.units.to_counts(folded if start is None else start)
        self.robots = Positioners(
            addresses_of(self.plane), self.plane.ids, self.units.quantum_prad, start, **positioners
        )
        self.session = Session(
            self.plane,
            self.units,
            Safety(),
            SimulatedBuses(self.robots, bus_timing("1M"), faults),
            self.units.to_angles(start),
            config,
        )
        self.t = 0.0

    def orders(self, theta, phi, ticks=250):
        """One segment for each joint that moves: turns of theta and phi [quanta a tick], (n,)."""
        velocity = np.stack(np.broadcast_arrays(theta, phi, np.zeros(self.plane.n)), 1)[:, :2]
        velocity = velocity.astype(np.int64).ravel()
        moves = velocity != 0
        offsets = np.concatenate([[0], np.cumsum(moves)])
        return WireMotion(
            self.units, self.session.counts, offsets, np.full(moves.sum(), ticks), velocity[moves]
        )

    def call(self, name, *arguments):
        self.t = max(self.t, getattr(self.session, name)(self.t, *arguments))

    def ready(self, theta=400, phi=0, targets=None):
        self.call("configure")
        motion = self.orders(theta, phi)
        self.session.submit(motion, targets)
        return motion

    def run(self):
        """Advance ten times a second until the plan ends."""
        for _ in range(200):
            if self.session.state is not SessionState.MOVING:
                return self.session.result
            self.t += 0.1
            self.call("advance")
        raise AssertionError("the plan does not end")

    def where(self):
        return self.robots.positions(self.t)


def ended_once(result, n):
    assert len(result.outcome) == len(result.reason) == len(result.error_mm) == n
    reached = result.outcome == Outcome.REACHED
    assert np.array_equal(reached, result.reason == Reason.OK)


def test_a_plan_from_bytes_to_targets():
    rig = Rig()
    motion = rig.ready(theta=np.arange(19) * 40 - 360, phi=-30)
    targets = kinematics.forward(rig.plane, rig.units.to_angles(motion.end))[1]
    rig.session.submit(motion, targets + [[0.03, 0.04]])
    rig.call("start")
    assert rig.session.state is SessionState.MOVING
    assert rig.session.upload.certificate.ok
    result = rig.run()
    ended_once(result, 19)
    assert set(result.outcome) == {Outcome.REACHED}
    assert result.error_mm == pytest.approx(np.full(19, 0.05), abs=1e-9)
    assert np.array_equal(rig.session.counts, motion.end)
    assert np.array_equal(rig.where(), motion.end)
    assert rig.session.state is SessionState.IDLE


def test_the_encoders_are_seen_on_the_way():
    rig = Rig()
    motion = rig.ready(phi=-30)
    rig.call("start")
    rig.t = rig.session.upload.start_s + 0.5
    rig.session.advance(rig.t)
    halfway = rig.units.to_angles(rig.session.counts)
    spread = 0.02 * rig.plane.speeds  # the sweep takes a few ms
    assert np.all(np.abs(halfway - motion.decoded()(0.5)) < spread)
    assert np.all(np.abs(halfway - motion.decoded().start)[:, 0] > spread[:, 0])


@pytest.mark.parametrize("present", [True, False])
def test_an_absent_robot_is_held_and_its_neighbours_are_certified_around_it(present):
    # one robot points at another, which turns to point at it while it turns away
    plane = Rig(7).plane
    away, comer = neighbour_pairs(plane)[0]
    toward = plane.centers[comer] - plane.centers[away]
    angle = np.arctan2(toward[1], toward[0])
    bend = 1.2  # tips lie half of this off theta
    facing = np.angle(np.exp(1j * (angle + np.pi))) - bend / 2
    start = np.tile([0.0, 3.1], (7, 1))
    start[away] = [angle - bend / 2, bend]
    start[comer] = [facing - np.sign(facing) * 7000 * 250 * 1e-6, bend]
    theta = np.zeros(7)
    theta[away] = -7000 * np.sign(start[away, 0])
    theta[comer] = np.sign(facing) * 7000e-6 / Rig(7).units.quantum_rad

    rig = Rig(7, start)
    rig.ready(theta)
    rig.robots.power([away], present, rig.t)
    rig.call("start")
    result = rig.run()
    ended_once(result, 7)
    expected = [Reason.OK] * 2 if present else [Reason.NOT_ACKNOWLEDGED, Reason.UNSAFE_AS_LOADED]
    assert result.reason[[away, comer]].tolist() == expected
    assert np.any(rig.where() != rig.units.to_counts(start)) == present
    assert rig.session.link.counters.table()[0]["retries"] == (0 if present else 4)


def test_the_certificate_sees_bytes_not_intentions(monkeypatch):
    rig = Rig()
    motion = rig.ready(theta=400, phi=-30)
    seen = []

    def tampered(*arguments):
        frames = encode(*arguments)
        if len(frames) <= 4:
            return frames
        data = frames.data.copy()
        rows = frames[np.array([4])]
        orders = decode_load(rig.units, rows)
        other = encode(
            rig.units, rows.to, orders.sequence, orders.offsets, orders.ticks, -orders.velocity
        )
        data[frames.offsets[4] : frames.offsets[5]] = other.data
        return Frames(frames.to, frames.offsets, data)

    def certified(plane, motion, *arguments):
        seen.append(motion)
        return hold(plane, motion, *arguments)

    upload = fiber_bus_bridge.upload
    encode, hold = upload.encode_load, upload.hold_until_safe
    monkeypatch.setattr(upload, "encode_load", tampered)
    monkeypatch.setattr(upload, "hold_until_safe", certified)
    rig.call("start")
    turns = rig.units.to_counts(seen[-1].end - seen[-1].start)
    assert turns[4].tolist() == [-400 * 250, 30 * 250]
    assert turns[5].tolist() == [400 * 250, -30 * 250]
    result = rig.run()
    assert (result.outcome[4], result.reason[4]) == (Outcome.HELD, Reason.OFF_TARGET)
    assert np.array_equal(np.delete(rig.where(), 4, 0), np.delete(motion.end, 4, 0))


def test_a_tampered_order_is_not_verified_and_does_not_move(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    link = rig.session.link
    statuses = link.statuses

    def tamper_then_read(rows, t, whole=True):
        rig.robots.memory["order"][3, 3] ^= 1
        return statuses(rows, t, whole)

    monkeypatch.setattr(link, "statuses", tamper_then_read)
    rig.call("start")
    monkeypatch.undo()
    assert not rig.session.upload.started[3]
    # its bus went to a fresh sequence number, so that the GO meant nothing to it
    assert rig.session.upload.sequence.tolist() == [2] * 10 + [1] * 9
    result = rig.run()
    assert (result.outcome[3], result.reason[3]) == (Outcome.HELD, Reason.NOT_VERIFIED)
    expected = motion.end.copy()
    expected[3] = motion.start[3]
    assert np.array_equal(rig.where(), expected)


def test_an_order_the_robot_refuses_holds_only_that_robot():
    rig = Rig()
    rig.call("configure")
    rig.robots.memory["limits"][5] = 0
    rig.session.submit(rig.orders(-400, 0))  # farther out of what it takes for its limits
    rig.call("start")
    result = rig.run()
    assert result.reason[5] == Reason.REFUSED and result.outcome[5] == Outcome.HELD
    assert (result.outcome == Outcome.REACHED).sum() == 18
    assert rig.session.link.counters.table()[0]["refused"] == 3


def test_a_reset_after_loading_is_noticed_before_go(monkeypatch):
    rig = Rig()
    rig.ready()
    send = rig.session.link.send

    def send_then_lose_power(rows, frames, t):
        acks = send(rows, frames, t)
        rig.robots.power([2], False, rig.session.link.now_s)
        rig.robots.power([2], True, rig.session.link.now_s)
        return acks

    monkeypatch.setattr(rig.session.link, "send", send_then_lose_power)
    rig.call("start")
    monkeypatch.undo()
    assert rig.run().reason[2] == Reason.NOT_VERIFIED


def test_a_robot_that_misses_the_go_is_told_by_itself_and_starts_with_the_others(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    call = rig.session.link.call

    def deaf_to_go(frames, t):
        rig.robots.memory["call_deaf"][1] = True
        replies = call(frames, t)
        rig.robots.memory["call_deaf"][1] = False
        return replies

    monkeypatch.setattr(rig.session.link, "call", deaf_to_go)
    rig.call("start")
    monkeypatch.undo()
    started = rig.robots.memory["started_s"]
    assert np.ptp(started) < 20e-6 and started.min() > rig.session.link.now_s
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), motion.end)


def test_a_robot_that_cannot_be_started_calls_the_others_off_and_they_go_without_it(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    link = rig.session.link
    transfer = link.transfer

    def deaf_to_every_go(frames, *arguments, **options):
        heads = [p[p[:1] == b"\xf1" :][:1] for p in map(frames.payload, range(len(frames)))]
        rig.robots.memory["deaf"][1] = any(h and h[0] >> 4 == Opcode.GO for h in heads)
        return transfer(frames, *arguments, **options)

    monkeypatch.setattr(link, "transfer", deaf_to_every_go)
    rig.call("start")
    assert rig.session.upload.started.tolist() == [row != 1 for row in range(19)]
    assert set(rig.session.upload.sequence) == {2}
    assert np.array_equal(rig.where(), motion.start)
    result = rig.run()
    ended_once(result, 19)
    assert (result.outcome[1], result.reason[1]) == (Outcome.HELD, Reason.NOT_ACKNOWLEDGED)
    assert (result.outcome == Outcome.REACHED).sum() == 18


@pytest.mark.parametrize("when_s", [-0.2, 0.2])
def test_a_robot_that_hears_no_general_call_keeps_nobody_else_from_the_end(when_s):
    rig = Rig()
    motion = rig.ready()
    if when_s > 0:
        rig.call("start")
        when_s += rig.session.upload.start_s
    rig.robots.schedule([(3, when_s, Event.CALL_DEAF, 1)])
    if when_s < 0:
        rig.call("start")
    result = rig.run()
    ended_once(result, 19)
    assert result.outcome[3] != Outcome.REACHED
    assert result.reason[3] == Reason.NOT_ACKNOWLEDGED
    assert set(np.delete(result.outcome, 3)) == {Outcome.REACHED}
    assert np.array_equal(np.delete(rig.where(), 3, 0), np.delete(motion.end, 3, 0))


def test_a_bus_that_hears_the_go_late_once_is_told_again():
    quiet = Rig()
    quiet.ready()
    quiet.call("start")
    # the clock of the second bus is held when the GO is on it, and never again
    go_s = quiet.session.upload.go_s
    rig = Rig(faults=Faults(stretches=((12, go_s - 1.1e-4, go_s, 1e-3),)))
    motion = rig.ready()
    rig.call("start")
    assert rig.session.upload.started.all() and rig.session.upload.go_s > go_s + 2e-3
    assert set(rig.run().outcome) == {Outcome.REACHED}
    assert np.array_equal(rig.where(), motion.end)


def test_a_bus_that_hears_the_go_late_does_not_start_and_nobody_is_left_stopped():
    rig = Rig(faults=Faults(stretches=((12, 0.0, np.inf, 1e-3),)))
    motion = rig.ready(theta=np.where(np.arange(19) == 4, 0, 400))
    rig.call("start")
    moves = (np.arange(19) < 10) & (np.arange(19) != 4)
    assert np.array_equal(rig.session.upload.started, moves)
    result = rig.run()
    assert set(result.reason[10:]) == {Reason.NOT_ACKNOWLEDGED}
    assert np.array_equal(rig.where()[moves], motion.end[moves])
    assert np.array_equal(rig.where()[~moves], motion.start[~moves])
    assert set(rig.robots.states(rig.t)[~moves]) == {RobotState.IDLE}


@pytest.mark.parametrize("when_s", [0.0, 0.3])
def test_a_robot_that_stops_by_itself_stops_everybody_at_once(when_s):
    rig = Rig(config=SessionConfig(resumes=0))
    rig.ready()
    rig.call("start")
    at = rig.session.upload.start_s + when_s
    rig.robots.schedule([(3, at, Event.JAM_THETA, 1)])
    result = rig.run()
    assert rig.session.state is SessionState.STOPPED
    ended_once(result, 19)
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, Reason.NOT_ACKNOWLEDGED)
    assert set(np.delete(result.reason, 3)) == {Reason.STOPPED}
    halted = rig.robots.memory["halted_s"]
    assert halted[3] == pytest.approx(at, abs=20e-6)
    assert np.all(halted - at < rig.session.config.watch_s + 1e-3)


@pytest.mark.parametrize("when_s", [0.0, 0.3123, 0.9999])
def test_those_who_had_to_stop_go_on_to_the_very_end_of_their_orders(when_s):
    rig = Rig()
    motion = rig.ready(theta=np.arange(19) * 40 - 360, phi=-30)
    rig.call("start")
    at = rig.session.upload.start_s + when_s
    rig.robots.schedule([(3, at, Event.JAM_THETA, 1)])
    result = rig.run()
    assert rig.session.state is SessionState.IDLE and len(rig.session.uploads) == 2
    ended_once(result, 19)
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, Reason.NOT_ACKNOWLEDGED)
    assert set(np.delete(result.outcome, 3)) == {Outcome.REACHED}
    assert np.array_equal(np.delete(rig.where(), 3, 0), np.delete(motion.end, 3, 0))


def test_what_remains_of_a_motion_keeps_its_instants():
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


def test_robots_nobody_beats_for_stop_themselves():
    rig = Rig()
    rig.ready()
    rig.call("start")
    rig.t = rig.session.upload.start_s + 0.3
    rig.session.advance(rig.t)
    silence_s = 1e-3 * rig.session.config.silence_ms
    assert set(rig.robots.states(rig.t + silence_s + 0.1)) == {RobotState.FAULT}
    assert set(rig.robots.memory["fault"]) == {Fault.SILENCE}
    assert np.ptp(rig.robots.memory["halted_s"]) < 100e-6


def test_a_robot_that_falls_silent_fails_and_holds_its_neighbours_until_found_again():
    rig = Rig()
    rig.ready()
    rig.call("start")
    rig.robots.schedule([(0, rig.session.upload.start_s + 0.3, Event.POWER, 0)])
    result = rig.run()
    ended_once(result, 19)
    assert (result.outcome[0], result.reason[0]) == (Outcome.FAILED, Reason.NOT_ACKNOWLEDGED)
    # nobody knows where it is: who could touch it stays where all stopped, the rest go on
    assert rig.session.state is SessionState.IDLE
    touchy = np.isin(
        np.arange(19), neighbour_pairs(rig.plane)[(neighbour_pairs(rig.plane) == 0).any(axis=1)]
    )
    assert set(result.reason[touchy & (np.arange(19) > 0)]) == {Reason.UNSAFE_AS_LOADED}
    assert set(result.reason[~touchy]) == {Reason.OK}

    rig.session.submit(rig.orders(-400, 0))
    rig.call("start")
    pairs = neighbour_pairs(rig.plane)
    beside = np.setdiff1d(pairs[(pairs == 0).any(axis=1)].ravel(), 0)
    held = np.union1d(beside, [0])
    assert np.array_equal(np.flatnonzero(~rig.session.upload.started), held)
    rig.run()

    rig.robots.power([0], True, rig.t)
    rig.call("configure")
    assert np.array_equal(rig.session.counts, rig.where())
    rig.session.submit(rig.orders(np.where(np.isin(np.arange(19), held), -300, 0), 0))
    rig.call("start")
    assert (rig.run().outcome[held] == Outcome.REACHED).all()


@pytest.mark.parametrize("moving", [True, False])
def test_stop_then_clear(moving):
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


def test_a_frame_that_was_not_meant_for_it_costs_no_robot(monkeypatch):
    rig = Rig(3)
    send = rig.session.link.send

    def astray(rows, *arguments):
        acks = send(rows, *arguments)
        if len(rows) == 3:
            rig.robots.memory["fault"][1] = Fault.BAD_CRC
        return acks

    monkeypatch.setattr(rig.session.link, "send", astray)
    rig.call("configure")
    assert rig.session.known.all()


def test_a_stop_survives_the_bridge():
    rig = Rig(7)
    rig.call("configure")
    rig.call("stop")
    again = Session(rig.plane, rig.units, Safety(), SimulatedBuses(rig.robots), rig.session.angles)
    again.configure(rig.t)
    assert again.state is SessionState.STOPPED


WRONG = [
    ((), "submit", "UNCONFIGURED: configure first"),
    ((), "start", "UNCONFIGURED: configure first"),
    ((), "clear", "UNCONFIGURED: configure first"),
    ((), "home", "UNCONFIGURED: configure first"),
    (("configure",), "start", "IDLE: send orders"),
    (("configure", "submit"), "home", "READY: start, or clear"),
    (("configure", "submit"), "configure", "READY: start, or clear"),
    (("configure", "submit", "start"), "start", "MOVING: wait for the end, or stop"),
    (("configure", "submit", "start"), "submit", "MOVING: wait for the end, or stop"),
    (("configure", "submit", "start"), "home", "MOVING: wait for the end, or stop"),
    (("configure", "submit", "start"), "clear", "MOVING: wait for the end, or stop"),
    (("configure", "submit", "start"), "configure", "MOVING: wait for the end, or stop"),
    (("configure", "stop"), "home", "STOPPED: clear first"),
    (("configure", "stop"), "configure", "STOPPED: clear first"),
]


@pytest.mark.parametrize(("before", "name", "words"), WRONG)
def test_calls_in_the_wrong_state_are_refused_and_change_nothing(before, name, words):
    rig = Rig(3)

    def call(name):
        if name == "submit":
            rig.session.submit(rig.orders(400, 0))
        else:
            rig.call(name)

    for step in before:
        call(step)
    state, now = rig.session.state, rig.session.link.now_s
    with pytest.raises(SessionError) as error:
        call(name)
    assert f"cannot {name} while {words}" in str(error.value)
    assert (rig.session.state, rig.session.link.now_s) == (state, now)


def test_orders_that_do_not_fit_are_refused():
    rig = Rig(3)
    rig.call("configure")
    good = rig.orders(400, 0)
    shifted = WireMotion(rig.units, good.start + [[0], [500], [0]], *_rest(good))
    with pytest.raises(SessionError, match=r"robot 1: orders begin at \["):
        rig.session.submit(shifted)
    with pytest.raises(SessionError, match="orders for 4 robots, not 3"):
        rig.session.submit(WireMotion(rig.units, np.zeros((4, 2)), np.zeros(9), [], []))
    with pytest.raises(SessionError, match="configured for"):
        rig.session.submit(WireMotion(replace(rig.units, tick_us=10), good.start, *_rest(good)))
    with pytest.raises(SessionError, match="targets of shape"):
        rig.session.submit(good, np.zeros((2, 2)))
    assert rig.session.state is SessionState.IDLE


def _rest(motion):
    return motion.offsets, motion.ticks, motion.velocity


def test_every_robot_of_a_plan_has_its_own_reason():
    # 0 moves and is not asked, 1 is asked and has no orders, 2 is disabled, 3 is absent,
    # 4 has too many segments, 5 is asked to be where it is, 6 arrives beside its target
    rig = Rig(8, enabled=np.arange(8) != 2)
    rig.robots.power([3], False, 0.0)
    rig.call("configure")
    velocity = np.zeros((8, 2), dtype=np.int64)
    velocity[[0, 2, 3, 6], 0] = 400
    counts = np.where(velocity != 0, 1, 0)
    counts[4, 0] = 16
    offsets = np.concatenate([[0], np.cumsum(counts.ravel())])
    m = offsets[-1]
    motion = WireMotion(rig.units, rig.session.counts, offsets, np.full(m, 20), np.full(m, 300))
    tips = kinematics.forward(rig.plane, rig.units.to_angles(motion.end))[1]
    targets = tips + np.where(np.arange(8)[:, None] == 5, 0.0, 2.0)
    targets[[0, 7]] = np.nan
    rig.session.submit(motion, targets)
    rig.call("start")
    result = rig.run()
    ended_once(result, 8)
    assert result.reason.tolist() == [
        Reason.NO_TARGET,
        Reason.NOT_PLANNED,
        Reason.DISABLED,
        Reason.NOT_ACKNOWLEDGED,
        Reason.TOO_MANY_SEGMENTS,
        Reason.OK,
        Reason.OFF_TARGET,
        Reason.NO_TARGET,
    ]
    assert set(np.delete(result.outcome, 5)) == {Outcome.HELD}
    assert np.isnan(result.error_mm[[0, 7]]).all() and result.error_mm[6] == pytest.approx(8**0.5)


def test_an_objection_after_the_certificate_drops_all_orders():
    rig = Rig(7)
    motion = rig.ready()
    seen = []

    def object_to_it():
        seen.append(set(rig.robots.states(rig.session.link.now_s)))
        return False

    rig.call("start", object_to_it)
    assert seen == [{RobotState.LOADED}]
    assert set(rig.session.result.reason) == {Reason.STOPPED}
    assert set(rig.robots.states(rig.t)) == {RobotState.IDLE}
    assert np.array_equal(rig.robots.positions(rig.t + 9), motion.start)


def test_a_plan_that_is_replaced_ends():
    rig = Rig(3)
    rig.ready()
    replaced = rig.session.submit(rig.orders(-400, 0))
    ended_once(replaced, 3)
    assert set(replaced.reason) == {Reason.STOPPED}
    assert rig.session.state is SessionState.READY and rig.session.result is None


def test_home_folds_all_and_can_be_called_again():
    # tips of random outstretched arms, those in each other's way come later
    start = np.stack([np.linspace(-3, 3, 19), np.linspace(1.5, 2.5, 19)], axis=1)
    rig = Rig(19, start)
    assert certify(rig.plane, rig.orders(0, 0).decoded(), Safety()).ok
    rig.call("configure")
    for call in range(3):
        rig.call("home")
        may = {Reason.OK, Reason.UNSAFE_AS_LOADED, *([Reason.NO_TARGET] if call else [])}
        assert set(rig.run().reason) <= may
    theta, phi = rig.units.to_angles(rig.where()).T
    assert np.array_equal(theta, rig.units.to_angles(rig.units.to_counts(start[:, 0])))
    short = rig.plane.limits[:, 1, 1] - phi
    assert np.all((0 <= short) & (short < 2 * rig.units.quantum_rad))


def test_a_stranger_at_an_address_is_not_commanded():
    rig = Rig(3)
    rig.robots.memory["serial"][1] = 77
    rig.call("configure")
    assert rig.session.known.tolist() == [True, False, True]
    assert rig.robots.states(rig.t)[1] == RobotState.UNCONFIGURED


def test_the_same_call_puts_the_same_bytes_on_the_buses():
    def traffic():
        rig = Rig()
        rig.robots.power([7], False, 0.0)
        rig.ready(theta=300, phi=-20)
        rig.call("start")
        rig.run()
        parts = [
            (e.frames.to.bus, e.frames.to.address, e.frames.data, e.replies.data, e.replies.end_s)
            for e in rig.session.link.take_traffic()
        ]
        assert rig.session.link.take_traffic() == []
        return b"".join(column.tobytes() for part in parts for column in part)

    assert traffic() == traffic()


def test_go_starts_all_buses_at_one_instant_and_is_sent_once():
    rig = Rig()
    rig.ready()
    rig.session.link.take_traffic()
    rig.call("start")
    calls = [e for e in rig.session.link.take_traffic() if not e.frames.to.address.any()]
    assert len(calls) == 1 and calls[0].frames.to.bus.tolist() == [0, 1]
    assert decode_command(calls[0].frames.payload(0), 0, False) == (Opcode.GO, 1)
    assert len(set(calls[0].replies.start_s)) == 1


def test_the_fresh_sequence_numbers_come_round():
    rig = Rig(3)
    rig.call("configure")
    for turn in range(35):
        rig.session.submit(rig.orders(200 if turn % 2 else -200, 0, ticks=5))
        rig.call("start")
        assert set(rig.run().outcome) == {Outcome.REACHED}


def test_an_unsafe_robot_that_cannot_be_disarmed_does_not_hear_the_go(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    uploader, link = rig.session._uploader, rig.session.link
    certify_loaded, call = uploader._certify, link.call
    held = np.arange(19) == 2

    def unsafe_and_cut_off(loaded):
        rig.robots.powered[2] = False  # only from the bus: it keeps its order
        return certify_loaded(loaded)[0], held

    def heard_again(frames, t):
        rig.robots.powered[2] = True
        return call(frames, t)

    monkeypatch.setattr(uploader, "_certify", unsafe_and_cut_off)
    monkeypatch.setattr(link, "call", heard_again)
    rig.call("start")
    assert rig.robots.states(rig.t)[2] == RobotState.LOADED
    assert np.array_equal(rig.session.upload.started, ~held)
    result = rig.run()
    assert result.reason[2] == Reason.UNSAFE_AS_LOADED
    expected = np.where(held[:, None], motion.start, motion.end)
    assert np.array_equal(rig.where(), expected)


def test_nobody_moves_when_no_sequence_number_is_safe(monkeypatch):
    rig = Rig(7)
    motion = rig.ready()
    uploader = rig.session._uploader
    certify_loaded, rounds = uploader._certify, iter(np.eye(7, dtype=bool))
    monkeypatch.setattr(
        uploader, "_certify", lambda loaded: (certify_loaded(loaded)[0], next(rounds))
    )
    monkeypatch.setattr(uploader, "_disarm", lambda rows, boot, t: np.array([2]))
    rig.call("start")
    ended_once(rig.session.result, 7)
    told = rig.session.result.reason.tolist()
    assert told == [Reason.UNSAFE_AS_LOADED] * 6 + [Reason.STOPPED]
    assert np.array_equal(rig.robots.positions(rig.t + 9), motion.start)

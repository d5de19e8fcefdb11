# SPDX-License-Identifier: Apache-2.0
"""Sessions: the calls allowed in each state, and the result of every robot of a plan."""

from dataclasses import replace

import numpy as np
import pytest
from session_rig import Rig, ended_once

from fiber_bus_bridge import SessionError, SessionState
from fiber_bus_bridge.wire import Fault, RobotState
from fiber_core import kinematics
from fiber_core.clearance import Safety, certify
from fiber_core.outcomes import Outcome, Reason
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion


def test_a_plan_brings_all_robots_to_their_targets():
    rig = Rig()
    motion = rig.ready(theta=np.arange(19) * 40 - 360, phi=-30)
    targets = kinematics.forward(rig.plane, rig.units.to_angles(motion.end))[1]
    rig.session.submit(motion, targets + [[0.03, 0.04]])
    rig.call("start")
    assert rig.session.state is SessionState.MOVING
    assert rig.session.loaded_plan.certificate.ok
    result = rig.run()
    ended_once(result, 19)
    assert set(result.outcome) == {Outcome.REACHED}
    assert result.error_mm == pytest.approx(np.full(19, 0.05), abs=1e-9)
    assert np.array_equal(rig.session.counts, motion.end)
    assert np.array_equal(rig.where(), motion.end)
    assert rig.session.state is SessionState.IDLE


def test_the_encoders_are_read_during_the_motion():
    rig = Rig()
    motion = rig.ready(phi=-30)
    rig.call("start")
    rig.t = rig.session.loaded_plan.start_s + 0.5
    rig.session.advance(rig.t)
    halfway = rig.units.to_angles(rig.session.counts)
    spread = 0.02 * rig.plane.speeds  # reading all robots takes a few ms
    assert np.all(np.abs(halfway - motion.decoded()(0.5)) < spread)
    assert np.all(np.abs(halfway - motion.decoded().start)[:, 0] > spread[:, 0])


def test_a_robot_that_has_arrived_has_no_speed_while_another_moves():
    rig = Rig(n=3)
    session = rig.session
    rig.call("configure")
    session.submit(rig.orders(400, 0, ticks=[250, 250, 1000]))
    rig.call("start")
    for _ in range(15):
        rig.t += 0.1
        rig.call("advance")
    assert session.state is SessionState.MOVING
    assert session.velocities[2, 0] == pytest.approx(400 * rig.units.velocity_rad_s, rel=0.05)
    assert not session.velocities[:2].any()


def test_a_fault_of_a_stray_frame_does_not_exclude_a_robot(monkeypatch):
    rig = Rig(3)
    send = rig.session.transactions.send

    def astray(rows, *arguments):
        acks = send(rows, *arguments)
        if len(rows) == 3:
            rig.robots.memory["fault"][1] = Fault.BAD_CRC
        return acks

    monkeypatch.setattr(rig.session.transactions, "send", astray)
    rig.call("configure")
    assert rig.session.known.all()


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
    state, now = rig.session.state, rig.session.transactions.now_s
    with pytest.raises(SessionError) as error:
        call(name)
    assert f"cannot {name} while {words}" in str(error.value)
    assert (rig.session.state, rig.session.transactions.now_s) == (state, now)


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
    with pytest.raises(SessionError, match="targets have shape"):
        rig.session.submit(good, np.zeros((2, 2)))
    assert rig.session.state is SessionState.IDLE


def _rest(motion):
    return motion.offsets, motion.ticks, motion.velocity


def test_every_robot_of_a_plan_has_its_own_reason():
    # 0 moves and is not asked, 1 is asked and has no orders, 2 is disabled, 3 is absent,
    # 4 has too many segments, 5 is asked to be where it is, 6 arrives off its target
    rig = Rig(8, enabled=np.arange(8) != 2)
    rig.robots.power([3], False, 0.0)
    rig.call("configure")
    rig.session.vouch([3])  # or its neighbours would rest
    velocity = np.zeros((8, 2), dtype=np.int64)
    velocity[[0, 2, 3, 6], 0] = 400
    counts = np.where(velocity != 0, 1, 0)
    counts[4, 0] = 16
    offsets = Parts.from_counts(counts).offsets
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


def test_a_plan_that_is_replaced_ends_as_stopped():
    rig = Rig(3)
    rig.ready()
    replaced = rig.session.submit(rig.orders(-400, 0))
    ended_once(replaced, 3)
    assert set(replaced.reason) == {Reason.STOPPED}
    assert rig.session.state is SessionState.READY and rig.session.result is None


def test_home_folds_all_robots_in_repeated_calls():
    # stretched arms; robots in each other's way fold in later calls
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


def test_a_robot_with_another_serial_number_is_not_commanded():
    rig = Rig(3)
    rig.robots.memory["serial"][1] = 77
    rig.call("configure")
    assert rig.session.known.tolist() == [True, False, True]
    assert rig.robots.states(rig.t)[1] == RobotState.UNCONFIGURED

# SPDX-License-Identifier: Apache-2.0
"""Tests that every bus backend must pass: simulated buses and adapters of the Linux kernel."""

import os
import re
import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kernel_buses import KernelBuses, umockdev

from fiber_bus_bridge import Session, SessionConfig, SessionState, addresses_of, bus_timing
from fiber_bus_bridge.bus import Ack, Recovery
from fiber_bus_bridge.simulation import Faults, LineFault, Positioners, SimulatedBuses
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import (
    STATUS_BYTES,
    Addresses,
    Frames,
    Opcode,
    RobotState,
    decode_status,
    encode_command,
    general_call,
)
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits

pytestmark = pytest.mark.timeout(600)

TO = Addresses([0, 0, 0, 5], [8, 9, 0x77, 300], [False, False, False, True])
WRAPPER = shutil.which("umockdev-wrapper")
INSIDE = "umockdev" in os.environ.get("LD_PRELOAD", "")


@pytest.fixture(params=["linux" if INSIDE else "simulated"])
def backend(request):
    """Function that makes a backend with robots at some addresses and faults.

    Inside umockdev, where a test runs this file a second time, it makes the Linux backend.
    """
    made = []

    def make(to=TO, faults=None, robots=None):
        if robots is None:
            serial = np.arange(len(to)) + 1
            robots = Positioners(to, serial, 1_565_000, np.zeros((len(to), 2)))
        buses = SimulatedBuses(robots, bus_timing("1M"), faults)
        made.append(KernelBuses(buses) if request.param == "linux" else buses)
        return made[-1], robots

    yield make
    for each in made:
        if request.param == "linux":
            each.close()


@pytest.mark.skipif(INSIDE, reason="runs inside umockdev already")
def test_the_linux_backend_passes_these_tests():
    if WRAPPER is None or umockdev() is None:
        pytest.skip("umockdev with its Python bindings is not installed: /dev/i2c-N is not tested")
    pytest.importorskip("smbus2", reason="smbus2 is not installed: /dev/i2c-N is not tested")
    command = [
        WRAPPER,
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-rs",
        "-k",
        "[linux",
        __file__,
    ]
    run = subprocess.run(
        command, capture_output=True, text=True, timeout=500, cwd=Path(__file__).parents[3]
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert re.search(r"\b11 passed, 1 deselected\b", run.stdout), run.stdout


def test_a_stop_is_sent_where_no_thread_can_be_started(backend, monkeypatch):
    buses, robots = backend()
    robots.memory["state"] = RobotState.IDLE

    def refuse(_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    buses.transfer(encode_command(Opcode.STOP, TO), 0, 0.0)
    assert (robots.states(1.0) == RobotState.STOPPED).all()


def test_messages_reach_the_robots_they_are_for(backend):
    buses, robots = backend()
    robots.memory["state"] = RobotState.IDLE
    stop = encode_command(Opcode.STOP, TO[np.array([1, 3])])
    assert buses.transfer(stop, 0, 0.0).ack.tolist() == [Ack.OK] * 2
    states = robots.memory["state"].tolist()
    assert states == [RobotState.IDLE, RobotState.STOPPED] * 2


def test_an_absent_or_refusing_robot_does_not_acknowledge(backend):
    buses, _ = backend()
    absent = Addresses([0, 5], [10, 301], [False, True])
    replies = buses.transfer(encode_command(Opcode.CLEAR, absent), 4, 0.0)
    assert replies.ack.tolist() == [Ack.NO_ADDRESS] * 2
    assert np.array_equal(replies.table(4), np.full((2, 4), 255))
    # the kernel's drivers do not distinguish the two
    wrong = Frames.from_bytes(TO, [b"\x40\x00"] * 4)
    assert set(buses.transfer(wrong, 0, 0.0).ack) <= {Ack.NO_ADDRESS, Ack.REFUSED}


def test_replies_come_from_the_addressed_robots(backend):
    buses, robots = backend()
    robots.memory["position"] = np.arange(8).reshape(4, 2) * 1000 - 3000
    nothing = Frames(TO, np.zeros(5, dtype=int), np.zeros(0, dtype=np.uint8))
    replies = buses.transfer(nothing, STATUS_BYTES, 0.0)
    status = decode_status(TO, replies.table(STATUS_BYTES))
    assert status.ok.all() and np.array_equal(status.position, robots.memory["position"])
    identity = Transactions(buses, TO).identities(np.arange(4), 0.0)
    assert identity.ok.all() and identity.serial.tolist() == [1, 2, 3, 4]


def test_a_general_call_reaches_all_robots(backend):
    buses, robots = backend()
    robots.memory["state"] = RobotState.IDLE
    call = encode_command(Opcode.STOP, general_call([0, 5]))
    assert buses.transfer(call, 0, 0.0).ack.tolist() == [Ack.OK] * 2
    assert set(robots.memory["state"]) == {RobotState.STOPPED}


def test_one_failing_robot_of_a_batch_does_not_hide_the_others(backend):
    to = Addresses(np.zeros(100), np.arange(100) + 8, np.zeros(100, dtype=bool))
    buses, robots = backend(to)
    robots.memory["state"] = RobotState.IDLE
    robots.power([50], False, 0.0)
    ack = buses.transfer(encode_command(Opcode.STOP, to), 0, 0.0).ack
    assert ack[50] == Ack.NO_ADDRESS and set(np.delete(ack, 50)) == {Ack.OK}
    assert set(np.delete(robots.memory["state"], 50)) == {RobotState.STOPPED}
    if hasattr(buses, "calls"):
        assert max(buses.calls) == 42 and buses.calls.count(1) == 42


def test_a_go_is_never_sent_twice(backend):
    buses, robots = backend()
    robots.power(np.arange(4), False, 0.0)
    frames = [encode_command(Opcode.CLEAR, TO[:1]), encode_command(Opcode.GO, TO[:1], 3)]
    both = Frames.from_bytes(TO[np.array([0, 0])], [f.payload(0) for f in frames])
    assert buses.transfer(both, 0, 0.0).ack.tolist() == [Ack.NO_ADDRESS] * 2
    if hasattr(buses, "calls"):
        assert buses.calls == [1, 1]


@pytest.mark.parametrize(
    ("line", "acks"),
    [
        (LineFault.SDA_LOW, [Ack.STUCK, Ack.NOT_SENT, Ack.NOT_SENT, Ack.OK]),
        (LineFault.SCL_LOW, [Ack.TIMED_OUT, Ack.NOT_SENT, Ack.NOT_SENT, Ack.OK]),
        (LineFault.BABBLE, [Ack.LOST, Ack.LOST, Ack.LOST, Ack.OK]),
    ],
)
def test_line_faults_are_distinguished_and_affect_only_their_bus(backend, line, acks):
    buses, _ = backend(faults=Faults(lines=((line, 0, 0.0, np.inf, Recovery.NOTHING),)))
    assert buses.transfer(encode_command(Opcode.CLEAR, TO), 0, 0.0).ack.tolist() == acks


def test_a_plan_is_carried_out(backend):
    rows = np.arange(19)
    plane = replace(preset("desi", 19), bus=rows // 10, address=8 + rows % 10)
    units = WireUnits.for_plane(plane)
    start = units.to_counts(np.stack([np.linspace(-1, 1, 19), np.full(19, 2.6)], axis=1))
    to = addresses_of(plane)
    buses, robots = backend(to, robots=Positioners(to, plane.ids, units.quantum_prad, start))
    # the mock kernel serves one bus after the other, so the GO is late on the second bus
    safety, unhurried = Safety(start_skew_s=2e-3), SessionConfig(stretch_s=np.inf)
    session = Session(plane, units, safety, buses, units.to_angles(start), unhurried)
    t = session.configure(0.0)
    assert session.known.all()
    offsets = np.repeat(np.arange(20), 2)[1:]
    motion = WireMotion(units, start, offsets, np.full(19, 60), np.full(19, 400))
    session.submit(motion)
    t = session.start(t)
    for _ in range(20):
        if session.state is not SessionState.MOVING:
            break
        t = session.advance(t + 0.1)
    assert session.loaded_plan.started.all() and set(session.result.outcome) == {Outcome.REACHED}
    assert np.array_equal(session.counts, motion.end)

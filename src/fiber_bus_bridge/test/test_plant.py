# SPDX-License-Identifier: Apache-2.0
"""The plant as a process of its own: the same bytes, a time of its own, and its true motion."""

import os
import signal
import socket
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from plant_rig import (
    LONG_S,
    PLANE,
    START,
    UNITS,
    FakeTime,
    begin,
    finish,
    served,
    session_on,
    turning,
)
from rclpy.context import Context
from rclpy.parameter import Parameter

from fiber_bus_bridge import SessionState, addresses_of, bus_timing
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.node import BridgeNode, hardware
from fiber_bus_bridge.plant import PlantBuses, PlantTruth, plant_socket, touching
from fiber_bus_bridge.plant.memory_file import MemoryFile
from fiber_bus_bridge.plant.messages import REQUESTS, Kind, PlantError, Unpacker, pack
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.simulation import Mechanics, SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import (
    Addresses,
    Fault,
    Opcode,
    RobotState,
    encode_command,
    general_call,
)
from fiber_core.clearance import certify
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome
from fiber_core.wire_units import WireMotion

pytestmark = pytest.mark.timeout(300)

FAULTS = "noise,stall,busy,arbitration,brown_out,scl_stuck"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "plant.sock"


def wait_for(condition):
    """Let the thread of the plant work until a condition holds."""
    until_s = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < until_s, "the condition did not come to hold"
        time.sleep(1e-3)


def traffic(tap):
    """All that went over the buses, as bytes, with its times."""
    return [
        [
            part.tobytes()
            for part in (
                each.frames.to.bus, each.frames.to.address, each.frames.to.ten_bit,
                each.frames.offsets, each.frames.data, each.replies.ack, each.replies.start_s,
                each.replies.end_s, each.replies.offsets, each.replies.data,
            )
        ]
        for each in tap.exchanges
    ]  # fmt: skip


@pytest.mark.parametrize("faults", ["", FAULTS])
@pytest.mark.parametrize("seed", [1, 2])
def test_traffic_is_the_same_to_the_byte_with_and_without_a_process(path, faults, seed):
    config = SimulationConfig(seed=seed, faults=faults, faults_from_s=0.0, faults_until_s=0.6)
    session, here = session_on(simulated_buses(PLANE, UNITS, START, config))
    t = finish(session, begin(session))
    with served(path, config) as plant:
        other, there = session_on(plant.connect())
        assert finish(other, begin(other)) == t
    assert len(here.exchanges) > 100
    assert traffic(here) == traffic(there)
    assert np.array_equal(session.counts, other.counts)


def end(*_):
    """A bridge that ends between VERIFY and GO."""
    raise KeyboardInterrupt


def without_care(plane, motion, safety):
    """A certifier that takes every motion for safe, as if the robots rested."""
    rest = SegmentMotion(motion.start, np.zeros(2 * plane.n + 1, dtype=int), [], [])
    return motion, np.zeros(plane.n, dtype=bool), certify(plane, rest, safety)


def moving(plant, **motion):
    """A session whose robots have moved for 0.1 s."""
    session, _ = session_on(plant.connect())
    t = begin(session, **motion)
    session.advance(t + 0.1)
    assert plant.plant.moving == PLANE.n
    return session


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_robots_stop_by_their_watchdogs_when_the_bridge_is_gone(path, scale):
    clock = FakeTime()
    with served(path, clock=clock, time_scale=scale, patience_s=1e6) as plant:
        session = moving(plant, ticks=1000)
        end = session.loaded_plan.motion.end
        gone_s = plant.plant.now_s
        session.transactions.backend.buses.close()
        if scale:
            wait_for(lambda: not plant.plant.connected)
            assert plant.plant.moving == PLANE.n, "the machine's time has not gone on"
            clock.now_s += 0.004
            wait_for(lambda: plant.plant.now_s > gone_s)
            assert plant.plant.moving == PLANE.n, "4 ms are less than the watchdog"
            clock.now_s += 1.0
        memory = plant.buses.positioners.memory
        wait_for(lambda: not plant.plant.moving)
        assert set(memory["state"]) == {RobotState.FAULT}
        assert set(memory["fault"]) == {Fault.SILENCE}
        assert (memory["halted_s"] < gone_s + 0.006).all()
        assert (memory["position"][:, 0] != end[:, 0]).all()


@pytest.mark.parametrize("scale", [0.0, 0.5])
def test_robots_stop_when_a_connected_bridge_is_silent_for_longer_than_the_patience(path, scale):
    clock = FakeTime()
    with served(path, clock=clock, time_scale=scale, patience_s=2.0) as plant:
        session = moving(plant, ticks=1000)
        silent_s = plant.plant.now_s
        clock.now_s += 1.9
        with PlantTruth(path) as truth:
            truth.since()  # the plant has looked at its clock
            assert plant.plant.now_s == silent_s and plant.plant.moving == PLANE.n
            clock.now_s += 0.6
            wait_for(lambda: not plant.plant.moving)
        assert plant.plant.now_s >= silent_s + (2.5 * scale if scale else 0.0)
        # the bridge that wakes up finds its robots stopped, and starts them again
        finish(session, silent_s)
        assert set(session.result.outcome) == {Outcome.REACHED}
        assert len(session.loaded_plans) == 2


def test_orders_that_wait_lapse_when_the_bridge_is_gone(path):
    with served(path, time_scale=0.0) as plant:
        session, _ = session_on(plant.connect(), certify=end)
        t = session.configure(0.0)
        session.submit(turning(session))
        with pytest.raises(KeyboardInterrupt):
            session.start(t)
        assert plant.plant.waiting == PLANE.n
        session.transactions.backend.buses.close()
        wait_for(lambda: not plant.plant.connected and not plant.plant.waiting)
        memory = plant.buses.positioners.memory
        assert set(memory["fault"]) == {Fault.WATCHDOG}


def test_the_next_bridge_finds_robots_where_they_are_with_their_numbers(path):
    with served(path, time_scale=0.0) as plant:
        session = moving(plant, ticks=1000)
        session.transactions.backend.buses.close()
        wait_for(lambda: not plant.plant.connected and not plant.plant.moving)
        memory = plant.buses.positioners.memory.copy()
        later, _ = session_on(plant.connect())
        t = later.configure(0.0)
        assert t > plant.plant.truth.since()[2].ended_s.max()
        assert np.array_equal(later.counts, memory["position"])
        assert (later.counts != UNITS.to_counts(START)).any(axis=1).all()
        assert np.array_equal(later.robots["boot"], memory["boot"])
        # their watchdogs stopped them, so no operator has to clear
        assert set(memory["fault"]) == {Fault.SILENCE} and later.state is SessionState.IDLE
        finish(later, begin(later, t))
        assert set(later.result.outcome) == {Outcome.REACHED}


def test_a_second_bridge_is_refused_by_name_and_may_come_when_the_first_has_left(path):
    with served(path) as plant:
        first = plant.connect()
        with pytest.raises(PlantError, match=f"in use by a bridge, process {os.getpid()}"):
            plant.connect(pause=lambda _: None)
        assert first.alert_lines(0.0).size == 0
        first.close()
        assert plant.connect().alert_lines(0.0).size == 0


def test_a_bridge_with_another_plane_or_clock_is_refused_with_the_value(path):
    to = addresses_of(PLANE)
    moved = Addresses(to.bus, np.where(np.arange(PLANE.n) == 4, 999, to.address), to.ten_bit)
    with served(path) as plant:
        for ids, there, clock, match in (
            (PLANE.ids[:5], to[:5], "1M", "bridge has 5 robots, this plant 19"),
            (PLANE.ids, moved, "1M", f"robot {PLANE.ids[4]} has address {to.address[4]}.* 999"),
            (PLANE.ids, to, "400k", "1e.06 Hz in this plant, 400000 Hz"),
        ):
            with pytest.raises(PlantError, match=match):
                PlantBuses(path, ids, there, bus_timing(clock))
        assert not plant.plant.connected


def test_without_a_plant_no_robot_answers_and_the_next_plant_is_found(path):
    clock = FakeTime()
    with served(path) as plant:
        buses = plant.connect(answer_s=2.0, clock=clock)
        session, _ = session_on(buses)
        t = session.configure(0.0)
        assert session.known.all()
    t = session.configure(t)
    assert not session.known.any()
    with served(path):
        t = session.configure(t)
        assert not session.known.any(), "the bridge looks for a plant twice a second"
        clock.now_s += 0.5
        session.configure(t)
        assert session.known.all()


def test_a_paused_plant_keeps_the_bridge_no_longer_than_two_answers(path):
    with served(path) as plant:
        session, tap = session_on(plant.connect(answer_s=0.2, clock=FakeTime()))
        plant._ended.set()
        plant._thread.join(LONG_S)
        begin_s = time.monotonic()
        session.configure(0.0)
        assert len(tap.exchanges) >= 3 and not session.known.any()
        assert time.monotonic() < begin_s + 1.5


def test_a_request_that_its_bridge_left_behind_is_not_carried_out(path):
    with served(path) as plant:
        buses = plant.connect()
        plant._ended.set()
        plant._thread.join(LONG_S)  # the plant is paused
        state = plant.buses.positioners.memory.copy()
        to = addresses_of(PLANE)
        stop = pack(
            REQUESTS, Kind.TRANSFER, bus=to.bus, address=to.address, ten_bit=to.ten_bit,
            offsets=np.arange(PLANE.n + 1), data=np.full(PLANE.n, 0x30), read_bytes=0,
            not_before_s=0.0,
        )  # fmt: skip
        buses._link._socket.sendall(stop)
        buses.close()
        while plant.plant.connected:
            plant.server.step(0.1)
        assert np.array_equal(plant.buses.positioners.memory, state)


def test_the_truth_is_the_true_motion_and_is_read_without_effect(path):
    with served(path) as plant:
        session, _ = session_on(plant.connect())
        t = begin(session)
        with PlantTruth(path) as reader:
            session.advance(t + 0.1)
            on_the_way = reader.since()
            assert np.isnan(on_the_way.moves.ended_s).all() and len(on_the_way.moves.row) == 19
            t = finish(session, t)
            found = reader.since(on_the_way.next)
            assert found.first == 19 and len(found.moves.row) == 0
            found = reader.since()
        assert found.verified.all() and set(found.controller) == {1}
        assert np.array_equal(found.position, session.counts)
        motion = found.motion()
        assert np.allclose(motion.end, session.angles, atol=UNITS.quantum_rad)
        assert np.allclose(motion.start, UNITS.to_angles(UNITS.to_counts(START)))
        assert not touching(PLANE, found).unsafe.any()
    assert set(session.result.outcome) == {Outcome.REACHED}


def test_a_reader_of_the_truth_finds_the_plant_that_began_anew(path):
    with served(path):
        reader = PlantTruth(path, wait_s=5.0)
    with reader:
        with served(path):
            assert len(reader.since().moves.row) == 0
        reader._wait_s = 0.1
        with pytest.raises(PlantError, match="no plant at"):
            reader.since()


def test_arms_that_touch_are_found_in_the_truth(path):
    with served(path) as plant:
        session, _ = session_on(plant.connect(), certify=without_care)
        session.configure(0.0)
        # every arm is stretched, every second one turns around
        turns = np.where(np.arange(PLANE.n) % 2, 3000, 0)
        velocity = np.stack([turns, np.full(PLANE.n, -2000)], axis=1).ravel()
        offsets, ticks = np.arange(2 * PLANE.n + 1), np.full(2 * PLANE.n, 600)
        session.submit(WireMotion(UNITS, session.counts, offsets, ticks, velocity))
        finish(session, session.start(1.0))
        with PlantTruth(path) as reader:
            truth = reader.since()
        found = touching(PLANE, truth)
        assert found.unsafe.any() and found.min_gap_mm < 0
        # contacts are those of the true arms: these are stuck, whatever their counters read
        stuck = Mechanics.ideal(PLANE.n).with_(stuck_from=np.zeros((PLANE.n, 2)))
        assert not touching(PLANE, truth, stuck).unsafe.any()
        assert touching(PLANE, truth, Mechanics.ideal(PLANE.n)).min_gap_mm == found.min_gap_mm
        with pytest.raises(PlantError, match="before movement 7: ask from 0 on"):
            truth._replace(first=7).motion(stuck)


def test_orders_of_a_dead_bridge_or_never_read_back_count_as_unverified(path):
    with served(path, time_scale=1e-6, patience_s=1e6) as plant:
        session, _ = session_on(plant.connect(), certify=end)
        t = session.configure(0.0)
        session.submit(turning(session))
        with pytest.raises(KeyboardInterrupt):
            session.start(t)
        session.transactions.backend.buses.close()
        wait_for(lambda: not plant.plant.connected)
        other, _ = session_on(plant.connect())
        # the GO of the next bridge, under the sequence number of the dead one
        buses = other.transactions.buses
        sequence = int(plant.buses.positioners.memory["sequence"][0])
        frames = encode_command(Opcode.GO, general_call(buses), sequence, 100)
        other.transactions.transfer(frames, 0, 0.0)
        with PlantTruth(path) as reader:
            found = reader.since()
        assert len(found.moves.row) == PLANE.n
        assert set(found.controller) == {2} and not found.verified.any()


def test_old_movements_are_forgotten_and_the_motion_still_begins_where_it_did():
    buses = simulated_buses(PLANE, UNITS, START, SimulationConfig())
    plant = Plant(buses, UNITS.quantum_rad, kept=1)

    class Direct:
        def transfer(self, frames, read, before):
            read = np.broadcast_to(np.asarray(read), (len(frames),))
            return plant.transfer(frames, read, before, 0.0)

        def recover(self, bus, recovery, t):
            return buses.recover(bus, recovery, t)

        def alert_lines(self, t):
            return buses.alert_lines(t)

    session, _ = session_on(Direct())
    t = session.configure(0.0)
    for k in range(6):
        before = session.counts.copy()
        session.submit(turning(session, speed=400 * (-1) ** k))
        t = finish(session, session.start(t))
    assert plant.truth.count == 6 * PLANE.n and plant.truth.forgotten >= 2 * PLANE.n
    first, start, moves, controller, verified = plant.true_movements(5 * PLANE.n)
    assert first == 5 * PLANE.n and np.array_equal(start, before)
    assert np.array_equal(moves.motion(start, UNITS.quantum_rad, t).end.shape, (PLANE.n, 2))
    assert len(controller) == PLANE.n and verified.all()


def test_a_plant_that_was_killed_leaves_its_robots_where_they_were(path, tmp_path):
    """As after a kill, the second plant has nothing of the first but the file."""
    memory_path = tmp_path / "robots"
    buses = simulated_buses(PLANE, UNITS, START, SimulationConfig())
    kept = MemoryFile(memory_path, buses)
    assert not kept.taken_over
    session, _ = session_on(buses)
    t = session.configure(0.0)
    # some have arrived when the others still move
    motion = turning(session, ticks=np.where(np.arange(PLANE.n) % 3 == 0, 20, 1000))
    session.submit(motion)
    session.advance(session.start(t) + 0.3)
    states = buses.positioners.memory["state"]
    assert set(states) == {RobotState.MOVING, RobotState.DONE}
    kept.keep_time()
    kept._head["now_s"] -= 1e-3  # killed before it wrote the time of the last heartbeat
    where = buses.positioners.positions(buses.now_s)  # hardly before the cut
    copy = tmp_path / "copy"
    copy.write_bytes(memory_path.read_bytes())

    buses = simulated_buses(PLANE, UNITS, START, SimulationConfig())
    later = MemoryFile(copy, buses)
    assert later.taken_over
    plant = Plant(buses, UNITS.quantum_rad)
    later.power_cut()
    plant.run_on(0.0)
    memory = buses.positioners.memory
    assert np.allclose(memory["position"], where, atol=400)
    assert set(memory["boot"]) == {2} and set(memory["state"]) == {RobotState.UNCONFIGURED}
    plant.truth.observe()
    _, start, moves = plant.truth.since()
    where = memory["position"]
    assert sorted(moves.row) == list(range(PLANE.n))
    assert np.array_equal(start, motion.start)
    end = moves.motion(start, UNITS.quantum_rad, buses.now_s).end
    assert np.allclose(end, UNITS.to_angles(where), atol=2 * UNITS.quantum_rad)
    session, _ = session_on(buses)
    finish(session, begin(session, 0.0))
    assert set(session.result.outcome) == {Outcome.REACHED}
    with pytest.raises(PlantError, match="cannot be used"):
        MemoryFile(copy, simulated_buses(PLANE, UNITS, START, SimulationConfig()))


def test_another_plane_does_not_take_over_the_file(tmp_path):
    MemoryFile(tmp_path / "robots", simulated_buses(PLANE, UNITS, START, SimulationConfig()))
    data = (tmp_path / "robots").read_bytes()
    (tmp_path / "other").write_bytes(b"x" + data[1:])
    buses = simulated_buses(PLANE, UNITS, START, SimulationConfig())
    kept = MemoryFile(tmp_path / "other", buses)
    assert not kept.taken_over
    assert np.array_equal(buses.positioners.memory["position"], UNITS.to_counts(START))


def test_only_the_owner_can_reach_the_socket_and_one_plant_serves_it(path):
    with served(path):
        assert path.stat().st_mode & 0o777 == 0o600
        with pytest.raises(PlantError, match="another plant serves"), served(path):
            pass
    with served(path):  # the file of an ended plant is in the way of no other
        pass


def test_the_default_path_is_in_a_folder_of_this_user_and_names_domain_and_plane(
    tmp_path, monkeypatch
):
    monkeypatch.delenv("FIBER_PLANT", raising=False)
    monkeypatch.setenv("ROS_DOMAIN_ID", "17")
    tmp_path.chmod(0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert plant_socket() == tmp_path / "fiber-plant-17.sock"
    assert plant_socket("/north/a") == tmp_path / "fiber-plant-17-north.a.sock"
    tmp_path.chmod(0o755)
    with pytest.raises(PlantError, match="not readable by this user alone"):
        plant_socket()
    monkeypatch.setenv("FIBER_PLANT", "/x/y.sock")
    assert str(plant_socket()) == "/x/y.sock"
    with (
        pytest.raises(PlantError, match="bytes, a socket has at most 107"),
        served(tmp_path / ("long" * 30)),
    ):
        pass


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        struct.pack("<4sHH", b"FPL1", 77, 1) + bytes(4),
        struct.pack("<4sHHI", b"FPL1", Kind.ALERTS, 1, 2**32 - 1),
        struct.pack("<4sHHI", b"FPL1", Kind.ALERTS, 1, 3) + b"abc",
        pack(REQUESTS, Kind.ALERTS, t=0.0),
        pack(REQUESTS, Kind.ALERTS, t=[]),
        pack(REQUESTS, Kind.OPEN, ids=[], bus=[], address=[], ten_bit=[], clock_hz=[]),
        pack(
            REQUESTS, Kind.TRANSFER, bus=[0], address=[5000], ten_bit=[0], offsets=[0, 9],
            data=[1], read_bytes=-1, not_before_s=np.nan,
        ),
    ],
)  # fmt: skip
def test_no_message_of_a_stranger_ends_the_plant(path, data):
    with served(path) as plant:
        session, _ = session_on(plant.connect())
        with socket.socket(socket.AF_UNIX) as stranger:
            stranger.connect(str(path))
            stranger.settimeout(LONG_S)
            stranger.sendall(data)
            answer = stranger.recv(1000)
            assert answer == b"" or b"FPL1" in answer
        session.configure(0.0)
        assert session.known.all()


def test_every_message_survives_the_way_in_any_pieces():
    rng = np.random.default_rng(0)
    unpacker = Unpacker(REQUESTS)
    sent = [pack(REQUESTS, Kind.RECOVER, bus=k, recovery=1, t=0.5 * k) for k in range(20)]
    stream, got = b"".join(sent), []
    while stream:
        size = int(rng.integers(1, 60))
        unpacker.feed(stream[:size])
        stream = stream[size:]
        while (message := unpacker.take()) is not None:
            got.append(message)
    assert [int(columns["bus"][0]) for _, columns in got] == list(range(20))
    assert [float(columns["t"][0]) for _, columns in got] == [0.5 * k for k in range(20)]


@pytest.mark.parametrize(
    ("parameters", "match"),
    [
        ({"faults": "stall"}, "faults is 'stall': give it to the plant at"),
        ({"clock_ppm": 1.0}, "clock_ppm is 1.0: give it to the plant at"),
        ({"robots": 7}, "no plant at .*: "),
        ({"robots": 7, "devices": ["/dev/i2c-0"]}, "choose one"),
    ],
)
def test_a_bridge_without_its_plant_or_with_the_plants_parameters_does_not_start(
    path, parameters, match, monkeypatch, new_domain
):
    monkeypatch.setattr(hardware, "_PLANT_S", 0.1)
    monkeypatch.setattr(hardware, "rehearse", lambda: None)
    context = Context()
    rclpy.init(context=context, domain_id=new_domain())
    try:
        given = {"plant": str(path)} | parameters
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        with pytest.raises(BridgeError, match=match):
            BridgeNode(context=context, parameter_overrides=overrides)
    finally:
        context.try_shutdown()


@pytest.fixture
def plant_process(path, tmp_path):
    """Function that starts the executable; each process is ended with the test."""
    started = []

    def start(*options):
        log = tmp_path / f"plant_{len(started)}.log"
        command = [sys.executable, "-m", "fiber_bus_bridge.plant.main", f"--socket={path}"]
        with open(log, "wb") as file:
            process = subprocess.Popen([*command, *options], stdout=file, stderr=file)
        started.append(process)
        return process, log

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_the_executable_serves_logs_and_ends_well(plant_process, path, how):
    process, log = plant_process("--robots=7", "--faults=stall", "--time-scale=0")
    with PlantTruth(path, wait_s=LONG_S) as reader:
        assert len(reader.since().position) == 7
    second, second_log = plant_process("--robots=7")
    assert second.wait(LONG_S) == 2
    assert f"another plant serves {path}" in second_log.read_text()
    process.send_signal(how)
    assert process.wait(LONG_S) == 0
    assert "7 robots on 1 buses" in log.read_text()
    assert not path.exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--faults=fire"], "fault 'fire': expected one of"),
        (["--clock=2M"], "bus mode '2M' does not exist"),
        (["--robots=-3"], "robots"),
        (["--time-scale=-1"], "time_scale"),
        (["--problem=missing.npz"], "missing.npz"),
    ],
)
def test_the_executable_refuses_what_it_cannot_do_with_the_value(plant_process, options, said):
    process, log = plant_process("--preset=desi", *options)
    assert process.wait(LONG_S) == 2
    assert said in log.read_text() and "Traceback" not in log.read_text()

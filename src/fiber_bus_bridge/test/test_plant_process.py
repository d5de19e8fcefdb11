# SPDX-License-Identifier: Apache-2.0
"""The plant as a file, a socket and an executable."""

import signal
import socket
import struct
import subprocess
import sys

import numpy as np
import pytest
import rclpy
from plant_rig import (
    LONG_S,
    PLANE,
    START,
    UNITS,
    begin,
    finish,
    served,
    session_on,
    turning,
)
from rclpy.context import Context
from rclpy.parameter import Parameter

from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.node import BridgeNode, hardware
from fiber_bus_bridge.plant import PlantTruth, plant_socket
from fiber_bus_bridge.plant.memory_file import MemoryFile
from fiber_bus_bridge.plant.messages import REQUESTS, Kind, PlantError, Unpacker, pack
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import (
    RobotState,
)
from fiber_core.outcomes import Outcome


@pytest.fixture
def path(tmp_path):
    return tmp_path / "plant.sock"


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

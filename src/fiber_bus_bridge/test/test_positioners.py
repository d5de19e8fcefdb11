# SPDX-License-Identifier: Apache-2.0
"""Simulated positioners: accepted and refused frames, states, and final positions."""

import numpy as np
import pytest

from fiber_bus_bridge import WireError
from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_bus_bridge.wire import (
    STATUS_BYTES,
    Addresses,
    Alert,
    Configuration,
    Fault,
    Frames,
    Opcode,
    RobotState,
    decode_identity,
    decode_status,
    encode_command,
    encode_config,
    encode_load,
    general_call,
)
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

UNITS = WireUnits()
LIMITS = [[-2_000_000, 2_000_000], [0, 2_000_000]]
SPEED = [8000, 6000]


class Bench:
    """A few robots on one bus and a controller that keeps its own time."""

    def __init__(self, n=1, start=(0, 1_000_000), watchdog_ms=0, **clocks):
        self.to = Addresses([0] * n, np.arange(n) + 8, [False] * n)
        start = np.broadcast_to(start, (n, 2))
        self.robots = Positioners(self.to, np.arange(n) + 100, UNITS.quantum_prad, start, **clocks)
        self.buses = SimulatedBuses(self.robots)
        self.watchdog_ms = watchdog_ms
        self.t = 0.0

    def send(self, frames):
        replies = self.buses.transfer(frames, 0, self.t)
        self.t = float(replies.end_s.max())
        return replies.ack.tolist()

    def configure(self, units=UNITS):
        n = len(self.to)
        limits, speed = np.broadcast_to(LIMITS, (n, 2, 2)), np.broadcast_to(SPEED, (n, 2))
        return self.send(
            encode_config(Configuration(units, limits, speed, self.watchdog_ms), self.to)
        )

    def load(self, sequence=1, theta=((250, 1000),), phi=((100, -500),)):
        segments = np.array([*theta, *phi]).reshape(-1, 2)
        offsets = [0, len(theta), len(theta) + len(phi)]
        orders = WireMotion.from_zero(UNITS, offsets, *segments.T)
        return self.send(encode_load(self.to[:1], sequence, orders))

    def go(self, sequence=1):
        return self.send(encode_command(Opcode.GO, general_call([0]), sequence))

    def command(self, opcode):
        return self.send(encode_command(opcode, self.to))

    def status(self, t=None):
        self.t = self.t if t is None else t
        empty = Frames.equal_length(self.to, np.zeros((len(self.to), 0)))
        replies = self.buses.transfer(empty, STATUS_BYTES, self.t)
        self.t = float(replies.end_s.max())
        status = decode_status(self.to, replies.table(STATUS_BYTES))
        assert status.ok.all()
        return status


def random_motion(rng, n):
    """Orders of up to 15 segments that stay inside the limits and speeds of the bench."""
    counts = rng.integers(0, 16, 2 * n)
    offsets = Parts.from_counts(counts).offsets
    ticks = rng.integers(1, 120, offsets[-1])
    # 15 segments of 120 ticks and 500 quanta remain within 900 000 quanta of the start
    return WireMotion(
        UNITS, np.tile([0, 1_000_000], (n, 1)), offsets, ticks, rng.integers(-500, 501, offsets[-1])
    )


def test_encoders_end_exactly_and_follow_the_motion_in_between():
    rng = np.random.default_rng(3)
    n = 60
    motion = random_motion(rng, n)
    bench = Bench(n)
    assert bench.configure() == [Ack.OK] * n
    orders = encode_load(bench.to, 4, motion)
    assert bench.send(orders) == [Ack.OK] * n
    bench.go(4)
    begun, decoded = bench.t, motion.decoded()
    for t in np.sort(rng.uniform(0, decoded.makespan_s, 50)):
        off = bench.robots.positions(begun + t) * UNITS.quantum_rad - decoded(t)
        assert np.abs(off).max() <= 0.51 * UNITS.quantum_rad
    assert np.array_equal(bench.robots.positions(begun + decoded.makespan_s + 1e-6), motion.end)
    status = bench.status(begun + decoded.makespan_s + 1)
    assert np.array_equal(status.position, motion.end)
    assert set(status.state) == {RobotState.DONE}


def test_clocks_and_skew_shift_the_motion():
    bench = Bench(3, clock_ppm=[0, 10_000, 0], start_skew_s=[0, 0, 0.05])
    bench.configure()
    motion = WireMotion.from_zero(UNITS, [0, 1, 1, 2, 2, 3, 3], [1000] * 3, [1000] * 3)
    bench.send(encode_load(bench.to, 1, motion))
    bench.go()
    theta = bench.robots.positions(bench.t + 2.0)[:, 0]
    assert theta.tolist() == [500_000, 505_000, 487_500]
    states = bench.robots.states(bench.t + 1000 * UNITS.tick_s / 1.01 + 1e-6)
    assert states.tolist() == [RobotState.MOVING, RobotState.DONE, RobotState.MOVING]
    assert bench.robots.positions(bench.t + 9)[:, 0].tolist() == [1_000_000] * 3


def test_a_stop_halts_a_robot_at_the_position_where_it_is_received():
    bench = Bench()
    bench.configure()
    bench.load(theta=((250, 1000),), phi=((100, -500), (100, 0), (100, 500)))
    bench.go()
    begun, bench.t = bench.t, bench.t + 0.5
    bench.command(Opcode.STOP)
    run = (bench.t - begun) / UNITS.tick_s
    expected = [round(1000 * run), 1_000_000 - 50_000]
    assert 100 < run < 200
    status = bench.status(bench.t + 10)
    assert status.position[0].tolist() == expected
    assert status.state[0] == RobotState.STOPPED
    assert bench.load(2) == [Ack.REFUSED] and bench.go(2) == [Ack.OK]
    assert bench.status(bench.t + 10).position[0].tolist() == expected


CONFIGURE = ("configure",)
LOAD, GO = ("load", 1), ("go", 1)
STOP, CLEAR = ("command", Opcode.STOP), ("command", Opcode.CLEAR)
RESET = ("command", Opcode.RESET)
WAIT = ("wait",)
OVERWRITE = ("load", 1, (), ())

# frames to a robot, whether it accepts the last of them, its state and fault afterwards
STORIES = [
    ((), True, RobotState.UNCONFIGURED, Fault.NONE),
    ((LOAD,), False, RobotState.UNCONFIGURED, Fault.NOT_CONFIGURED),
    ((STOP,), True, RobotState.UNCONFIGURED, Fault.NONE),
    ((CONFIGURE,), True, RobotState.IDLE, Fault.NONE),
    ((CONFIGURE, GO), True, RobotState.IDLE, Fault.NONE),
    ((CONFIGURE, LOAD), True, RobotState.LOADED, Fault.NONE),
    ((CONFIGURE, LOAD, LOAD), True, RobotState.LOADED, Fault.NONE),
    ((CONFIGURE, LOAD, ("load", 2)), True, RobotState.LOADED, Fault.NONE),
    ((CONFIGURE, LOAD, CONFIGURE), True, RobotState.IDLE, Fault.NONE),
    ((CONFIGURE, LOAD, CLEAR), True, RobotState.IDLE, Fault.NONE),
    ((CONFIGURE, LOAD, CLEAR, GO), True, RobotState.IDLE, Fault.NONE),
    ((CONFIGURE, LOAD, ("go", 2)), True, RobotState.LOADED, Fault.NONE),
    ((CONFIGURE, LOAD, STOP), True, RobotState.STOPPED, Fault.NONE),
    ((CONFIGURE, LOAD, GO), True, RobotState.MOVING, Fault.NONE),
    ((CONFIGURE, LOAD, GO, GO), True, RobotState.MOVING, Fault.NONE),
    ((CONFIGURE, LOAD, GO, ("load", 2)), False, RobotState.MOVING, Fault.WRONG_STATE),
    ((CONFIGURE, LOAD, GO, CONFIGURE), False, RobotState.MOVING, Fault.WRONG_STATE),
    ((CONFIGURE, LOAD, GO, CLEAR), False, RobotState.MOVING, Fault.WRONG_STATE),
    ((CONFIGURE, LOAD, GO, RESET), True, RobotState.UNCONFIGURED, Fault.NONE),
    ((CONFIGURE, LOAD, GO, STOP), True, RobotState.STOPPED, Fault.NONE),
    ((CONFIGURE, LOAD, GO, STOP, CONFIGURE), True, RobotState.STOPPED, Fault.NONE),
    ((CONFIGURE, LOAD, GO, STOP, LOAD), False, RobotState.STOPPED, Fault.WRONG_STATE),
    ((CONFIGURE, LOAD, GO, STOP, CLEAR), True, RobotState.IDLE, Fault.NONE),
    ((CONFIGURE, LOAD, GO, WAIT), True, RobotState.DONE, Fault.NONE),
    ((CONFIGURE, LOAD, GO, WAIT, GO), True, RobotState.DONE, Fault.NONE),
    ((CONFIGURE, LOAD, GO, WAIT, LOAD), False, RobotState.DONE, Fault.STALE_SEQUENCE),
    ((CONFIGURE, LOAD, GO, WAIT, CLEAR, LOAD), False, RobotState.IDLE, Fault.STALE_SEQUENCE),
    ((CONFIGURE, LOAD, GO, WAIT, ("go", 2), LOAD), True, RobotState.LOADED, Fault.NONE),
    ((CONFIGURE, LOAD, GO, WAIT, ("load", 2)), True, RobotState.LOADED, Fault.NONE),
    ((CONFIGURE, OVERWRITE, GO), True, RobotState.DONE, Fault.NONE),
    ((CONFIGURE, ("load", 1, ((1, 8001),))), False, RobotState.IDLE, Fault.OVER_SPEED),
    ((CONFIGURE, ("load", 1, (), ((1, -6001),))), False, RobotState.IDLE, Fault.OVER_SPEED),
    # outside the limits on the way, although the end is inside
    (
        (CONFIGURE, ("load", 1, (), ((201, -5000), (100, 5000)))),
        False,
        RobotState.IDLE,
        Fault.OUTSIDE_LIMITS,
    ),
    ((CONFIGURE, ("load", 1, (), ((200, -5000),))), True, RobotState.LOADED, Fault.NONE),
]


@pytest.mark.parametrize(("story", "taken", "state", "fault"), STORIES)
def test_a_robot_has_the_state_and_fault_of_the_wire_format(story, taken, state, fault):
    bench = Bench()
    acks = [Ack.OK]
    for verb, *arguments in story:
        if verb == "wait":
            bench.t += 5.0
        else:
            acks = getattr(bench, verb)(*arguments)
    status = bench.status()
    assert (acks == [Ack.OK], status.state[0], status.fault[0]) == (taken, state, fault)
    assert bool(status.alerts[0] & Alert.REFUSED) == (fault != Fault.NONE)


def test_an_order_is_executed_once():
    bench = Bench()
    bench.configure()
    bench.load()
    for _ in range(3):
        bench.go()
        bench.t += 5.0
    assert bench.status().position[0].tolist() == [250_000, 950_000]


def test_a_robot_outside_its_limits_accepts_only_orders_that_return():
    bench = Bench(start=(0, 2_000_100))
    bench.configure()
    assert bench.load(1, (), ((1, 1),)) == [Ack.REFUSED]
    assert bench.load(1, (), ((100, -10),)) == [Ack.OK]


def test_a_robot_reports_the_checksum_of_its_stored_order():
    bench = Bench()
    bench.configure()
    bench.load()
    before = bench.status().order_crc[0]
    bench.robots.memory["order"][0, 3] ^= 4
    assert bench.status().order_crc[0] != before
    bench.go()
    status = bench.status(bench.t + 5)
    assert (status.state[0], status.fault[0]) == (RobotState.FAULT, Fault.MEMORY)
    assert status.position[0].tolist() == [0, 1_000_000]


def test_an_order_that_is_never_started_lapses():
    bench = Bench(watchdog_ms=1000)
    bench.configure()
    bench.load()
    assert bench.status(bench.t + 0.9).state[0] == RobotState.LOADED
    status = bench.status(bench.t + 0.2)
    assert (status.state[0], status.fault[0]) == (RobotState.FAULT, Fault.WATCHDOG)
    assert status.alerts[0] == Alert.LAPSED
    bench.go()
    assert bench.robots.positions(bench.t + 5)[0].tolist() == [0, 1_000_000]


def test_power_loss_stops_and_shows_in_the_boot_counter():
    bench = Bench()
    bench.configure()
    bench.load()
    bench.go()
    begun = bench.t
    bench.robots.power([0], False, begun + 0.4)
    bench.robots.power([0], True, begun + 0.7)
    status = bench.status(begun + 2)
    assert status.position[0].tolist() == [100_000, 950_000]
    assert (status.state[0], status.boot[0]) == (RobotState.UNCONFIGURED, 2)
    assert status.alerts[0] == Alert.REBOOTED


def test_other_quanta_and_impossible_units_are_refused():
    bench = Bench()
    assert bench.configure(WireUnits(quantum_prad=UNITS.quantum_prad + 1)) == [Ack.REFUSED]
    assert bench.status().fault[0] == Fault.OTHER_QUANTUM
    for units in (WireUnits(velocity_bits=17), WireUnits(duration_bits=17)):
        assert bench.configure(units) == [Ack.REFUSED]
        assert bench.status().fault[0] == Fault.BAD_VALUE


def test_a_robot_reports_its_identity():
    bench = Bench(2)
    requests = encode_command(Opcode.IDENTIFY, bench.to)
    replies = bench.buses.transfer(requests, 9, 0.0)
    identity = decode_identity(bench.to, replies.table(9))
    assert identity.ok.all() and identity.serial.tolist() == [100, 101]
    assert identity.address.tolist() == [8, 9] and not identity.ten_bit.any()


def test_impossible_robots_are_refused():
    to = Addresses([0], [8], [False])
    with pytest.raises(WireError, match="serial number -1"):
        Positioners(to, [-1], 1000, [[0, 0]])
    with pytest.raises(WireError, match="encoder"):
        Positioners(to, [1], 1000, [[0, 2**31]])


@pytest.mark.parametrize("seed", range(3))
def test_noise_moves_no_robot(seed):
    rng = np.random.default_rng(seed)
    bench = Bench()
    bench.configure()
    bench.load()
    noise = [rng.bytes(rng.integers(1, 40)) for _ in range(2000)]
    to = [bench.to, general_call([0])][seed % 2][np.zeros(2000, dtype=int)]
    acks = bench.send(Frames.from_bytes(to, noise))
    assert set(acks) == {Ack.REFUSED}
    status = bench.status(bench.t + 5)
    assert status.position[0].tolist() == [0, 1_000_000]
    assert status.state[0] == RobotState.LOADED

# SPDX-License-Identifier: Apache-2.0
"""Lists of speeds: in CONFIG, named by the moves of orders, checked by robots, verified."""

from dataclasses import replace

import numpy as np
import pytest
from fastcrc import crc16
from hypothesis import given, settings
from hypothesis import strategies as st

from fiber_bus_bridge import Session, SessionState, addresses_of
from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import (
    Addresses,
    Configuration,
    Fault,
    Frames,
    Opcode,
    Speeds,
    decode_config,
    decode_load,
    encode_config,
    encode_load,
)
from fiber_core.clearance import Safety
from fiber_core.drive import Drive, ListedSpeeds, rules_broken
from fiber_core.drive.listed_units import listed_units
from fiber_core.drive.named import with_drive
from fiber_core.errors import LayoutError
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits

PLANE = with_drive(preset("desi_petals", 24), "desi")
UNITS = WireUnits.for_plane(PLANE)
TABLE = listed_units(PLANE, UNITS)
LISTS = Speeds.of(PLANE, UNITS)
START = PLANE.limits.mean(axis=2)
CONFIG = SimulationConfig(preset="desi_petals", robots=PLANE.n)
RUN, CREEP, RAMP = TABLE.velocity[:, 0], TABLE.velocity[:, 1], int(TABLE.ramp[0])
SIGN = PLANE.drive.listed.approach_sign.astype(int)


class Rig:
    """Simulated robots, and a session with them."""

    def __init__(self):
        self.buses = simulated_buses(PLANE, UNITS, START, CONFIG)
        self.memory = self.buses.positioners.memory
        self.session = Session(PLANE, UNITS, Safety(), self.buses, START)
        self.t = 0.0
        self.call("configure")

    def call(self, name, *arguments):
        self.t = max(self.t, getattr(self.session, name)(self.t, *arguments))

    def submit_and_start(self, orders):
        self.session.submit(orders)
        self.call("start")

    def refusals(self, frames):
        """The Fault of every robot after these frames."""
        self.memory["fault"] = 0
        self.buses.transfer(frames, 0, self.t)
        return [Fault(fault) for fault in self.memory["fault"]]


def motion_of(profiles):
    """The motion of (ticks, velocity) of theta and phi of each robot."""
    counts = [len(joint) for joint in profiles]
    ticks, velocity = np.array([s for joint in profiles for s in joint]).reshape(-1, 2).T
    start = UNITS.to_counts(START)[: len(profiles) // 2]
    return WireMotion(UNITS, start, np.concatenate([[0], np.cumsum(counts)]), ticks, velocity)


def ending(robot, joint, back=0, forth=0):
    """The approach of a joint, longer by some ticks."""
    sign, rising = SIGN[joint], (SIGN[joint] + 1) // 2
    return [
        (TABLE.back[robot, joint] + back, -sign * CREEP[robot, joint, 1 - rising]),
        (TABLE.forth[robot, joint] + forth, sign * CREEP[robot, joint, rising]),
    ]


def simple(robot, ticks=40):
    """A run and the approach of both joints, theta falling, phi after a wait."""
    run = [(ticks, -RUN[robot, 0, 0]), (RAMP, 0), *ending(robot, 0, back=3)]
    wait = [(9, 0), (ticks, -RUN[robot, 1, 0]), (RAMP + 2, 0), *ending(robot, 1, forth=5)]
    return [run, wait]


def random_joint(robot, joint, rng):
    """Moves that the motor can make, in any order, with waits."""
    moves, owed = [], 0
    for _ in range(rng.integers(0, 3)):
        way, speed = rng.integers(2), rng.integers(2)
        rest = owed + rng.choice([0, rng.integers(1, 900)])
        if rest or moves:
            moves.append((rest or 1, 0))
        least = TABLE.least[robot, speed, joint, way]
        velocity = (2 * way - 1) * TABLE.velocity[robot, speed, joint, way]
        moves.append((least + rng.integers(0, 200), velocity))
        owed = int(TABLE.ramp[speed])
    if moves and owed:
        moves.append((owed + rng.choice([0, 1, 600]), 0))
    longer = [0, 0]
    longer[rng.integers(2)] = rng.integers(0, 2000)
    for ticks, velocity in ending(robot, joint, *longer):
        while ticks > 0:  # a segment has at most max_ticks
            moves.append((min(ticks, UNITS.max_ticks), velocity))
            ticks -= UNITS.max_ticks
    return moves


def same_motion(one, other):
    """Whether two motions are the same function of time, in whatever segments."""
    for profile in range(2 * one.n):
        ways = []
        for motion in (one, other):
            part = slice(motion.offsets[profile], motion.offsets[profile + 1])
            ways.append(np.repeat(motion.velocity[part], motion.ticks[part]))
        if not np.array_equal(*ways):
            return False
    return True


def test_a_list_travels_in_the_configuration_and_comes_back():
    to = addresses_of(PLANE)
    limits, speed = UNITS.range_counts(PLANE), np.full((PLANE.n, 2), 8000)
    frames = encode_config(Configuration(UNITS, limits, speed, 1000, listed=LISTS), to)
    for row in range(PLANE.n):
        config = decode_config(frames.payload(row), int(to.address[row]), bool(to.ten_bit[row]))
        assert config.listed.content.tobytes() == LISTS.content[row].tobytes()
    words = LISTS.content[0, 2:].reshape(-1, 2)
    numbers = [int.from_bytes(word.tobytes()) for word in words]
    assert LISTS.content[0, :2].tolist() == [2, 1 | 0 << 3 | 1 << 4]
    first = [TABLE.back[0, 0], TABLE.forth[0, 0], TABLE.back[0, 1], TABLE.forth[0, 1]]
    assert numbers[:4] == first
    for k in range(2):
        of_speed = [*TABLE.velocity[0, k].ravel(), TABLE.ramp[k], *TABLE.least[0, k].ravel()]
        assert numbers[4 + 9 * k : 13 + 9 * k] == of_speed


def test_orders_of_listed_moves_are_short_and_come_back():
    to = addresses_of(PLANE)
    motion = motion_of([joint for robot in range(PLANE.n) for joint in simple(robot)])
    frames = encode_load(to, 5, motion, LISTS)
    # theta: run, approach; phi: wait, run, rest, approach
    assert set(frames.lengths) == {4 + 2 * 6}
    assert set(frames.data[frames.offsets[:-1]]) == {Opcode.MOVES << 4 | 5}
    orders = decode_load(UNITS, frames, LISTS)
    assert orders.ok.all() and same_motion(orders.motion, motion)
    plain = encode_load(to, 5, motion)
    assert set(plain.lengths) == {4 + 3 * 9}


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=200)
def test_moves_that_motors_can_make_are_orders_of_moves(seed):
    rng = np.random.default_rng(seed)
    profiles = [random_joint(i, joint, rng) for i in range(PLANE.n) for joint in range(2)]
    motion = motion_of(profiles)
    assert len(rules_broken(PLANE.drive, motion.decoded())) == 0
    frames = encode_load(addresses_of(PLANE), 3, motion, LISTS)
    orders = decode_load(UNITS, frames, LISTS)
    assert (frames.data[frames.offsets[:-1]] >> 4 == Opcode.MOVES).all()
    assert orders.ok.all() and same_motion(orders.motion, motion)


@given(st.integers(0, 2**32 - 1), st.binary(max_size=40))
@settings(deadline=None, max_examples=300)
def test_noise_with_a_checksum_is_refused_or_is_a_motion(seed, noise):
    to, rng = addresses_of(PLANE)[:1], np.random.default_rng(seed)
    moves = rng.integers(0, 4, 2)
    body = bytes([Opcode.MOVES << 4 | 5, moves[0] << 4 | moves[1]])
    body += noise[: 2 * moves.sum()].ljust(2 * moves.sum(), b"\x10")
    if rng.random() < 0.2:
        body = noise
    orders = decode_load(UNITS, Frames.from_bytes(to, [sealed(to, body)]), LISTS[:1])
    if orders.ok[0]:
        again = encode_load(to, orders.sequence, orders.motion, LISTS[:1])
        assert same_motion(decode_load(UNITS, again, LISTS[:1]).motion, orders.motion)
        assert (orders.motion.counts <= 15).all()


def sealed(to, body):
    address = int(to.address[0])
    head = [address << 1]
    if to.ten_bit[0]:
        head = [0b11110000 | address >> 8 << 1, address & 0xFF]
    return body + crc16.ibm_3740(bytes(head) + body).to_bytes(2, "big")


@pytest.mark.parametrize(
    ("theta", "fault"),
    [
        ("3005", Fault.UNLISTED_SPEED),  # the third of two speeds
        ("b005", Fault.UNLISTED_SPEED),
        ("f005", Fault.UNLISTED_SPEED),
        ("1000", Fault.BAD_DURATION),
        ("0000", Fault.BAD_DURATION),
        ("10", Fault.BAD_LENGTH),
        ("1005 9005", Fault.BAD_LENGTH),
        ("8fff 8fff 8fff", Fault.BAD_LENGTH),  # more segments than an order has
    ],
)
def test_a_malformed_move_is_refused(theta, fault):
    to, moves = addresses_of(PLANE)[:1], bytes.fromhex(theta)
    number = 1 if len(theta) < 12 else 3
    body = bytes([Opcode.MOVES << 4 | 5, number << 4]) + moves
    frame = Frames.from_bytes(to, [sealed(to, body)])
    assert decode_load(UNITS, frame, LISTS[:1]).fault[0] == fault
    assert Rig().refusals(frame)[0] == fault


def test_a_robot_without_a_list_refuses_moves():
    motion = motion_of([joint for robot in range(PLANE.n) for joint in simple(robot)])
    frames = encode_load(addresses_of(PLANE), 5, motion, LISTS)
    assert set(decode_load(UNITS, frames).fault) == {Fault.UNLISTED_SPEED}


def test_robots_carry_out_orders_of_moves():
    rig = Rig()
    profiles = [[], []] * PLANE.n
    profiles[6:8] = simple(3)
    motion = motion_of(profiles)
    rig.submit_and_start(motion)
    assert rig.memory["order"][3, 0] >> 4 == Opcode.MOVES
    while rig.session.state is SessionState.MOVING:
        rig.t += 0.1
        rig.call("advance")
    assert rig.session.result.reason[3] == Reason.OK
    assert rig.session.counts[3].tolist() == motion.end[3].tolist()


@pytest.mark.parametrize("number", [0, 1, 3, 11, 19, 29, 45])  # a byte of the list
def test_a_robot_that_holds_another_list_is_not_started(number):
    rig = Rig()
    assert rig.memory["listed_bytes"][3] == LISTS.content.shape[1] > number
    rig.memory["listed"][3, number] ^= 1
    profiles = [[], []] * PLANE.n
    profiles[6:8], profiles[16:18] = simple(3), simple(8)
    rig.submit_and_start(motion_of(profiles))
    loaded = rig.session.loaded_plan
    assert loaded.started[8] and not loaded.started[3]
    assert loaded.reason[3] != Reason.OK


def test_a_robot_refuses_speeds_that_are_not_listed_and_moves_that_are_too_short():
    rig = Rig()
    good = [joint for robot in range(PLANE.n) for joint in simple(robot)]
    to = addresses_of(PLANE)
    assert set(rig.refusals(encode_load(to, 2, motion_of(good), LISTS))) == {Fault.NONE}
    # in segments too, whose speeds are no numbers of a list
    assert set(rig.refusals(encode_load(to, 3, motion_of(good)))) == {Fault.NONE}
    wrong = [[*joint] for joint in good]
    wrong[0][0] = (40, -RUN[0, 0, 0] + 1)
    wrong[5][1] = (TABLE.least[2, 0, 1, 0] - 1, -RUN[2, 1, 0])
    for lists in (None, LISTS):
        faults = rig.refusals(encode_load(to, 4, motion_of(wrong), lists))
        assert faults[0] == Fault.UNLISTED_SPEED and faults[2] == Fault.SHORT_MOVE
        assert set(faults[3:]) == {Fault.NONE}


def block(content):
    return bytes([2, len(content)]) + bytes(content)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda x: x[:-1], Fault.BAD_LENGTH),
        (lambda x: [3, *x[1:]], Fault.BAD_LENGTH),
        (lambda x: [0, *x[1:]], Fault.BAD_LENGTH),
        (lambda x: [x[0], x[1] | 2, *x[2:]], Fault.BAD_VALUE),  # the approach at a third speed
        (lambda x: [x[0], x[1] | 32, *x[2:]], Fault.BAD_VALUE),
        (lambda x: [*x[:10], 0, 0, *x[12:]], Fault.BAD_VALUE),  # no speed
        (lambda x: [*x[:28], 255, 255, *x[30:]], Fault.BAD_VALUE),  # speeds that rise
    ],
)
def test_a_list_that_no_motor_has_is_refused(change, fault):
    to = Addresses([0], [300], [True])
    limits, speed = UNITS.range_counts(PLANE)[:1], np.full((1, 2), 8000)
    config = Configuration(UNITS, limits, speed, 1000, listed=LISTS[:1])
    body = encode_config(config, to).payload(0)[:-2]
    content = LISTS.content[0].tolist()
    assert body.endswith(block(content))
    changed = body.removesuffix(block(content)) + block(change(content))
    with pytest.raises(WireError) as error:
        decode_config(sealed(to, changed), 300, True)
    assert error.value.fault == fault


def test_a_list_that_does_not_fit_its_fields_names_the_robot():
    slow = ListedSpeeds(
        PLANE.drive.listed.speeds_rad_s, [0.022, 0.0], PLANE.drive.listed.least_rad,
        approach_rad=(3.0, 3.0), approach_speed=1, returns=True,
    )  # fmt: skip
    scale = np.ones((PLANE.n, 2, 2))
    scale[7] = 0.05
    plane = replace(PLANE, drive=Drive(PLANE.n, listed=slow, scale=scale))
    ticks = listed_units(plane, UNITS).back[7, 0]
    assert ticks > 2**16 - 1
    with pytest.raises(WireError, match=f"robot {PLANE.ids[7]}: {ticks} ticks"):
        Speeds.of(plane, UNITS)


@pytest.mark.parametrize(("units", "both"), [((100.6, 99.6), 100), ((100.4, 99.8), 100)])
def test_speeds_that_are_one_in_whole_units_are_refused_with_robot_and_values(units, both):
    speeds = np.array(units) * UNITS.velocity_rad_s
    listed = ListedSpeeds(speeds, np.zeros(2), np.zeros(2), tolerance_rad_s=UNITS.velocity_rad_s)
    scale = np.ones((PLANE.n, 2, 2))
    scale[:4], scale[5:] = 4.0, 4.0
    plane = replace(PLANE, drive=Drive(PLANE.n, listed=listed, scale=scale))
    told = f"robot {PLANE.ids[4]}: .* {speeds[0]:.6g} and {speeds[1]:.6g} rad/s .* {both} velocity"
    with pytest.raises(LayoutError, match=told):
        Speeds.of(plane, UNITS)

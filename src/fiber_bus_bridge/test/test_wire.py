# SPDX-License-Identifier: Apache-2.0
"""Wire format: golden bytes with their meaning, a slow reference, and malformed frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastcrc import crc8, crc16
from hypothesis import given, settings
from hypothesis import strategies as st

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire import (
    Addresses,
    Configuration,
    Fault,
    Frames,
    Gears,
    Opcode,
    Ramps,
    RobotState,
    Speeds,
    decode_command,
    decode_config,
    decode_identity,
    decode_load,
    decode_status,
    encode_address,
    encode_command,
    encode_config,
    encode_identity,
    encode_load,
    encode_place,
    encode_status,
    general_call,
)
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

UNITS = WireUnits()
ROBOT = Addresses([3], [300], [True])
NEXT = Addresses([3], [301], [True])
PAGE = Path(__file__).resolve().parents[3] / "docs" / "wire-format.md"

GOLDEN = {
    "LOAD": "15 21 0f a0 fa ff fc 01 80 07 ff 6c e1",
    "LOAD, empty, to 0x20": "15 00 2d b7",
    "GO, general call": "f1 25 17 70 71 b0",
    "STOP, general call": "f1 30 91",
    "STOP": "30 78",
    "CLEAR": "40 2f",
    "RESET": "50 5f",
    "IDENTIFY": "70 bf",
    "HEARTBEAT, general call": "f1 80 88",
    "ADDRESS": "90 00 00 12 67 81 2d 09 73",
    "ADDRESS, general call": "f1 90 00 00 12 67 81 2d bb fc",
    "PLACE": "a0 ff fc 2f 70 00 1e 9f d8 9e 4a",
    "CONFIG": "64 0e 0a 00 00 0f a0 00 17 e1 48 ff de fc d0 00 21 03 30 00 00 00 00 00 1e a1 66 "
    "1f 5e 1f 5e 27 10 00 19 00 4d 97 45",
    "CONFIG with gears": "64 0e 0a 00 00 0f a0 00 17 e1 48 ff de fc d0 00 21 03 30 00 00 00 00 00 "
    "1e a1 66 1f 5e 1f 5e 27 10 00 19 00 4d 01 28 00 40 00 00 00 00 00 00 ff a0 00 00 00 60 00 00 "
    "ff de fc ce 00 21 03 32 ff ce 7b 34 00 5f 76 e8 00 1f 5e 01 00 1f 5e 01 a3 8a",
    "CONFIG with speeds": "64 0e 0a 00 00 0f a0 00 17 e1 48 ff de fc d0 00 21 03 30 00 00"
    " 00 00 00 1e a1 66 1f 5e 1f "
    "5e 27 10 00 19 00 4d 02 2e 02 11 01 13 01 13 01 13 01 13 1f 5e 1f 5e 1f 5e 1f 5e 00 06 00 "
    "07 00 07 00 07 00 07 00 7a 00 7a 00 7a 00 7a 00 00 00 01 00 01 00 01 00 01 37 ce",
    "CONFIG with ramps": "64 0e 0a 00 00 0f a0 00 17 e1 48 ff de fc d0 00 21 03 30 00 00"
    " 00 00 00 1e a1 66 1f 5e 1f "
    "5e 27 10 00 19 00 4d 02 2e 02 11 01 13 01 13 01 13 01 13 1f 5e 1f 5e 1f 5e 1f 5e 00 06 00 "
    "07 00 07 00 07 00 07 00 7a 00 7a 00 7a 00 7a 00 00 00 01 00 01 00 01 00 01 "
    "03 08 00 00 55 f0 00 00 00 00 b6 8e",
    "MOVES": "b5 24 10 64 70 03 00 09 90 64 00 02 80 05 62 12",
    "VERIFY": "35 6c e1 07 e0",
    "STATUS": "35 6c e1 07 e0 14 01 ff fc 2f 70 00 1e 9f d8 3d f0",
    "VERIFY, 0x20": "20 00 00 01 63",
    "ID": "74 00 00 12 67 81 2c 07 02",
}
# theta 1000 for 250 ticks then -1 for 1, phi -8191 for 1023; sequence 5
ORDER = WireMotion.from_zero(UNITS, [0, 2, 3], [250, 1, 1023], [1000, -1, -8191])
CONFIG = Configuration(
    UNITS, np.array([[[-2163504, 2163504], [0, 2007398]]]), np.array([[8030, 8030]]), 10_000, 25, 77
)
GEARED = replace(
    CONFIG,
    gears=Gears(
        np.array([[[2**22, 0], [-3 * 2**21, 3 * 2**21]]]),
        np.array([[[-2163506, 2163506], [-3245260, 6256360]]]),
        np.array([[2055681, 2055681]]),
    ),
)
# speeds of 8030 and 122 units in all joints, see the page
LISTED = Speeds(
    np.frombuffer(bytes([2, 17]) + np.array(
        [275] * 4 + [8030] * 4 + [6] + [7] * 4 + [122] * 4 + [0] + [1] * 4, dtype=">u2"
    ).tobytes(), dtype=np.uint8)[None]
)  # fmt: skip
# 22 ms at the first speed, none at the second
RAMPS = Ramps(np.array([[0, 0, 0x55, 0xF0, 0, 0, 0, 0]], dtype=np.uint8))
MOVES = WireMotion.from_zero(
    UNITS, [0, 4, 9], [100, 6, 278, 275, 9, 100, 8, 275, 280],
    [-8030, 0, 122, -122, 0, 8030, 0, -122, 122],
)  # fmt: skip


def golden(name):
    return bytes.fromhex(GOLDEN[name])


def wire_bytes(to, row, data=b""):
    """Address bytes of a write and the data."""
    address = int(to.address[row])
    if to.ten_bit[row]:
        return bytes([0b11110000 | address >> 8 << 1, address & 0xFF]) + data
    return bytes([address << 1]) + data


def slow_load(units, to, row, sequence, theta, phi):
    """A LOAD frame composed as text of zeros and ones."""
    pad = 8 * units.segment_bytes - units.velocity_bits - units.duration_bits
    text = f"{1:04b}{sequence:04b}{len(theta):04b}{len(phi):04b}"
    for ticks, velocity in theta + phi:
        two_complement = velocity % 2**units.velocity_bits
        text += "0" * pad
        text += f"{two_complement:0{units.velocity_bits}b}{ticks:0{units.duration_bits}b}"
    body = bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))
    return body + crc16.ibm_3740(wire_bytes(to, row, body)).to_bytes(2, "big")


def test_golden_writes():
    alone = Addresses([0], [0x20], [False])
    written = {
        "LOAD": encode_load(ROBOT, 5, ORDER),
        "LOAD, empty, to 0x20": encode_load(alone, 5, WireMotion.at_rest(UNITS, [[0, 0]])),
        "GO, general call": encode_command(Opcode.GO, general_call([3]), 5, 6000),
        "STOP, general call": encode_command(Opcode.STOP, general_call([3])),
        "STOP": encode_command(Opcode.STOP, ROBOT),
        "CLEAR": encode_command(Opcode.CLEAR, ROBOT),
        "RESET": encode_command(Opcode.RESET, ROBOT),
        "IDENTIFY": encode_command(Opcode.IDENTIFY, ROBOT),
        "HEARTBEAT, general call": encode_command(Opcode.HEARTBEAT, general_call([3])),
        "ADDRESS": encode_address(ROBOT, [4711], NEXT),
        "ADDRESS, general call": encode_address(general_call([3]), [4711], NEXT),
        "PLACE": encode_place(ROBOT, [[-250_000, 2_007_000]]),
        "CONFIG": encode_config(CONFIG, ROBOT),
        "CONFIG with gears": encode_config(GEARED, ROBOT),
        "CONFIG with speeds": encode_config(replace(CONFIG, listed=LISTED), ROBOT),
        "CONFIG with ramps": encode_config(replace(CONFIG, listed=LISTED, ramps=RAMPS), ROBOT),
        "MOVES": encode_load(ROBOT, 5, MOVES, LISTED),
    }
    assert {name: frames.payload(0).hex(" ") for name, frames in written.items()} == {
        name: GOLDEN[name] for name in written
    }


def test_golden_replies():
    # LOADED, sequence 5, seventh boot, OUTSIDE_LIMITS, REFUSED, encoders -250000 and 2007000
    status = encode_status(ROBOT, 3, 5, 0x6CE1, 7, 20, 1, [-250_000, 2_007_000])
    assert status.tobytes() == golden("STATUS")
    assert status.tobytes().startswith(golden("VERIFY"))
    assert encode_identity(ROBOT, 4711, 7).tobytes() == golden("ID")
    full = decode_status(ROBOT, status)
    assert full.ok[0] and full.state[0] == RobotState.LOADED and full.fault[0] == 20
    assert (full.sequence[0], full.order_crc[0], full.boot[0]) == (5, 0x6CE1, 7)
    assert full.alerts[0] == 1 and full.position[0].tolist() == [-250_000, 2_007_000]
    short = decode_status(ROBOT, status[:, :5])
    assert short.ok[0] and short.order_crc[0] == 0x6CE1
    alone = Addresses([0], [0x20], [False])
    idle = np.frombuffer(golden("VERIFY, 0x20"), dtype=np.uint8)[None]
    assert decode_status(alone, idle).state[0] == RobotState.IDLE
    identity = decode_identity(ROBOT, np.frombuffer(golden("ID"), dtype=np.uint8)[None])
    assert identity.ok[0] and identity.ten_bit[0]
    assert (identity.serial[0], identity.address[0], identity.boot[0]) == (4711, 300, 7)


def test_golden_reads():
    orders = decode_load(UNITS, Frames.from_bytes(ROBOT, [golden("LOAD")]))
    assert orders.ok[0] and orders.sequence[0] == 5 and orders.crc[0] == 0x6CE1
    for name in ("offsets", "ticks", "velocity", "start"):
        assert np.array_equal(getattr(orders.motion, name), getattr(ORDER, name))
    assert decode_command(golden("GO, general call"), 0, False) == (Opcode.GO, 5)
    config = decode_config(golden("CONFIG"), 300, True)
    assert config.units == UNITS and (config.watchdog_ms, config.silence_ms) == (10_000, 25)
    assert np.array_equal(config.limits, CONFIG.limits)
    assert np.array_equal(config.speed, CONFIG.speed) and config.slot == [77]
    assert config.gears is None
    geared = decode_config(golden("CONFIG with gears"), 300, True)
    assert geared.gears is not None and np.array_equal(geared.limits, CONFIG.limits)
    for name, value in vars(GEARED.gears).items():
        assert np.array_equal(getattr(geared.gears, name), value)


def test_the_page_of_the_wire_format_shows_the_golden_bytes():
    page = " ".join(PAGE.read_text(encoding="utf-8").split())
    missing = [name for name, text in GOLDEN.items() if text not in page]
    assert not missing


def profiles(units):
    segment = st.tuples(
        st.integers(1, units.max_ticks), st.integers(-units.max_velocity, units.max_velocity)
    )
    return st.lists(segment, max_size=15)


@st.composite
def batches(draw):
    units = WireUnits(
        velocity_bits=draw(st.integers(2, 16)), duration_bits=draw(st.integers(1, 16))
    )
    orders = draw(st.lists(st.tuples(profiles(units), profiles(units)), max_size=4))
    ten_bit = [draw(st.booleans()) for _ in orders]
    address = [draw(st.integers(0, 1023 if t else 127)) for t in ten_bit]
    sequence = [draw(st.integers(0, 15)) for _ in orders]
    return units, Addresses(np.zeros(len(orders)), address, ten_bit), sequence, orders


@settings(max_examples=200, deadline=None)
@given(batches())
def test_orders_agree_with_the_reference_and_decode_to_the_same_values(batch):
    units, to, sequence, orders = batch
    flat = [profile for order in orders for profile in order]
    offsets = Parts.from_counts([len(p) for p in flat]).offsets
    ticks = [s[0] for p in flat for s in p]
    velocity = [s[1] for p in flat for s in p]
    motion = WireMotion.from_zero(units, offsets, ticks, velocity)
    frames = encode_load(to, sequence, motion)
    assert [frames.payload(i) for i in range(len(to))] == [
        slow_load(units, to, i, sequence[i], *order) for i, order in enumerate(orders)
    ]
    back = decode_load(units, frames)
    assert back.ok.all() and back.sequence.tolist() == sequence
    assert back.motion.offsets.tolist() == offsets.tolist()
    assert back.motion.ticks.tolist() == ticks and back.motion.velocity.tolist() == velocity


@pytest.mark.parametrize("flips", [1, 2])
def test_flipped_bits_of_an_order_are_refused(flips):
    good = int.from_bytes(golden("LOAD"), "big")
    bits = 8 * len(golden("LOAD"))
    masks = [1 << i for i in range(bits)]
    if flips == 2:
        masks = [a | b for a in masks for b in masks if a < b]
    bad = [(good ^ mask).to_bytes(bits // 8, "big") for mask in masks]
    to = ROBOT[np.zeros(len(bad), dtype=int)]
    orders = decode_load(UNITS, Frames.from_bytes(to, bad))
    assert len(orders.fault) == len(bad) and not orders.ok.any() and not orders.motion.moves.any()


def test_flipped_bits_of_commands_and_replies_are_refused():
    for name in (
        "GO, general call",
        "STOP, general call",
        "STOP",
        "CLEAR",
        "CONFIG",
        "ADDRESS",
        "PLACE",
    ):
        good, address = golden(name), (0, False) if "call" in name else (300, True)
        decode_command(good, *address)
        for bit in range(8 * len(good)):
            bad = (int.from_bytes(good, "big") ^ 1 << bit).to_bytes(len(good), "big")
            with pytest.raises(WireError):
                decode_command(bad, *address)
    for name, decode in (
        ("STATUS", decode_status),
        ("VERIFY", decode_status),
        ("ID", decode_identity),
    ):
        good = np.unpackbits(np.frombuffer(golden(name), dtype=np.uint8))
        bad = np.packbits(good ^ np.eye(len(good), dtype=np.uint8), axis=1)
        replies = decode(ROBOT[np.zeros(len(bad), dtype=int)], bad)
        assert not replies.ok.any()


def test_an_order_for_another_robot_is_refused():
    frames = encode_load(ROBOT, 5, ORDER)
    for other in (Addresses([3], [301], [True]), Addresses([3], [44], [False])):
        moved = Frames(other, frames.offsets, frames.data)
        assert decode_load(UNITS, moved).fault[0] == Fault.BAD_CRC


def sealed(hexes):
    body = bytes.fromhex(hexes)
    return body + crc16.ibm_3740(wire_bytes(ROBOT, 0, body)).to_bytes(2, "big")


@pytest.mark.parametrize(
    ("payload", "fault"),
    [
        (b"", Fault.BAD_LENGTH),
        (b"\x15", Fault.BAD_LENGTH),
        (golden("LOAD")[:-1], Fault.BAD_LENGTH),
        (golden("LOAD") + b"\x00", Fault.BAD_LENGTH),
        (sealed("15 21 0fa0fa fffc01"), Fault.BAD_LENGTH),
        (sealed("25 00"), Fault.BAD_OPCODE),
        (golden("LOAD")[:-1] + b"\x00", Fault.BAD_CRC),
        (sealed("15 10 0fa000"), Fault.BAD_DURATION),
        (sealed("15 10 8000fa"), Fault.BAD_VELOCITY),
    ],
)
def test_each_malformed_order_has_its_fault(payload, fault):
    assert decode_load(UNITS, Frames.from_bytes(ROBOT, [payload])).fault[0] == fault


def test_padding_must_be_zero():
    narrow = WireUnits(velocity_bits=13, duration_bits=10)
    good, bad = sealed("15 10 0003ff"), sealed("15 10 8003ff")
    to = ROBOT[np.zeros(2, dtype=int)]
    faults = decode_load(narrow, Frames.from_bytes(to, [good, bad])).fault
    assert faults.tolist() == [Fault.NONE, Fault.BAD_PADDING]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((ROBOT, 16, ORDER), "16 sequence"),
        ((ROBOT, 0, WireMotion.from_zero(UNITS, [0, 16, 16], [1] * 16, [1] * 16)), "16, 0] segmen"),
        ((ROBOT, 0, WireMotion.at_rest(WireUnits(velocity_bits=17), [[0, 0]])), "17 velocity"),
        ((ROBOT, 0, WireMotion.at_rest(UNITS, [[0, 0], [0, 0]])), "2 robots do not fit 1 addr"),
    ],
)
def test_values_that_do_not_fit_are_refused(arguments, words):
    with pytest.raises(WireError) as error:
        encode_load(*arguments)
    assert words in str(error.value)


def test_only_go_and_short_commands_are_encoded_as_such():
    for opcode in (Opcode.LOAD, Opcode.CONFIG, Opcode.ADDRESS, Opcode.PLACE):
        with pytest.raises(WireError):
            encode_command(opcode, ROBOT)
    with pytest.raises(WireError):
        encode_command(Opcode.STOP, ROBOT, 1)
    for sequence, countdown in ((16, 0), (-1, 0), (5, 65_536)):
        with pytest.raises(WireError):
            encode_command(Opcode.GO, ROBOT, sequence, countdown)


def test_only_go_and_config_carry_low_bits():
    body = b"\x31"
    with pytest.raises(WireError) as error:
        decode_command(body + bytes([crc8.smbus(wire_bytes(ROBOT, 0, body))]), 300, True)
    assert error.value.fault == Fault.BAD_OPCODE


def test_a_config_of_another_version_is_refused():
    body = b"\x63" + golden("CONFIG")[1:-2]
    payload = body + crc16.ibm_3740(wire_bytes(ROBOT, 0, body)).to_bytes(2, "big")
    with pytest.raises(WireError) as error:
        decode_config(payload, 300, True)
    assert error.value.fault == Fault.BAD_VERSION


def with_blocks(*blocks):
    body = golden("CONFIG")[:-2] + b"".join(blocks)
    return body + crc16.ibm_3740(wire_bytes(ROBOT, 0, body)).to_bytes(2, "big")


GEARS_BLOCK = golden("CONFIG with gears")[len(golden("CONFIG")) - 2 : -2]


@pytest.mark.parametrize(
    ("blocks", "fault"),
    [
        ((GEARS_BLOCK, GEARS_BLOCK), Fault.BAD_VALUE),
        ((GEARS_BLOCK[:-1],), Fault.BAD_LENGTH),
        ((GEARS_BLOCK, b"\x07"), Fault.BAD_LENGTH),
        ((b"\x01\x27" + GEARS_BLOCK[3:],), Fault.BAD_VALUE),
        ((b"\x7f\x00",), Fault.BAD_VALUE),
    ],
)
def test_a_block_of_a_config_that_is_not_known_is_refused(blocks, fault):
    assert decode_config(with_blocks(GEARS_BLOCK), 300, True).gears is not None
    with pytest.raises(WireError) as error:
        decode_config(with_blocks(*blocks), 300, True)
    assert error.value.fault == fault


@pytest.mark.parametrize(
    "change",
    [
        {"limits": np.full((1, 2, 2), 2**31)},
        {"speed": np.full((1, 2), 2**16)},
        {"watchdog_ms": -1},
        {"gears": replace(GEARED.gears, motor_speed=np.full((1, 2), 2**32))},
        {"units": WireUnits(quantum_prad=2**32)},
    ],
)
def test_a_config_that_does_not_fit_is_refused(change):
    with pytest.raises(WireError):
        encode_config(Configuration(**{**vars(CONFIG), **change}), ROBOT)


@given(st.binary(max_size=80))
@settings(deadline=None)
def test_noise_is_never_an_order(noise):
    orders = decode_load(UNITS, Frames.from_bytes(ROBOT, [noise]))
    if orders.ok[0]:  # an accepted frame is, byte for byte, the frame that the encoder writes
        assert encode_load(ROBOT, orders.sequence, orders.motion).payload(0) == noise


def test_frames_can_be_selected_by_row():
    to = Addresses([0, 0, 1], [8, 9, 8], [False] * 3)
    frames = Frames.from_bytes(to, [b"a", b"", b"cde"])
    chosen = frames[np.array([2, 0])]
    assert [chosen.payload(i) for i in range(2)] == [b"cde", b"a"]
    assert chosen.to.bus.tolist() == [1, 0]
    with pytest.raises(WireError):
        Frames(to, [0, 1, 2, 9], frames.data)
    with pytest.raises(WireError):
        Addresses([0], [200], [False])

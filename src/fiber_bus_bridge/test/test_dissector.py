# SPDX-License-Identifier: Apache-2.0
"""The dissector for Wireshark agrees with the decoder of the package, field by field."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fiber_bus_bridge import bus_timing
from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_bus_bridge.wire import (
    ADDRESS_FIELDS,
    CALL_PREFIX,
    GO_FIELDS,
    IDENTITY_BYTES,
    PLACE_FIELDS,
    ROLL_CALL_ADDRESS,
    STATUS_BYTES,
    VERIFY_BYTES,
    VERSION,
    Addresses,
    Configuration,
    Fault,
    Frames,
    Gears,
    Opcode,
    RobotState,
    decode_command,
    decode_config,
    decode_identity,
    decode_load,
    decode_status,
    encode_address,
    encode_command,
    encode_config,
    encode_load,
    encode_place,
    general_call,
    roll_call,
)
from fiber_core.wire_units import WireMotion, WireUnits

pytest.importorskip("vcd", reason="pyvcd is not installed: no captures")

TSHARK = shutil.which("tshark")
SCRIPT = Path(__file__).parents[3] / "tools" / "fiber_positioners.lua"

TO = Addresses([0, 0, 1, 1], [8, 0x77, 300, 1022], [False, False, True, True])
CALLED = general_call([0, 1])
UNITS = WireUnits()
NOTHING = Frames(TO, np.zeros(5, dtype=int), np.zeros(0, dtype=np.uint8))
GEARS = Gears(
    np.tile(np.array([[1, 0], [-1.5, 1.5]]) * 2**22, (4, 1, 1)).astype(int),
    np.tile([[-2_000_000, 2_000_000], [-4_000_000, 4_000_000]], (4, 1, 1)),
    np.full((4, 2), 8000 * 256),
)
# width of the fields that the dissector shows in hexadecimal
HEX = {"order_crc": 4, "alerts": 2, "crc": 4, "pec": 2}
FIELDS = (
    "bus address ten_bit read opcode sequence theta_segments phi_segments segments countdown "
    "version velocity_bits duration_bits tick_us quantum_prad theta_low theta_high phi_low "
    "phi_high theta_speed phi_speed watchdog_ms silence_ms slot block coupling motor_limits "
    "motor_speed present serial new_address state order_crc boot fault alerts theta phi crc pec"
).split()


@pytest.fixture(scope="module")
def traffic():
    """A tap with frames of every kind: configuration, orders, motion, refusals, absent robots."""
    at = np.full((4, 2), -70_000)
    robots = Positioners(TO, [11, 22, 33, 44], UNITS.quantum_prad, at, coupling=GEARS.coupling)
    tap, t = Tap(SimulatedBuses(robots, bus_timing("1M")), bus_timing("1M")), 0.0
    limits = np.tile([[-2_000_000, 2_000_001], [-1_000_002, 2_000_003]], (4, 1, 1))
    plain = Configuration(UNITS, limits, np.tile([8000, 7000], (4, 1)), 9000, 20, [3, 11, 0, 1])
    offsets = [0, 1, 2, 2, 2, 3, 3, 4, 4]
    orders = WireMotion.from_zero(UNITS, offsets, [9, 8, 7, 6], [50, -60, 70, 0])
    load = encode_load(TO, 5, orders)
    absent = Addresses([0, 1], [0x20, 301], [False, True])
    for frames, read in (
        (encode_command(Opcode.IDENTIFY, TO), IDENTITY_BYTES),
        (load, 0),  # refused: no robot is configured
        (encode_config(plain, TO), 0),  # refused: the robots have gears
        (NOTHING, STATUS_BYTES),
        (encode_config(replace(plain, gears=GEARS), TO), 0),
        (NOTHING, STATUS_BYTES),
        (load, 0),
        (NOTHING, VERIFY_BYTES),
        (encode_command(Opcode.GO, CALLED, 5, 700), 0),
        (encode_command(Opcode.GO, TO[:1], 6, 0x1234), 0),
        (encode_command(Opcode.HEARTBEAT, CALLED), 0),
        (roll_call([0, 1]), 2),
        (NOTHING, STATUS_BYTES),
        (encode_command(Opcode.STOP, absent), 0),
        (encode_command(Opcode.STOP, CALLED), 0),
        (NOTHING, STATUS_BYTES),
        (encode_command(Opcode.CLEAR, TO), 0),
        (encode_place(TO, np.full((4, 2), -70_001)), 0),
        (NOTHING, STATUS_BYTES),
        (encode_address(TO, [11, 22, 33, 44], TO[::-1]), 0),
        (encode_command(Opcode.RESET, TO), 0),
    ):
        t = float(tap.transfer(frames, read, t).end_s.max()) + 1e-3
    return tap


def packets_of(exchange):
    """Yield the fields of each message of an exchange, by name, in the order of the frames."""
    frames, replies = exchange.frames, exchange.replies
    for row in range(len(frames)):
        to = frames.to[row : row + 1]
        place = {
            "bus": int(to.bus[0]), "address": int(to.address[0]), "ten_bit": int(to.ten_bit[0])
        }  # fmt: skip
        read = replies.data[replies.offsets[row] : replies.offsets[row + 1]]
        payload = frames.payload(row) if replies.ack[row] != Ack.NO_ADDRESS else b""
        if payload or place["ten_bit"] or not len(read):
            yield place | {"read": 0} | written(to, frames[np.array([row])], payload)
        if len(read) and replies.ack[row] == Ack.OK:
            yield place | {"read": 1} | reply_fields(to, read[None])


def written(to, frame, payload):
    if not payload:
        return {}
    head = payload[1:] if payload[0] == CALL_PREFIX else payload
    opcode, sequence = Opcode(head[0] >> 4), head[0] & 15
    fields = {"opcode": int(opcode)}
    if opcode == Opcode.LOAD:
        order = decode_load(UNITS, frame)
        assert order.ok.all()
        counts = order.motion.parts.counts
        fields |= {"sequence": int(order.sequence[0]), "crc": int(order.crc[0])}
        fields |= {"theta_segments": int(counts[0]), "phi_segments": int(counts[1])}
        return fields | ({"segments": payload[2:-2].hex()} if counts.any() else {})
    decoded = decode_command(payload, int(to.address[0]), bool(to.ten_bit[0]))
    assert decoded == (opcode, sequence)
    if opcode == Opcode.GO:
        row = np.frombuffer(head, GO_FIELDS)[0]
        return fields | {
            "sequence": sequence, "countdown": int(row["countdown"]), "crc": int(row["crc"])
        }  # fmt: skip
    if opcode == Opcode.ADDRESS:
        row = np.frombuffer(head, ADDRESS_FIELDS)[0]
        new = int(row["form_address"]) & 0x7FFF
        return fields | {"serial": int(row["serial"]), "new_address": new, "crc": int(row["crc"])}
    if opcode == Opcode.PLACE:
        row = np.frombuffer(head, PLACE_FIELDS)[0]
        theta, phi = row["position"].tolist()
        return fields | {"theta": theta, "phi": phi, "crc": int(row["crc"])}
    if opcode == Opcode.CONFIG:
        config = decode_config(payload, int(to.address[0]), bool(to.ten_bit[0]))
        units = config.units
        limits = dict(zip(("theta_low", "theta_high", "phi_low", "phi_high"), config.limits.flat))
        speeds = dict(zip(("theta_speed", "phi_speed"), config.speed.flat))
        named = ("velocity_bits", "duration_bits", "tick_us", "quantum_prad")
        fields |= {"version": VERSION} | {name: getattr(units, name) for name in named}
        fields |= {"watchdog_ms": config.watchdog_ms, "silence_ms": config.silence_ms}
        fields |= {"slot": int(np.asarray(config.slot)[0])}
        if config.gears is not None:
            block = head[-42:-2]
            fields |= {"block": 1, "coupling": block[:16].hex()}
            fields |= {"motor_limits": block[16:32].hex(), "motor_speed": block[32:].hex()}
        return fields | limits | speeds | {"crc": int.from_bytes(head[-2:])}
    return fields | {"pec": head[-1]}


def reply_fields(to, data):
    if to.ten_bit[0] and to.address[0] == ROLL_CALL_ADDRESS:
        return {"present": data.tobytes().hex()}
    pec = int(data[0, VERIFY_BYTES - 1])
    if data.shape[1] == IDENTITY_BYTES:
        identity = decode_identity(to, data)
        assert identity.ok.all()
        return {
            "opcode": int(Opcode.IDENTIFY), "version": VERSION, "serial": int(identity.serial[0]),
            "new_address": int(identity.address[0]), "boot": int(identity.boot[0]),
            "pec": int(data[0, -1]),
        }  # fmt: skip
    status = decode_status(to, data)
    assert status.ok.all()
    names = ("state", "sequence", "order_crc", "boot")
    fields = {name: int(getattr(status, name)[0]) for name in names} | {"pec": pec}
    if data.shape[1] == STATUS_BYTES:
        theta, phi = status.position[0]
        fields |= {"fault": int(status.fault[0]), "alerts": int(status.alerts[0])}
        fields |= {"theta": int(theta), "phi": int(phi), "crc": int.from_bytes(data[0, -2:])}
    return fields


def dissected(path):
    """Yield fields and description of every packet, by tshark with the script of tools/."""
    names = [f"fiber.{name}" for name in FIELDS]
    command = [TSHARK, "-X", f"lua_script:{SCRIPT}", "-r", str(path), "-T", "fields"]
    command += ["-E", "separator=;", *(word for name in names for word in ("-e", name))]
    run = subprocess.run(
        [*command, "-e", "_ws.col.Info"], capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stderr
    for line in run.stdout.splitlines():
        *values, words = line.split(";")
        yield {name: value for name, value in zip(FIELDS, values) if value}, words


@pytest.mark.skipif(TSHARK is None, reason="tshark is not installed: the dissector is not tested")
def test_every_field_agrees_with_the_decoder(traffic, tmp_path):
    expected = {0: [], 1: []}
    for exchange in traffic.exchanges:
        for fields in packets_of(exchange):
            shown = {
                name: f"0x{value:0{HEX[name]}x}" if name in HEX else str(value)
                for name, value in fields.items()
            }
            expected[fields["bus"]].append(shown)
    states = {fields.get("state") for fields in expected[0]}
    assert states >= {str(int(s)) for s in (RobotState.IDLE, RobotState.LOADED, RobotState.STOPPED)}
    traffic.write(tmp_path)
    found = {0: [], 1: []}
    descriptions = set()
    for fields, words in dissected(tmp_path / "buses.pcap"):
        found[int(fields["bus"])].append(fields)
        descriptions.add(words)
    assert found == expected
    assert {field for packets in found.values() for packet in packets for field in packet} == set(
        FIELDS
    )
    assert descriptions >= {
        "identity", "address only", "CONFIG", "LOAD, 1 + 1 segments", "GO to all", "GO",
        "HEARTBEAT to all", "STOP to all", "roll call", "CLEAR", "ADDRESS", "PLACE", "RESET",
        "verify LOADED", "status IDLE", "status STOPPED",
    }  # fmt: skip


def test_the_dissector_names_the_codes_of_the_wire_format():
    text = SCRIPT.read_text(encoding="utf-8")
    for table, codes in (("OPCODES", Opcode), ("STATES", RobotState), ("FAULTS", Fault)):
        body = text.split(f"local {table} = {{")[1].split("}")[0]
        named = dict(entry.strip().split(" = ") for entry in body.split(",") if entry.strip())
        assert named == {f"[{int(code)}]": f'"{code.name}"' for code in codes}, table

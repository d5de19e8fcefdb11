# SPDX-License-Identifier: Apache-2.0
"""Captures hold, for independent readers, every byte on the buses, with legal times."""

import os
import re
import shutil
import struct
import subprocess

import numpy as np
import pytest

from fiber_bus_bridge import bus_timing
from fiber_bus_bridge.bus import BUS_TIMINGS
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_bus_bridge.wire import (
    Addresses,
    Frames,
    Opcode,
    encode_command,
    encode_load,
    general_call,
)
from fiber_core.wire_units import WireMotion, WireUnits

pytest.importorskip("vcd", reason="pyvcd is not installed: no captures")

TO = Addresses([0, 0, 1, 1], [8, 0x77, 300, 1023], [False, False, True, True])
SIGROK = shutil.which("sigrok-cli")


@pytest.fixture(params=["100k", "400k", "1M", "1.7M", "3.4M"])
def mode(request):
    return request.param


def captured(mode, folder):
    """Capture messages of every kind; return bytes and acknowledges on the wire, by bus."""
    robots = Positioners(TO, [1, 2, 3, 4], 1_565_000, np.zeros((4, 2)))
    tap = Tap(SimulatedBuses(robots, bus_timing(mode)), bus_timing(mode))
    apart_s = 1000 / bus_timing(mode).clock_hz
    offsets = [0, 1, 2, 2, 2, 3, 3, 4, 4]
    orders = WireMotion.from_zero(WireUnits(), offsets, [1, 2, 3, 4], [5, -6, 7, 0])
    load = encode_load(TO, 5, orders)
    absent = Addresses([0, 1], [0x20, 301], [False, True])
    nothing = Frames(TO, np.zeros(5, dtype=int), np.zeros(0, dtype=np.uint8))
    tap.transfer(encode_command(Opcode.CLEAR, TO), 0, 0 * apart_s)
    tap.transfer(nothing, 17, 1 * apart_s)
    tap.transfer(encode_command(Opcode.IDENTIFY, TO), 9, 2 * apart_s)
    tap.transfer(load, 0, 3 * apart_s)  # refused: no robot is configured
    tap.transfer(encode_command(Opcode.STOP, absent), 0, 4 * apart_s)
    tap.transfer(encode_command(Opcode.STOP, general_call([0, 1])), 0, 5 * apart_s)
    replies = [e.replies for e in tap.exchanges]
    tap.write(folder)
    expected = {0: [], 1: []}
    for row in range(4):
        bus, low = int(TO.bus[row]), int(TO.address[row]) & 0xFF
        head = (0xF0 | (int(TO.address[row]) >> 8) << 1) if TO.ten_bit[row] else low << 1
        rest = [low] if TO.ten_bit[row] else []
        expected[bus].append(
            (0, row, [head, *rest, *encode_command(Opcode.CLEAR, TO).payload(row)], 1)
        )
        if rest:
            expected[bus].append((1, row, [head, *rest], 1))
        expected[bus].append((1, row + 0.5, [head | 1, *replies[1].table(17)[row]], 0))
        asks = encode_command(Opcode.IDENTIFY, TO).payload(row)
        expected[bus].append((2, row, [head, *rest, *asks], 1))
        expected[bus].append((2, row + 0.5, [head | 1, *replies[2].table(9)[row]], 0))
        expected[bus].append((3, row, [head, *rest, *load.payload(row)], 0))
    expected[0] += [(4, 0, [0x40], 0), (5, 0, [0, 0xF1, 0x30, 0x91], 1)]
    expected[1] += [(4, 0, [0xF2, 301 & 0xFF], 0), (5, 0, [0, 0xF1, 0x30, 0x91], 1)]
    return {bus: [(list(map(int, b)), a) for *_, b, a in sorted(x)] for bus, x in expected.items()}


def edges_of(path):
    """Edges of a VCD by signal, read without the project: step [s], [(time in steps, level)]."""
    names, edges, now, step = {}, {}, 0, None
    for line in path.read_text(encoding="ascii").splitlines():
        if match := re.match(r"\$timescale (\d+) ns \$end", line):
            step = int(match[1]) * 1e-9
        elif match := re.match(r"\$var wire 1 (\S+) (\w+) \$end", line):
            names[match[1]] = match[2]
            edges[match[2]] = []
        elif line.startswith("#"):
            now = int(line[1:])
        elif line[:1] in "01":
            edges[names[line[1:]]].append((now, int(line[0])))
    return step, edges


def i2c_of(sda, scl):
    """Decode edges: bytes and last acknowledge of each START, and the shortest times [steps]."""
    events = sorted([(t, 1, "sda", v) for t, v in sda] + [(t, 0, "scl", v) for t, v in scl])
    level, bits, parts = {"sda": 1, "scl": 1}, None, []
    since = {"sda": None, "scl": None}
    shortest = {}

    def note(name, value):
        shortest[name] = min(shortest.get(name, value), value)

    start = stop = data = None
    for t, _, line, v in events:
        if v == level[line]:
            since[line] = t if since[line] is None else since[line]
            continue
        if line == "scl" and v:
            note("low", t - since["scl"])
            if data is not None:
                note("data_setup", t - data)
            if bits is not None:
                bits.append(level["sda"])
        elif line == "scl":
            note("high", t - since["scl"])
            if start is not None:
                note("start_hold", t - start)
            start = None
        elif level["scl"] and not v:
            if stop is not None:
                note("free", t - stop)
            elif parts:
                note("restart_setup", t - since["scl"])
            if bits is not None:
                parts[-1] = bits[:-1]  # the rise before a repeated START is no bit
            start, stop, bits = t, None, []
            parts.append(bits)
        elif level["scl"] and v:
            note("stop_setup", t - since["scl"])
            parts[-1], bits, stop = bits[:-1], None, t
        data = t if line == "sda" else data
        level[line], since[line] = v, t
    decoded = []
    for part in parts:
        assert len(part) % 9 == 0
        table = np.array(part).reshape(-1, 9)
        decoded.append((np.packbits(table[:, :8], axis=1)[:, 0].tolist(), int(not table[-1, 8])))
    return decoded, shortest


def test_the_waveform_decodes_to_every_byte_and_keeps_the_minimum_times(mode, tmp_path):
    expected = captured(mode, tmp_path)
    step, edges = edges_of(tmp_path / "buses.vcd")
    timing = BUS_TIMINGS[mode]
    for bus in expected:
        decoded, shortest = i2c_of(edges[f"SDA{bus}"], edges[f"SCL{bus}"])
        assert decoded == expected[bus]
        high_s = {"100k": 4e-6, "400k": 0.6e-6, "1M": 0.26e-6, "1.7M": 120e-9, "3.4M": 60e-9}
        setup_s = {"100k": 250e-9, "400k": 100e-9, "1M": 50e-9, "1.7M": 10e-9, "3.4M": 10e-9}
        required = {
            "low": timing.low_s, "high": high_s[mode], "data_setup": setup_s[mode],
            "start_hold": timing.start_hold_s, "restart_setup": timing.restart_setup_s,
            "stop_setup": timing.stop_setup_s, "free": timing.free_s,
        }  # fmt: skip
        assert set(shortest) == set(required)
        for name, value in required.items():
            assert shortest[name] * step >= value - step, name


@pytest.mark.skipif(SIGROK is None, reason="sigrok-cli is not installed: no independent decoder")
def test_sigrok_decodes_every_byte(mode, tmp_path):
    expected = captured(mode, tmp_path)
    for bus, messages in expected.items():
        command = [
            SIGROK, "-i", tmp_path / "buses.vcd", "-I", "vcd",
            "-P", f"i2c:scl=SCL{bus}:sda=SDA{bus}:address_format=unshifted", "-A", "i2c=addr-data",
        ]  # fmt: skip
        # sigrok has its own Python, which must not find that of the tests
        plain = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "LANG": "C"}
        run = subprocess.run(command, env=plain, capture_output=True, text=True, timeout=60)
        assert run.returncode == 0, run.stderr
        parts = []
        for line in run.stdout.splitlines():
            words = line.split(": ", 1)[1]
            if words.startswith("Start"):
                parts.append([[], None])
            elif match := re.match(r"(?:Address|Data) (?:write|read): (\w+)", words):
                parts[-1][0].append(int(match[1], 16))
            elif words in ("ACK", "NACK"):
                parts[-1][1] = int(words == "ACK")
        assert [tuple(part) for part in parts] == messages


def test_the_packets_hold_every_byte(tmp_path):
    expected = captured("1M", tmp_path)
    data = (tmp_path / "buses.pcap").read_bytes()
    magic, *_, link_type = struct.unpack("<IHHiIII", data[:24])
    assert (magic, link_type) == (0xA1B23C4D, 209)
    at, found, before = 24, {0: [], 1: []}, 0
    while at < len(data):
        seconds, nanoseconds, size, original = struct.unpack("<IIII", data[at : at + 16])
        body = data[at + 16 : at + 16 + size]
        assert size == original and seconds * 10**9 + nanoseconds >= before
        before = seconds * 10**9 + nanoseconds
        bus, flags = struct.unpack(">BI", body[:5])
        assert flags == 0
        found[bus].append(list(body[5:]))
        at += 16 + size
    assert found == {bus: [b for b, _ in parts] for bus, parts in expected.items()}


def test_a_tap_keeps_messages_up_to_its_limit(tmp_path):
    robots = Positioners(TO, [1, 2, 3, 4], 1_565_000, np.zeros((4, 2)))
    tap = Tap(SimulatedBuses(robots), bus_timing("1M"), limit=5)
    for _ in range(3):
        tap.transfer(encode_command(Opcode.CLEAR, TO), 0, 0.0)
    assert (tap.kept, tap.dropped) == (4, 8)
    tap.write(tmp_path / "new")
    assert (tap.kept, tap.dropped) == (0, 0)
    assert set(os.listdir(tmp_path / "new")) == {"buses.vcd", "buses.pcap"}

#!/usr/bin/env python3
"""Throw random and mutated bytes at a positioner and at the bridge's decoders.

Nothing may crash, and whatever is accepted must be, byte for byte, what our own encoder
writes for the values decoded from it. Mutations of valid frames: bits turned over, cut off,
lengthened, two frames spliced, bytes exchanged.
"""

import argparse
import sys
from collections import Counter

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_bus_bridge.wire import (
    VERIFY_BYTES,
    Addresses,
    Configuration,
    Frames,
    Opcode,
    decode_command,
    decode_identity,
    decode_load,
    decode_status,
    encode_address,
    encode_command,
    encode_config,
    encode_identity,
    encode_load,
    encode_status,
    general_call,
)
from fiber_core.wire_units import WireUnits

__all__ = ["fuzz_positioner", "fuzz_replies", "main"]

_UNITS = WireUnits()
_ROBOT = Addresses([0], [300], [True])
_BATCH = 5000


def mutated(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes like these but a little wrong."""
    data = bytearray(payload)
    for _ in range(rng.integers(1, 3)):
        kind = rng.integers(5)
        if kind == 0 and data:
            for _ in range(rng.integers(1, 6)):
                data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        elif kind == 1:
            del data[rng.integers(len(data) + 1) :]
        elif kind == 2:
            data += rng.bytes(rng.integers(1, 4))
        elif kind == 3:
            data[rng.integers(len(data) + 1) :] = other[rng.integers(len(other)) :]
        elif len(data) > 1:
            i, j = rng.integers(len(data), size=2)
            data[i], data[j] = data[j], data[i]
    return bytes(data)


def _valid(to, rng):
    """Valid frames of every kind to one target."""
    called = to.address[0] == 0
    short = (Opcode.STOP, Opcode.CLEAR, Opcode.RESET, Opcode.IDENTIFY, Opcode.HEARTBEAT)
    frames = [encode_command(opcode, to) for opcode in short]
    frames += [encode_command(Opcode.GO, to, s, 100 * s) for s in range(16)]
    limits, speed = np.array([[[-2_000_000, 2_000_000], [0, 2_000_000]]]), np.array([[8000, 8000]])
    frames.append(encode_config(Configuration(_UNITS, limits, speed, 1000, 20), to))
    frames.append(encode_address(to, [rng.integers(2, 2**32)], _ROBOT))
    for sequence in range(0 if called else 16):
        counts = rng.integers(0, 4, 2)
        ticks, velocity = rng.integers(1, 100, counts.sum()), rng.integers(-99, 99, counts.sum())
        offsets = np.concatenate([[0], np.cumsum(counts)])
        frames.append(encode_load(_UNITS, to, sequence, offsets, ticks, velocity))
    return [f.payload(0) for f in frames]


def _stands(payload, to):
    """Whether bytes are what our encoders write for the values in them."""
    address, ten_bit = int(to.address[0]), bool(to.ten_bit[0])
    orders = decode_load(_UNITS, Frames.from_bytes(to, [payload]))
    if orders.ok[0]:
        columns = orders.sequence, orders.offsets, orders.ticks, orders.velocity
        return encode_load(_UNITS, to, *columns).payload(0) == payload
    try:
        opcode, low = decode_command(payload, address, ten_bit)
    except WireError:
        return False
    body = payload[1:] if address == 0 and not ten_bit else payload
    if opcode == Opcode.GO:
        countdown = int.from_bytes(body[1:3], "big")
        return encode_command(opcode, to, low, countdown).payload(0) == payload
    if opcode == Opcode.ADDRESS:
        form = int.from_bytes(body[5:7], "big")
        new = Addresses([0], [form & 0x7FFF], [form >> 15])
        again = encode_address(to, [int.from_bytes(body[1:5], "big")], new)
        return again.payload(0) == payload
    # a CONFIG is its fields, one after the other: its checksum is all there is to break
    return opcode == Opcode.CONFIG or encode_command(opcode, to).payload(0) == payload


def fuzz_positioner(count: int, rng: np.random.Generator) -> tuple[Counter, list[str]]:
    """Send frames to a configured robot; returns what was accepted, and what should not have."""
    robots = Positioners(_ROBOT, [1], _UNITS.quantum_prad, [[0, 1_000_000]])
    buses, told, wrong = SimulatedBuses(robots), Counter(), []
    done = 0
    while done < count:
        to = (_ROBOT, general_call([0]))[rng.integers(2)]
        valid = _valid(to, rng)
        size = min(_BATCH, count - done)
        payloads = [
            rng.bytes(rng.integers(1, 40))
            if rng.random() < 0.3
            else mutated(valid[rng.integers(len(valid))], valid[rng.integers(len(valid))], rng)
            for _ in range(size)
        ]
        payloads = [p or b"\x00" for p in payloads]
        frames = Frames.from_bytes(to[np.zeros(size, dtype=int)], payloads)
        # configured anew each time: most of what is accepted stops or clears it
        setup = [p for p in _valid(_ROBOT, rng) if p[0] >> 4 in (Opcode.CLEAR, Opcode.CONFIG)]
        buses.transfer(Frames.from_bytes(_ROBOT[np.zeros(len(setup), int)], setup), 0, 0.0)
        ack = buses.transfer(frames, 0, 0.0).ack
        told["refused"] += int((ack == Ack.REFUSED).sum())
        for row in np.flatnonzero(ack == Ack.OK):
            told["accepted"] += 1
            if not _stands(payloads[row], to):
                wrong.append(f"accepted {payloads[row].hex(' ')} to {to.address[0]}")
        done += size
    return told, wrong


def fuzz_replies(count: int, rng: np.random.Generator) -> tuple[Counter, list[str]]:
    """Decode random and mutated replies; returns what was accepted, and what should not have."""
    told, wrong, done = Counter(), [], 0
    while done < count:
        to = _ROBOT[np.zeros(_BATCH, dtype=int)]
        state, boot = rng.integers(1, 8, _BATCH), rng.integers(256, size=_BATCH)
        status = encode_status(
            to, state, 3, rng.integers(65_536, size=_BATCH), boot, 0, 0,
            rng.integers(-(2**31), 2**31, (_BATCH, 2)),
        )  # fmt: skip
        identity = encode_identity(to, rng.integers(2**32, size=_BATCH), boot)
        for table, decode, encode in (
            (status, decode_status, _status_again),
            (status[:, :VERIFY_BYTES], decode_status, _verify_again),
            (identity, decode_identity, lambda t, r: encode_identity(t, r.serial, r.boot)),
        ):
            data = table.copy()
            for _ in range(rng.integers(1, 8)):
                at = rng.integers(data.shape[1], size=_BATCH)
                data[np.arange(_BATCH), at] ^= (1 << rng.integers(8, size=_BATCH)).astype(np.uint8)
            noise = rng.random(_BATCH) < 0.3
            data[noise] = rng.integers(256, size=(noise.sum(), data.shape[1]))
            decoded = decode(to, data)
            ok = np.flatnonzero(decoded.ok)
            again = encode(to, decoded)[ok]
            off = (again != data[ok]).any(axis=1)
            told["accepted"] += len(ok)
            told["refused"] += _BATCH - len(ok)
            wrong += [f"decoded {data[row].tobytes().hex(' ')}" for row in ok[off]]
            done += _BATCH
    return told, wrong


def _status_again(to, s):
    columns = s.state, s.sequence, s.order_crc, s.boot, s.fault, s.alerts, s.position
    return encode_status(to, *columns)


def _verify_again(to, s):
    return _status_again(to, s)[:, :VERIFY_BYTES]


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns 1 when something wrong was accepted."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=1_000_000, help="half to each side")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    failed = 0
    for name, fuzz in (("positioner", fuzz_positioner), ("decoders", fuzz_replies)):
        told, wrong = fuzz(args.frames // 2, np.random.default_rng(args.seed))
        print(f"{name}: {told['refused']} refused, {told['accepted']} accepted, {len(wrong)} wrong")
        print("\n".join(wrong[:20]))
        failed += len(wrong)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

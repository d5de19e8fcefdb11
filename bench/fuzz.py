#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Send random and mutated bytes to a positioner and to the decoders of the bridge.

No input may cause a crash, and an accepted frame must be, byte for byte, the frame that the encoder
writes for the decoded values; an order of moves must be one of the same motion. Mutations of valid
frames: flipped bits, frames cut short or lengthened, two frames spliced, bytes exchanged.
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
    Bytes,
    Configuration,
    Frames,
    Opcode,
    Speeds,
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
from fiber_core.array_types import Bools
from fiber_core.drive.named import with_drive
from fiber_core.presets import preset
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["fuzz_positioner", "fuzz_replies", "main"]

_UNITS = WireUnits()
_ROBOT = Addresses(np.array([0]), np.array([300]), np.array([True]))
_LISTED = with_drive(preset("desi", 7), "desi")
_ALL_LISTS = Speeds.of(_LISTED, WireUnits.for_plane(_LISTED))
assert _ALL_LISTS is not None  # DESI's motors have listed speeds
_LISTS = _ALL_LISTS[:1]  # of the robot, in half of the batches
_BATCH = 5000


def mutated(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a valid frame with one or two mutations; `other` supplies bytes to splice."""
    data = bytearray(payload)
    for _ in range(rng.integers(1, 3)):
        kind = rng.integers(5)
        if kind == 0 and data:
            for _ in range(rng.integers(1, 6)):
                data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        elif kind == 1:
            del data[rng.integers(len(data) + 1) :]
        elif kind == 2:
            data += rng.bytes(int(rng.integers(1, 4)))
        elif kind == 3:
            data[rng.integers(len(data) + 1) :] = other[rng.integers(len(other)) :]
        elif len(data) > 1:
            i, j = rng.integers(len(data), size=2)
            data[i], data[j] = data[j], data[i]
    return bytes(data)


def _valid(to: Addresses, rng: np.random.Generator, lists: Speeds | None = None) -> list[bytes]:
    """Valid frames of every kind to one target."""
    called = to.address[0] == 0
    short = (Opcode.STOP, Opcode.CLEAR, Opcode.RESET, Opcode.IDENTIFY, Opcode.HEARTBEAT)
    frames = [encode_command(opcode, to) for opcode in short]
    frames += [encode_command(Opcode.GO, to, s, 100 * s) for s in range(16)]
    limits, speed = np.array([[[-2_000_000, 2_000_000], [0, 2_000_000]]]), np.array([[8000, 8000]])
    frames.append(encode_config(Configuration(_UNITS, limits, speed, 1000, 20, listed=lists), to))
    frames.append(encode_address(to, [rng.integers(2, 2**32)], _ROBOT))
    for sequence in range(0 if called else 16):
        counts = rng.integers(0, 4, 2)
        ticks, velocity = rng.integers(1, 100, counts.sum()), rng.integers(-99, 99, counts.sum())
        offsets = Parts.from_counts(counts).offsets
        motion = WireMotion.from_zero(_UNITS, offsets, ticks, velocity)
        frames.append(encode_load(to, sequence, motion))
        if lists is not None:
            frames.append(_moves(to, sequence, lists, rng))
    return [f.payload(0) for f in frames]


def _moves(to: Addresses, sequence: int, lists: Speeds, rng: np.random.Generator) -> Frames:
    """An order of a run, or none, and the approach of either joint."""
    run, creep = (int.from_bytes(lists.content[0, at : at + 2].tobytes(), "big") for at in (10, 28))
    segments, counts = [], []
    for sign in (-1, 1):
        ticks = int(rng.integers(0, 60))
        forth = 276 + int(rng.integers(0, 30))
        joint = [(ticks + 7, sign * run), (6 + ticks, 0)] if ticks % 3 else []
        joint += [(275, -sign * creep), (forth, sign * creep)]
        segments += joint
        counts.append(len(joint))
    ticks, velocity = np.array(segments).T
    motion = WireMotion.from_zero(_UNITS, Parts.from_counts(counts).offsets, ticks, velocity)
    return encode_load(to, sequence, motion, lists)


def _same_moves(payload: bytes, to: Addresses, lists: Speeds) -> bool:
    # whether the frame that the encoder writes for an order of moves is the same motion
    orders = decode_load(_UNITS, Frames.from_bytes(to, [payload]), lists)
    again = decode_load(_UNITS, encode_load(to, orders.sequence, orders.motion, lists), lists)
    turns = [np.repeat(one.motion.velocity, one.motion.ticks).tobytes() for one in (orders, again)]
    return bool(orders.ok[0] and again.ok[0] and turns[0] == turns[1])


def _is_canonical(payload: bytes, to: Addresses, lists: Speeds | None) -> bool:
    """Whether a frame is the one that the encoders write for its decoded values."""
    address, ten_bit = int(to.address[0]), bool(to.ten_bit[0])
    if payload[0] >> 4 == Opcode.MOVES:
        return lists is not None and _same_moves(payload, to, lists)
    orders = decode_load(_UNITS, Frames.from_bytes(to, [payload]))
    if orders.ok[0]:
        return encode_load(to, orders.sequence, orders.motion).payload(0) == payload
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
        new = Addresses(np.array([0]), np.array([form & 0x7FFF]), np.array([form >> 15 == 1]))
        encoded = encode_address(to, [int.from_bytes(body[1:5], "big")], new)
        return encoded.payload(0) == payload
    # a CONFIG is its fields one after the other: only its checksum can be wrong
    return opcode == Opcode.CONFIG or encode_command(opcode, to).payload(0) == payload


def fuzz_positioner(count: int, rng: np.random.Generator) -> tuple[Counter[str], list[str]]:
    """Send frames to a configured robot.

    Args:
        count: number of frames.
        rng: source of randomness.

    Returns:
        The numbers of accepted and refused frames, and the frames that were wrongly accepted.
    """
    robots = Positioners(_ROBOT, [1], _UNITS.quantum_prad, [[0, 1_000_000]])
    buses, wrong, done = SimulatedBuses(robots), [], 0
    counts: Counter[str] = Counter()
    while done < count:
        to = (_ROBOT, general_call([0]))[rng.integers(2)]
        lists = _LISTS if rng.random() < 0.5 else None
        valid = _valid(to, rng, lists if to is _ROBOT else None)
        size = min(_BATCH, count - done)
        payloads = [
            rng.bytes(int(rng.integers(1, 40)))
            if rng.random() < 0.3
            else mutated(valid[rng.integers(len(valid))], valid[rng.integers(len(valid))], rng)
            for _ in range(size)
        ]
        payloads = [p or b"\x00" for p in payloads]
        frames = Frames.from_bytes(to[np.zeros(size, dtype=int)], payloads)
        # configured for each batch: most accepted frames stop or clear the robot
        setup = [
            p for p in _valid(_ROBOT, rng, lists) if p[0] >> 4 in (Opcode.CLEAR, Opcode.CONFIG)
        ]
        buses.transfer(Frames.from_bytes(_ROBOT[np.zeros(len(setup), int)], setup), 0, 0.0)
        ack = buses.transfer(frames, 0, 0.0).ack
        counts["refused"] += int((ack == Ack.REFUSED).sum())
        for row in np.flatnonzero(ack == Ack.OK):
            counts["accepted"] += 1
            if not _is_canonical(payloads[row], to, lists):
                wrong.append(f"accepted {payloads[row].hex(' ')} to {to.address[0]}")
        done += size
    return counts, wrong


def fuzz_replies(count: int, rng: np.random.Generator) -> tuple[Counter[str], list[str]]:
    """Decode random and mutated replies; arguments and result as in fuzz_positioner."""
    counts: Counter[str] = Counter()
    wrong, done = [], 0
    while done < count:
        to = _ROBOT[np.zeros(_BATCH, dtype=int)]
        state, boot = rng.integers(1, 8, _BATCH), rng.integers(256, size=_BATCH)
        status = encode_status(
            to, state, 3, rng.integers(65_536, size=_BATCH), boot, 0, 0,
            rng.integers(-(2**31), 2**31, (_BATCH, 2)),
        )  # fmt: skip
        identity = encode_identity(to, rng.integers(2**32, size=_BATCH), boot)
        for table, encode_decoded in (
            (status, _decoded_status),
            (status[:, :VERIFY_BYTES], _decoded_verify),
            (identity, _decoded_identity),
        ):
            data = table.copy()
            for _ in range(rng.integers(1, 8)):
                at = rng.integers(data.shape[1], size=_BATCH)
                data[np.arange(_BATCH), at] ^= (1 << rng.integers(8, size=_BATCH)).astype(np.uint8)
            noise = rng.random(_BATCH) < 0.3
            data[noise] = rng.integers(256, size=(noise.sum(), data.shape[1]))
            valid, encoded = encode_decoded(to, data)
            ok = np.flatnonzero(valid)
            off = (encoded[ok] != data[ok]).any(axis=1)
            counts["accepted"] += len(ok)
            counts["refused"] += _BATCH - len(ok)
            wrong += [f"decoded {data[row].tobytes().hex(' ')}" for row in ok[off]]
            done += _BATCH
    return counts, wrong


def _decoded_status(to: Addresses, data: Bytes) -> tuple[Bools, Bytes]:
    """Whether each reply is valid, and the encoding of its decoded values."""
    s = decode_status(to, data)
    columns = s.state, s.sequence, s.order_crc, s.boot, s.fault, s.alerts, s.position
    return s.ok, encode_status(to, *columns)


def _decoded_verify(to: Addresses, data: Bytes) -> tuple[Bools, Bytes]:
    valid, encoded = _decoded_status(to, data)
    return valid, encoded[:, :VERIFY_BYTES]


def _decoded_identity(to: Addresses, data: Bytes) -> tuple[Bools, Bytes]:
    identity = decode_identity(to, data)
    return identity.ok, encode_identity(to, identity.serial, identity.boot)


def main(argv: list[str] | None = None) -> int:
    """Run the command; return 1 when a wrong frame was accepted."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=1_000_000, help="half for each side")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    failed = 0
    for name, fuzz in (("positioner", fuzz_positioner), ("decoders", fuzz_replies)):
        counts, wrong = fuzz(args.frames // 2, np.random.default_rng(args.seed))
        refused, accepted = counts["refused"], counts["accepted"]
        print(f"{name}: {refused} refused, {accepted} accepted, {len(wrong)} wrong")
        print("\n".join(wrong[:20]))
        failed += len(wrong)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

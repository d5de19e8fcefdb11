# SPDX-License-Identifier: Apache-2.0
"""Edges of SDA and SCL for each message, with the minimum times of the standard."""

from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

import numpy as np

from fiber_bus_bridge.bus import Ack, BusTiming, Exchange
from fiber_core.array_types import Floats, Ints

__all__ = ["Waveform", "waveform", "wire_bytes"]

SDA, SCL = 0, 1
_Edges: TypeAlias = tuple[Floats, Ints, Ints, Ints]


class Waveform(NamedTuple):
    """Edges of the two lines of each bus, in order of time; before them the lines are high.

    Args:
        time_s: time of each edge [s], shape (e,).
        bus: bus number, shape (e,).
        line: 0 for SDA, 1 for SCL, shape (e,).
        level: level after the edge, 0 or 1, shape (e,).
    """

    time_s: Floats
    bus: Ints
    line: Ints
    level: Ints


def wire_bytes(exchange: Exchange, row: int) -> list[list[tuple[int, bool]]]:
    """Return the bytes of a message and their acknowledges, one list for each START.

    A message ends at a byte that is not acknowledged. A message that failed because of its
    lines has no bytes.
    """
    frames, replies = exchange.frames, exchange.replies
    ack = replies.ack[row]
    if ack >= Ack.LOST:
        return []
    address, ten_bit = int(frames.to.address[row]), bool(frames.to.ten_bit[row])
    written = list(frames.payload(row))
    read = list(replies.data[replies.offsets[row] : replies.offsets[row + 1]])
    head = 0xF0 | (address >> 8) << 1 if ten_bit else address << 1
    low = [address & 0xFF] if ten_bit else []
    if ack == Ack.NO_ADDRESS:
        only_read = bool(read) and not written and not ten_bit
        address_bytes = [(byte, True) for byte in [head | only_read, *low]]
        return [[*address_bytes[:-1], (address_bytes[-1][0], False)]]
    parts = []
    if written or ten_bit or not read:
        part = [(byte, True) for byte in [head, *low, *written]]
        if ack == Ack.REFUSED:
            return [[*part[:-1], (part[-1][0], False)]]
        parts.append(part)
    if read:
        # the controller acknowledges all but the last byte
        acks = [True] * (len(read) - 1) + [False]
        parts.append([(head | 1, True), *zip(read, acks)])
    return parts


def waveform(exchanges: Iterable[Exchange], timing: BusTiming) -> Waveform:
    """Return the edges of all messages that have bytes on the wire.

    From its START a message lasts as long as BusTiming.message_s returns. During a stretched
    clock and the master code of High-speed mode the lines rest; bits read wrong are shown as
    received. The clock is low for tLOW and high for the rest of a bit; SDA changes after a
    quarter of the low time.
    """
    parts = [_edges(e, row, timing) for e in exchanges for row in range(len(e.frames))]
    parts = [part for part in parts if part is not None]
    if not parts:
        nothing = np.zeros(0)
        none = nothing.astype(np.int64)
        return Waveform(nothing, none, none, none)
    time_s, bus, line, level = (np.concatenate(column) for column in zip(*parts))
    order = np.argsort(time_s, kind="stable")
    return Waveform(time_s[order], bus[order], line[order], level[order])


def _edges(exchange: Exchange, row: int, timing: BusTiming) -> _Edges | None:
    """Times, buses, lines and levels of the edges of one message, None without bytes."""
    parts = wire_bytes(exchange, row)
    if not parts:
        return None
    times: list[float] = []
    lines: list[int] = []
    levels: list[int] = []

    def edge(at: float, line: int, level: int) -> None:
        times.append(at)
        lines.append(line)
        levels.append(level)

    bit_s, low_s = 1.0 / timing.clock_hz, timing.low_s
    t = float(exchange.replies.start_s[row])
    sda = 1
    for number, part in enumerate(parts):
        if number:  # repeated START: both lines up, then SDA down
            if not sda:
                edge(t + low_s / 4, SDA, 1)
            edge(t + low_s, SCL, 1)
            t += low_s + timing.restart_setup_s
        edge(t, SDA, 0)
        sda = 0
        t += timing.start_hold_s
        edge(t, SCL, 0)
        for byte, acknowledged in part:
            for k in range(9):
                bit = (byte >> (7 - k)) & 1 if k < 8 else int(not acknowledged)
                if bit != sda:
                    edge(t + low_s / 4, SDA, bit)
                    sda = bit
                edge(t + low_s, SCL, 1)
                t += bit_s
                edge(t, SCL, 0)
    if sda:
        edge(t + low_s / 4, SDA, 0)
    edge(t + low_s, SCL, 1)
    edge(t + low_s + timing.stop_setup_s, SDA, 1)
    bus = np.full(len(times), exchange.frames.to.bus[row])
    return np.array(times), bus, np.array(lines), np.array(levels)

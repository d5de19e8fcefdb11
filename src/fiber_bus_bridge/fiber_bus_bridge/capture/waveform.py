"""SDA and SCL of messages, edge by edge, with the least times of the standard kept."""

from typing import NamedTuple

import numpy as np

from fiber_bus_bridge.bus import Ack, BusTiming, Exchange

__all__ = ["Waveform", "waveform", "wire_bytes"]

SDA, SCL = 0, 1


class Waveform(NamedTuple):
    """Edges of the two lines of each bus, in order of time; lines are high before.

    Args:
        time_s: when [s], shape (e,).
        bus: on which bus, shape (e,).
        line: 0 for SDA, 1 for SCL, shape (e,).
        level: 0 or 1 from then on, shape (e,).
    """

    time_s: np.ndarray
    bus: np.ndarray
    line: np.ndarray
    level: np.ndarray


def wire_bytes(exchange: Exchange, row: int) -> list[list[tuple[int, bool]]]:
    """Return the bytes of a message and their acknowledges, one list for each START.

    A message that was not acknowledged ends there. What failed for its lines has no bytes.
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
        there = [(byte, True) for byte in [head | only_read, *low]]
        return [[*there[:-1], (there[-1][0], False)]]
    turns = []
    if written or ten_bit or not read:
        part = [(byte, True) for byte in [head, *low, *written]]
        if ack == Ack.REFUSED:
            return [[*part[:-1], (part[-1][0], False)]]
        turns.append(part)
    if read:
        # the controller acknowledges all but the last byte
        acks = [True] * (len(read) - 1) + [False]
        turns.append([(head | 1, True), *zip(read, acks)])
    return turns


def waveform(exchanges, timing: BusTiming) -> Waveform:
    """Return the edges of all messages that had bytes.

    From START a message takes what BusTiming.message_s says. A slow clock and the
    master code of High-speed mode are time in which the lines rest, and bits read wrong are
    shown as what came of them. A bit is low for tLOW and high for the rest of its time; SDA
    changes a quarter into the low.
    """
    parts = [_message(e, row, timing) for e in exchanges for row in range(len(e.frames))]
    parts = [part for part in parts if part is not None]
    if not parts:
        nothing = np.zeros(0)
        return Waveform(nothing, *(nothing.astype(np.int64),) * 3)
    time_s, bus, line, level = (np.concatenate(column) for column in zip(*parts))
    order = np.argsort(time_s, kind="stable")
    return Waveform(time_s[order], bus[order], line[order], level[order])


def _message(exchange, row, timing):
    turns = wire_bytes(exchange, row)
    if not turns:
        return None
    times, lines, levels = [], [], []

    def edge(at, line, level):
        times.append(at)
        lines.append(line)
        levels.append(level)

    bit_s, low_s = 1.0 / timing.clock_hz, timing.low_s
    t = float(exchange.replies.start_s[row])
    sda = 1
    for turn, part in enumerate(turns):
        if turn:  # repeated START: both lines up, then SDA down
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

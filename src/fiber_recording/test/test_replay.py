# SPDX-License-Identifier: Apache-2.0
"""Replay of frames: a robot starts the last order it acknowledged, at a GO with its number."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import addresses_of
from fiber_bus_bridge.wire import Opcode, encode_command, encode_load, general_call
from fiber_core.frame_log import FrameLog
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.replay import replay

PLANE = preset("desi", 3)
UNITS = WireUnits.for_plane(PLANE)
ADDRESSES = addresses_of(PLANE)
START = np.array([[0, 10], [20, 30], [40, 50]])


def log(frames, t=0.0, ack=0, read=False):
    count = len(frames)
    return FrameLog(
        t + 1e-3 * np.arange(count),
        frames.to.bus,
        frames.to.address,
        frames.to.ten_bit,
        np.full(count, read),
        np.full(count, ack),
        frames.offsets,
        frames.data,
    )


def load(rows, sequence, ticks, velocity):
    """One segment of theta for each robot."""
    offsets = np.minimum(np.arange(2 * len(rows) + 1) // 2 + np.arange(2 * len(rows) + 1) % 2, 99)
    orders = WireMotion.from_zero(UNITS, offsets, ticks, velocity)
    return encode_load(ADDRESSES[np.array(rows)], sequence, orders)


def go(sequence):
    return encode_command(Opcode.GO, general_call([0]), sequence)


def replay_and_end(*logs):
    followed = replay(PLANE, UNITS, START, logs)
    return followed, followed.end


def test_orders_are_followed_from_the_encoders_before_the_plan():
    followed, end = replay_and_end(
        log(load([0, 1, 2], 1, [5, 6, 7], [1, -2, 3]), 1.0), log(go(1), 4.0)
    )
    assert np.array_equal(end, START + [[5, 0], [-12, 0], [21, 0]])
    assert followed.started.all() and np.array_equal(followed.load_bytes, [7, 7, 7])
    assert followed.bus_time_s == pytest.approx(3.0)


def test_nothing_starts_without_a_go():
    followed, end = replay_and_end(log(load([0], 1, [5], [1])))
    assert not followed.started.any() and np.array_equal(end, START) and followed.bus_time_s == 0.0


def test_a_go_with_another_number_starts_no_robot():
    followed, _ = replay_and_end(
        log(load([0, 1], 1, [5, 5], [1, 1])), log(load([1], 2, [9], [1])), log(go(2))
    )
    assert np.array_equal(followed.started, [False, True, False])


def test_the_last_order_counts():
    _, end = replay_and_end(log(load([0], 1, [5], [1])), log(load([0], 1, [8], [2])), log(go(1)))
    assert np.array_equal(end[0], START[0] + [16, 0])


@pytest.mark.parametrize("how", ["no address", "refused"])
def test_an_order_that_was_not_acknowledged_is_not_stored(how):
    not_stored = log(load([0], 1, [8], [2]), ack=1 + (how == "refused"))
    _, end = replay_and_end(log(load([0], 1, [5], [1])), not_stored, log(go(1)))
    assert np.array_equal(end[0], START[0] + [5, 0])


def test_a_cleared_order_does_not_start():
    clear = encode_command(Opcode.CLEAR, ADDRESSES[np.array([0])])
    followed, _ = replay_and_end(log(load([0, 1], 1, [5, 5], [1, 1])), log(clear), log(go(1)))
    assert np.array_equal(followed.started, [False, True, False])


def test_an_order_starts_once():
    once = (log(load([0], 1, [5], [1])), log(go(1)))
    assert np.array_equal(replay_and_end(*once)[1], replay_and_end(*once, log(go(1)))[1])


def test_bytes_read_from_robots_are_not_orders():
    followed, _ = replay_and_end(log(load([0], 1, [5], [1]), read=True), log(go(1)))
    assert not followed.started.any()


@pytest.mark.parametrize("stopped", [[], [0], [1], [0, 1]])
def test_a_start_cancelled_in_its_countdown_is_part_of_the_phase_but_moves_no_robot(stopped):
    plane = replace(PLANE, bus=[0, 0, 1], address=[8, 9, 8])
    addresses = addresses_of(plane)
    motion = WireMotion.from_zero(UNITS, [0, 1, 1, 2, 2, 3, 3], [5, 6, 7], [1, -2, 3])
    orders = encode_load(addresses, 1, motion)
    go_to_all = encode_command(Opcode.GO, general_call([0, 1]), 1, 6000)  # 60 ms
    logs = [log(orders, 1.0), log(go_to_all, 2.0)]
    if stopped:
        logs.append(log(encode_command(Opcode.STOP, general_call(stopped)), 2.03))
    followed = replay(plane, UNITS, START, logs)
    cancelled = np.isin(plane.bus, stopped)
    assert np.array_equal(followed.started, ~cancelled)
    assert np.array_equal(
        followed.end, START + np.where(cancelled, 0, [5, -12, 21])[:, None] * [1, 0]
    )
    assert np.array_equal(followed.executed.end == UNITS.to_angles(START), (followed.end == START))
    assert followed.motion.ticks.tolist() == ([] if cancelled.all() else [5, 6, 7])

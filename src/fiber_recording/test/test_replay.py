"""Frames say what robots were told: the last order acknowledged, if a GO of its number came."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import addresses_of
from fiber_bus_bridge.wire import Opcode, encode_command, encode_load, general_call
from fiber_core.frame_log import FrameLog
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_recording.replay import replay

PLANE = preset("desi", 3)
UNITS = WireUnits.for_plane(PLANE)
TO = addresses_of(PLANE)
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
    return encode_load(UNITS, TO[np.array(rows)], sequence, offsets, ticks, velocity)


def go(sequence):
    return encode_command(Opcode.GO, general_call([0]), sequence)


def ends(*logs):
    told = replay(PLANE, UNITS, START, logs)
    return told, told.end


def test_orders_are_followed_from_where_the_encoders_were():
    told, end = ends(log(load([0, 1, 2], 1, [5, 6, 7], [1, -2, 3]), 1.0), log(go(1), 4.0))
    assert np.array_equal(end, START + [[5, 0], [-12, 0], [21, 0]])
    assert told.started.all() and np.array_equal(told.load_bytes, [7, 7, 7])
    assert told.bus_time_s == pytest.approx(3.0)


def test_nothing_starts_without_a_go():
    told, end = ends(log(load([0], 1, [5], [1])))
    assert not told.started.any() and np.array_equal(end, START) and told.bus_time_s == 0.0


def test_a_go_of_another_number_starts_nobody():
    told, _ = ends(log(load([0, 1], 1, [5, 5], [1, 1])), log(load([1], 2, [9], [1])), log(go(2)))
    assert np.array_equal(told.started, [False, True, False])


def test_the_last_order_counts():
    _, end = ends(log(load([0], 1, [5], [1])), log(load([0], 1, [8], [2])), log(go(1)))
    assert np.array_equal(end[0], START[0] + [16, 0])


@pytest.mark.parametrize("how", ["no address", "refused"])
def test_what_was_not_acknowledged_was_not_taken(how):
    lost = log(load([0], 1, [8], [2]), ack=1 + (how == "refused"))
    _, end = ends(log(load([0], 1, [5], [1])), lost, log(go(1)))
    assert np.array_equal(end[0], START[0] + [5, 0])


def test_a_cleared_order_does_not_start():
    clear = encode_command(Opcode.CLEAR, TO[np.array([0])])
    told, _ = ends(log(load([0, 1], 1, [5, 5], [1, 1])), log(clear), log(go(1)))
    assert np.array_equal(told.started, [False, True, False])


def test_an_order_starts_once():
    once = (log(load([0], 1, [5], [1])), log(go(1)))
    assert np.array_equal(ends(*once)[1], ends(*once, log(go(1)))[1])


def test_bytes_read_from_robots_are_no_orders():
    told, _ = ends(log(load([0], 1, [5], [1]), read=True), log(go(1)))
    assert not told.started.any()


@pytest.mark.parametrize("stopped", [[], [0], [1], [0, 1]])
def test_who_is_called_off_belongs_to_what_was_told_to_go_but_stays(stopped):
    plane = replace(PLANE, bus=[0, 0, 1], address=[8, 9, 8])
    to = addresses_of(plane)
    orders = encode_load(UNITS, to, 1, [0, 1, 1, 2, 2, 3, 3], [5, 6, 7], [1, -2, 3])
    told_to_go = encode_command(Opcode.GO, general_call([0, 1]), 1, 6000)  # 60 ms
    logs = [log(orders, 1.0), log(told_to_go, 2.0)]
    if stopped:
        logs.append(log(encode_command(Opcode.STOP, general_call(stopped)), 2.03))
    told = replay(plane, UNITS, START, logs)
    off = np.isin(plane.bus, stopped)
    assert np.array_equal(told.started, ~off)
    assert np.array_equal(told.end, START + np.where(off, 0, [5, -12, 21])[:, None] * [1, 0])
    assert np.array_equal(told.executed.end == UNITS.to_angles(START), (told.end == START))
    assert told.motion.ticks.tolist() == ([] if off.all() else [5, 6, 7])

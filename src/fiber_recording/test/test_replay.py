# SPDX-License-Identifier: Apache-2.0
"""Replay of frames: a robot starts the last order it acknowledged, at a GO with its number."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import addresses_of
from fiber_bus_bridge.wire import (
    Frames,
    Opcode,
    RobotState,
    encode_command,
    encode_load,
    encode_place,
    encode_status,
    general_call,
)
from fiber_core.frame_log import FrameLog
from fiber_core.outcomes import PlanOutcome
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording import build_recording, load_recording, save_recording
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


def replies(state, position, t, boot=0, rows=(0, 1, 2)):
    """Readings of robots at a time [s]; the position is that of all."""
    to = ADDRESSES[np.array(rows)]
    data = encode_status(to, state, 1, 0, boot, 0, 0, position[list(rows)])
    offsets = np.arange(len(data) + 1) * data.shape[1]
    return log(Frames(to, offsets, data.ravel()), t, read=True)


def built(*logs, counts_after=None):
    """The recording of a plan, which also certifies the motion that was carried out."""
    ended = PlanOutcome(0, PLANE.ids, np.zeros(3), np.zeros(3), np.zeros(3))
    return build_recording(
        PLANE, UNITS, logs=logs, outcome=ended, counts_before=START, counts_after=counts_after
    )


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


FAR = UNITS.to_counts(1.35)  # in 0.1 ms no joint turns that far
WAY = np.array([[200_000, 0], [-480_000, 0], [800_000, 0]])  # of ORDERS, in 100 ticks
ORDERS = (
    log(load([0, 1, 2], 1, [100, 100, 100], [2000, -4800, 8000]), 1.0),
    replies(RobotState.LOADED, START, 2.0),
    log(go(1), 4.0),
)
OVER_S = 4.0 + 101 * UNITS.tick_s


def changed_note(recording):
    return [note for note in recording.about["notes"] if note.startswith("counters were set")]


def test_counters_that_an_image_sets_after_a_motion_are_no_part_of_it():
    done = replies(RobotState.DONE, START + WAY, OVER_S)
    image = log(encode_place(ADDRESSES, START + WAY + [[0, 9], [FAR, 0], [0, 0]]), OVER_S + 0.1)
    seen = replies(RobotState.DONE, START + WAY + [[0, 9], [FAR, 0], [0, 0]], OVER_S + 0.2)
    recording = built(*ORDERS, done, image, seen)
    assert np.array_equal(recording.phases[0].end, START + WAY)
    assert not recording.phases[0].stopped.any() and not changed_note(recording)


def test_a_motion_begins_where_an_image_in_its_frames_has_set_the_counters():
    image = log(encode_place(ADDRESSES, START + [[0, 0], [FAR, 0], [0, 0]]), 0.5)
    done = replies(RobotState.DONE, START + WAY + [[0, 0], [FAR, 0], [0, 0]], OVER_S)
    recording = built(image, *ORDERS, done)
    assert np.array_equal(recording.phases[0].motion.start, START + [[0, 0], [FAR, 0], [0, 0]])
    assert np.array_equal(recording.problem.start, recording.executed.start)
    assert np.array_equal(recording.phases[0].end, START + WAY + [[0, 0], [FAR, 0], [0, 0]])
    (note,) = changed_note(recording)
    assert note.endswith(f": robot {PLANE.ids[1]}")


def test_a_robot_that_is_done_tells_where_it_began():
    # an image after the motion had set the counters by the time they were taken for those before
    done = replies(RobotState.DONE, START + WAY - [[0, 0], [FAR, 0], [0, 0]], OVER_S)
    recording = built(*ORDERS, done)
    assert np.array_equal(recording.phases[0].motion.start, START - [[0, 0], [FAR, 0], [0, 0]])
    assert np.array_equal(recording.phases[0].end, START + WAY - [[0, 0], [FAR, 0], [0, 0]])
    assert len(changed_note(recording)) == 1


HALF_S = 4.0 + 50.5 * UNITS.tick_s
STOP = log(encode_command(Opcode.STOP, general_call([0])), HALF_S)


def rest_of_the_way(stopped, rows, t):
    """The frames in which robots that have stopped are resumed."""
    left = (START + WAY - stopped)[rows, 0] // 50
    return log(load(rows, 2, [50] * len(rows), left), t), log(go(2), t + 0.001)


@pytest.mark.parametrize("configured", [False, True])
def test_a_counter_that_was_lost_with_the_power_tells_of_no_motion(configured):
    # robot 1 loses its power in motion; the others are stopped, and go on a little later
    half = START + WAY // 2
    moving = replies(RobotState.MOVING, START + WAY // 4, 4.0 + 25 * UNITS.tick_s)
    state, read = np.array([RobotState.STOPPED] * 3), half.copy()
    state[1], read[1] = RobotState.UNCONFIGURED, 0
    logs = [*ORDERS, moving, STOP, replies(state, read, HALF_S + 0.01, [0, 1, 0])]
    if configured:  # its counter is set to the middle of its ranges
        middle = np.array([[FAR, FAR]])
        logs.append(log(encode_place(ADDRESSES[np.array([1])], middle), HALF_S + 0.02))
        read[1] = middle
    logs += rest_of_the_way(half, [0, 2], HALF_S + 0.03)
    recording = built(*logs, counts_after=np.where(np.arange(3)[:, None] == 1, read, START + WAY))
    first, second = recording.phases
    assert np.array_equal(second.end[[0, 2]], (START + WAY)[[0, 2]])
    # no sooner than it was read, no later than all had stopped
    assert -240_000 <= first.end[1, 0] - START[1, 0] <= -120_000 and first.end[1, 1] == START[1, 1]
    assert first.stop_us[1] <= second.begin_us
    (note,) = changed_note(recording)
    assert note.endswith(f": robot {PLANE.ids[1]}")
    assert recording.about["notes"][-1].startswith("nothing tells where it stopped")


def test_a_counter_that_outlives_a_loss_of_power_tells_where_its_robot_stopped():
    half = START + WAY // 2
    read = half + [[0, 0], [9600, 0], [0, 0]]  # two ticks before the STOP
    state = [RobotState.STOPPED, RobotState.UNCONFIGURED, RobotState.STOPPED]
    recording = built(*ORDERS, STOP, replies(state, read, HALF_S + 0.01, [0, 1, 0]))
    (phase,) = recording.phases
    assert np.array_equal(phase.end, read) and not changed_note(recording)
    assert abs(phase.stop_us[1] - 48e6 * UNITS.tick_s) < 1e6 * UNITS.tick_s


def test_a_robot_that_is_lost_is_not_shown_where_it_was_not_yet():
    # its order leads on for long, and its counter was set to a place far along
    half = START + WAY // 2
    moving = replies(RobotState.MOVING, START + WAY // 4, 4.0 + 25 * UNITS.tick_s)
    only = np.array([0, 2])
    stopped = replies(RobotState.STOPPED, half, HALF_S + 0.01, rows=only)
    after = START + WAY
    recording = built(
        *ORDERS, moving, STOP, stopped, *rest_of_the_way(half, only, HALF_S + 0.02),
        counts_after=after,
    )  # fmt: skip
    first, second = recording.phases
    assert first.stopped[1] and first.stop_us[1] < second.begin_us
    assert abs(recording.executed.end[1, 0] - UNITS.to_angles(first.end[1, 0])) < 1e-9


@pytest.mark.parametrize("told", ["set", "done"])
def test_counters_that_are_set_between_two_phases_move_no_arm(told, tmp_path):
    half, set_to = START + WAY // 2, np.array([[0, 0], [FAR, 0], [0, 0]])
    logs = [*ORDERS, STOP, replies(RobotState.STOPPED, half, HALF_S + 0.01)]
    if told == "set":
        logs.append(log(encode_place(ADDRESSES, half + set_to), HALF_S + 0.02))
    logs += rest_of_the_way(half, [0, 1, 2], HALF_S + 0.03)
    logs.append(replies(RobotState.DONE, START + WAY + set_to, HALF_S + 0.03 + OVER_S))
    recording = built(*logs)
    assert np.array_equal(recording.phases[1].end, START + WAY)
    assert len(changed_note(recording)) == 1
    save_recording(tmp_path / "recording.npz", recording)
    loaded = load_recording(tmp_path / "recording.npz").executed
    np.testing.assert_allclose(loaded.end, UNITS.to_angles(START + WAY), atol=1e-9)
    assert loaded.fastest.max() < 8001 * UNITS.velocity_rad_s

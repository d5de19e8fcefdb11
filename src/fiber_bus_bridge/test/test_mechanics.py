# SPDX-License-Identifier: Apache-2.0
"""Mechanical errors: the arms follow their counters, scaled, late, not at all, or up to a stop."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.simulation import (
    NEVER,
    MechanicalErrors,
    Mechanics,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_bus_bridge.simulation.true_arms import _PIECE_RAD
from fiber_core.motion import SegmentMotion

N = 7
ALL = MechanicalErrors(
    scale=0.01, backlash_deg=0.5, wave_deg=0.05, speed_noise=0.01, slipping=0.3, stuck=0.2
)


def motion_of(rng, n=N, start=None):
    counts = np.stack([rng.integers(1, 6, n), rng.integers(0, 6, n)], axis=1).ravel()
    m = counts.sum()
    velocity = rng.choice([-3.0, -1.0, 0.0, 0.7, 2.5], m)
    start = rng.uniform(-1, 1, (n, 2)) if start is None else start
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return SegmentMotion(start, offsets, rng.uniform(0.01, 0.6, m), velocity)


def line(*pieces, n=1):
    """Theta of n robots makes pieces of (duration, velocity); phi rests."""
    k = len(pieces)
    offsets = np.repeat(np.arange(n + 1) * k, 2)[1:]
    duration, velocity = np.tile(np.array(pieces, dtype=float).T, n)
    return SegmentMotion(np.zeros((n, 2)), offsets, duration, velocity)


def end_of(mechanics, *motions):
    state = arms_at(mechanics, np.zeros((mechanics.n, 2)))
    for motion in motions:
        made, state = arms_motion(mechanics, state, motion)
        np.testing.assert_allclose(made.end, true_angles(mechanics, state), atol=1e-12)
    return true_angles(mechanics, state)[0, 0]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_without_errors_the_arms_move_as_their_counters_to_the_byte(seed):
    motion, ideal = motion_of(np.random.default_rng(seed)), Mechanics.ideal(N)
    made, _ = arms_motion(ideal, arms_at(ideal, motion.start), motion)
    for one, other in zip(made.arrays, motion.arrays):
        assert one.tobytes() == np.asarray(other, dtype=one.dtype).tobytes()
    drawn = draw_mechanics(N, MechanicalErrors(), np.random.default_rng(seed))
    made, _ = arms_motion(drawn, arms_at(drawn, motion.start), motion)
    assert made.velocity_rad_s.tobytes() == motion.velocity_rad_s.tobytes()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_two_movements_are_the_same_one_by_one_and_in_one_motion(seed):
    rng = np.random.default_rng(seed)
    drawn = draw_mechanics(N, ALL, rng)
    one, two = motion_of(rng), motion_of(rng)
    state = arms_at(drawn, one.start)
    _, middle = arms_motion(drawn, state, one)
    _, apart = arms_motion(drawn, middle, two)
    both, movement = [], []
    for profile in range(2 * N):
        for number, each in enumerate((one, two)):
            part = slice(*each.offsets[profile : profile + 2])
            both += list(zip(each.duration_s[part], each.velocity_rad_s[part]))
            movement += [number] * (part.stop - part.start)
    offsets = one.offsets + two.offsets
    joined = SegmentMotion(one.start, offsets, *np.array(both).reshape(-1, 2).T)
    _, together = arms_motion(drawn, state, joined, np.array(movement, dtype=np.int64))
    np.testing.assert_allclose(
        true_angles(drawn, together), true_angles(drawn, apart), rtol=0, atol=1e-12
    )


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), share=st.floats(0.05, 0.95))
def test_a_motion_that_is_broken_off_has_moved_the_arms_as_the_whole_one_until_then(seed, share):
    rng = np.random.default_rng(seed)
    drawn = draw_mechanics(N, ALL, rng)
    motion = motion_of(rng)
    t = share * motion.makespan_s
    lasts = np.clip(t - motion.begins_s, 0.0, motion.duration_s)
    kept = lasts > 0.0
    counts = np.add.reduceat(np.append(kept, 0), motion.offsets[:-1]) * (motion.counts.ravel() > 0)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    cut = SegmentMotion(motion.start, offsets, lasts[kept], motion.velocity_rad_s[kept])
    state = arms_at(drawn, motion.start)
    whole, _ = arms_motion(drawn, state, motion)
    part, _ = arms_motion(drawn, state, cut)
    # part ends on the curve of the sines, and whole is on a chord of it: h^2 / 8 times the most of
    # the second derivative at most, h the length of a piece
    periods = 1.0 + np.arange(drawn.wave_rad.shape[2])
    bend = (np.abs(drawn.wave_rad) * periods**2).sum(axis=2)
    assert (np.abs(part(t) - whole(t)) <= _PIECE_RAD**2 / 8.0 * bend + 1e-12).all()


def test_the_scale_is_that_of_the_direction():
    scale = np.ones((1, 2, 2))
    scale[0, 0] = 0.5, 1.1
    mechanics = Mechanics.ideal(1).with_(scale=scale)
    assert end_of(mechanics, line((1.0, 2.0))) == pytest.approx(2.2)
    assert end_of(mechanics, line((1.0, 2.0), (1.0, -2.0))) == pytest.approx(1.2)


def test_a_reversal_loses_the_backlash_and_the_same_direction_loses_nothing():
    mechanics = Mechanics.ideal(1).with_(backlash_rad=[[0.1, 0.0]], slack_rad=[[0.1, 0.0]])
    up, down = line((1.0, 1.0)), line((1.0, -1.0))
    assert end_of(mechanics, up, up) == pytest.approx(2.0)
    assert end_of(mechanics, up, down) == pytest.approx(0.1)
    assert end_of(mechanics, up, down, down) == pytest.approx(-0.9)
    assert end_of(mechanics, up, down, up) == pytest.approx(1.0)
    assert end_of(mechanics, line((0.05, -1.0))) == pytest.approx(0.0)


def test_a_stop_holds_the_arm_while_its_counter_goes_on():
    stops = np.broadcast_to([-1.0, 1.5], (1, 2, 2))
    mechanics = Mechanics.ideal(1).with_(stops_rad=stops)
    assert end_of(mechanics, line((2.0, 1.0))) == 1.5
    assert end_of(mechanics, line((2.0, 1.0), (0.5, -1.0))) == 1.0
    assert end_of(mechanics, line((9.0, -1.0))) == -1.0


def test_a_joint_that_sticks_misses_one_movement_and_one_that_is_stuck_all_later_ones():
    up = line((1.0, 1.0))
    sticks = Mechanics.ideal(1).with_(still_in=[[1, NEVER]])
    assert [end_of(sticks, *[up] * k) for k in (1, 2, 3)] == [1.0, 1.0, 2.0]
    stuck = Mechanics.ideal(1).with_(stuck_from=[[1, NEVER]])
    assert [end_of(stuck, *[up] * k) for k in (1, 2, 3)] == [1.0, 1.0, 1.0]


def test_a_slipping_joint_loses_another_share_each_time():
    slips = Mechanics.ideal(1).with_(slip=[[0.3, 0.0]], seed=5)
    up = line((1.0, 1.0))
    ends = np.diff([0.0] + [end_of(slips, *[up] * k) for k in range(1, 6)])
    assert (ends < 1.0).all() and (ends > 0.7).all() and len(set(ends.round(9))) == 5
    assert end_of(slips, up) == end_of(slips, up)


def test_the_arm_ends_on_the_curve_of_its_sines_and_passes_near_it():
    wave = np.zeros((1, 2, 3))
    wave[0, 0] = 1e-3, -5e-4, 8e-4
    mechanics = Mechanics.ideal(1).with_(wave_rad=wave, phase_rad=np.full((1, 2, 3), 0.3))
    state = arms_at(mechanics, [[0.4, 0.0]])
    np.testing.assert_allclose(true_angles(mechanics, state), [[0.4, 0.0]], atol=1e-15)
    made, end = arms_motion(mechanics, state, line((2.0, 1.2)))
    for t in np.linspace(0.0, 2.0, 101):
        here = state._replace(gear=state.gear + [1.2 * t, 0.0])
        assert made(t)[0, 0] == pytest.approx(true_angles(mechanics, here)[0, 0], abs=2e-5)
    assert end.gear[0, 0] == pytest.approx(state.gear[0, 0] + 2.4)


def test_the_draw_has_the_sizes_that_were_asked_for_and_is_seeded():
    errors = MechanicalErrors(scale=0.004, backlash_deg=0.1, non_movers=0.01, stuck=0.02)
    drawn = draw_mechanics(5000, errors, np.random.default_rng(1))
    assert np.std(drawn.scale) == pytest.approx(0.004, rel=0.05)
    assert np.any(drawn.still_in == 0, axis=1).sum() == 50
    assert np.any(drawn.stuck_from == 0, axis=1).sum() == 100
    assert not (np.any(drawn.still_in == 0, axis=1) & np.any(drawn.stuck_from == 0, axis=1)).any()
    again = draw_mechanics(5000, errors, np.random.default_rng(1))
    assert again.scale.tobytes() == drawn.scale.tobytes() and again.seed == drawn.seed


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"backlash_rad": [[0.1, 0.1], [0.1, -0.2]]}, "robot row 1: backlash_rad must be 0 to 1"),
        ({"slack_rad": [[0.0, 0.0], [0.3, 0.0]]}, "robot row 1: slack_rad must be <= backlash"),
        ({"scale": np.full((2, 2, 2), np.nan)}, "robot row 0: scale must be 0 to 10, got"),
        ({"still_in": [[0, 0], [0, -1]]}, "robot row 1: still_in must be 0 or more"),
        ({"stops_rad": np.full((2, 2, 2), [1.0, -1.0])}, "robot row 0: stops_rad must be low"),
        ({"slip": np.zeros((3, 2))}, "slip has shape"),
    ],
)
def test_bad_mechanics_are_refused_with_row_and_value(changes, message):
    with pytest.raises(BridgeError, match=message):
        Mechanics.ideal(2).with_(**changes)
    with pytest.raises(BridgeError, match="scale"):
        MechanicalErrors(scale=-1.0)


def test_shares_of_different_robots_are_1_at_most_together():
    MechanicalErrors(non_movers=0.7, stuck=0.2, slipping=0.1)
    with pytest.raises(BridgeError, match=r"stuck 0\.3 and slipping 0\.1 .* got 1\.1"):
        MechanicalErrors(non_movers=0.7, stuck=0.3, slipping=0.1)

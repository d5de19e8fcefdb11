# SPDX-License-Identifier: Apache-2.0
"""Laws of both kinds of motion: what is said of some robots changes no other robot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_motions import random_motion

from fiber_core.motion import profile_rows
from fiber_core.wire_units import WireMotion, WireUnits

UNITS = WireUnits()


@st.composite
def motions(draw):
    """A motion in either units."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    motion = random_motion(rng, draw(st.integers(0, 6)))
    if draw(st.booleans()):
        return motion
    parts = motion.parts
    ticks, velocity = rng.integers(1, 99, parts.total), rng.integers(-99, 99, parts.total)
    return WireMotion(UNITS, rng.integers(-99, 99, (motion.n, 2)), parts.offsets, ticks, velocity)


def robots_of(motion):
    """Start and segments of each robot, as lists."""
    names = ("ticks", "velocity") if isinstance(motion, WireMotion) else MOTION_COLUMNS
    columns = [getattr(motion, name) for name in names]
    profiles = [
        [column[motion.parts.slice(k)].tolist() for column in columns] for k in range(2 * motion.n)
    ]
    return [(motion.start[i].tolist(), profiles[2 * i : 2 * i + 2]) for i in range(motion.n)]


MOTION_COLUMNS = ("duration_s", "velocity_rad_s")
REST = [[[], []], [[], []]]


def rows(motion, data, unique=False):
    some = st.lists(st.sampled_from(range(motion.n)), unique=unique)
    return data.draw(some) if motion.n else []


def checked(motion):
    """The same motion through its constructor: its numbers are valid and cannot be changed."""
    again = type(motion)(**{name: getattr(motion, name) for name in vars(motion)})
    for name in vars(motion):
        value = getattr(motion, name)
        assert not isinstance(value, np.ndarray) or not value.flags.writeable
    return again


@given(motions(), st.data())
def test_held_robots_rest_and_no_other_changes(motion, data):
    held = np.isin(np.arange(motion.n), rows(motion, data))
    left = motion.without(held)
    expected = [(s, REST if h else p) for h, (s, p) in zip(held, robots_of(motion))]
    assert robots_of(left) == robots_of(checked(left)) == expected
    assert robots_of(motion.only(~held)) == expected
    assert np.array_equal(left.moves, motion.moves & ~held)
    assert robots_of(left.without(held)) == expected


@given(motions(), st.data())
def test_the_motion_of_some_robots_is_their_part_of_the_motion(motion, data):
    chosen = rows(motion, data)
    some = motion.of_robots(chosen)
    assert robots_of(some) == robots_of(checked(some)) == [robots_of(motion)[k] for k in chosen]
    assert np.array_equal(some.counts, motion.counts[chosen].reshape(-1, 2))
    assert np.array_equal(
        profile_rows(chosen).reshape(-1, 2) // 2, np.stack([chosen, chosen], axis=1)
    )


@given(motions(), st.data())
def test_robots_that_move_in_another_way_keep_their_start(motion, data):
    chosen = rows(motion, data, unique=True)
    source = motion.of_robots(rows(motion, data)[: len(chosen)] if motion.n else [])
    chosen = chosen[: source.n]
    changed = motion.with_robots(chosen, source)
    expected = robots_of(motion)
    for row, (_, profiles) in zip(chosen, robots_of(source)):
        expected[row] = (expected[row][0], profiles)
    assert robots_of(changed) == robots_of(checked(changed)) == expected


@given(motions(), st.data())
def test_a_robot_given_back_its_own_motion_moves_as_before(motion, data):
    chosen = rows(motion, data, unique=True)
    held = np.isin(np.arange(motion.n), chosen)
    again = motion.without(held).with_robots(chosen, motion.of_robots(chosen))
    assert robots_of(again) == robots_of(motion)


@pytest.mark.parametrize("seed", range(5))
def test_a_motion_of_whole_units_comes_back_unchanged(seed):
    rng = np.random.default_rng(seed)
    units = WireUnits(tick_us=rng.integers(10, 9000), quantum_prad=rng.integers(1000, 10**7))
    offsets = np.arange(401)
    ticks, speeds = rng.integers(1, units.max_ticks + 1, 400), rng.integers(-8191, 8192, 400)
    start = rng.integers(-(2**31), 2**31, (200, 2))
    motion = WireMotion(units, start, offsets, ticks, speeds)
    assert robots_of(WireMotion.nearest(motion.decoded(), units)) == robots_of(motion)


def test_knots_are_where_segments_begin_and_end():
    motion = WireMotion(UNITS, [[5, -7], [0, 9]], [0, 2, 2, 2, 3], [10, 3, 4], [2, -1, 6])
    parts, ticks, counts = motion.knots()
    assert [ticks[parts.slice(k)].tolist() for k in range(4)] == [[0, 10, 13], [0], [0], [0, 4]]
    assert [counts[parts.slice(k)].tolist() for k in range(4)] == [[5, 25, 22], [-7], [0], [9, 33]]

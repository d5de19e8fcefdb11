# SPDX-License-Identifier: Apache-2.0
"""Orders after a stop: they end where and when the interrupted orders end, within the limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiber_bus_bridge.remaining_motion import remaining_motion
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

UNITS = WireUnits()
FAST = np.full((2, 2), 1000)


def profile(motion, joint):
    part = motion.parts.slice(joint)
    return motion.ticks[part].tolist(), motion.velocity[part].tolist()


def position(motion, joint, tick):
    """Position of a joint at a tick [quanta], by summing its speeds tick by tick."""
    ticks, velocity = profile(motion, joint)
    speeds = np.repeat(velocity, ticks)[:tick]
    return motion.start.ravel()[joint] + int(speeds.sum())


@st.composite
def stopped(draw):
    """Two robots, the tick at which they are stopped, and how far they are from their orders."""
    segment = st.tuples(st.integers(1, 40), st.integers(-90, 90))
    joints = draw(st.lists(st.lists(segment, max_size=4), min_size=4, max_size=4))
    ticks = [n for joint in joints for n, _ in joint]
    velocity = [v for joint in joints for _, v in joint]
    start = np.array(draw(st.lists(st.integers(-500, 500), min_size=4, max_size=4)))
    motion = WireMotion(
        UNITS, start.reshape(2, 2), Parts.from_counts([len(j) for j in joints]).offsets,
        np.array(ticks, dtype=np.int64), np.array(velocity, dtype=np.int64),
    )  # fmt: skip
    tick = draw(st.integers(0, 170))
    off = np.array(draw(st.lists(st.integers(-30, 30), min_size=4, max_size=4)))
    counts = np.array([position(motion, j, tick) for j in range(4)]) + off
    return motion, tick, counts.reshape(2, 2)


@settings(deadline=None)  # the first call loads a compiled loop
@given(stopped(), st.floats(0.0, 0.999))
def test_robots_end_where_and_when_they_would_have_ended(drawn, part):
    motion, tick, counts = drawn
    left = remaining_motion(motion, counts, (tick + part) * UNITS.tick_s, FAST, [True, True])
    assert np.array_equal(left.start, counts)
    for joint in range(4):
        ticks, velocity = profile(motion, joint)
        new_ticks, new_velocity = profile(left, joint)
        assert all(n > 0 for n in new_ticks)
        assert counts.ravel()[joint] + np.dot(new_ticks, new_velocity) == (
            position(motion, joint, sum(ticks)) if ticks else counts.ravel()[joint]
        )
        assert not new_velocity or new_velocity[-1] != 0
        ends = np.cumsum(ticks)
        after = [k for k in range(len(ticks)) if k and ends[k - 1] > tick + part]
        later = [(ticks[k], velocity[k]) for k in after]
        while later and later[-1][1] == 0:
            later.pop()
        assert list(zip(new_ticks, new_velocity))[len(new_ticks) - len(later) :] == later
        first = new_velocity[: len(new_ticks) - len(later)]
        assert len(first) <= 2 and np.ptp(first or [0]) <= 1
        if later:  # they begin when they would have begun
            begin = sum(ticks[: after[0]]) - tick
            assert sum(new_ticks[: len(first)]) == max(begin, 1)


@settings(deadline=None)  # the first call loads a compiled loop
@given(stopped(), st.integers(20, 60))
def test_no_joint_exceeds_its_speed_in_the_part_that_was_interrupted(drawn, fastest):
    motion, tick, counts = drawn
    speed = np.full((2, 2), fastest)
    left = remaining_motion(motion, counts, tick * UNITS.tick_s, speed, [True, True])
    for joint in range(4):
        ticks, velocity = profile(left, joint)
        before = set(zip(*profile(motion, joint)))
        own = [v for n, v in zip(ticks, velocity) if (n, v) not in before]
        assert np.abs(own or [0]).max() <= fastest


@pytest.mark.parametrize("elapsed_s", [-1.0, 0.0])
def test_a_motion_stopped_before_it_began_is_as_it_was(elapsed_s):
    motion = WireMotion(UNITS, [[0, 5]], [0, 2, 3], [10, 7, 4], [3, -8, 50])
    left = remaining_motion(motion, motion.start, elapsed_s, FAST[:1], [True])
    assert profile(left, 0) == ([10, 7], [3, -8]) and profile(left, 1) == ([4], [50])


def test_robots_that_do_not_resume_rest_where_they_are():
    motion = WireMotion(UNITS, [[0, 0], [0, 0]], [0, 1, 2, 3, 4], [10] * 4, [5] * 4)
    counts = np.array([[7, 9], [11, 13]])
    left = remaining_motion(motion, counts, 2 * UNITS.tick_s, FAST, [False, True])
    assert np.array_equal(left.end, [[7, 9], [50, 50]])
    assert left.counts.tolist() == [[0, 0], [2, 2]]

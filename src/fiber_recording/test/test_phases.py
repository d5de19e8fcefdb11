# SPDX-License-Identifier: Apache-2.0
"""The executed motion is that of the orders, with stops and rests between phases."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.wire_units import WireMotion
from fiber_recording import Phase, RecordingError, counts_at, executed_motion

STOP_S, RESUME_S = 0.3003, 0.455001


def test_one_phase_is_its_orders_to_the_last_bit(recording):
    (phase,) = recording.phases
    motion, orders = executed_motion([phase]), phase.motion.decoded()
    for name in ("start", "offsets", "duration_s", "velocity_rad_s"):
        np.testing.assert_array_equal(getattr(motion, name), getattr(orders, name))


def test_orders_are_executed_until_the_stop_and_robots_rest_until_they_resume(resumed):
    first, second = resumed.phases
    motion, orders = resumed.executed, first.motion.decoded()
    by_itself = np.flatnonzero(first.stopped & (first.stop_us < 300_000))
    assert len(by_itself) == 1
    others = np.delete(np.arange(motion.n), by_itself)
    for t in np.linspace(-0.1, STOP_S - 1e-6, 40):
        np.testing.assert_allclose(motion(t)[others], orders(t)[others], atol=1e-12)
    stands = resumed.units.to_angles(np.where(first.stopped[:, None], first.stop_counts, 0))
    for t in np.linspace(STOP_S + 2e-4, RESUME_S - 1e-6, 9):
        at = motion(t)
        np.testing.assert_allclose(at[first.stopped], stands[first.stopped], atol=1e-12)
        assert not motion.velocity(t)[first.stopped].any()
    for t in np.linspace(RESUME_S, 3.0, 40):
        moved = first.stopped & second.motion.decoded().counts.any(axis=1)
        exact = second.motion.decoded()(t - RESUME_S)
        np.testing.assert_allclose(motion(t)[moved], exact[moved], atol=1e-12)
    np.testing.assert_allclose(motion(9.0)[by_itself], stands[by_itself], atol=1e-12)


def test_counts_agree_with_the_motion(resumed):
    motion, rng = resumed.executed, np.random.default_rng(0)
    row = rng.integers(0, motion.n, 400)
    time_us = rng.integers(-100_000, 2_000_000, 400)
    counts = counts_at(resumed.phases, row, time_us)
    exact = np.array([motion(t)[r] for r, t in zip(row, time_us * 1e-6)])
    off = np.abs(resumed.units.to_angles(counts) - exact)
    assert off.max() < 1.001 * 5 * resumed.units.quantum_rad
    ends = counts_at(resumed.phases, np.arange(motion.n), np.full(motion.n, 10**9))
    np.testing.assert_array_equal(ends, resumed.phases[-1].end)


def test_a_second_phase_without_a_stop_is_not_a_pause(recording):
    motion = recording.motion
    rest = WireMotion(motion.units, motion.end, np.zeros_like(motion.offsets), [], [])
    continued = replace(recording, phases=(Phase.whole(motion), Phase.whole(rest, 9_000_000)))
    assert continued.pauses_s == []
    np.testing.assert_allclose(continued.executed(9.5), recording.executed.end)


def test_shapes_are_checked(recording):
    with pytest.raises(RecordingError, match="stop_us has shape"):
        Phase(recording.motion, 0, [-1], recording.motion.start)

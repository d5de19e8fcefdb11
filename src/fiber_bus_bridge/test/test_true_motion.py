# SPDX-License-Identifier: Apache-2.0
"""The motion of the counters that movements make: the segments of a plain loop."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fiber_bus_bridge.simulation import Movements

QUANTUM_RAD = 1e-3
ROBOTS, SEGMENTS, UNTIL_S = 4, 3, 40.0


def random_movements(rng):
    """Movements of some robots: broken off at any time, some in their countdown, the last go on."""
    rows, times = [], []
    for row in range(ROBOTS - 1):  # the last robot never moves
        t = rng.uniform(0.5, 1.0)
        for _ in range(rng.integers(0, 4)):
            lasts_s = rng.choice([rng.uniform(0.0, 9.0), -0.1, 0.0])
            rows.append(row)
            times.append((t, t + lasts_s))
            t += max(lasts_s, 0.0) + rng.choice([0.0, rng.uniform(0.0, 2.0)])
        if times and rows[-1] == row and rng.random() < 0.5:
            times[-1] = (times[-1][0], np.nan)
    order = np.argsort([begin for begin, _ in times], kind="stable").astype(int)
    count, (started_s, ended_s) = len(rows), np.array(times).reshape(-1, 2)[order].T
    return Movements(
        np.array(rows, dtype=np.int64)[order], started_s, ended_s, rng.uniform(0.01, 0.02, count),
        rng.integers(0, SEGMENTS + 1, (count, 2)),
        rng.integers(1, 200, (count, 2, SEGMENTS)), rng.integers(-5, 6, (count, 2, SEGMENTS)),
        rng.integers(0, 2000, (count, 2, SEGMENTS)),
    )  # fmt: skip


def plain_pieces(moves, row, joint, begin_s):
    """Duration, speed, movement and ramp of the segments of one joint."""
    pieces, now, number = [], begin_s, 0
    for k in np.flatnonzero(moves.row == row):
        end_s = UNTIL_S if np.isnan(moves.ended_s[k]) else moves.ended_s[k]
        left = end_s - moves.started_s[k]
        if left <= 0.0:
            continue
        pieces.append((moves.started_s[k] - now, 0.0, -1, 0.0))
        for m in range(moves.counts[k, joint]):
            lasts_s = min(moves.ticks[k, joint, m] * moves.tick_s[k], left)
            speed = moves.velocity[k, joint, m] * QUANTUM_RAD / moves.tick_s[k]
            pieces.append((lasts_s, speed, number, 1e-6 * moves.ramp_us[k, joint, m]))
            left -= lasts_s
        pieces.append((left, 0.0, number, 0.0))
        now, number = end_s, number + 1
    return np.array([piece for piece in pieces if piece[0] > 1e-12]).reshape(-1, 4)


@given(seed=st.integers(0, 2**32 - 1))
def test_movements_make_the_segments_of_a_plain_loop(seed):
    rng = np.random.default_rng(seed)
    moves, start = random_movements(rng), rng.integers(-500, 500, (ROBOTS, 2))
    motion, numbers, ramps = moves.counters(start, QUANTUM_RAD, UNTIL_S, 0.25)
    np.testing.assert_array_equal(motion.start, start * QUANTUM_RAD)
    for row, joint in np.ndindex(ROBOTS, 2):
        part = slice(*motion.offsets[2 * row + joint : 2 * row + joint + 2])
        kept = motion.duration_s[part] > 1e-12  # what rounding leaves of a time
        found = [motion.duration_s[part], motion.velocity_rad_s[part], numbers[part], ramps[part]]
        plain = plain_pieces(moves, row, joint, 0.25)
        np.testing.assert_allclose(np.transpose(found)[kept], plain, rtol=1e-9, atol=1e-12)

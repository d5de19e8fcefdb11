# SPDX-License-Identifier: Apache-2.0
"""Random motions, robots with clocks that differ, and a Safety with the same gap for all pairs."""

import numpy as np

from fiber_core.clearance import Safety
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts

__all__ = ["RESOLVE_ALL", "Fixed", "all_at", "angles_at", "random_motion"]


class Fixed(Safety):
    """Requires the same gap of all pairs, for every start."""

    def required_mm(self, plane, motion, pairs):
        return np.full(len(pairs), self.margin_mm)


RESOLVE_ALL = Fixed(margin_mm=1e3)


def random_motion(rng, n, most=3) -> SegmentMotion:
    """Return a motion of up to `most` segments a profile, with rests and empty profiles."""
    counts = rng.integers(0, most + 1, 2 * n)
    m = int(counts.sum())
    return SegmentMotion(
        rng.uniform(-np.pi, np.pi, (n, 2)),
        Parts.from_counts(counts).offsets,
        rng.uniform(0.01, 0.8, m),
        rng.uniform(-6.0, 6.0, m) * rng.integers(0, 2, m),
    )


def angles_at(motion: SegmentMotion, times) -> np.ndarray:
    """Return joint angles when the clock of each robot shows its own times (n, t): (n, 2, t)."""
    out = np.empty((motion.n, 2, times.shape[1]))
    for i in range(motion.n):
        for joint in range(2):
            profile = slice(*motion.offsets[2 * i + joint : 2 * i + joint + 2])
            duration, speed = motion.duration_s[profile], motion.velocity_rad_s[profile]
            knots = np.concatenate([[0.0], np.cumsum(duration)])
            angles = motion.start[i, joint] + np.concatenate([[0.0], np.cumsum(duration * speed)])
            out[i, joint] = np.interp(times[i], knots, angles)
    return out


def all_at(motion: SegmentMotion, times) -> np.ndarray:
    """Return joint angles when all clocks show the times (t,): shape (n, 2, t)."""
    return angles_at(motion, np.broadcast_to(times, (motion.n, len(times))))

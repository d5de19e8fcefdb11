"""Random motions, where robots are by clocks of their own, and a gap that asks for all of it."""

import numpy as np

from fiber_core.clearance import Safety
from fiber_core.motion import SegmentMotion

__all__ = ["RESOLVE_ALL", "Fixed", "all_at", "angles_at", "random_motion"]


class Fixed(Safety):
    """Asks for the same gap of all pairs, however they start."""

    def required_mm(self, plane, motion, pairs):
        return np.full(len(pairs), self.margin_mm)


RESOLVE_ALL = Fixed(margin_mm=1e3)


def random_motion(rng, n, most=3) -> SegmentMotion:
    """Up to `most` segments a profile, rests and empty profiles among them."""
    counts = rng.integers(0, most + 1, 2 * n)
    m = int(counts.sum())
    return SegmentMotion(
        rng.uniform(-np.pi, np.pi, (n, 2)),
        np.concatenate([[0], np.cumsum(counts)]),
        rng.uniform(0.01, 0.8, m),
        rng.uniform(-6.0, 6.0, m) * rng.integers(0, 2, m),
    )


def angles_at(motion: SegmentMotion, times) -> np.ndarray:
    """Joint angles when each robot's clock shows its own times (n, t): shape (n, 2, t)."""
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
    """Joint angles when all clocks show the times (t,): shape (n, 2, t)."""
    return angles_at(motion, np.broadcast_to(times, (motion.n, len(times))))

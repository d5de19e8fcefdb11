"""How near neighbours come to each other on a motion, and when."""

import numpy as np

from fiber_core.clearance import neighbour_pairs, sampled_gaps
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_recording.recording import Approaches

__all__ = ["closest_approaches"]

_COARSE = 240  # instants at which every pair is looked at
_FINE = 2400  # instants for the nearest of them
_NEAREST = 100  # pairs looked at closely


def closest_approaches(plane: FocalPlane, motion: SegmentMotion, tick_s: float) -> Approaches:
    """Return the smallest gap each pair of neighbours was met at, and when; nearest first.

    A picture of the motion and no proof of it: gaps are sampled, coarsely for all pairs
    and finely for the nearest hundred. The proof is fiber_core.clearance.certify.

    Args:
        plane: the focal plane.
        motion: the motion as sent.
        tick_s: speeds change at whole numbers of it [s], so that is where gaps have corners.
    """
    pairs = neighbour_pairs(plane)
    gap, time_s = _sampled(plane, motion, pairs, _instants(motion, tick_s, _COARSE))
    nearest = np.argsort(gap, kind="stable")[:_NEAREST]
    rows = np.unique(pairs[nearest])
    rows = rows[rows < plane.n]
    few = plane.permuted(rows)
    renumbered = np.concatenate([np.zeros(plane.n), len(rows) + np.arange(len(plane.obstacles))])
    renumbered[rows] = np.arange(len(rows))
    close = _sampled(
        few,
        _only(motion, rows),
        renumbered[pairs[nearest]].astype(np.int32),
        _instants(motion, tick_s, _FINE),
    )
    better = close[0] < gap[nearest]
    gap[nearest[better]], time_s[nearest[better]] = close[0][better], close[1][better]
    order = np.argsort(gap, kind="stable")
    return Approaches(pairs[order], gap[order], time_s[order])


def _instants(motion, tick_s, most):
    ticks = max(1, round(motion.makespan_s / tick_s))
    every = max(1, -(-ticks // most))
    return tick_s * np.append(np.arange(0, ticks, every), ticks)


def _sampled(plane, motion, pairs, times):
    if len(pairs) == 0:
        return np.zeros(0), np.zeros(0)
    gaps = sampled_gaps(plane, pairs, np.stack([motion(t) for t in times], axis=-1))
    at = gaps.argmin(axis=1)
    return gaps[np.arange(len(pairs)), at], times[at]


def _only(motion, rows):
    profiles = (2 * rows[:, None] + [0, 1]).ravel()
    counts = np.diff(motion.offsets)[profiles]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    take = np.repeat(motion.offsets[profiles] - offsets[:-1], counts) + np.arange(offsets[-1])
    return SegmentMotion(
        motion.start[rows], offsets, motion.duration_s[take], motion.velocity_rad_s[take]
    )

# SPDX-License-Identifier: Apache-2.0
"""The smallest gap between neighbours in a motion, and the time of that gap."""

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Gaps, Times
from fiber_core.clearance import neighbour_pairs, sampled_gaps
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_recording.recording import Approaches

__all__ = ["closest_approaches"]

_COARSE = 240  # instants at which all pairs are sampled
_FINE = 2400  # instants at which the closest pairs are sampled
_CLOSEST = 100  # pairs that are sampled finely


def closest_approaches(plane: FocalPlane, motion: SegmentMotion, tick_s: float) -> Approaches:
    """Return the smallest gap of each pair of neighbours and its time, closest pair first.

    The gaps are sampled, coarsely for all pairs and finely for the closest hundred, and so they
    prove nothing. The proof is the certificate of fiber_core.clearance.certify.

    Args:
        plane: the focal plane.
        motion: the motion.
        tick_s: tick of the orders [s]; velocities change at whole ticks, so gaps are sampled
            there.
    """
    pairs = neighbour_pairs(plane)
    gap, time_s = _smallest_gaps(plane, motion, pairs, _instants(motion, tick_s, _COARSE))
    closest = np.argsort(gap, kind="stable")[:_CLOSEST]
    rows = np.unique(pairs[closest])
    rows = rows[rows < plane.n]
    renumbered = np.concatenate([np.zeros(plane.n), len(rows) + np.arange(plane.fixtures)])
    renumbered[rows] = np.arange(len(rows))
    fine_gap, fine_s = _smallest_gaps(
        plane.permuted(rows),
        motion.of_robots(rows),
        renumbered[pairs[closest]].astype(np.int32),
        _instants(motion, tick_s, _FINE),
    )
    smaller = fine_gap < gap[closest]
    gap[closest[smaller]], time_s[closest[smaller]] = fine_gap[smaller], fine_s[smaller]
    order = np.argsort(gap, kind="stable")
    return Approaches(pairs[order], gap[order], time_s[order])


def _instants(motion: SegmentMotion, tick_s: float, most: int) -> Times:
    """Whole ticks from 0 to the end of a motion [s], equally spaced but for the last."""
    ticks = max(1, round(motion.makespan_s / tick_s))
    every = max(1, -(-ticks // most))
    return tick_s * np.append(np.arange(0, ticks, every), ticks)


def _smallest_gaps(
    plane: FocalPlane, motion: SegmentMotion, pairs: NDArray[np.integer], times: Times
) -> tuple[Gaps, Times]:
    """Smallest gap of each pair at some instants [mm], and its time [s]."""
    if len(pairs) == 0:
        return np.zeros(0), np.zeros(0)
    gaps = sampled_gaps(plane, pairs, np.stack([motion(t) for t in times], axis=-1))
    at = gaps.argmin(axis=1)
    return gaps[np.arange(len(pairs)), at], times[at]

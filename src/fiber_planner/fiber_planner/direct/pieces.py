# SPDX-License-Identifier: Apache-2.0
"""Sampled profiles as constant-velocity segments, one for each straight piece."""

import numba as nb
import numpy as np

from fiber_core.array_types import Floats, Mask, Times
from fiber_core.motion import SampledMotion, SegmentMotion

__all__ = ["pieces_of", "straight_pieces"]

_STRAIGHT_RAD = 1e-11  # samples this close to a line are on it


def straight_pieces(motion: SampledMotion) -> SegmentMotion:
    """Return a sampled motion as constant-velocity segments, one for each straight piece.

    The conversion is exact: samples on a line become one segment, rest at the end none.

    Args:
        motion: sampled joint angles; its first instant becomes time zero.
    """
    return pieces_of(motion.time_s, motion.angles, np.ones(motion.n, dtype=bool))


def pieces_of(time_s: Times, angles: Floats, which: Mask) -> SegmentMotion:
    """Return the sampled profiles of some robots as constant-velocity segments; the others rest.

    Args:
        time_s: increasing times [s], shape (t,); the first becomes time zero.
        angles: joint angles [rad], shape (n, 2, t).
        which: robots to convert, shape (n,) or longer.
    """
    n, _, samples = angles.shape
    profiles = np.ascontiguousarray(angles).reshape(2 * n, samples)
    offsets, duration, velocity = _pieces(time_s, profiles, which)
    return SegmentMotion(angles[:, :, 0], offsets, duration, velocity)


@nb.njit(cache=True)
def _pieces(time_s, profiles, which):
    rows, samples = profiles.shape
    offsets = np.zeros(rows + 1, dtype=np.int64)
    duration = np.empty(rows * max(1, samples - 1))
    velocity = np.empty_like(duration)
    used = 0
    for i in range(rows):
        row = profiles[i]
        last = samples - 1 if which[i // 2] else 0
        while last > 0 and row[last - 1] == row[last]:
            last -= 1
        begin = 0
        while begin < last:
            end = last
            if not _on_line(time_s, row, begin, last):
                end = begin + 1
                while _on_line(time_s, row, begin, end + 1):
                    end += 1
            duration[used] = time_s[end] - time_s[begin]
            velocity[used] = (row[end] - row[begin]) / duration[used]
            used += 1
            begin = end
        offsets[i + 1] = used
    return offsets, duration[:used].copy(), velocity[:used].copy()


@nb.njit(cache=True)
def _on_line(time_s, row, begin, end):
    slope = (row[end] - row[begin]) / (time_s[end] - time_s[begin])
    for k in range(begin + 1, end):
        if abs(row[begin] + slope * (time_s[k] - time_s[begin]) - row[k]) > _STRAIGHT_RAD:
            return False
    return True

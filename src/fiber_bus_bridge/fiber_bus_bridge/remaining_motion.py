# SPDX-License-Identifier: Apache-2.0
"""Orders for the remaining part of a motion in which all robots were stopped together."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion

__all__ = ["remaining_motion"]


def remaining_motion(
    motion: WireMotion, counts: ArrayLike, elapsed_s: float, speed: ArrayLike, chosen: ArrayLike
) -> WireMotion:
    """Return the motion that takes robots from their stop to the end of their orders.

    The remaining part of the interrupted segment of a joint is D quanta in n ticks: r = D mod n
    ticks at floor(D / n) + 1 and the others at floor(D / n), which ends exactly. The segments after
    it are unchanged, so joints meet the same instants as in the motion that was certified.

    Args:
        motion: the motion that was stopped.
        counts: encoders now [quanta], shape (n, 2).
        elapsed_s: time from the start of the motion to its stop [s].
        speed: highest joint speeds [velocity units], shape (n, 2).
        chosen: robots that resume, shape (n,); the others rest.
    """
    counts = np.asarray(counts, dtype=np.int64)
    chosen = np.asarray(chosen, dtype=bool)
    # the interrupted segment of a joint becomes two at most
    most = len(motion.ticks) + 2 * counts.size
    ticks, velocity = np.empty((2, most), dtype=np.int64)
    lengths = np.zeros(counts.size, dtype=np.int64)
    m = _remaining(
        motion.offsets, motion.ticks, motion.velocity, motion.start.ravel(), counts.ravel(),
        max(elapsed_s / motion.units.tick_s, 0.0), np.asarray(speed).ravel(),
        np.repeat(chosen, 2), ticks, velocity, lengths,
    )  # fmt: skip
    offsets = Parts.from_counts(lengths).offsets
    return WireMotion(motion.units, counts, offsets, ticks[:m], velocity[:m])


@njit(cache=True)
def _remaining(
    offsets, ticks, velocity, start, now, elapsed, speed, chosen, left_ticks, left_velocity, lengths
):
    # Write the remaining segments and their number for each profile; return the number of all.
    m = 0
    for profile in range(len(now)):
        first, last = offsets[profile], offsets[profile + 1]
        if not chosen[profile] or first == last:
            continue
        # the interrupted segment, or the last one, and where it ends
        k, end, position = first, ticks[first], start[profile] + ticks[first] * velocity[first]
        while k < last - 1 and end <= elapsed:
            k += 1
            end += ticks[k]
            position += ticks[k] * velocity[k]
        distance = position - now[profile]
        shortest = -(-abs(distance) // speed[profile])
        left = max(np.int64(np.ceil(end - elapsed)), shortest, 1)
        slow, more = distance // left, distance % left
        begin = m
        for n, v in ((left - more, slow), (more, slow + 1)):
            if n > 0:
                left_ticks[m], left_velocity[m] = n, v
                m += 1
        for i in range(k + 1, last):
            left_ticks[m], left_velocity[m] = ticks[i], velocity[i]
            m += 1
        while m > begin and left_velocity[m - 1] == 0:
            m -= 1
        lengths[profile] = m - begin
    return m

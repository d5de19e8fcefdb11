# SPDX-License-Identifier: Apache-2.0
"""Orders that motors with a ramp can carry out: large changes of velocity in two steps."""

import numba as nb
import numpy as np

from fiber_core.array_types import Floats, Ints, Offsets
from fiber_core.drive import Drive
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion

__all__ = ["softened"]

_LONGER_TICKS = 12  # how much longer than the ramp the step between two velocities may last


def softened(drive: Drive, motion: WireMotion) -> WireMotion:
    """Return orders in which large changes of velocity are made in two steps.

    Where a joint changes its velocity by more than its acceleration allows within the ramp, the
    ends of both segments become one segment of their mean velocity that lasts at least as long as
    the ramp. The joint is at the same place after that step, or a few quanta beside it where no
    whole numbers fit better. Where the segments are too short they stay as they are; the
    certificate holds such a robot.

    Args:
        drive: how the motors of these robots carry out orders.
        motion: their orders.
    """
    units = motion.units
    largest = drive.largest_step_rad_s / units.velocity_rad_s
    if np.isinf(largest).all():
        return motion
    ramp_ticks = int(np.ceil(drive.ramp_s / units.tick_s - 1e-9))
    counts, ticks, velocity = _softened(
        motion.offsets, motion.ticks, motion.velocity, largest.ravel(), ramp_ticks, _LONGER_TICKS
    )
    offsets = Parts.from_counts(counts).offsets
    return WireMotion(units, motion.start, offsets, ticks, velocity)


@nb.njit(cache=True)
def _softened(
    offsets: Offsets, ticks: Ints, velocity: Ints, largest: Floats, ramp: int, longer: int
) -> tuple[Ints, Ints, Ints]:
    profiles = len(offsets) - 1
    counts = np.zeros(profiles, dtype=np.int64)
    new_ticks = np.empty(2 * len(ticks), dtype=np.int64)
    new_velocity = np.empty(2 * len(ticks), dtype=np.int64)
    used = 0
    for profile in range(profiles):
        before = used
        for k in range(offsets[profile], offsets[profile + 1]):
            left = ticks[k]
            if used > before and abs(velocity[k] - new_velocity[used - 1]) > largest[profile]:
                v, w, most = new_velocity[used - 1], velocity[k], largest[profile]
                n, a, mean = _mean_step(new_ticks[used - 1], v, left, w, most, ramp, longer)
                if n > 0:
                    new_ticks[used - 1] -= a
                    new_ticks[used], new_velocity[used] = n, mean
                    used += 1
                    left -= n - a
            new_ticks[used], new_velocity[used] = left, velocity[k]
            used += 1
        counts[profile] = used - before
    return counts, new_ticks[:used].copy(), new_velocity[:used].copy()


@nb.njit(cache=True)
def _mean_step(
    first: int, v: int, second: int, w: int, most: float, ramp: int, longer: int
) -> tuple[int, int, int]:
    # Length n of a segment that replaces the last a ticks at v and the first n - a ticks at w, a,
    # and its whole velocity, at most `most` from both; the place after it is off by as few quanta
    # as possible. Both segments keep a tick; zeros if they are too short. Among equals, the
    # shortest and most even step.
    best, least = (0, 0, 0), ramp + longer
    for n in range(ramp, ramp + longer + 1):
        for off in range(n):
            a = n // 2 + ((off + 1) // 2 if off % 2 else -(off // 2))
            if a < 1 or a >= first or n - a < 1 or n - a >= second:
                continue
            way = a * v + (n - a) * w
            mean = int(np.rint(way / n))
            if max(abs(mean - v), abs(w - mean)) <= most and abs(way - n * mean) < least:
                best, least = (n, a, mean), abs(way - n * mean)
                if least == 0:
                    return best
    return best

# SPDX-License-Identifier: Apache-2.0
"""Finds when a robot stopped from where it stopped on the way of its orders."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.wire_units import WireMotion

__all__ = ["stop_time_s"]

_SAME_PLACE = 3.0  # places this close to each other are the same [quanta]


def stop_time_s(motion: WireMotion, row: int, counts: ArrayLike, near_s: float) -> float:
    """Return the time from the begin of an order to the stop of its robot [s].

    Both joints of a robot stop together. So the time at which its orders lead nearest to its
    encoders is more accurate than the time of the STOP, which the robot receives a little later
    or which came after it had stopped by itself. Two cases are ambiguous: both joints rest, or
    the way passes a place twice. Then the time nearest to the STOP is taken.

    Args:
        motion: the orders.
        row: row of the robot.
        counts: its encoders after the stop [quanta], shape (2,).
        near_s: time of the STOP, from the begin of the order [s].
    """
    counts = np.asarray(counts)
    knots, all_ticks, all_counts = motion.of_robots([row]).knots()
    ends = [all_ticks[knots.slice(joint)] for joint in (0, 1)]
    places = [all_counts[knots.slice(joint)] - motion.start[row, joint] for joint in (0, 1)]
    ticks = np.union1d(*ends)
    if len(ticks) == 1:
        return 0.0
    # in each piece both joints are linear: place = begin + share * step, share in 0..1
    way = np.stack([np.interp(ticks, e, p) for e, p in zip(ends, places)], axis=1)
    begins, step, lasts = way[:-1], np.diff(way, axis=0), np.diff(ticks)
    square = (step**2).sum(axis=1)
    share_at_stop = (near_s / motion.units.tick_s - ticks[:-1]) / lasts
    along = ((counts - motion.start[row] - begins) * step).sum(axis=1)
    share = np.where(square > 0, along / np.maximum(square, 1e-9), share_at_stop)
    share = np.clip(share, 0.0, 1.0)
    off = np.linalg.norm(begins + share[:, None] * step + motion.start[row] - counts, axis=1)
    times_s = (ticks[:-1] + share * lasts) * motion.units.tick_s
    nearest = off <= off.min() + _SAME_PLACE
    return float(times_s[nearest][np.argmin(np.abs(times_s[nearest] - near_s))])

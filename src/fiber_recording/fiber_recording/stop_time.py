# SPDX-License-Identifier: Apache-2.0
"""Finds when a robot stopped from where it stopped on the way of its orders."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.wire_units import WireMotion

__all__ = ["StopOnWay", "stop_on_way"]

_SAME_PLACE = 3.0  # places this close to each other are the same [quanta]


class StopOnWay(NamedTuple):
    """Where on the way of its orders a robot stopped.

    Args:
        time_s: the time, from the begin of the order [s].
        off_rad: how far its counters are from the way [rad].
    """

    time_s: float
    off_rad: float


def stop_on_way(
    motion: WireMotion,
    row: int,
    counts: ArrayLike,
    near_s: float,
    since_s: float = 0.0,
    until_s: float = np.inf,
) -> StopOnWay:
    """Return when a robot stopped, from the begin of its order, and how far it is from its way.

    Both joints of a robot stop together. So the time at which its orders lead nearest to its
    encoders is more accurate than the time of the STOP, which the robot receives a little later
    or which came after it had stopped by itself. Two cases are ambiguous: both joints rest, or
    the way passes a place twice. Then the time nearest to the STOP is taken.

    Args:
        motion: the orders.
        row: row of the robot.
        counts: its encoders after the stop [quanta], shape (2,).
        near_s: time of the STOP, from the begin of the order [s].
        since_s, until_s: it stopped between these times, from the begin of the order [s].
    """
    counts, units = np.asarray(counts), motion.units
    knots, all_ticks, all_counts = motion.of_robots([row]).knots()
    ends = [all_ticks[knots.slice(joint)] for joint in (0, 1)]
    places = [all_counts[knots.slice(joint)] - motion.start[row, joint] for joint in (0, 1)]
    ticks = np.union1d(*ends)
    if len(ticks) == 1:
        off = np.linalg.norm(motion.start[row] - counts)
        return StopOnWay(0.0, float(off) * units.quantum_rad)
    until = np.clip(until_s / units.tick_s, 0.0, ticks[-1])
    since = np.clip(since_s / units.tick_s, 0.0, until)
    # in each piece both joints are linear: place = begin + share * step, share in 0..1
    way = np.stack([np.interp(ticks, e, p) for e, p in zip(ends, places)], axis=1)
    begins, step, lasts = way[:-1], np.diff(way, axis=0), np.diff(ticks)
    square = (step**2).sum(axis=1)
    share_at_stop = (near_s / units.tick_s - ticks[:-1]) / lasts
    along = ((counts - motion.start[row] - begins) * step).sum(axis=1)
    share = np.where(square > 0, along / np.maximum(square, 1e-9), share_at_stop)
    # of each piece the part between the times; none of it has an end before its begin
    low, high = (np.clip((end - ticks[:-1]) / lasts, 0.0, 1.0) for end in (since, until))
    share = np.clip(share, low, high)
    off = np.linalg.norm(begins + share[:, None] * step + motion.start[row] - counts, axis=1)
    times_s = (ticks[:-1] + share * lasts) * units.tick_s
    outside = (ticks[1:] < since) | (ticks[:-1] > until)
    off[outside] = np.inf
    nearest = off <= off.min() + _SAME_PLACE
    time_s = float(times_s[nearest][np.argmin(np.abs(times_s[nearest] - near_s))])
    return StopOnWay(time_s, float(off.min()) * units.quantum_rad)

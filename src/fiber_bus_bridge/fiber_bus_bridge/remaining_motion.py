"""Orders for the remaining part of a motion in which all robots were stopped together."""

import numpy as np
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
    counts, speeds = np.asarray(counts, dtype=np.int64), np.asarray(speed).ravel()
    elapsed = max(elapsed_s / motion.units.tick_s, 0.0)
    start, now = motion.start.ravel(), counts.ravel()
    ticks: list[int] = []
    velocity: list[int] = []
    lengths = np.zeros(len(now), dtype=np.int64)
    for profile in np.flatnonzero(np.repeat(chosen, 2)):
        part = motion.parts.slice(int(profile))
        part_ticks, part_velocity = motion.ticks[part], motion.velocity[part]
        if len(part_ticks) == 0:
            continue
        ends = np.cumsum(part_ticks)
        positions = start[profile] + np.cumsum(part_ticks * part_velocity)
        k = min(int(np.searchsorted(ends, elapsed, side="right")), len(ends) - 1)
        distance = int(positions[k] - now[profile])
        shortest = -(-abs(distance) // int(speeds[profile]))
        left = max(int(np.ceil(ends[k] - elapsed)), shortest, 1)
        slow, more = divmod(distance, left)
        pieces = [(left - more, slow), (more, slow + 1)]
        pieces = [(n, v) for n, v in pieces if n > 0]
        pieces += zip(part_ticks[k + 1 :].tolist(), part_velocity[k + 1 :].tolist())
        while pieces and pieces[-1][1] == 0:
            pieces.pop()
        ticks += [n for n, _ in pieces]
        velocity += [v for _, v in pieces]
        lengths[profile] = len(pieces)
    offsets = Parts.from_counts(lengths).offsets
    return WireMotion(
        motion.units,
        counts,
        offsets,
        np.array(ticks, dtype=np.int64),
        np.array(velocity, dtype=np.int64),
    )

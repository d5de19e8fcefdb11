"""Orders for what is left of a motion in which all were stopped together."""

import numpy as np

from fiber_core.wire_units import WireMotion

__all__ = ["remaining_motion"]


def remaining_motion(motion: WireMotion, counts, elapsed_s: float, speed, chosen) -> WireMotion:
    """Return the motion that takes robots from where they stopped to where they were going.

    What remains of the segment a joint was in is D quanta in n ticks: r = D mod n of them at
    floor(D / n) + 1 and the others at floor(D / n), which ends exactly. The segments after it
    are as they were, so joints meet the same instants as in the motion that was certified.

    Args:
        motion: the motion that was stopped.
        counts: where encoders are now [quanta], shape (n, 2).
        elapsed_s: how long after its begin it was stopped [s].
        speed: highest joint speeds [velocity units], shape (n, 2).
        chosen: robots that go on, shape (n,); the others rest.
    """
    counts, speed = np.asarray(counts), np.asarray(speed).ravel()
    elapsed = max(elapsed_s / motion.units.tick_s, 0.0)
    position, from_ = motion.start.ravel(), counts.ravel()
    ticks, velocity, lengths = [], [], np.zeros(len(from_), dtype=np.int64)
    for profile in np.flatnonzero(np.repeat(chosen, 2)):
        part = slice(motion.offsets[profile], motion.offsets[profile + 1])
        lasts, turns = motion.ticks[part], motion.velocity[part]
        if len(lasts) == 0:
            continue
        ends = np.cumsum(lasts)
        places = position[profile] + np.cumsum(lasts * turns)
        k = min(int(np.searchsorted(ends, elapsed, side="right")), len(ends) - 1)
        way = int(places[k] - from_[profile])
        left = max(int(np.ceil(ends[k] - elapsed)), -(-abs(way) // int(speed[profile])), 1)
        slow, more = divmod(way, left)
        pieces = [(left - more, slow), (more, slow + 1)]
        pieces = [(n, v) for n, v in pieces if n > 0]
        pieces += zip(lasts[k + 1 :].tolist(), turns[k + 1 :].tolist())
        while pieces and pieces[-1][1] == 0:
            pieces.pop()
        ticks += [n for n, _ in pieces]
        velocity += [v for _, v in pieces]
        lengths[profile] = len(pieces)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    return WireMotion(motion.units, counts, offsets, ticks, velocity)

"""When a robot that stands somewhere on the way of its orders stopped there."""

import numpy as np

from fiber_core.wire_units import WireMotion

__all__ = ["stop_time_s"]

_ALIKE = 3.0  # places that are this near to each other are one [quanta]


def stop_time_s(motion: WireMotion, row: int, counts, about_s: float) -> float:
    """Return how long after its begin a robot stopped, by where it stands [s].

    Both joints stop together, so the place on their way that is nearest to where they are
    tells the time better than the STOP does, which robots hear a little later, or which came
    after the robot had stopped by itself. Where both rest the place tells nothing, and a
    way can come through a place twice: then the time nearest to the STOP counts.

    Args:
        motion: the orders.
        row: the robot.
        counts: where its encoders stand [quanta], shape (2,).
        about_s: when it was told to stop, counted alike [s].
    """
    ends, places = [], []
    for profile in (2 * row, 2 * row + 1):
        part = slice(*motion.offsets[profile : profile + 2])
        lasts, turns = motion.ticks[part], motion.velocity[part]
        ends.append(np.concatenate([[0], np.cumsum(lasts)]))
        places.append(np.concatenate([[0], np.cumsum(lasts * turns)]))
    ticks = np.union1d(*ends)
    if len(ticks) == 1:
        return 0.0
    way = np.stack([np.interp(ticks, e, p) for e, p in zip(ends, places)], axis=1)
    begins, step, lasts = way[:-1], np.diff(way, axis=0), np.diff(ticks)
    square = (step**2).sum(axis=1)
    wanted = (about_s / motion.units.tick_s - ticks[:-1]) / lasts
    along = ((np.asarray(counts) - motion.start[row] - begins) * step).sum(axis=1)
    share = np.clip(np.where(square > 0, along / np.maximum(square, 1e-9), wanted), 0.0, 1.0)
    off = np.linalg.norm(begins + share[:, None] * step + motion.start[row] - counts, axis=1)
    times_s = (ticks[:-1] + share * lasts) * motion.units.tick_s
    alike = off <= off.min() + _ALIKE
    return float(times_s[alike][np.argmin(np.abs(times_s[alike] - about_s))])

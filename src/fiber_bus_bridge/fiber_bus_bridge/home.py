"""Orders that fold robots: phi to its upper limit, theta still."""

import numpy as np

from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["home_motion"]


def home_motion(units: WireUnits, start, high, speed, chosen) -> WireMotion:
    """Return the motion that folds robots with one segment each, as fast as they may.

    A joint stops within as many quanta of its limit as the move has ticks, never beyond;
    what is farther than one segment reaches is left for another call.

    Args:
        units: tick, quantum and widths.
        start: joint positions now [quanta], shape (n, 2).
        high: upper limits of phi [quanta], shape (n,).
        speed: highest speeds of phi [velocity units], shape (n,).
        chosen: robots to fold, shape (n,).
    """
    way = np.where(chosen, high - start[:, 1], 0)
    ticks = np.clip(-(-np.abs(way) // np.maximum(speed, 1)), 1, units.max_ticks)
    velocity = np.sign(way) * np.minimum(np.abs(way) // ticks, speed)
    moves = velocity != 0
    offsets = np.concatenate([[0], np.cumsum(np.stack([np.zeros_like(way), moves], 1).ravel())])
    return WireMotion(units, start, offsets, ticks[moves], velocity[moves])

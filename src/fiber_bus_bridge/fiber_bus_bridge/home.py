# SPDX-License-Identifier: Apache-2.0
"""Orders that bring robots home: phi to its upper limit, theta still."""

import numpy as np

from fiber_core.array_types import Counts, Ints, Mask
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["home_motion"]


def home_motion(
    units: WireUnits, start: Counts, high: Ints, speed: Ints, chosen: Mask
) -> WireMotion:
    """Return the motion that folds robots with one segment each, at their highest speed.

    The velocity is a whole number, so a joint stops short of its limit by fewer quanta than the
    move has ticks, never beyond the limit. A joint that is farther away than one segment reaches
    needs another call.

    Args:
        units: tick, quantum and widths.
        start: joint positions now [quanta], shape (n, 2).
        high: upper limits of phi [quanta], shape (n,).
        speed: highest speeds of phi [velocity units], shape (n,).
        chosen: robots to fold, shape (n,).
    """
    distance = np.where(chosen, high - start[:, 1], 0)
    ticks = np.clip(-(-np.abs(distance) // np.maximum(speed, 1)), 1, units.max_ticks)
    velocity = np.sign(distance) * np.minimum(np.abs(distance) // ticks, speed)
    moves = velocity != 0
    segments = np.stack([np.zeros_like(distance), moves], axis=1)
    offsets = Parts.from_counts(segments).offsets
    return WireMotion(units, start, offsets, ticks[moves], velocity[moves])

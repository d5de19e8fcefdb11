"""Profiles: a piecewise linear motion with the instant and the angle at which segments begin."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.array_types import Angles, Floats, Ints, Times, Velocities
from fiber_core.motion import SegmentMotion

__all__ = ["Profiles", "profiles_of"]


class Profiles(NamedTuple):
    """A SegmentMotion with the instant and the angle at which each segment begins.

    ``stop[i] = first[i]`` makes robot i rest at its start.

    Args:
        start: joint angles at time zero [rad], shape (n, 2).
        first: first segment of each joint, shape (n, 2).
        stop: the segment after the last segment of each joint, shape (n, 2).
        begins_s: instant at which each segment begins [s], shape (m,).
        ends_s: instant at which each segment ends [s], shape (m,).
        angle: joint angle at the begin of each segment [rad], shape (m,).
        velocity: joint velocity in each segment [rad/s], shape (m,).
        low: lowest angle of each joint [rad], shape (n, 2).
        high: highest angle of each joint [rad], shape (n, 2).
        fastest: highest speed of each joint [rad/s], shape (n, 2).
    """

    start: Angles
    first: Ints
    stop: Ints
    begins_s: Times
    ends_s: Times
    angle: Floats
    velocity: Floats
    low: Angles
    high: Angles
    fastest: Velocities


def profiles_of(motion: SegmentMotion) -> Profiles:
    """Return the profiles of a motion."""
    first, stop = motion.offsets[:-1].reshape(-1, 2), motion.offsets[1:].reshape(-1, 2)
    columns = _unroll(motion.start, first, stop, motion.duration_s, motion.velocity_rad_s)
    return Profiles(motion.start.copy(), first.copy(), stop.copy(), *columns)


@nb.njit(cache=True, error_model="numpy")
def _unroll(
    start: Angles, first: Ints, stop: Ints, duration: Floats, velocity: Floats
) -> tuple[Times, Times, Floats, Floats, Angles, Angles, Velocities]:
    # the columns of Profiles from begins_s on
    m = len(duration)
    begins, ends, angles = np.empty(m), np.empty(m), np.empty(m)
    low, high = start.copy(), start.copy()
    fastest = np.zeros(start.shape)
    for i in range(len(start)):
        for joint in range(2):
            time, angle = 0.0, start[i, joint]
            for k in range(first[i, joint], stop[i, joint]):
                begins[k], angles[k] = time, angle
                time += duration[k]
                angle += velocity[k] * duration[k]
                ends[k] = time
                low[i, joint] = min(low[i, joint], angle)
                high[i, joint] = max(high[i, joint], angle)
                fastest[i, joint] = max(fastest[i, joint], abs(velocity[k]))
    return begins, ends, angles, velocity.copy(), low, high, fastest

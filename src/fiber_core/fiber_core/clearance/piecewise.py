"""A motion with the instant and the angle at which each of its segments begins."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.motion import SegmentMotion

__all__ = ["Profiles", "profiles_of"]


class Profiles(NamedTuple):
    """A SegmentMotion with the instant and the angle at which each segment begins.

    A robot is made to rest by ``stop[i] = first[i]``.

    Args:
        start: joint angles at time zero [rad], shape (n, 2).
        first: first segment of each joint, shape (n, 2).
        stop: the one after its last segment, shape (n, 2).
        begins_s: when each segment begins [s], shape (m,).
        ends_s: when it ends [s], shape (m,).
        angle: joint angle at its begin [rad], shape (m,).
        velocity: joint speed in it [rad/s], shape (m,).
        low: lowest angle of each joint [rad], shape (n, 2).
        high: highest angle of each joint [rad], shape (n, 2).
        fastest: highest speed of each joint [rad/s], shape (n, 2).
    """

    start: np.ndarray
    first: np.ndarray
    stop: np.ndarray
    begins_s: np.ndarray
    ends_s: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    low: np.ndarray
    high: np.ndarray
    fastest: np.ndarray


def profiles_of(motion: SegmentMotion) -> Profiles:
    """Return the instant and angle at which each segment of a motion begins."""
    first, stop = motion.offsets[:-1].reshape(-1, 2), motion.offsets[1:].reshape(-1, 2)
    segments = _unrolled(motion.start, first, stop, motion.duration_s, motion.velocity_rad_s)
    return Profiles(motion.start.copy(), first.copy(), stop.copy(), *segments)


@nb.njit(cache=True, error_model="numpy")
def _unrolled(start, first, stop, duration, velocity):
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

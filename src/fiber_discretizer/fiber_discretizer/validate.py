"""Check a planned trajectory before it is discretized."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Counts, Velocities
from fiber_core.errors import MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.validation import frozen_array
from fiber_core.wire_units import WireUnits
from fiber_discretizer.options import DiscretizeOptions

__all__ = ["check_trajectory", "peak_speeds", "starting_counts"]

_START_NOISE_RAD = 1e-9  # of the certificate too: a joint that starts farther out fails it
_PROFILE_NOISE_RAD = 1e-6  # rounding brings later parts of a profile inside


def check_trajectory(
    plane: FocalPlane,
    trajectory: SampledMotion,
    start_counts: ArrayLike,
    units: WireUnits,
    options: DiscretizeOptions,
    velocities: ArrayLike | None = None,
) -> Codes:
    """Return the Reason why each robot's profiles cannot be used, OK where they can.

    Args:
        plane: the focal plane.
        trajectory: joint profiles of all its robots.
        start_counts: present encoder counts [quanta], shape (n, 2).
        units: size of tick and quantum.
        options: for start_tolerance_rad and speed_tolerance. A jump between two samples is
            a speed that is too high.
        velocities: joint velocities given with the angles [rad/s], shape (n, 2, t), or None.

    Returns:
        Reason of each robot, shape (n,): DISABLED where a disabled robot is to move,
        BAD_TRAJECTORY where a profile does not begin at the present angle, has angles or
        velocities that are too fast, moves outside the joint limits, or moves a joint with a
        speed limit below one velocity unit.

    Raises:
        MotionError: velocities do not have the shape of the trajectory.
    """
    angles, start = trajectory.angles, units.to_angles(start_counts)
    low, high = np.moveaxis(plane.limits, -1, 0)
    fastest = peak_speeds(trajectory)
    too_fast = plane.speeds * (1 + options.speed_tolerance)
    bad = np.abs(trajectory.start - start) > options.start_tolerance_rad
    bad |= fastest > too_fast
    if velocities is not None:
        velocities = frozen_array(velocities, np.float64, angles.shape, "velocities", MotionError)
        bad |= ~(np.abs(velocities) <= too_fast[:, :, None]).all(axis=2)
    moves = fastest > 0
    bad |= moves & (plane.speeds < units.velocity_rad_s)
    bad |= moves & ((start < low - _START_NOISE_RAD) | (start > high + _START_NOISE_RAD))
    least, most = angles.min(axis=2), angles.max(axis=2)
    bad |= moves & ((least < low - _PROFILE_NOISE_RAD) | (most > high + _PROFILE_NOISE_RAD))
    reason = np.where(bad.any(axis=1), int(Reason.BAD_TRAJECTORY), int(Reason.OK))
    reason[moves.any(axis=1) & ~plane.enabled] = Reason.DISABLED
    return reason


def peak_speeds(trajectory: SampledMotion) -> Velocities:
    """Return the highest speed of each joint between two samples [rad/s], shape (n, 2)."""
    return _peak_speeds(np.diff(trajectory.time_s), trajectory.angles)


@njit(cache=True)
def _peak_speeds(steps, angles):
    peak = np.zeros(angles.shape[:2])
    for i in range(angles.shape[0]):
        for j in range(angles.shape[1]):
            for k in range(len(steps)):
                speed = abs(angles[i, j, k + 1] - angles[i, j, k]) / steps[k]
                peak[i, j] = max(peak[i, j], speed)
    return peak


def starting_counts(
    plane: FocalPlane,
    trajectory: SampledMotion,
    units: WireUnits,
    given: ArrayLike | None = None,
) -> Counts:
    """Return the encoder counts at the start, as given or at the begin of the trajectory.

    Rounding never takes a joint across its limit; a joint that begins outside stays there.

    Args:
        plane: the focal plane.
        trajectory: joint profiles of all its robots.
        units: size of the quantum.
        given: present encoder counts [quanta], shape (n, 2), or None.

    Returns:
        Encoder counts [quanta], shape (n, 2).

    Raises:
        MotionError: the trajectory or the counts have another number of robots than the
            plane, or the trajectory begins before time zero.
    """
    if trajectory.n != plane.n:
        raise MotionError(f"a trajectory of {trajectory.n} robots for a plane of {plane.n}")
    if trajectory.time_s[0] < 0:
        raise MotionError(f"the trajectory begins at {trajectory.time_s[0]} s, before time zero")
    if given is not None:
        return frozen_array(given, np.int64, (plane.n, 2), "start_counts", MotionError)
    return units.encoder_counts(plane, trajectory.start)

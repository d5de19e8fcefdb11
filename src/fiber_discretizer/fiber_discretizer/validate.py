# SPDX-License-Identifier: Apache-2.0
"""Check a planned trajectory before it is discretized."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Counts, Floats, Velocities
from fiber_core.drive import Breaches, MotorRule
from fiber_core.errors import MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.validation import frozen_array
from fiber_core.wire_units import WireUnits
from fiber_discretizer.options import DiscretizeOptions

__all__ = ["check_size", "check_trajectory", "peak_speeds", "starting_counts", "until_rest"]

_START_NOISE_RAD = 1e-9  # of the certificate too: a joint that starts farther out fails it
_MOST_SAMPLES = 100_000  # six times the ticks of the longest order of the usual units
_MOST_ROWS = 100_000_000  # samples times robots: 20 000 samples of 5000 robots
_PROFILE_NOISE_RAD = 1e-6  # rounding brings later parts of a profile inside


def check_trajectory(
    plane: FocalPlane,
    trajectory: SampledMotion,
    start_counts: ArrayLike,
    units: WireUnits,
    options: DiscretizeOptions,
    velocities: ArrayLike | None = None,
) -> tuple[Codes, Breaches]:
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
        velocities that are too fast, moves outside the joint limits, moves a joint with a
        speed limit below one velocity unit, or comes to rest after the end of the longest
        order. And speeds, angles and durations that are not allowed.

    Raises:
        MotionError: velocities do not have the shape of the trajectory.
    """
    angles, start = trajectory.angles, units.to_angles(start_counts)
    low, high = np.moveaxis(plane.limits, -1, 0)
    fastest = peak_speeds(trajectory)
    too_fast = plane.speeds * (1 + options.speed_tolerance)
    bad = np.abs(trajectory.start - start) > options.start_tolerance_rad
    moves = fastest > 0
    bad |= fastest > too_fast
    if velocities is not None:
        velocities = frozen_array(velocities, np.float64, angles.shape, "velocities", MotionError)
        given = np.abs(velocities)
        bad |= ~(given <= too_fast[:, :, None]).all(axis=2)
        fastest = np.maximum(fastest, given.max(axis=2))
    beyond = [Breaches.of(MotorRule.JOINT_SPEED, fastest > too_fast, fastest, most=plane.speeds)]
    bad |= moves & (plane.speeds < units.velocity_rad_s)
    bad |= moves & ((start < low - _START_NOISE_RAD) | (start > high + _START_NOISE_RAD))
    least, most = angles.min(axis=2), angles.max(axis=2)
    below = moves & (least < low - _PROFILE_NOISE_RAD)
    above = moves & (most > high + _PROFILE_NOISE_RAD)
    end_s, longest = _arrivals_s(trajectory), longest_s(units, options)
    late = moves & (end_s > longest)
    beyond += [
        Breaches.of(MotorRule.JOINT_RANGE, below, least, low, high),
        Breaches.of(MotorRule.JOINT_RANGE, above, most, low, high),
        Breaches.of(MotorRule.ORDER_LENGTH, late, end_s, most=longest),
    ]
    bad |= below | above | late
    reason = np.where(bad.any(axis=1), int(Reason.BAD_TRAJECTORY), int(Reason.OK))
    reason[moves.any(axis=1) & ~plane.enabled] = Reason.DISABLED
    return reason, Breaches.joined(beyond)


def check_size(trajectory: SampledMotion) -> None:
    """Refuse a trajectory with more samples than any order can express.

    Raises:
        MotionError: names the numbers of samples and robots.
    """
    samples, rows = len(trajectory.time_s), len(trajectory.time_s) * trajectory.n
    if samples > _MOST_SAMPLES or rows > _MOST_ROWS:
        raise MotionError(
            f"the trajectory has {samples} samples of {trajectory.n} robots, expected at most "
            f"{_MOST_SAMPLES} samples, and {_MOST_ROWS} samples times robots"
        )


def longest_s(units: WireUnits, options: DiscretizeOptions) -> float:
    """Return the duration of the longest motion that an order can carry [s]."""
    return options.max_segments * units.max_ticks * units.tick_s


def until_rest(
    trajectory: SampledMotion, units: WireUnits, options: DiscretizeOptions
) -> SampledMotion:
    """Return a trajectory that is too long for an order without the rest at its end.

    Args:
        trajectory: joint profiles of all robots; no robot moves after the end of the longest
            order.
        units: size of tick, width of the duration field.
        options: for max_segments.
    """
    if trajectory.time_s[-1] <= longest_s(units, options):
        return trajectory
    arrival_s = max(_arrivals_s(trajectory).max(initial=0.0), trajectory.time_s[1])
    if arrival_s > longest_s(units, options):  # all rest
        still = np.repeat(trajectory.angles[:, :, :1], 2, axis=2)
        return SampledMotion(np.array([0.0, units.tick_s]), still)
    keep = trajectory.time_s <= arrival_s
    return SampledMotion(trajectory.time_s[keep], trajectory.angles[:, :, keep])


def _arrivals_s(trajectory: SampledMotion) -> Floats:
    # when each joint comes to rest [s], shape (n, 2)
    still = trajectory.angles == trajectory.angles[:, :, -1:]
    last = still.shape[2] - np.argmin(still[:, :, ::-1], axis=2)
    last = np.where(still.all(axis=2), 0, np.minimum(last, still.shape[2] - 1))
    return trajectory.time_s[last]


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

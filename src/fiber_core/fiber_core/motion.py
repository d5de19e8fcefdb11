# SPDX-License-Identifier: Apache-2.0
"""Motions of all joints in time: sampled profiles and constant-velocity segments.

A motion is called: ``motion(t)`` gives joint angles, ``motion.velocity(t)`` joint
speeds. Before its first and after its last instant a motion rests.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, TypeAlias

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Angles, Floats, Offsets, Times, Velocities
from fiber_core.errors import MotionError
from fiber_core.joint_segments import JointSegments, profile_rows
from fiber_core.ragged import Parts
from fiber_core.validation import frozen_array

__all__ = [
    "AngleSegments",
    "CurveArrays",
    "Extremes",
    "MotionArrays",
    "SampledMotion",
    "SegmentMotion",
    "profile_rows",
]

# start, offsets, duration_s and velocity_rad_s of a SegmentMotion
MotionArrays: TypeAlias = tuple[Angles, Offsets, Floats, Floats]
# the same and the acceleration of each piece, an empty array if no piece has one
CurveArrays: TypeAlias = tuple[Angles, Offsets, Floats, Floats, Floats]
# lowest and highest angle, highest speed and highest acceleration of each joint
Extremes: TypeAlias = tuple[Angles, Angles, Velocities, Floats]


def _finite(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> Floats:
    array = frozen_array(value, np.float64, shape, name, MotionError)
    if not np.isfinite(array).all():
        at = np.argwhere(~np.isfinite(array))[0]
        raise MotionError(f"{name}{at.tolist()} must be finite, got {array[tuple(at)]}")
    return array


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """Joint profiles sampled at common times, straight lines in between.

    Args:
        time_s: strictly increasing times [s], shape (t,), t >= 1.
        angles: joint angles [rad], shape (n, 2, t).

    Raises:
        MotionError: shapes do not fit, times do not increase, a value is not finite, or an
            angle is out of bounds.
    """

    time_s: Times
    angles: Floats

    def __post_init__(self):
        time_s = _finite(self.time_s, (None,), "time_s")
        if len(time_s) == 0:
            raise MotionError("a motion needs at least one sample")
        if np.any(np.diff(time_s) <= 0):
            at = int(np.argmax(np.diff(time_s) <= 0))
            raise MotionError(f"times must increase: {time_s[at + 1]} s follows {time_s[at]} s")
        object.__setattr__(self, "time_s", time_s)
        angles = _finite(self.angles, (None, 2, len(time_s)), "angles")
        far = max(angles.max(initial=0.0), -angles.min(initial=0.0))
        if far > bounds.MAX_ANGLE_RAD:
            at = np.argwhere(np.abs(angles) > bounds.MAX_ANGLE_RAD)[0]
            raise MotionError(
                f"robot row {at[0]}: angles must be {-bounds.MAX_ANGLE_RAD:.6g} to "
                f"{bounds.MAX_ANGLE_RAD:.6g} rad, got {angles[tuple(at)]} rad"
            )
        object.__setattr__(self, "angles", angles)

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.angles)

    @property
    def start(self) -> Angles:
        """Joint angles before the motion [rad], shape (n, 2)."""
        return self.angles[:, :, 0]

    @property
    def end(self) -> Angles:
        """Joint angles after the motion [rad], shape (n, 2)."""
        return self.angles[:, :, -1]

    @cached_property
    def makespan_s(self) -> float:
        """Instant after which no joint moves [s]."""
        moves = np.any(self.angles != self.angles[:, :, -1:], axis=(0, 1))
        return float(self.time_s[np.flatnonzero(moves)[-1] + 1]) if moves.any() else 0.0

    def __call__(self, t: float) -> Angles:
        """Return the joint angles at time t [s]: [rad], shape (n, 2)."""
        if len(self.time_s) == 1 or t <= self.time_s[0]:
            return self.start.copy()
        if t >= self.time_s[-1]:
            return self.end.copy()
        k = int(np.searchsorted(self.time_s, t, side="right")) - 1
        w = (t - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k])
        return (1 - w) * self.angles[:, :, k] + w * self.angles[:, :, k + 1]

    def velocity(self, t: float) -> Velocities:
        """Return the joint velocities at time t [s]: [rad/s], shape (n, 2).

        At a sample, they are those of the piece that begins there.
        """
        if len(self.time_s) == 1 or not self.time_s[0] <= t < self.time_s[-1]:
            return np.zeros_like(self.start)
        k = int(np.searchsorted(self.time_s, t, side="right")) - 1
        step = self.angles[:, :, k + 1] - self.angles[:, :, k]
        return step / (self.time_s[k + 1] - self.time_s[k])


class AngleSegments(JointSegments):
    """What motions in rad and s have in common: extremes and times of their joints."""

    start: Angles
    duration_s: Floats

    @cached_property
    def _extremes(self) -> Extremes:
        raise NotImplementedError

    @property
    def lowest(self) -> Angles:
        """Lowest angle of each joint [rad], shape (n, 2)."""
        return self._extremes[0]

    @property
    def highest(self) -> Angles:
        """Highest angle of each joint [rad], shape (n, 2)."""
        return self._extremes[1]

    @property
    def fastest(self) -> Velocities:
        """Highest speed of each joint [rad/s], shape (n, 2)."""
        return self._extremes[2]

    @property
    def hardest(self) -> Floats:
        """Highest acceleration of each joint, either sign [rad/s2], shape (n, 2)."""
        return self._extremes[3]

    @cached_property
    def durations(self) -> Floats:
        """Time that each joint takes [s], shape (n, 2)."""
        return self._sums(self.duration_s)

    @property
    def makespan_s(self) -> float:
        """Time that the slowest joint takes [s]."""
        return float(self.durations.max(initial=0.0))

    @cached_property
    def begins_s(self) -> Times:
        """When each segment begins: exactly when the segment before it ends [s], shape (m,)."""
        return self.parts.before(self.duration_s)


@dataclass(frozen=True, eq=False)
class SegmentMotion(AngleSegments):
    """Joint profiles of constant-velocity segments, all starting at time zero.

    Args:
        start: joint angles at time zero [rad], shape (n, 2).
        offsets: first segment of each profile, shape (2 n + 1,), as in JointSegments.
        duration_s: duration of each segment [s], positive, shape (m,).
        velocity_rad_s: joint velocity in each segment [rad/s], shape (m,).

    Raises:
        MotionError: shapes do not fit, offsets decrease, or a value is out of range.
    """

    start: Angles
    offsets: Offsets
    duration_s: Floats
    velocity_rad_s: Floats

    _COLUMNS: ClassVar[tuple[str, ...]] = ("duration_s", "velocity_rad_s")

    def __post_init__(self):
        start = _finite(self.start, (None, 2), "start")
        shape = (2 * len(start) + 1,)
        offsets = frozen_array(self.offsets, np.int64, shape, "offsets", MotionError)
        if not Parts(offsets).cover(2 * len(start), int(offsets[-1])):
            raise MotionError("offsets must rise from 0")
        m = int(offsets[-1])
        duration = _finite(self.duration_s, (m,), "duration_s")
        if np.any(duration <= 0):
            at = int(np.argmax(duration <= 0))
            row = int(np.searchsorted(offsets, at, side="right") - 1) // 2
            raise MotionError(
                f"robot row {row}: segment {at} must last longer than 0 s, got {duration[at]} s"
            )
        velocity = _finite(self.velocity_rad_s, (m,), "velocity_rad_s")
        for name, value in (
            ("start", start),
            ("offsets", offsets),
            ("duration_s", duration),
            ("velocity_rad_s", velocity),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def at_rest(cls, angles: ArrayLike) -> "SegmentMotion":
        """Return the motion in which all robots stay where they are.

        Args:
            angles: their joint angles [rad], shape (n, 2).
        """
        angles = np.asarray(angles, dtype=float)
        return cls(angles, np.zeros(2 * len(angles) + 1, dtype=np.int64), np.zeros(0), np.zeros(0))

    @classmethod
    def of_valid(
        cls, start: Angles, offsets: Offsets, duration_s: Floats, velocity_rad_s: Floats
    ) -> "SegmentMotion":
        """Return a motion of arrays that are valid for sure; they become read-only.

        The arguments are those of the class.
        """
        return cls._unchecked(start, offsets, (duration_s, velocity_rad_s), {})

    @property
    def arrays(self) -> MotionArrays:
        """Start, offsets, durations and velocities, as compiled loops take them."""
        return self.start, self.offsets, self.duration_s, self.velocity_rad_s

    @property
    def curve_arrays(self) -> CurveArrays:
        """The same arrays and an empty one in place of accelerations."""
        return *self.arrays, np.zeros(0)

    @cached_property
    def _extremes(self) -> Extremes:
        found = _extremes(self.start, self.offsets, self.duration_s, self.velocity_rad_s)
        return *found, np.zeros((self.n, 2))  # no accelerations are given

    @cached_property
    def end(self) -> Angles:
        """Joint angles after the motion [rad], shape (n, 2)."""
        return self.start + self._sums(self.duration_s * self.velocity_rad_s)

    def __call__(self, t: float) -> Angles:
        """Return the joint angles at time t [s]: [rad], shape (n, 2)."""
        elapsed = np.clip(t - self.begins_s, 0.0, self.duration_s)
        return self.start + self._sums(elapsed * self.velocity_rad_s)

    def velocity(self, t: float) -> Velocities:
        """Return the joint velocities at time t [s]: [rad/s], shape (n, 2).

        Between two segments, they are those of the segment that begins there.
        """
        active = (self.begins_s <= t) & (t < self.begins_s + self.duration_s)
        return self._sums(np.where(active, self.velocity_rad_s, 0.0))


@nb.njit(cache=True)
def _extremes(
    start: Angles, offsets: Offsets, duration_s: Floats, velocity_rad_s: Floats
) -> tuple[Angles, Angles, Velocities]:
    # lowest and highest angle, and highest speed of each joint
    low, high, fastest = start.copy(), start.copy(), np.zeros(start.shape)
    for i in range(len(start)):
        for joint in range(2):
            angle = start[i, joint]
            for k in range(offsets[2 * i + joint], offsets[2 * i + joint + 1]):
                angle += velocity_rad_s[k] * duration_s[k]
                low[i, joint] = min(low[i, joint], angle)
                high[i, joint] = max(high[i, joint], angle)
                fastest[i, joint] = max(fastest[i, joint], abs(velocity_rad_s[k]))
    return low, high, fastest

# SPDX-License-Identifier: Apache-2.0
"""True curves: the piecewise quadratic angles of joints whose motors have a ramp."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numba as nb
import numpy as np

from fiber_core.array_types import Angles, Floats, Offsets, Velocities
from fiber_core.drive.drive import Drive
from fiber_core.drive.rules import ramps_of
from fiber_core.motion import AngleSegments, CurveArrays, Extremes, SegmentMotion
from fiber_core.ragged import Parts

__all__ = ["CurveMotion", "carried_out", "spread_out"]

_SAME_S = 1e-12  # two changes of the law that are nearer than this are one


@dataclass(frozen=True, eq=False)
class CurveMotion(AngleSegments):
    """Joint profiles of constant acceleration, piece by piece, all starting at time zero.

    It has the properties of a SegmentMotion, and the certificate takes it in its place. Made by
    `carried_out`; the values are taken as they are.

    Args:
        start: joint angles at time zero [rad], shape (n, 2).
        offsets: first piece of each profile, shape (2 n + 1,), as in JointSegments.
        duration_s: duration of each piece [s], positive, shape (m,).
        velocity_rad_s: joint velocity at the begin of each piece [rad/s], shape (m,).
        acceleration_rad_s2: joint acceleration in each piece [rad/s2], shape (m,).
        angle_rad: joint angle at the begin of each piece [rad], shape (m,).
    """

    start: Angles
    offsets: Offsets
    duration_s: Floats
    velocity_rad_s: Floats
    acceleration_rad_s2: Floats
    angle_rad: Floats

    _COLUMNS: ClassVar[tuple[str, ...]] = (
        "duration_s",
        "velocity_rad_s",
        "acceleration_rad_s2",
        "angle_rad",
    )

    @property
    def curve_arrays(self) -> CurveArrays:
        """Start, offsets, durations, velocities and accelerations, as compiled loops take them."""
        columns = self.duration_s, self.velocity_rad_s, self.acceleration_rad_s2
        return self.start, self.offsets, *columns

    @cached_property
    def _extremes(self) -> Extremes:
        return _extremes(*self.curve_arrays, self.angle_rad)

    def __call__(self, t: float) -> Angles:
        """Return the joint angles at time t [s]: [rad], shape (n, 2)."""
        return self.start + self._sums(self._turned(np.clip(t - self.begins_s, 0, self.duration_s)))

    def velocity(self, t: float) -> Velocities:
        """Return the joint velocities at time t [s]: [rad/s], shape (n, 2)."""
        passed = t - self.begins_s
        active = (passed >= 0.0) & (passed < self.duration_s)
        speed = self.velocity_rad_s + self.acceleration_rad_s2 * passed
        return self._sums(np.where(active, speed, 0.0))

    @cached_property
    def end(self) -> Angles:
        """Joint angles after the motion [rad], shape (n, 2)."""
        return self.start + self._sums(self._turned(self.duration_s))

    def _turned(self, passed: Floats) -> Floats:
        # angle from the begin of each piece after some time in it [s]
        return passed * (self.velocity_rad_s + 0.5 * self.acceleration_rad_s2 * passed)


def carried_out(drive: Drive, motion: SegmentMotion) -> SegmentMotion | CurveMotion:
    """Return the motion that the joints make of ordered segments: the true curve.

    With a ramp of T the velocity at t is the mean of the ordered one from t - T to t. So it is a
    straight line between the instants at which an ordered change begins, at t, or ends, at
    t + T. With listed speeds each segment is spread over the ramp of its speed, and the velocity
    is the sum of all segments.

    Args:
        drive: how the motors carry out orders.
        motion: the ordered segments, decoded from the bytes.
    """
    if not drive.has_curves:
        return motion
    if drive.listed is not None:
        return _curves(motion, _superposed(*motion.arrays, ramps_of(drive, motion)))
    return _curves(motion, _filtered(*motion.arrays, drive.ramp_s))


def spread_out(motion: SegmentMotion, ramp_s: Floats) -> SegmentMotion | CurveMotion:
    """Return the motion of joints whose segments are each spread over a ramp of its own.

    Args:
        motion: the segments.
        ramp_s: ramp of each segment [s], 0 or more, shape (m,); that of a rest has no effect.
    """
    ramps = np.unique(ramp_s[motion.velocity_rad_s != 0.0])
    if not ramps.any():
        return motion
    if len(ramps) == 1:
        return _curves(motion, _filtered(*motion.arrays, float(ramps[0])))
    return _curves(motion, _superposed(*motion.arrays, ramp_s))


def _curves(
    motion: SegmentMotion, pieces: tuple[Offsets, Floats, Floats, Floats, Floats]
) -> CurveMotion:
    counts, duration, velocity, acceleration, angle = pieces
    parts = Parts.from_counts(counts)
    return CurveMotion(motion.start, parts.offsets, duration, velocity, acceleration, angle)


@nb.njit(cache=True)
def _filtered(
    start: Angles, offsets: Offsets, duration_s: Floats, velocity_rad_s: Floats, ramp_s: float
) -> tuple[Offsets, Floats, Floats, Floats, Floats]:
    # the pieces of each profile: their number, durations, velocities and angles at their begin,
    # accelerations
    profiles = len(offsets) - 1
    most = 2 * len(duration_s) + 2 * profiles
    counts = np.zeros(profiles, dtype=np.int64)
    duration, velocity, acceleration = np.empty(most), np.empty(most), np.empty(most)
    angle = np.empty(most)
    used = 0
    for profile in range(profiles):
        first, last = offsets[profile], offsets[profile + 1]
        if first == last:
            continue
        before = used
        # the ordered velocity now, and the one a ramp ago; the segments that they belong to
        lead, lag = first, first - 1
        lead_s, lag_s = duration_s[first], ramp_s  # when the present ones end
        t, w, q = 0.0, 0.0, start[profile // 2, profile % 2]
        while lag < last:
            end = min(lead_s, lag_s)
            now = velocity_rad_s[lead] if lead < last else 0.0
            ago = velocity_rad_s[lag] if lag >= first else 0.0
            step = end - t
            if step > _SAME_S:
                a = (now - ago) / ramp_s
                duration[used], velocity[used], acceleration[used], angle[used] = step, w, a, q
                used += 1
                q += step * (w + 0.5 * a * step)
                w += a * step
                t = end
            if lead_s <= end + _SAME_S:
                lead += 1
                lead_s = lead_s + duration_s[lead] if lead < last else np.inf
            if lag_s <= end + _SAME_S:
                lag += 1
                lag_s = lag_s + duration_s[lag] if lag < last else np.inf
        counts[profile] = used - before
    return counts, duration[:used], velocity[:used], acceleration[:used], angle[:used]


@nb.njit(cache=True)
def _superposed(
    start: Angles, offsets: Offsets, duration_s: Floats, velocity_rad_s: Floats, ramp_s: Floats
) -> tuple[Offsets, Floats, Floats, Floats, Floats]:
    # as _filtered, each segment k being spread over ramp_s[k]
    profiles = len(offsets) - 1
    most = 4 * len(duration_s)
    counts = np.zeros(profiles, dtype=np.int64)
    duration, velocity, acceleration = np.empty(most), np.empty(most), np.empty(most)
    angle = np.empty(most)
    used = 0
    for profile in range(profiles):
        first, last = offsets[profile], offsets[profile + 1]
        segments = last - first
        if segments == 0:
            continue
        begin, changes = np.empty(segments + 1), np.empty(2 * segments + 2)
        begin[0] = 0.0
        for k in range(segments):
            begin[k + 1] = begin[k] + duration_s[first + k]
        for k in range(segments + 1):
            here = ramp_s[first + k] if k < segments else 0.0
            ago = ramp_s[first + k - 1] if k > 0 else 0.0
            # a change begins at a segment's begin, and ends a ramp of either segment later
            changes[2 * k] = begin[k] + here
            changes[2 * k + 1] = begin[k] + ago
        instants = np.sort(np.concatenate((begin, changes)))
        before, q, t = used, start[profile // 2, profile % 2], 0.0
        for instant in instants:
            step = instant - t
            if step <= _SAME_S:
                continue
            w, a = 0.0, 0.0
            for k in range(segments):
                v, ramp = velocity_rad_s[first + k], ramp_s[first + k]
                if v == 0.0 or begin[k] > t + 0.5 * step or begin[k + 1] + ramp <= t:
                    continue
                if ramp == 0.0:
                    w += v
                    continue
                rising = min(max((t - begin[k]) / ramp, 0.0), 1.0)
                falling = min(max((t - begin[k + 1]) / ramp, 0.0), 1.0)
                w += v * (rising - falling)
                middle = t + 0.5 * step
                if middle < begin[k] + ramp:
                    a += v / ramp
                if begin[k + 1] < middle < begin[k + 1] + ramp:
                    a -= v / ramp
            duration[used], velocity[used], acceleration[used], angle[used] = step, w, a, q
            used += 1
            q += step * (w + 0.5 * a * step)
            t = instant
        counts[profile] = used - before
    return counts, duration[:used], velocity[:used], acceleration[:used], angle[:used]


@nb.njit(cache=True)
def _extremes(
    start: Angles,
    offsets: Offsets,
    duration_s: Floats,
    velocity_rad_s: Floats,
    acceleration_rad_s2: Floats,
    angle_rad: Floats,
) -> tuple[Angles, Angles, Velocities, Floats]:
    # lowest and highest angle, highest speed and highest acceleration of each joint
    low, high = start.copy(), start.copy()
    fastest, hardest = np.zeros(start.shape), np.zeros(start.shape)
    for i in range(len(start)):
        for joint in range(2):
            for k in range(offsets[2 * i + joint], offsets[2 * i + joint + 1]):
                w, a, lasts = velocity_rad_s[k], acceleration_rad_s2[k], duration_s[k]
                turn = lasts  # an angle is extreme at the end of a piece, or where it turns round
                for _ in range(2):
                    angle = angle_rad[k] + turn * (w + 0.5 * a * turn)
                    low[i, joint] = min(low[i, joint], angle)
                    high[i, joint] = max(high[i, joint], angle)
                    if a == 0.0 or not 0.0 < -w / a < lasts:
                        break
                    turn = -w / a
                fastest[i, joint] = max(fastest[i, joint], abs(w), abs(w + a * lasts))
                hardest[i, joint] = max(hardest[i, joint], abs(a))
    return low, high, fastest, hardest

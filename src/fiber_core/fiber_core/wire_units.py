# SPDX-License-Identifier: Apache-2.0
"""Whole-number units of time and angle in which orders travel on a bus.

A segment on the wire is a whole number of ticks and a whole number of velocity
units. One velocity unit is one quantum of angle per tick, so the position of a joint
is a whole number of quanta at every tick and a positioner integrates its orders
without rounding.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Counts, Floats, Ints, Offsets
from fiber_core.errors import MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.joint_segments import JointSegments
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts
from fiber_core.validation import frozen_array

__all__ = ["ORDER_SEGMENTS", "WireMotion", "WireUnits"]

ORDER_SEGMENTS = 15  # segments of one joint that one order can carry: a 4-bit count
_HEADROOM = 1.02  # velocity range above the speed limit, so that rounding never saturates
_ENCODER_COUNTS = 2**31 - 1  # counts of an encoder either side of zero
_FASTEST_TICK_RAD = np.deg2rad(0.72)  # the fastest joint turns this far in one tick


@dataclass(frozen=True)
class WireUnits:
    """Size of the tick and of the quantum, and widths of the two fields of a segment.

    Args:
        tick_us: one tick [us].
        quantum_prad: one quantum of joint angle [1e-12 rad].
        velocity_bits: width of the signed velocity field.
        duration_bits: width of the unsigned duration field.

    Raises:
        MotionError: a size is not positive, or a field is too narrow or too wide.
    """

    tick_us: int = 4000
    quantum_prad: int = 1_565_000
    velocity_bits: int = 14
    duration_bits: int = 10

    def __post_init__(self):
        for name, low, high in (
            ("tick_us", 1, 2**32),
            ("quantum_prad", 1, 2**32),
            ("velocity_bits", 2, 32),
            ("duration_bits", 1, 32),
        ):
            bounds.check_number(getattr(self, name), name, low, high, MotionError, whole=True)

    @classmethod
    def for_plane(
        cls, plane: FocalPlane, velocity_bits: int = 14, duration_bits: int = 10
    ) -> "WireUnits":
        """Choose the finest units that still carry the highest speed of a plane.

        A tick is the time that the fastest joint takes for 0.72 deg (4 ms at 180 deg/s),
        in whole tens of microseconds: slow instruments get longer ticks, so that a
        half turn always fits the duration field. The quantum is never so fine that an
        encoder of 32 bits cannot count every angle within the bounds.

        Args:
            plane: the focal plane.
            velocity_bits: width of the signed velocity field.
            duration_bits: width of the unsigned duration field.
        """
        fastest = float(plane.speeds.max(initial=0.0)) or np.pi
        tick_us = int(np.clip(10 * round(_FASTEST_TICK_RAD / fastest * 1e5), 10, 65_535 * 10))
        full_scale = 2 ** (velocity_bits - 1) - 1
        quantum = int(np.ceil(_HEADROOM * fastest * tick_us * 1e-6 / full_scale * 1e12))
        least = int(np.ceil(bounds.MAX_ANGLE_RAD / _ENCODER_COUNTS * 1e12))
        return cls(tick_us, max(quantum, least), velocity_bits, duration_bits)

    @property
    def tick_s(self) -> float:
        """One tick [s]."""
        return self.tick_us * 1e-6

    @property
    def quantum_rad(self) -> float:
        """One quantum of joint angle [rad]."""
        return self.quantum_prad * 1e-12

    @property
    def velocity_rad_s(self) -> float:
        """One velocity unit [rad/s]."""
        return self.quantum_rad / self.tick_s

    @property
    def max_velocity(self) -> int:
        """Largest velocity the field carries, either sign [velocity units]."""
        return 2 ** (self.velocity_bits - 1) - 1

    @property
    def max_ticks(self) -> int:
        """Longest duration the field carries [ticks]."""
        return 2**self.duration_bits - 1

    @property
    def longest_order_s(self) -> float:
        """Time of the longest motion of one joint that one order can carry [s]."""
        return ORDER_SEGMENTS * self.max_ticks * self.tick_s

    @property
    def segment_bytes(self) -> int:
        """Bytes of one segment on the wire."""
        return (self.velocity_bits + self.duration_bits + 7) // 8

    def to_counts(self, angles: ArrayLike) -> Ints:
        """Return the nearest whole number of quanta for angles [rad]; int64, same shape."""
        return np.rint(np.asarray(angles) / self.quantum_rad).astype(np.int64)

    def to_angles(self, counts: ArrayLike) -> Floats:
        """Return the angles [rad] of positions in quanta; same shape."""
        return np.asarray(counts) * self.quantum_rad

    def range_counts(self, plane: FocalPlane) -> Ints:
        """Return the lowest and highest positions inside the joint limits [quanta].

        Args:
            plane: the focal plane.

        Returns:
            Positions, shape (n, 2, 2): robot, joint (theta, phi), (low, high).
        """
        low, high = np.moveaxis(plane.limits, -1, 0) / self.quantum_rad
        first, last = np.ceil(low), np.floor(high)
        nearest = np.rint(0.5 * (low + high))  # of a fixed joint, with no count between its limits
        first, last = np.where(first > last, nearest, (first, last))
        return np.stack([first, last], axis=-1).astype(np.int64)

    def encoder_counts(self, plane: FocalPlane, angles: ArrayLike) -> Counts:
        """Return the encoder counts of robots at some angles [quanta], shape (n, 2).

        Rounding takes no joint across its stop; a joint beyond its stop stays there.

        Args:
            plane: the focal plane.
            angles: joint angles [rad], shape (n, 2).
        """
        nearest = self.to_counts(angles)
        inside = np.clip(nearest, *np.moveaxis(self.range_counts(plane), -1, 0))
        return np.where(np.abs(nearest - inside) <= 1, inside, nearest)


@dataclass(frozen=True, eq=False)
class WireMotion(JointSegments):
    """A motion in whole wire units, as the discretizer makes it and the bus carries it.

    Args:
        units: size of tick and quantum.
        start: joint positions at time zero [quanta], shape (n, 2).
        offsets: first segment of each profile, shape (2 n + 1,), as in JointSegments.
        ticks: duration of each segment [ticks], positive, shape (m,).
        velocity: joint velocity in each segment [velocity units], shape (m,).

    Raises:
        MotionError: shapes do not fit or a number does not fit its field.
    """

    units: WireUnits
    start: Counts
    offsets: Offsets
    ticks: Ints
    velocity: Ints

    _COLUMNS: ClassVar[tuple[str, ...]] = ("ticks", "velocity")

    def __post_init__(self):
        columns = {"start": (None, 2), "offsets": (None,), "ticks": (None,), "velocity": (None,)}
        for name, shape in columns.items():
            value = frozen_array(getattr(self, name), np.int64, shape, name, MotionError)
            object.__setattr__(self, name, value)
        n, m = len(self.start), len(self.ticks)
        if not self.parts.cover(2 * n, m):
            raise MotionError(f"offsets do not describe {2 * n} profiles of {m} segments")
        if self.velocity.shape != (m,):
            raise MotionError(f"{m} durations but {len(self.velocity)} velocities")
        for name, value, low, high in (
            ("duration", self.ticks, 1, self.units.max_ticks),
            ("velocity", self.velocity, -self.units.max_velocity, self.units.max_velocity),
        ):
            wrong = (value < low) | (value > high)
            if wrong.any():
                at = int(np.argmax(wrong))
                robot = int(np.searchsorted(self.offsets, at, side="right") - 1) // 2
                raise MotionError(
                    f"robot row {robot}: {name} {value[at]} is outside {low}..{high} wire units"
                )

    @classmethod
    def at_rest(cls, units: WireUnits, start: Counts) -> "WireMotion":
        """Return the motion in which all robots stay where they are.

        Args:
            units: size of tick and quantum.
            start: their joint positions [quanta], shape (n, 2).
        """
        nothing = np.zeros(0, dtype=np.int64)
        return cls(units, start, np.zeros(2 * len(start) + 1, np.int64), nothing, nothing)

    @classmethod
    def from_zero(
        cls, units: WireUnits, offsets: ArrayLike, ticks: ArrayLike, velocity: ArrayLike
    ) -> "WireMotion":
        """Return a motion of robots that start at position zero: orders, which have no start.

        The arguments are those of the class, and so are the errors.
        """
        start = np.zeros((np.size(offsets) // 2, 2), dtype=np.int64)
        columns = (np.asarray(column) for column in (offsets, ticks, velocity))
        return cls(units, start, *columns)

    def starting_at(self, start: ArrayLike) -> "WireMotion":
        """Return the same orders, carried out from other positions.

        Args:
            start: joint positions at time zero [quanta], shape (n, 2).

        Raises:
            MotionError: the shape does not fit.
        """
        checked = frozen_array(start, np.int64, (self.n, 2), "start", MotionError)
        return self._made(checked, self.parts, self._columns)

    @property
    def end(self) -> Counts:
        """Joint positions after the motion [quanta], shape (n, 2)."""
        return self.start + self._sums(self.ticks * self.velocity)

    def knots(self) -> tuple[Parts, Ints, Ints]:
        """Return where each joint is when a segment begins or ends, in whole units.

        Returns:
            The knots of each profile, one more than its segments; their instants [ticks] and the
            joint positions at them [quanta], shape (m + 2 n,).
        """
        knots, ticks = self.parts.knots, self.parts.running(self.ticks)
        travel = self.parts.running(self.ticks * self.velocity)
        return knots, ticks, travel + self.start.ravel()[knots.owner]

    def _shared(self) -> Mapping[str, object]:
        return {"units": self.units}

    @classmethod
    def nearest(cls, motion: SegmentMotion, units: WireUnits) -> "WireMotion":
        """Return a motion with every number rounded to whole units.

        Args:
            motion: a motion; one that was decoded from whole units comes back unchanged.
            units: size of tick and quantum.

        Raises:
            MotionError: a number does not fit its field.
        """
        return cls(
            units,
            units.to_counts(motion.start),
            motion.offsets,
            np.rint(motion.duration_s / units.tick_s).astype(np.int64),
            np.rint(motion.velocity_rad_s / units.velocity_rad_s).astype(np.int64),
        )

    def decoded(self) -> SegmentMotion:
        """Return the motion that a perfect positioner makes from these numbers."""
        units = self.units
        columns = self.ticks * units.tick_s, self.velocity * units.velocity_rad_s
        return SegmentMotion.of_valid(units.to_angles(self.start), self.offsets, *columns)

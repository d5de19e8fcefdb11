"""Constant-velocity segments of many joint profiles, in wire units."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core.array_types import Counts, Ints, Offsets
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.fit.linearize import Polylines

__all__ = ["Segments"]

Numbers: TypeAlias = NDArray[np.floating[Any] | np.integer[Any]]  # integers once rounded


@dataclass(frozen=True, eq=False)
class Segments:
    """Constant-velocity segments in wire units, ragged by profile.

    Ticks and velocities are whole numbers once they are rounded, and need not be before.

    Args:
        offsets: first segment of each profile, shape (p + 1,).
        ticks: durations [ticks], shape (m,).
        velocity: joint speeds [velocity units], shape (m,).
    """

    offsets: Offsets
    ticks: Numbers
    velocity: Numbers

    @property
    def counts(self) -> Ints:
        """Number of segments of each profile, shape (p,)."""
        return Parts(self.offsets).counts

    @classmethod
    def none(cls, profiles: int) -> "Segments":
        """Return that many profiles at rest."""
        empty = np.zeros(0, dtype=np.int64)
        return cls(np.zeros(profiles + 1, dtype=np.int64), empty, empty)

    @classmethod
    def along(cls, paths: Polylines, units: WireUnits) -> "Segments":
        """Return the segments that follow each path from time zero, not rounded."""
        first, last = paths.offsets[:-1], paths.offsets[1:] - 1
        ticks = np.diff(paths.time_s, prepend=0.0) / units.tick_s
        quanta = np.diff(paths.angles, prepend=0.0) / units.quantum_rad
        ticks[first], quanta[first] = paths.time_s[first] / units.tick_s, 0.0
        keep = ticks > 0.0
        counts = np.add.reduceat(keep, first) * (last >= first)
        offsets = Parts.from_counts(counts).offsets
        return cls(offsets, ticks[keep], quanta[keep] / ticks[keep])

    def to_wire(self, start: Counts, units: WireUnits) -> WireMotion:
        """Return rounded segments of theta and phi of n robots as a motion in wire units.

        Args:
            start: encoder counts at the start [quanta], shape (n, 2).
            units: size of tick and quantum, and the widths of the fields.

        Raises:
            MotionError: a number does not fit its field.
        """
        ticks = np.rint(self.ticks).astype(np.int64)
        velocity = np.rint(self.velocity).astype(np.int64)
        return WireMotion(units, start, self.offsets, ticks, velocity)

    def rows(self, rows: ArrayLike) -> "Segments":
        """Return some of the profiles alone.

        Args:
            rows: the profiles, shape (r,).
        """
        rows = np.asarray(rows, dtype=np.int64)
        return Segments.none(len(rows)).replaced(np.arange(len(rows)), self, rows)

    def replaced(
        self, rows: ArrayLike, other: "Segments", other_rows: ArrayLike | None = None
    ) -> "Segments":
        """Return these segments with some profiles taken from another set.

        Args:
            rows: profiles that are replaced, shape (r,).
            other: segments of the profiles that replace them.
            other_rows: profiles of `other`, in the order of `rows`, shape (r,); all by default.
        """
        source = np.stack([self.offsets[:-1], self.counts], axis=1)
        others = np.stack([other.offsets[:-1] + len(self.ticks), other.counts], axis=1)
        if other_rows is not None:
            others = others[np.asarray(other_rows, dtype=np.int64)]
        source[np.asarray(rows, dtype=np.int64)] = others
        first, counts = source.T
        parts, pick = Parts.gather(first, counts)
        ticks = np.concatenate([self.ticks, other.ticks]).take(pick)
        return Segments(parts.offsets, ticks, np.concatenate([self.velocity, other.velocity])[pick])

    def without(self, rows: ArrayLike) -> "Segments":
        """Return these segments with some profiles at rest.

        Args:
            rows: the profiles, shape (r,).
        """
        return self.replaced(rows, Segments.none(np.size(rows)))

    def polylines(self, start: ArrayLike, units: WireUnits) -> Polylines:
        """Return the profiles that whole-number segments make.

        Args:
            start: encoder count of each joint at the start [quanta], shape (p,).
            units: size of tick and quantum.
        """
        offsets = self.offsets + np.arange(len(self.offsets))
        first = offsets[:-1]

        def knots(steps: Numbers, at_first: Ints) -> Ints:
            # running sums per profile, begun anew at each first knot
            values = np.zeros(offsets[-1], dtype=np.int64)
            values[np.setdiff1d(np.arange(offsets[-1]), first)] = steps
            running = np.cumsum(values)
            return running + np.repeat(at_first - running[first], self.counts + 1)

        ticks = knots(self.ticks, np.zeros(len(first), dtype=np.int64))
        counts = knots(self.ticks * self.velocity, np.asarray(start))
        return Polylines(offsets, ticks * units.tick_s, units.to_angles(counts))

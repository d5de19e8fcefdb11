"""Constant-velocity segments of many profiles, in wire units."""

from dataclasses import dataclass

import numpy as np

from fiber_core.wire_units import WireUnits
from fiber_discretizer.fit.linearize import Polylines

__all__ = ["Segments"]


@dataclass(frozen=True, eq=False)
class Segments:
    """Constant-velocity segments in wire units, ragged by profile.

    Args:
        offsets: first segment of each profile, shape (p + 1,).
        ticks: durations [ticks], shape (m,).
        velocity: joint speeds [velocity units], shape (m,); both are whole numbers once
            they are rounded, and need not be before.
    """

    offsets: np.ndarray
    ticks: np.ndarray
    velocity: np.ndarray

    @property
    def counts(self) -> np.ndarray:
        """Number of segments of each profile, shape (p,)."""
        return np.diff(self.offsets)

    @classmethod
    def none(cls, profiles: int) -> "Segments":
        """Return that many profiles at rest."""
        nothing = np.zeros(0, dtype=np.int64)
        return cls(np.zeros(profiles + 1, dtype=np.int64), nothing, nothing)

    @classmethod
    def along(cls, paths: Polylines, units: WireUnits) -> "Segments":
        """Return what carries each profile along a path from time zero, nothing rounded."""
        first, last = paths.offsets[:-1], paths.offsets[1:] - 1
        ticks = np.diff(paths.time_s, prepend=0.0) / units.tick_s
        quanta = np.diff(paths.angles, prepend=0.0) / units.quantum_rad
        ticks[first], quanta[first] = paths.time_s[first] / units.tick_s, 0.0
        keep = ticks > 0.0
        counts = np.add.reduceat(keep, first) * (last >= first)
        offsets = np.concatenate([[0], np.cumsum(counts)])
        return cls(offsets, ticks[keep], quanta[keep] / ticks[keep])

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Return ticks and velocity, whole numbers by now, as integers, each of shape (m,)."""
        return np.rint(self.ticks).astype(np.int64), np.rint(self.velocity).astype(np.int64)

    def rows(self, rows) -> "Segments":
        """Return the profiles `rows`, shape (r,), alone."""
        return Segments.none(len(rows)).replaced(np.arange(len(rows)), self, rows)

    def replaced(self, rows, other: "Segments", their_rows=slice(None)) -> "Segments":
        """Return these segments with the profiles `rows`, shape (r,), taken from another set.

        Args:
            rows: profiles replaced.
            other: where they are taken from.
            their_rows: which of its profiles, in this order; all by default.
        """
        source = np.stack([self.offsets[:-1], self.counts], axis=1)
        others = np.stack([other.offsets[:-1] + len(self.ticks), other.counts], axis=1)
        source[rows] = others[their_rows]
        first, counts = source.T
        offsets = np.concatenate([[0], np.cumsum(counts)])
        pick = np.arange(offsets[-1]) + np.repeat(first - offsets[:-1], counts)
        ticks = np.concatenate([self.ticks, other.ticks])[pick]
        return Segments(offsets, ticks, np.concatenate([self.velocity, other.velocity])[pick])

    def without(self, rows) -> "Segments":
        """Return these segments with the profiles `rows`, shape (r,), at rest."""
        return self.replaced(rows, Segments.none(len(rows)))

    def polylines(self, start, units: WireUnits) -> Polylines:
        """Return the profiles these segments make of positions start [quanta], shape (p,)."""
        offsets = self.offsets + np.arange(len(self.offsets))
        first = offsets[:-1]

        def knots(steps, at_first):
            # running sums per profile, begun anew at each first knot
            values = np.zeros(offsets[-1], dtype=np.int64)
            values[np.setdiff1d(np.arange(offsets[-1]), first)] = steps
            running = np.cumsum(values)
            return running + np.repeat(at_first - running[first], np.diff(offsets))

        ticks = knots(self.ticks, np.zeros(len(first), dtype=np.int64))
        counts = knots(self.ticks * self.velocity, np.asarray(start))
        return Polylines(offsets, ticks * units.tick_s, units.to_angles(counts))

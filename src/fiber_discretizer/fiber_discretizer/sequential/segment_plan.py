# SPDX-License-Identifier: Apache-2.0
"""The motion of all robots while it is made, and the pairs that are not proven safe."""

from typing import NamedTuple

import numpy as np

from fiber_core.array_types import Bools, Counts, Floats, Ints, Mask, Rows
from fiber_core.clearance import (
    Safety,
    bodies_of,
    gaps,
    levers_of,
    neighbour_pairs,
    neighbours_of,
    point_speeds,
    unproven,
)
from fiber_core.drive import CurveMotion, carried_out
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.wire_units import WireUnits

__all__ = ["SegmentPlan"]


class Snapshot(NamedTuple):
    """The state of a SegmentPlan at some moment; fields as its attributes."""

    motion: SegmentMotion
    true_motion: SegmentMotion | CurveMotion
    speeds: Floats
    is_rounded: Mask
    unsafe: Bools


class SegmentPlan:
    """The motion of all robots so far; at first all rest.

    Args:
        plane: the focal plane.
        units: size of tick and quantum, and the widths of the fields.
        start: encoder counts at the start [quanta], shape (n, 2).
        safety: gap asked for and timing errors to survive.
        makespan_s: how long any motion may last [s].

    Attributes:
        motion: the motion of all robots.
        is_rounded: robots with segments of whole units, shape (n,).
        unsafe: pairs that are not proven to keep their gap, shape (p,).
        pairs: pairs that can come too close, rows a, b as from neighbour_pairs, shape (p, 2).
        most_required_mm: gap each of these must keep at full speed [mm], shape (p,).
        levers_mm: from levers_of, shape (n, 2).
        bodies: outlines, from bodies_of.
        neighbours: from neighbours_of.
    """

    def __init__(
        self,
        plane: FocalPlane,
        units: WireUnits,
        start: Counts,
        safety: Safety,
        makespan_s: float,
    ):
        self.plane, self.units = plane, units
        self.motion = SegmentMotion.at_rest(units.to_angles(start))
        self._true_motion = carried_out(plane.drive, self.motion)
        self._safety, self._makespan_s = safety, makespan_s + plane.drive.ramp_s
        self.levers_mm = levers_of(plane)
        self._speeds = np.zeros(plane.n)  # bounds of the speeds of the points of each robot [mm/s]
        speeds = point_speeds(self.levers_mm, plane.speeds * plane.enabled[:, None])
        most_mm = safety.at_full_speed_mm(plane, self._makespan_s)
        self.pairs = neighbour_pairs(plane, max(1.0, most_mm))
        self._at_start_mm = gaps(plane, self.pairs, self.motion.start)
        self.most_required_mm = safety.required_at(
            speeds, self._makespan_s, self.pairs, self._at_start_mm, plane.sector
        )
        self.bodies, self.neighbours = bodies_of(plane), neighbours_of(plane.n, self.pairs)
        self.is_rounded = np.ones(plane.n, dtype=bool)
        self.unsafe = np.zeros(len(self.pairs), dtype=bool)

    @property
    def in_conflict(self) -> Mask:
        """Robots in an unsafe pair, shape (n,)."""
        return self.robots_in(np.flatnonzero(self.unsafe))

    def pairs_of(self, rows: Rows) -> Ints:
        """Return the pairs with at least one of some robots, increasing, shape (k,)."""
        _, at = self.neighbours.parts.select(rows)
        found = np.zeros(len(self.pairs), dtype=bool)
        found[self.neighbours.pair[at]] = True
        return np.flatnonzero(found)

    def robots_in(self, pairs: Ints) -> Mask:
        """Return the robots in some pairs, shape (n,).

        Args:
            pairs: the pairs, shape (k,).
        """
        found = np.zeros(self.plane.n + self.plane.fixtures, dtype=bool)
        found[self.pairs[pairs].ravel()] = True
        return found[: self.plane.n]

    def unproven(
        self, pairs: Ints, rows: Rows | None = None, changed: SegmentMotion | None = None
    ) -> Bools:
        """Return whether pairs would be unsafe with another motion of some robots, shape (k,).

        Joints follow the curves that the drive makes of the motion. A pair with a robot that
        would be accelerated harder than it can is unsafe.

        Args:
            pairs: the pairs that are checked, shape (k,).
            rows: robots that would move in another way, shape (m,); none by default.
            changed: their motion, of m robots.
        """
        true_motion, speeds = self._true_motion, self._speeds
        if rows is not None and changed is not None:
            true_motion, speeds = self._with_robots(rows, changed)
        required = self._safety.required_at(
            speeds,
            self._makespan_s,
            self.pairs[pairs],
            self._at_start_mm[pairs],
            self.plane.sector,
        )
        unsafe = unproven(self.bodies, true_motion, self.pairs[pairs], required)
        drive = self.plane.drive
        if drive.ramp_s == 0.0:
            return unsafe
        too_hard = true_motion.hardest > drive.acceleration_rad_s2 * (1 + 1e-9)
        if too_hard.any():
            fixtures = np.zeros(self.plane.fixtures, dtype=bool)
            robots = np.append(too_hard.any(axis=1), fixtures)
            unsafe |= robots[self.pairs[pairs]].any(axis=1)
        return unsafe

    def _with_robots(
        self, rows: Rows, motion: SegmentMotion
    ) -> tuple[SegmentMotion | CurveMotion, Floats]:
        # The true motion of all robots if some of them, m rows, had another motion, of m robots,
        # and a bound of the speeds of their points.
        changed, speeds = carried_out(self.plane.drive, motion), self._speeds.copy()
        speeds[rows] = point_speeds(self.levers_mm[rows], changed.fastest)
        if isinstance(self._true_motion, CurveMotion) and isinstance(changed, CurveMotion):
            return self._true_motion.with_robots(rows, changed), speeds
        return self.motion.with_robots(rows, motion), speeds

    def assign(self, rows: Rows, motion: SegmentMotion, is_rounded: bool = True) -> None:
        """Replace the motion of some robots.

        Args:
            rows: the robots, shape (m,).
            motion: their motion, of m robots.
            is_rounded: whether its segments are of whole units.
        """
        self._true_motion, self._speeds = self._with_robots(rows, motion)
        self.motion = self.motion.with_robots(rows, motion)
        self.is_rounded[rows] = is_rounded
        affected = self.pairs_of(rows)
        self.unsafe[affected] = self.unproven(affected)

    def snapshot(self) -> Snapshot:
        """Return the present state, for `restore`."""
        return Snapshot(
            self.motion, self._true_motion, self._speeds, self.is_rounded.copy(), self.unsafe.copy()
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Undo all that was assigned since a snapshot."""
        self.motion, self._true_motion, self._speeds, self.is_rounded, self.unsafe = snapshot

    def rest(self, robots: Mask) -> None:
        """Let some robots, shape (n,), stay where they are."""
        rows = np.flatnonzero(robots)
        self.assign(rows, SegmentMotion.at_rest(self.motion.start[rows]))

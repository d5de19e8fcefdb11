# SPDX-License-Identifier: Apache-2.0
"""Pairs of robots that come too close on true curves, in the plan and with candidates."""

from dataclasses import dataclass

import numpy as np

from fiber_core.array_types import Bools, Counts, Gaps, Ints, Pairs, Rows
from fiber_core.clearance import (
    Bodies,
    Neighbours,
    Safety,
    bodies_of,
    gaps,
    levers_of,
    neighbour_pairs,
    neighbours_of,
    point_speeds,
    unproven,
)
from fiber_core.drive import CurveMotion
from fiber_core.focal_plane import FocalPlane
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireUnits
from fiber_planner.scheduled.orders import Legs, curves_of

__all__ = ["Conflicts"]


@dataclass(frozen=True, eq=False)
class Conflicts:
    """The pairs of a plane that can come too close, and the gap that each must keep.

    Args:
        plane: the focal plane.
        units: size of tick and quantum.
        start: joint positions at time zero [quanta], shape (n, 2).
        pairs: rows a < b of bodies, shape (p, 2).
        required_mm: gap that they must keep at full speed [mm], shape (p,).
        bodies: outlines.
        neighbours: from neighbours_of.
    """

    plane: FocalPlane
    units: WireUnits
    start: Counts
    pairs: Pairs
    required_mm: Gaps
    bodies: Bodies
    neighbours: Neighbours

    @classmethod
    def of_plane(
        cls, plane: FocalPlane, units: WireUnits, start: Counts, safety: Safety, lasts_s: float
    ) -> "Conflicts":
        """Return the pairs of a plane.

        Args:
            plane: the focal plane; robots that are not enabled rest.
            units: size of tick and quantum.
            start: joint positions at time zero [quanta], shape (n, 2).
            safety: the margin and the timing errors.
            lasts_s: longest duration of the motion [s].
        """
        speeds = point_speeds(levers_of(plane), plane.speeds * plane.enabled[:, None])
        pairs = neighbour_pairs(plane, max(1.0, safety.at_full_speed_mm(plane, lasts_s)))
        moves = np.append(plane.enabled, np.zeros(plane.fixtures, dtype=bool))
        pairs = pairs[moves[pairs].any(axis=1)]
        at_start = gaps(plane, pairs, units.to_angles(start))
        required = safety.required_at(speeds, lasts_s, pairs, at_start, plane.sector)
        near = neighbours_of(plane.n, pairs)
        return cls(plane, units, start, pairs, required, bodies_of(plane), near)

    def curves(self, rows: Rows, legs: Legs, starts: Ints) -> CurveMotion:
        """Return the true curves of some robots, shape (m,), with these legs."""
        drive = self.plane.drive.of_robots(rows)
        return curves_of(drive, self.units, self.start[rows], legs, starts)

    def unsafe(self, motion: CurveMotion, pairs: Ints | None = None) -> Bools:
        """Return whether pairs, by default all, are not proven to keep their gap, shape (k,)."""
        at = np.arange(len(self.pairs)) if pairs is None else pairs
        return unproven(self.bodies, motion, self.pairs[at], self.required_mm[at])

    def of_candidates(
        self, motion: CurveMotion, rows: Rows, curves: CurveMotion
    ) -> tuple[Parts, Ints, Bools]:
        """Return the pairs of candidates with their neighbours, which move as they do.

        Args:
            motion: the motion of all robots.
            rows: the robot of each candidate, shape (m,); one may be there several times.
            curves: the motion of the candidates, of m robots.

        Returns:
            The pairs of each candidate as parts, their numbers and whether they are unsafe, (k,).
        """
        n, m = self.plane.n, len(rows)
        parts, at = self.neighbours.parts.select(rows)
        number, other = self.neighbours.pair[at], self.neighbours.body[at]
        # candidates stand between robots and fixed bodies
        other = np.where(other >= n, other + m, other)
        pairs = np.stack([n + parts.owner, other], axis=1).astype(np.int32)
        order = np.concatenate([np.arange(n), rows, np.arange(n, n + self.plane.fixtures)])
        bodies = Bodies._make(column[order] for column in self.bodies)
        both = _joined(motion, curves)
        return parts, number, unproven(bodies, both, pairs, self.required_mm[number])


def _joined(first: CurveMotion, second: CurveMotion) -> CurveMotion:
    # robots of both motions, one after the other
    columns = ("duration_s", "velocity_rad_s", "acceleration_rad_s2", "angle_rad")
    offsets = np.append(first.offsets, first.offsets[-1] + second.offsets[1:])
    start = np.concatenate([first.start, second.start])
    joined = (np.concatenate([getattr(first, c), getattr(second, c)]) for c in columns)
    return CurveMotion(start, offsets, *joined)

# SPDX-License-Identifier: Apache-2.0
"""Safety: the clearance that is asked for, timing errors included."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Floats, Gaps, Rows
from fiber_core.clearance.distance import gaps
from fiber_core.drive.curves import CurveMotion
from fiber_core.errors import MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

__all__ = ["Safety", "levers_of", "point_speeds"]

_MOST_MARGIN_MM = 1e3  # beyond the pitch of any instrument
_ROUNDING_S = 1e-9  # sums of times in another order
_MEASURED_MM = 1e-3  # more than the tolerance with which a certificate resolves a gap


@dataclass(frozen=True)
class Safety:
    """The gap that must remain between outlines, and the timing errors it must survive.

    Args:
        margin_mm: gap between outlines that must remain at every instant [mm].
        clock_ppm: worst error of a positioner's clock, either way [1e-6].
        start_skew_s: worst difference between the instants at which two positioners
            start, from buses and firmware [s].
        stop_skew_s: worst difference between the instants at which two positioners stop
            when one of them fails on its way [s]. Then the margin may be used up, and
            outlines must not touch.
        border_start_skew_s: worst difference between the instants at which two positioners of
            different sectors start [s].
        border_stop_skew_s: worst difference between the instants at which two positioners of
            different sectors stop when one of them fails on its way [s].

    Raises:
        MotionError: a value is not a number, negative or out of bounds; names it.
    """

    RANGES: ClassVar = {
        "margin_mm": bounds.Range(0.0, _MOST_MARGIN_MM),
        "clock_ppm": bounds.Range(0.0, bounds.MAX_CLOCK_PPM),
        "start_skew_s": bounds.Range(0.0, bounds.MAX_SKEW_S),
        "stop_skew_s": bounds.Range(0.0, bounds.MAX_SKEW_S),
        "border_start_skew_s": bounds.Range(0.0, bounds.MAX_SKEW_S),
        "border_stop_skew_s": bounds.Range(0.0, bounds.MAX_SKEW_S),
    }

    margin_mm: float = 0.05
    clock_ppm: float = 50.0
    start_skew_s: float = 200e-6
    stop_skew_s: float = 4e-3
    border_start_skew_s: float = 2.2e-3
    border_stop_skew_s: float = 29.5e-3

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MotionError)

    def required_mm(
        self, plane: FocalPlane, motion: SegmentMotion | CurveMotion, pairs: ArrayLike
    ) -> Gaps:
        """Return the gap that each pair must keep on the nominal motion [mm], shape (p,).

        Two robots whose clocks are off by up to e and that start up to s apart are where they
        should have been at t_a and t_b, with |t_a - t_b| <= 2 e T + s, T the makespan. No
        point of a robot moves faster than V = |w_theta| reach + |w_phi| reach of the phi
        link, with the highest speeds of this motion. Seen from the instant t_a only b is
        elsewhere, by at most V_b |t_a - t_b|, and from t_b only a: a pair needs
        margin + min(V_a, V_b) (2 e T + s). Robots that stop up to h apart must not touch: a pair
        needs min(V_a, V_b) (2 e T + s + h). Two robots of different sectors of the plane are driven
        by different hosts: for them s and h are those of the border.

        From a pair that starts closer than that, only one robot may move, the other being
        at rest, and it may not come closer: the pair must keep the gap with which it starts.
        Timing does not matter then, as only one of them moves.

        Args:
            plane: the focal plane.
            motion: the nominal motion.
            pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        """
        return self.required_from(plane, motion.start, motion.fastest, motion.makespan_s, pairs)

    def required_from(
        self,
        plane: FocalPlane,
        start_rad: ArrayLike,
        fastest_rad_s: ArrayLike,
        makespan_s: float,
        pairs: ArrayLike,
    ) -> Gaps:
        """Return required_mm of any motion with a given start and given highest speeds.

        Args:
            plane: the focal plane.
            start_rad: joint angles at time zero [rad], shape (n, 2).
            fastest_rad_s: highest speed of each joint [rad/s], shape (n, 2).
            makespan_s: longest duration of the motion [s].
            pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        """
        pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
        speeds = point_speeds(levers_of(plane), fastest_rad_s)
        moves = np.append(speeds > 0.0, np.zeros(plane.fixtures, dtype=bool))
        one_moves = np.flatnonzero(moves[pairs[:, 0]] != moves[pairs[:, 1]])
        at_start = np.full(len(pairs), np.inf)
        if len(one_moves):
            at_start[one_moves] = gaps(plane, pairs[one_moves], start_rad)
        return self.required_at(speeds, makespan_s, pairs, at_start, plane.sector)

    def required_at(
        self,
        speeds_mm_s: ArrayLike,
        makespan_s: float,
        pairs: ArrayLike,
        at_start_mm: ArrayLike = np.inf,
        sector: ArrayLike | None = None,
    ) -> Gaps:
        """Return required_mm of robots with points that move no faster than given speeds.

        Args:
            speeds_mm_s: V of each robot, as from point_speeds [mm/s], shape (n,).
            makespan_s: longest duration of the motion [s].
            pairs: rows a, b as from neighbour_pairs, shape (p, 2).
            at_start_mm: gaps with which the pairs start [mm], shape (p,).
            sector: sector of each robot, shape (n,); by default all are of one.
        """
        a, b = np.asarray(pairs).reshape(-1, 2).T
        n = np.size(speeds_mm_s)
        at_start_mm = np.asarray(at_start_mm)
        speed = np.append(speeds_mm_s, 0.0)  # obstacles stand still
        first, second = speed[np.minimum(a, n)], speed[np.minimum(b, n)]
        start_s, stop_s = self._skews(a, b, n, sector)
        skew_s = 2e-6 * self.clock_ppm * makespan_s + start_s
        going = self.margin_mm + skew_s * np.minimum(first, second)
        stopping = (skew_s + stop_s) * np.minimum(first, second)
        required = np.maximum(going, stopping)
        one_moves = (first > 0.0) != (second > 0.0)
        return np.where(one_moves, np.minimum(required, at_start_mm - _MEASURED_MM), required)

    def _skews(
        self, a: Rows, b: Rows, n: int, sector: ArrayLike | None
    ) -> tuple[Floats | float, Floats | float]:
        """Start and stop skew of pairs [s]."""
        of = np.zeros(n, dtype=np.int64) if sector is None else np.asarray(sector)
        if len(of) == 0 or (of == of[0]).all():
            return self.start_skew_s, self.stop_skew_s
        # an obstacle stands still: timing does not matter beside it
        border = (a < n) & (b < n) & (of[np.minimum(a, n - 1)] != of[np.minimum(b, n - 1)])
        start_s = np.where(border, self.border_start_skew_s, self.start_skew_s)
        return start_s, np.where(border, self.border_stop_skew_s, self.stop_skew_s)

    def check_borders(self, start_s: float, stop_s: float, of: str = "safety") -> None:
        """Check that the skews of borders contain what the sectors of a plane need.

        Args:
            start_s, stop_s: what they need, 0 on a plane of one sector [s].
            of: the parameters that hold these skews, for the error.

        Raises:
            MotionError: a skew is smaller; names it and both values.
        """
        for name, needs_s in (("border_start_skew_s", start_s), ("border_stop_skew_s", stop_s)):
            if getattr(self, name) < needs_s - _ROUNDING_S:
                raise MotionError(
                    f"{of}.{name} is {getattr(self, name):g} s, the terms of the sectors need "
                    f"{needs_s:g} s"
                )

    def anywhere(self, plane: FocalPlane) -> "Safety":
        """Return the safety that asks of every pair what it asks of the pair that needs most.

        Args:
            plane: the focal plane, with its sectors.
        """
        if plane.n == 0 or (plane.sector == plane.sector[0]).all():
            return self
        return replace(
            self,
            start_skew_s=max(self.start_skew_s, self.border_start_skew_s),
            stop_skew_s=max(self.stop_skew_s, self.border_stop_skew_s),
        )

    def at_full_speed_mm(self, plane: FocalPlane, lasts_s: float) -> float:
        """Return the gap that any two robots of a plane must keep at full speed [mm].

        Pairs of different sectors, where there are any, count as all others do.

        Args:
            plane: the focal plane; robots that are not enabled rest.
            lasts_s: longest duration of the motion [s].
        """
        speeds = point_speeds(levers_of(plane), plane.speeds * plane.enabled[:, None])
        fastest = np.repeat(np.argsort(speeds)[-1:], 2)  # twice the same; none without robots
        return float(self.anywhere(plane).required_at(speeds, lasts_s, fastest).max(initial=0.0))


def levers_of(plane: FocalPlane) -> Floats:
    """Return the largest distance of a point of a robot from the axis of each joint [mm], (n, 2).

    Args:
        plane: the focal plane.
    """
    phi_reach = np.hypot(*np.moveaxis(plane.phi_vertices, -1, 0)).max(axis=1)
    return np.stack([plane.reach_mm, phi_reach + plane.phi_radius], axis=1)


def point_speeds(levers_mm: ArrayLike, speed_rad_s: ArrayLike) -> Floats:
    """Return a bound of the speeds of all points of a robot [mm/s], shape (n,).

    Args:
        levers_mm: from levers_of [mm], shape (n, 2).
        speed_rad_s: highest speeds of the joints [rad/s], shape (n, 2).
    """
    return (np.asarray(speed_rad_s) * np.asarray(levers_mm)).sum(axis=1)

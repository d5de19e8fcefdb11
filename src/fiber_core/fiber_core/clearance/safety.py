"""How much clearance is asked for, timing errors included."""

from dataclasses import dataclass

import numpy as np

from fiber_core.clearance.distance import gaps
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

__all__ = ["Safety", "levers_of", "point_speeds"]

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
    """

    margin_mm: float = 0.05
    clock_ppm: float = 50.0
    start_skew_s: float = 200e-6
    stop_skew_s: float = 4e-3

    def required_mm(self, plane: FocalPlane, motion: SegmentMotion, pairs) -> np.ndarray:
        """Gap each pair must keep on the nominal motion [mm], shape (p,).

        Two robots whose clocks are off by up to e and that start up to s apart are where they
        should have been at t_a and t_b, with |t_a - t_b| <= 2 e T + s, T the makespan. No
        point of a robot moves faster than V = |w_theta| reach + |w_phi| reach of the phi
        link, with the highest speeds of this motion. Seen from the instant t_a only b is
        elsewhere, by at most V_b |t_a - t_b|, and from t_b only a: a pair needs
        margin + min(V_a, V_b) (2 e T + s). Stopped up to h apart it must not touch, for which it
        needs min(V_a, V_b) (2 e T + s + h).

        A pair that starts closer than that may only be left by one of the two, the other
        at rest, and without coming closer: the gap it starts with is what it must keep.
        Timing does not matter then, as only one of them moves.

        Args:
            plane: the focal plane.
            motion: the nominal motion.
            pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        """
        profile = np.repeat(np.arange(2 * plane.n), np.diff(motion.offsets))
        fastest = np.zeros(2 * plane.n)
        np.maximum.at(fastest, profile, np.abs(motion.velocity_rad_s))
        fastest = fastest.reshape(-1, 2)
        return self.required_from(plane, motion.start, fastest, motion.makespan_s, pairs)

    def required_from(
        self, plane: FocalPlane, start_rad, fastest_rad_s, makespan_s: float, pairs
    ) -> np.ndarray:
        """As required_mm, for any motion from a start with some highest speeds.

        Args:
            plane: the focal plane.
            start_rad: joint angles at time zero [rad], shape (n, 2).
            fastest_rad_s: highest speed of each joint [rad/s], shape (n, 2).
            makespan_s: how long the motion lasts at most [s].
            pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        """
        pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
        speeds = point_speeds(levers_of(plane), fastest_rad_s)
        moves = np.append(speeds > 0.0, np.zeros(len(plane.obstacles), dtype=bool))
        one_moves = np.flatnonzero(moves[pairs[:, 0]] != moves[pairs[:, 1]])
        at_start = np.full(len(pairs), np.inf)
        if len(one_moves):
            at_start[one_moves] = gaps(plane, pairs[one_moves], start_rad)
        return self.required_at(speeds, makespan_s, pairs, at_start)

    def required_at(self, speeds_mm_s, makespan_s: float, pairs, at_start_mm=np.inf) -> np.ndarray:
        """As required_mm, for robots whose points move no faster than some speeds.

        Args:
            speeds_mm_s: V of each robot, as from point_speeds [mm/s], shape (n,).
            makespan_s: how long the motion lasts at most [s].
            pairs: rows a, b as from neighbour_pairs, shape (p, 2).
            at_start_mm: gaps with which the pairs start [mm], shape (p,).
        """
        a, b = np.asarray(pairs).reshape(-1, 2).T
        n = len(speeds_mm_s)
        speed = np.append(speeds_mm_s, 0.0)  # obstacles stand still
        first, second = speed[np.minimum(a, n)], speed[np.minimum(b, n)]
        skew_s = 2e-6 * self.clock_ppm * makespan_s + self.start_skew_s
        going = self.margin_mm + skew_s * np.minimum(first, second)
        stopping = (skew_s + self.stop_skew_s) * np.minimum(first, second)
        required = np.maximum(going, stopping)
        one_moves = (first > 0.0) != (second > 0.0)
        return np.where(one_moves, np.minimum(required, at_start_mm - _MEASURED_MM), required)


def levers_of(plane: FocalPlane) -> np.ndarray:
    """Return the farthest any point of a robot can be from the axis of each joint [mm], (n, 2)."""
    phi_reach = np.hypot(*np.moveaxis(plane.phi_vertices, -1, 0)).max(axis=1)
    return np.stack([plane.reach_mm, phi_reach + plane.phi_radius], axis=1)


def point_speeds(levers_mm, speed_rad_s) -> np.ndarray:
    """Return how fast any point of a robot may be [mm/s], shape (n,), from both joint speeds."""
    return (np.asarray(speed_rad_s) * levers_mm).sum(axis=1)

"""How much clearance is asked for, timing errors included."""

from dataclasses import dataclass

import numpy as np

from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

__all__ = ["Safety"]


@dataclass(frozen=True)
class Safety:
    """The gap that must remain between outlines, and the timing errors it must survive.

    Args:
        margin_mm: gap between outlines that must remain at every instant [mm].
        clock_ppm: worst error of a positioner's clock, either way [1e-6].
        start_skew_s: worst difference between the instants at which two positioners
            start, from buses and firmware [s].
    """

    margin_mm: float = 0.05
    clock_ppm: float = 50.0
    start_skew_s: float = 200e-6

    def required_mm(self, plane: FocalPlane, motion: SegmentMotion, pairs) -> np.ndarray:
        """Gap each pair must keep on the nominal motion [mm], shape (p,).

        A robot whose clock is off by e and that starts s late is, at time t, where it
        should have been at t + dt with |dt| <= e T + s, T the makespan. No point of it
        moves faster than V = |w_theta| reach + |w_phi| reach of the phi link, with the
        highest speeds of this motion. So a pair (a, b) needs margin + (V_a + V_b) |dt|.

        Args:
            plane: the focal plane.
            motion: the nominal motion.
            pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        """
        profile = np.repeat(np.arange(2 * plane.n), np.diff(motion.offsets))
        fastest = np.zeros(2 * plane.n)
        np.maximum.at(fastest, profile, np.abs(motion.velocity_rad_s))
        return self._required_mm(plane, fastest.reshape(-1, 2), motion.makespan_s, pairs)

    def most_required_mm(self, plane: FocalPlane, makespan_s: float, pairs) -> np.ndarray:
        """Gap enough for any motion within the speed limits that lasts so long [mm], shape (p,)."""
        speeds = np.where(plane.enabled[:, None], plane.speeds, 0.0)
        return self._required_mm(plane, speeds, makespan_s, pairs)

    def _required_mm(self, plane, fastest, makespan_s, pairs):
        phi_reach = np.hypot(*np.moveaxis(plane.phi_vertices, -1, 0)).max(axis=1)
        levers = np.stack([plane.reach_mm, phi_reach + plane.phi_radius], axis=1)
        speed = (fastest * levers).sum(axis=1)
        speed = np.concatenate([speed, np.zeros(len(plane.obstacles))])
        late = self.clock_ppm * 1e-6 * makespan_s + self.start_skew_s
        return self.margin_mm + late * speed[np.asarray(pairs)].sum(axis=1)

"""How much neighbours may approach each other, at the samples of a motion still being changed."""

import numpy as np
from numba import njit

from fiber_core.clearance import bodies_of, pair_gap
from fiber_core.focal_plane import FocalPlane

__all__ = ["FreeSpace", "free_space_mm"]

_LOOSENESS = 0.1  # a sample is passed over while nobody moves farther than this part of the space


class FreeSpace:
    """Free space of every pair at every sample, brought up to date where robots were moved.

    Args:
        plane: the focal plane.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        required_mm: gap each pair must keep [mm], shape (p,).
        angles: joint angles at each sample [rad], shape (n, 2, t).

    Attributes:
        angles: joint angles now [rad], shape (n, 2, t); changed through move only.
    """

    def __init__(self, plane: FocalPlane, pairs, required_mm, angles):
        self.plane, self.pairs, self.required_mm = plane, pairs, required_mm
        self.angles = np.array(angles, dtype=float)
        self._space_mm = np.empty((len(pairs), self.angles.shape[2]))
        self._stale = np.ones(len(pairs), dtype=bool)

    def touching(self, robots: np.ndarray) -> np.ndarray:
        """Return the pairs with at least one of the robots (bool, shape (n,)): bool, (p,)."""
        fixed = np.zeros(len(self.plane.obstacles), dtype=bool)
        return np.append(robots, fixed)[self.pairs].any(axis=1)

    def move(self, robots: np.ndarray, angles: np.ndarray) -> None:
        """Give the robots (bool, shape (n,)) other angles [rad], shape (m, 2, t) or (m, 2, 1)."""
        changed = robots.copy()
        changed[robots] = np.any(self.angles[robots] != angles, axis=(1, 2))
        self.angles[robots] = angles
        self._stale |= self.touching(changed)

    def space_mm(self, which: np.ndarray) -> np.ndarray:
        """Return free_space_mm of some pairs (bool, shape (p,), k of them) [mm], shape (k, t)."""
        redo = np.flatnonzero(self._stale & which)
        _fill(self.plane, self.pairs, redo, self.required_mm, self.angles, self._space_mm)
        self._stale[redo] = False
        return self._space_mm if which.all() else self._space_mm[which]


def free_space_mm(plane: FocalPlane, pairs, required_mm, angles, others=None) -> np.ndarray:
    """Return a lower bound of gap - required gap of each pair at each sample [mm], shape (p, t).

    The bound is exact where the gap is too small, and never below nine tenths of the
    free space: samples are passed over while no point of the two robots has moved by more
    than a tenth of it, because the gap changes by no more than that.

    Args:
        plane: the focal plane.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        required_mm: gap each pair must keep [mm], shape (p,).
        angles: joint angles at each sample [rad], shape (n, 2, t).
        others: joint angles of the second of each pair, where they differ [rad], (n, 2, t).
    """
    space = np.empty((len(pairs), angles.shape[2]))
    rows = np.arange(len(pairs))
    _fill(plane, np.asarray(pairs), rows, required_mm, angles, space, others)
    return space


def _fill(plane, pairs, rows, required_mm, angles, space, others=None):
    pairs = pairs[rows].astype(np.int64)
    reach_phi = np.hypot(*np.moveaxis(plane.phi_vertices, -1, 0)).max(axis=1) + plane.phi_radius
    levers = np.stack([plane.reach_mm, reach_phi], axis=1)
    concerned = np.unique(pairs)
    first = second = (angles, _way_travelled(concerned, levers, angles))
    if others is not None:
        second = (others, _way_travelled(concerned, levers, others))
    _free_space(bodies_of(plane), pairs, rows, required_mm[rows], first, second, space)


@njit(cache=True)
def _way_travelled(bodies, levers, angles):
    # how far any point of a robot can have moved since the first sample
    way = np.zeros((len(angles), angles.shape[2]))
    for i in bodies:
        if i < len(angles):
            for k in range(1, way.shape[1]):
                step = levers[i, 0] * abs(angles[i, 0, k] - angles[i, 0, k - 1])
                step += levers[i, 1] * abs(angles[i, 1, k] - angles[i, 1, k - 1])
                way[i, k] = way[i, k - 1] + step
    return way


@njit(cache=True)
def _free_space(bodies, pairs, rows, required, first, second, space):
    angles_a, all_ways_a = first
    angles_b, all_ways_b = second
    samples = space.shape[1]
    nowhere = np.zeros(samples)
    for i in range(len(pairs)):
        a, b = pairs[i]
        line = space[rows[i]]
        way_a = all_ways_a[a] if a < len(all_ways_a) else nowhere
        way_b = all_ways_b[b] if b < len(all_ways_b) else nowhere
        here = 0
        line[0] = _gap_at(bodies, a, b, angles_a, angles_b, 0) - required[i]
        while here < samples - 1:
            so_far, allowed = way_a[here] + way_b[here], _LOOSENESS * line[here]
            there = here + 1
            while there < samples - 1 and way_a[there + 1] + way_b[there + 1] - so_far <= allowed:
                there += 1
            total = way_a[there] + way_b[there]
            if total == so_far:
                line[there] = line[here]
            else:
                line[there] = _gap_at(bodies, a, b, angles_a, angles_b, there) - required[i]
            for k in range(here + 1, there):
                passed = way_a[k] + way_b[k]
                line[k] = max(line[here] - (passed - so_far), line[there] - (total - passed))
            here = there


@njit(cache=True)
def _gap_at(bodies, a, b, angles_a, angles_b, k):
    theta_a = phi_a = theta_b = phi_b = 0.0
    if a < len(angles_a):
        theta_a, phi_a = angles_a[a, 0, k], angles_a[a, 1, k]
    if b < len(angles_b):
        theta_b, phi_b = angles_b[b, 0, k], angles_b[b, 1, k]
    return pair_gap(bodies, a, b, theta_a, phi_a, theta_b, phi_b)

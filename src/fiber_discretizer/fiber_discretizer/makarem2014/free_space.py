# SPDX-License-Identifier: Apache-2.0
"""How much neighbours may approach each other at the samples of a motion that is still changed."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_core.array_types import Bools, Floats, Ints, Mask, Pairs
from fiber_core.clearance import bodies_of, levers_of, pair_gap
from fiber_core.focal_plane import FocalPlane

__all__ = ["FreeSpace", "free_space_mm"]

_LOOSENESS = 0.1  # samples are skipped while the motion is less than this part of the free space


class FreeSpace:
    """Free space of every pair at every sample, updated where robots change their motion.

    Args:
        plane: the focal plane.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        required_mm: gap each pair must keep [mm], shape (p,).
        angles: joint angles at each sample [rad], shape (n, 2, t).

    Attributes:
        angles: present joint angles [rad], shape (n, 2, t); changed through `move` only.
    """

    def __init__(self, plane: FocalPlane, pairs: Pairs, required_mm: Floats, angles: ArrayLike):
        self.plane, self.pairs, self.required_mm = plane, pairs, required_mm
        self.angles = np.array(angles, dtype=float)
        self._space_mm = np.empty((len(pairs), self.angles.shape[2]))
        self._stale = np.ones(len(pairs), dtype=bool)

    def pairs_with(self, robots: Mask) -> Bools:
        """Return whether each pair has at least one of the robots, shape (p,).

        Args:
            robots: the robots, shape (n,).
        """
        fixed = np.zeros(self.plane.fixtures, dtype=bool)
        return np.any(np.append(robots, fixed)[self.pairs], axis=1)

    def move(self, robots: Mask, angles: Floats) -> None:
        """Replace the angles of some robots.

        Args:
            robots: the robots, shape (n,), m of them.
            angles: their angles [rad], shape (m, 2, t), or (m, 2, 1) at rest.
        """
        changed = robots.copy()
        changed[robots] = np.any(self.angles[robots] != angles, axis=(1, 2))
        self.angles[robots] = angles
        self._stale |= self.pairs_with(changed)

    def space_mm(self, which: Bools) -> Floats:
        """Return the free space of some pairs as free_space_mm does [mm], shape (k, t).

        Args:
            which: the pairs, shape (p,), k of them.
        """
        redo = np.flatnonzero(self._stale & which)
        _fill(self.plane, self.pairs, redo, self.required_mm, self.angles, self._space_mm)
        self._stale[redo] = False
        return self._space_mm if which.all() else self._space_mm[which]


def free_space_mm(
    plane: FocalPlane,
    pairs: ArrayLike,
    required_mm: Floats,
    angles: Floats,
    others: Floats | None = None,
) -> Floats:
    """Return a lower bound of gap - required gap of each pair at each sample [mm], shape (p, t).

    The bound is exact where the gap is too small, and never below nine tenths of the
    free space: samples are skipped while no point of the two robots has moved by more
    than a tenth of it, because the gap changes by no more than that.

    Args:
        plane: the focal plane.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        required_mm: gap each pair must keep [mm], shape (p,).
        angles: joint angles at each sample [rad], shape (n, 2, t).
        others: joint angles of the second robot of each pair, where they differ from
            `angles` [rad], shape (n, 2, t).
    """
    pairs = np.asarray(pairs)
    space = np.empty((len(pairs), angles.shape[2]))
    _fill(plane, pairs, np.arange(len(pairs)), required_mm, angles, space, others)
    return space


def _fill(
    plane: FocalPlane,
    pairs: Pairs,
    rows: Ints,
    required_mm: Floats,
    angles: Floats,
    space: Floats,
    others: Floats | None = None,
) -> None:
    pairs = pairs[rows].astype(np.int64)
    levers, affected = levers_of(plane), np.unique(pairs)
    first = second = (angles, _travel(affected, levers, angles))
    if others is not None:
        second = (others, _travel(affected, levers, others))
    _free_space(bodies_of(plane), pairs, rows, required_mm[rows], first, second, space)


@njit(cache=True)
def _travel(bodies, levers, angles):
    # how far any point of a robot can have moved since the first sample
    travel = np.zeros((len(angles), angles.shape[2]))
    for i in bodies:
        if i < len(angles):
            for k in range(1, travel.shape[1]):
                step = levers[i, 0] * abs(angles[i, 0, k] - angles[i, 0, k - 1])
                step += levers[i, 1] * abs(angles[i, 1, k] - angles[i, 1, k - 1])
                travel[i, k] = travel[i, k - 1] + step
    return travel


@njit(cache=True)
def _free_space(bodies, pairs, rows, required, first, second, space):
    angles_a, travels_a = first
    angles_b, travels_b = second
    samples = space.shape[1]
    at_rest = np.zeros(samples)
    for i in range(len(pairs)):
        a, b = pairs[i]
        line = space[rows[i]]
        travel_a = travels_a[a] if a < len(travels_a) else at_rest
        travel_b = travels_b[b] if b < len(travels_b) else at_rest
        known = 0
        line[0] = _gap_at(bodies, a, b, angles_a, angles_b, 0) - required[i]
        while known < samples - 1:
            so_far, allowed = travel_a[known] + travel_b[known], _LOOSENESS * line[known]
            to = known + 1
            while to < samples - 1 and travel_a[to + 1] + travel_b[to + 1] - so_far <= allowed:
                to += 1
            total = travel_a[to] + travel_b[to]
            if total == so_far:
                line[to] = line[known]
            else:
                line[to] = _gap_at(bodies, a, b, angles_a, angles_b, to) - required[i]
            for k in range(known + 1, to):
                passed = travel_a[k] + travel_b[k]
                line[k] = max(line[known] - (passed - so_far), line[to] - (total - passed))
            known = to


@njit(cache=True)
def _gap_at(bodies, a, b, angles_a, angles_b, k):
    theta_a = phi_a = theta_b = phi_b = 0.0
    if a < len(angles_a):
        theta_a, phi_a = angles_a[a, 0, k], angles_a[a, 1, k]
    if b < len(angles_b):
        theta_b, phi_b = angles_b[b, 0, k], angles_b[b, 1, k]
    return pair_gap(bodies, a, b, theta_a, phi_a, theta_b, phi_b)

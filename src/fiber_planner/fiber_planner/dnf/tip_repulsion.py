# SPDX-License-Identifier: Apache-2.0
"""Repulsion between tips, as in the papers: only tips repel, and only tips are kept apart.

Proof that no two tips ever come within d. Let r > d be the distance of tips i and j at the
start of a step and n the unit vector from j to i. In the step robot i turns its
joints by (h, k) at constant speeds; after the fraction s of it, 0 <= s <= 1, its tip is

    q_i(s) = q_i + s J_i (h, k) + e,    |e| <= s^2 A / 2,    A = l1 h^2 + l2 (h + k)^2

(Taylor: A bounds the second derivative of the tip along the step). So the distance by which
i closes in, -n.(q_i(s) - q_i), is at most s p + s^2 A / 2 with p = -n.J_i (h, k). That bound is
convex in s and zero at s = 0, hence never above max(0, p + A / 2). Robot i shortens
its step by the factor f until

    f p + f^2 A / 2 <= SHARE (r - d),    SHARE < 1/2

holds for each of its neighbours. Its neighbours do the same without knowing its
step, and therefore

    r(s) >= n.(q_i(s) - q_j(s)) >= r - 2 SHARE (r - d) > d

at every instant of the step, not only at its end. If r <= d at the start, f is
such that f p + f^2 A / 2 <= 0 for both: the two may only part.
"""

import math

import numba as nb
import numpy as np
from scipy.spatial import cKDTree

from fiber_core.array_types import Angles, Floats, Ints, Points
from fiber_core.clearance import Neighbours, neighbours_of
from fiber_core.focal_plane import FocalPlane
from fiber_planner.dnf.integrator import longest_step
from fiber_planner.dnf.navigation_function import Contacts, ControlLaw, repulsion, to_joints

__all__ = ["ROUNDING_MM", "SHARE", "TipNeighbours"]

SHARE = 0.4  # share of the free space between two neighbours that one may use up in a step
ROUNDING_MM = 1e-9  # part of the free space that is never used, against rounding


class TipNeighbours:
    """The tips around each robot: their repulsion, and the fraction of a step that they permit.

    An obstacle of radius R acts like a tip at distance (distance of its centre)
    - R + d/2: a tip, a disc of diameter d, never touches its edge.

    Args:
        plane: the focal plane.
        law: the control law.
    """

    def __init__(self, plane: FocalPlane, law: ControlLaw):
        self._plane, self._law = plane, law
        self.immovable = np.zeros(plane.n, dtype=bool)  # a robot that is too near may still part
        shrink = plane.obstacles[:, 2] - law.inner / 2
        self._shrink = np.concatenate([np.zeros(plane.n), shrink])
        places = np.concatenate([plane.centers, plane.obstacles[:, :2]])
        reaches = np.concatenate([plane.arms.sum(axis=1), shrink])
        self._near = _near(places, reaches, law.outer, plane.n)

    def repel(
        self, angles: Angles, elbows: Points, tips: Points, ranks: Floats
    ) -> tuple[Floats, Angles, Contacts]:
        """Return the repulsion on each robot.

        Args:
            angles: joint angles [rad], shape (n, 2); not used.
            elbows: the elbows at those angles [mm], shape (n, 2).
            tips: the tips at those angles [mm], shape (n, 2).
            ranks: ranks of the robots, shape (n,); a robot ignores neighbours of lower rank.

        Returns:
            Potential [1/s], shape (n,), minus its gradient by the robot's own joints
            [rad/s], shape (n, 2), and the contacts, for step_fractions.
        """
        spots = np.concatenate([tips, self._plane.obstacles[:, :2]])
        potential, push = _push(
            spots, self._shrink, self._near,
            elbows, self._plane.centers, ranks, self._law,
        )  # fmt: skip
        return potential, push, (spots, elbows)

    def step_fractions(self, step: Angles, contacts: Contacts) -> tuple[Floats, Ints]:
        """Return the fraction of its step that each robot may make, and the row that limits it.

        The row is that of a neighbour, n and more for an obstacle, and -1 if the robot may
        make its whole step. Both have shape (n,).

        Args:
            step: the steps wanted [rad], shape (n, 2).
            contacts: from repel.
        """
        plane = self._plane
        spots, elbows = contacts
        return _fractions(
            spots, elbows, step, self._shrink, self._near,
            plane.centers, plane.arms, self._law.inner,
        )  # fmt: skip


def _near(places: Points, reaches: Floats, outer: float, n: int) -> Neighbours:
    # All robots and obstacles, rows n and more, that can come within D of a tip of robots 0..n-1.
    pairs = np.zeros((0, 2), dtype=np.int64)
    if n:
        farthest = 2 * max(reaches.max(), 0.0) + outer
        pairs = cKDTree(places).query_pairs(farthest, output_type="ndarray")
    apart = np.hypot(*(places[pairs[:, 0]] - places[pairs[:, 1]]).T)
    return neighbours_of(n, pairs[apart < reaches[pairs].sum(axis=1) + outer], places=places)


@nb.njit(cache=True)
def _push(spots, shrink, near, elbows, centers, ranks, law):
    n, offsets, rows = len(elbows), near.offsets, near.body
    potential, push = np.zeros(n), np.zeros((n, 2))
    for i in range(n):
        x, y = spots[i, 0], spots[i, 1]
        fx = fy = 0.0
        for e in range(offsets[i], offsets[i + 1]):
            j = rows[e]
            if j < n and ranks[j] < ranks[i]:
                continue
            dx, dy = x - spots[j, 0], y - spots[j, 1]
            square = dx * dx + dy * dy
            beyond = max(law.outer + shrink[j], 0.0)
            if square >= beyond * beyond or square == 0.0:
                continue
            length = math.sqrt(square)
            r = max(length - shrink[j], 0.0)
            value, slope = repulsion(r * r, law.lambda2, law.outer, law.inner)
            potential[i] += value
            pull = 2.0 * slope * r / length  # d r^2 / d q = 2 r (unit vector to the tip)
            fx -= pull * dx
            fy -= pull * dy
        push[i] = to_joints(fx, fy, x, y, centers[i], elbows[i])
    return potential, push


@nb.njit(cache=True)
def _fractions(spots, elbows, step, shrink, near, centers, arms, inner):
    offsets, rows = near.offsets, near.body
    fractions, nearest = np.ones(len(elbows)), np.full(len(elbows), -1)
    for i in range(len(elbows)):
        h, k = step[i]
        if h == 0.0 and k == 0.0:
            continue
        x, y = spots[i, 0], spots[i, 1]
        mx = -(y - centers[i, 1]) * h - (y - elbows[i, 1]) * k
        my = (x - centers[i, 0]) * h + (x - elbows[i, 0]) * k
        bend = arms[i, 0] * h * h + arms[i, 1] * (h + k) * (h + k)
        # at a larger r the whole step is permitted
        clear = inner + (math.sqrt(mx * mx + my * my) + 0.5 * bend) / SHARE
        for e in range(offsets[i], offsets[i + 1]):
            j = rows[e]
            dx, dy = x - spots[j, 0], y - spots[j, 1]
            square = dx * dx + dy * dy
            beyond = max(clear + shrink[j], 0.0)
            if square >= beyond * beyond:
                continue
            length = math.sqrt(square)
            closing = -(dx * mx + dy * my) / length if length > 0.0 else 0.0
            allowed = SHARE * (length - shrink[j] - inner - ROUNDING_MM)
            fraction = longest_step(closing, bend, allowed)
            if fraction < fractions[i]:
                fractions[i], nearest[i] = fraction, j
    return fractions, nearest

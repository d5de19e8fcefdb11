# SPDX-License-Identifier: Apache-2.0
"""Repulsion between whole arms: every link repels the links of the neighbours.

Our extension, not in the papers: r of the navigation function becomes d plus the gap between two
outlines less a margin, and the potential of a robot is the sum over all pairs of one of its
links and a link of another body. If the gap at two goals, less the margin, is below D - d it
replaces D - d for that pair, so that the robots rest at their goals.
The gradient of a gap needs only the two nearest points: with n the unit vector from
the neighbour's to the robot's own, d gap = n . (displacement of the own point).

Proof that no gap ever falls to the margin. The outlines are convex hulls of vertices grown by
radii; let g > 0 be the gap less the margin. The hull of robot i lies beyond the line
through its nearest point c across n: n.(v - c) = slack >= 0 for each of its vertices v.
In a step that turns the joints by (h, k), as in tip_repulsion.py, vertex v comes nearer to the
other hull by at most f p + f^2 A / 2, p = -n.J_v (h, k), A = l1 h^2 + |v - elbow| (h + k)^2
(|v - centre| h^2 for a vertex of the theta link). Robot i shortens its step until

    f p + f^2 A / 2 <= SHARE g + slack

for all its vertices and all neighbours, so its hull loses at most SHARE g across n at
any instant of the step; the neighbour loses as much at most, and 2 SHARE < 1. If g <= 0
at the start the right side is slack alone: the gap may only grow.
"""

import math

import numba as nb
import numpy as np

from fiber_core.array_types import Angles, Floats, Ints, Pairs, Points
from fiber_core.clearance import (
    bodies_of,
    gaps,
    levers_of,
    neighbour_pairs,
    neighbours_of,
    point_speeds,
)
from fiber_core.focal_plane import FocalPlane
from fiber_planner.dnf.integrator import longest_step
from fiber_planner.dnf.navigation_function import Contacts, ControlLaw, repulsion
from fiber_planner.dnf.tip_repulsion import ROUNDING_MM, SHARE

__all__ = ["ArmNeighbours"]

# A pair of bodies a, b has four contacts, one for each pair of links: contact c is
# between link c & 1 of a and link c >> 1 of b, where 0 is the phi link, 1 the theta
# link. Its row: gap less the margin (inf: out of range), unit vector from b to a,
# nearest points on the hulls of a and of b.
_CONTACTS = 4
_ROW = 7


class ArmNeighbours:
    """The links around each robot: their repulsion, and the fraction of a step they permit.

    Robots that overlap a neighbour at the start do not move: nearest points, and so the
    gradient, are not defined for them. They are marked in `immovable`, shape (n,).

    Args:
        plane: the focal plane.
        start: joint angles now [rad], shape (n, 2).
        goal: joint angles that each robot aims at [rad], shape (n, 2).
        law: the control law.
        margin_mm: gap to keep [mm].
    """

    def __init__(
        self,
        plane: FocalPlane,
        start: Angles,
        goal: Angles,
        law: ControlLaw,
        margin_mm: float,
    ):
        self._plane, self._law, self._margin = plane, law, margin_mm
        self._bodies = bodies_of(plane)
        # outlines farther apart than this do not repel, and no step can make them touch
        stride = 1.1 * law.dt * point_speeds(levers_of(plane), plane.speeds).max(initial=0.0)
        self._range = max(law.outer - law.inner, stride / SHARE)
        pairs = neighbour_pairs(plane, self._range + margin_mm)
        self._pairs = _by_place(self._bodies.center, pairs, plane.n)
        touching = self._pairs[gaps(plane, self._pairs, start) <= 0.0]
        self.immovable = np.isin(np.arange(plane.n), touching)
        self._near = neighbours_of(plane.n, self._pairs, places=self._bodies.center)
        at_goal = gaps(plane, self._pairs, goal) - margin_mm
        self._outer = law.inner + np.clip(at_goal, 0.0, law.outer - law.inner)

    def repel(
        self, angles: Angles, elbows: Points, tips: Points, ranks: Floats
    ) -> tuple[Floats, Angles, Contacts]:
        """Return the repulsion on each robot.

        Args:
            angles: joint angles [rad], shape (n, 2).
            elbows: the elbows at those angles [mm], shape (n, 2).
            tips: the tips at those angles [mm], shape (n, 2); not used.
            ranks: ranks of the robots, shape (n,); a robot ignores neighbours of lower rank.

        Returns:
            Potential [1/s], shape (n,), minus its gradient by the robot's own joints
            [rad/s], shape (n, 2), and the contacts, for step_fractions.
        """
        plane, bodies = self._plane, self._bodies
        phi, theta, phi_discs, theta_discs = _placed(angles, elbows, bodies)
        contacts = _contacts(
            self._pairs, phi, theta, phi_discs, theta_discs,
            bodies.phi_count, bodies.theta_count, bodies.phi_radius, bodies.theta_radius,
            self._margin, self._range,
        )  # fmt: skip
        potential, push = _push(
            contacts, self._near, self._outer, elbows, plane.centers, ranks, self._law,
        )  # fmt: skip
        return potential, push, (contacts, phi, theta, elbows)

    def step_fractions(self, step: Angles, contacts: Contacts) -> tuple[Floats, Ints]:
        """Return the fraction of its step that each robot may make, and the row that limits it.

        The row is that of a neighbour, n and more for an obstacle, and -1 if the robot may
        make its whole step. Both have shape (n,).

        Args:
            step: the steps wanted [rad], shape (n, 2).
            contacts: from repel.
        """
        bodies = self._bodies
        rows, phi, theta, elbows = contacts
        return _fractions(
            rows, phi, theta, elbows, step, self._near,
            bodies.center, bodies.arm1, bodies.phi_count, bodies.theta_count,
        )  # fmt: skip


def _by_place(centers: Points, pairs: Pairs, n: int) -> Pairs:
    # Pairs with the leftmost robot first, obstacles last: the values of a pair do not depend
    # on the order of the rows.
    a, b = pairs.T.astype(np.int64)
    swap = (b < n) & (
        (centers[a, 0] > centers[b, 0])
        | ((centers[a, 0] == centers[b, 0]) & (centers[a, 1] > centers[b, 1]))
    )
    return np.stack([np.where(swap, b, a), np.where(swap, a, b)], axis=1)


@nb.njit(cache=True)
def _placed(angles, elbows, bodies):
    # vertices of both links of every body in the plane, and circles around them
    n, total = len(angles), len(bodies.center)
    phi = np.empty((total, bodies.phi_vertices.shape[1], 2))
    theta = np.empty((total, bodies.theta_vertices.shape[1], 2))
    phi_discs, theta_discs = np.empty((total, 3)), np.empty((total, 3))
    for i in range(total):
        origin, turn_theta, turn_phi = bodies.center[i], 0.0, 0.0
        if i < n:
            turn_theta, turn_phi = angles[i, 0], angles[i, 0] + angles[i, 1]
        c, s = math.cos(turn_theta), math.sin(turn_theta)
        _turned(bodies.theta_vertices[i], origin, c, s, theta[i])
        _turned(bodies.theta_disc[i : i + 1], origin, c, s, theta_discs[i : i + 1])
        if i < n:
            origin = elbows[i]
        c, s = math.cos(turn_phi), math.sin(turn_phi)
        _turned(bodies.phi_vertices[i], origin, c, s, phi[i])
        _turned(bodies.phi_disc[i : i + 1], origin, c, s, phi_discs[i : i + 1])
        theta_discs[i, 2], phi_discs[i, 2] = bodies.theta_disc[i, 2], bodies.phi_disc[i, 2]
    return phi, theta, phi_discs, theta_discs


@nb.njit(cache=True)
def _turned(points, origin, c, s, out):
    for v in range(len(points)):
        x, y = points[v, 0], points[v, 1]
        out[v, 0] = origin[0] + c * x - s * y
        out[v, 1] = origin[1] + s * x + c * y


@nb.njit(cache=True)
def _contacts(
    pairs, phi, theta, phi_discs, theta_discs,
    phi_count, theta_count, phi_radius, theta_radius, margin, beyond,
):  # fmt: skip
    contacts = np.full((len(pairs), _CONTACTS, _ROW), np.inf)
    for e in range(len(pairs)):
        a, b = pairs[e]
        for c in range(_CONTACTS):
            p_theta, q_theta = c & 1 == 1, c >> 1 == 1
            p_count = theta_count[a] if p_theta else phi_count[a]
            q_count = theta_count[b] if q_theta else phi_count[b]
            if p_count == 0 or q_count == 0:
                continue
            radii = theta_radius[a] if p_theta else phi_radius[a]
            radii += margin + (theta_radius[b] if q_theta else phi_radius[b])
            p_disc = theta_discs[a] if p_theta else phi_discs[a]
            q_disc = theta_discs[b] if q_theta else phi_discs[b]
            x, y = p_disc[0] - q_disc[0], p_disc[1] - q_disc[1]
            far = p_disc[2] + q_disc[2] + radii + beyond
            square = x * x + y * y
            if square >= far * far:
                continue
            p = theta[a] if p_theta else phi[a]
            q = theta[b] if q_theta else phi[b]
            if _apart_along(p, p_count, q, q_count, x, y) > (radii + beyond) * math.sqrt(square):
                continue
            ax, ay, bx, by = _nearest(p, p_count, q, q_count)
            nx, ny = ax - bx, ay - by
            apart = math.sqrt(nx * nx + ny * ny)
            if apart - radii < beyond and apart > 0.0:
                contacts[e, c] = apart - radii, nx / apart, ny / apart, ax, ay, bx, by
    return contacts


@nb.njit(cache=True)
def _apart_along(p, p_count, q, q_count, x, y):
    # how far hull p lies beyond hull q along (x, y), times the length of that vector
    low, high = np.inf, -np.inf
    for v in range(p_count):
        low = min(low, x * p[v, 0] + y * p[v, 1])
    for w in range(q_count):
        high = max(high, x * q[w, 0] + y * q[w, 1])
    return low - high


@nb.njit(cache=True)
def _nearest(p, p_count, q, q_count):
    # nearest points of two hulls that do not meet: a vertex of one is involved
    best = np.inf
    ax = ay = bx = by = 0.0
    for v in range(p_count):
        for w in range(1 if q_count < 3 else q_count):
            x, y = _on_edge(p[v], q[w], q[w + 1 if w + 1 < q_count else 0])
            square = (p[v, 0] - x) ** 2 + (p[v, 1] - y) ** 2
            if square < best:
                best, ax, ay, bx, by = square, p[v, 0], p[v, 1], x, y
    for w in range(q_count):
        for v in range(1 if p_count < 3 else p_count):
            x, y = _on_edge(q[w], p[v], p[v + 1 if v + 1 < p_count else 0])
            square = (q[w, 0] - x) ** 2 + (q[w, 1] - y) ** 2
            if square < best:
                best, ax, ay, bx, by = square, x, y, q[w, 0], q[w, 1]
    return ax, ay, bx, by


@nb.njit(cache=True)
def _on_edge(point, start, end):
    # the point of an edge nearest to a point
    ux, uy = end[0] - start[0], end[1] - start[1]
    square = ux * ux + uy * uy
    along = (point[0] - start[0]) * ux + (point[1] - start[1]) * uy
    share = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    return start[0] + share * ux, start[1] + share * uy


@nb.njit(cache=True)
def _push(contacts, near, outer, elbows, centers, ranks, law):
    n = len(elbows)
    potential, push = np.zeros(n), np.zeros((n, 2))
    for i in range(n):
        for e in range(near.offsets[i], near.offsets[i + 1]):
            j, pair, second = near.body[e], near.pair[e], near.side[e]
            if j < n and ranks[j] < ranks[i]:
                continue
            for c in range(_CONTACTS):
                gap = contacts[pair, c, 0]
                r = law.inner + gap
                if r >= outer[pair]:
                    continue
                value, slope = repulsion(r * r, law.lambda2, outer[pair], law.inner)
                potential[i] += value
                force = -2.0 * r * slope * (1.0 - 2.0 * second)
                fx, fy = force * contacts[pair, c, 1], force * contacts[pair, c, 2]
                x, y = contacts[pair, c, 3 + 2 * second], contacts[pair, c, 4 + 2 * second]
                push[i, 0] += (x - centers[i, 0]) * fy - (y - centers[i, 1]) * fx
                if (c >> second) & 1 == 0:  # phi does not move the theta link
                    push[i, 1] += (x - elbows[i, 0]) * fy - (y - elbows[i, 1]) * fx
    return potential, push


@nb.njit(cache=True)
def _fractions(
    contacts, phi, theta, elbows, step, near,
    centers, arm1, phi_count, theta_count,
):  # fmt: skip
    fractions, nearest = np.ones(len(step)), np.full(len(step), -1)
    for i in range(len(step)):
        h, k = step[i]
        if h == 0.0 and k == 0.0:
            continue
        cx, cy = centers[i, 0], centers[i, 1]
        for e in range(near.offsets[i], near.offsets[i + 1]):
            pair, second = near.pair[e], near.side[e]
            for c in range(_CONTACTS):
                gap = contacts[pair, c, 0]
                if gap == np.inf:
                    continue
                side = 1.0 - 2.0 * second
                nx, ny = side * contacts[pair, c, 1], side * contacts[pair, c, 2]
                x, y = contacts[pair, c, 3 + 2 * second], contacts[pair, c, 4 + 2 * second]
                of_theta = (c >> second) & 1 == 1
                hull = theta[i] if of_theta else phi[i]
                # origin of the link, rotation of the link, second derivative of the origin
                ox, oy = (cx, cy) if of_theta else (elbows[i, 0], elbows[i, 1])
                spin = h if of_theta else h + k
                bend = 0.0 if of_theta else arm1[i] * h * h
                share = SHARE * max(gap - ROUNDING_MM, 0.0)
                for v in range(theta_count[i] if of_theta else phi_count[i]):
                    vx, vy = hull[v, 0], hull[v, 1]
                    lx, ly = vx - ox, vy - oy
                    # displacement: of the origin about the centre, of the vertex about the origin
                    mx = -(oy - cy) * h - ly * spin
                    my = (ox - cx) * h + lx * spin
                    curve = bend + math.sqrt(lx * lx + ly * ly) * spin * spin
                    slack = max(nx * (vx - x) + ny * (vy - y), 0.0)
                    fraction = longest_step(-(nx * mx + ny * my), curve, share + slack)
                    if fraction < fractions[i]:
                        fractions[i], nearest[i] = fraction, near.body[e]
    return fractions, nearest
